"""Figure 14 of the telescope report: accuracy of a calibration by the method that chose its configurations.

    python -m docs.experiments.figure14

simulates every case, draws docs/figures/figure14.svg and renews the tables of docs/design.md. The same numbers on every
run. As in the report: an ideal 6-PUS, guesses 0.5 mm off, 2 um of noise, 17 sets of configurations of each kind.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docs.experiments.chart import Panel, Series, write_chart
from docs.experiments.marked_tables import renew
from docs.experiments.telescope_report_data import published
from truing.calibration.configuration_search import Bounded, DesignProblem, bounded, choose
from truing.estimation.design.pose_order import order_poses
from truing.estimation.design.pose_selection import efficiency, exchange, information_of, sum_log_det
from truing.estimation.rotation import exp_so3
from truing.schemas.campaign import read_campaign
from truing.simulation.mechanisms.legs.kinematics import forward
from truing.simulation.mechanisms.parameters import LegParameter, ParameterSet
from truing.simulation.mechanisms.pose_regressors import Placed
from truing.simulation.mechanisms.recalibration import recalibrate
from truing.stages.configurations.problem import design_problem, limits_of

DOCS = Path(__file__).resolve().parents[1]
SAMPLE = DOCS.parent / "sample_data" / "telescope" / "campaign.toml"
SEVEN = ("a_x", "a_y", "b_x", "b_y", "u_x", "u_y", "l")
METHODS = {"random": "random", "IOOPS-like": "ioops", "direct": "direct", "exchange": "exchange"}
COUNTS = (10, 12, 16, 20, 30, 40)
SETS = 17
DRAWS = 10  # of noise and guess, per set
GUESS, NOISE = 0.5e-3, 2e-6  # m
LEVER = 0.135  # m, the platform's joints from its centre: noise of 2 um there is that of the orientation
TESTED = 200  # poses all over the range


@dataclass(frozen=True)
class Outcome:
    """Accuracies (sets,), m: rms over draws and poses of the distance between predicted and true position."""

    accuracy: NDArray
    lost: NDArray  # (sets,) share of calibrations that found no minimum, which the accuracy leaves out
    share: NDArray  # D-efficiency (sets,)


@cache
def problem(within: str = "actuators") -> DesignProblem:
    """Return the nominal telescope of the sample campaign and the report's seven parameters of each leg."""
    settings = read_campaign(tomllib.loads(SAMPLE.read_text(encoding="utf-8")))
    limits = limits_of(settings, pose_too=within == "workspace", avoid=None, avoid_file="")
    return design_problem(settings, limits, SEVEN, None)


@cache
def candidates(within: str = "actuators") -> Bounded:
    """Return the bound for one measurement; for n it is P log n higher."""
    return bounded(problem(within), 1, None, np.random.default_rng(14))


def chosen(name: str, count: int, rng: np.random.Generator) -> Placed:
    """Return one set of configurations: of exchange, a single search from a random start, as the others are."""
    given = problem()
    if name == "exchange":
        corners = candidates().x[: candidates().corners]
        x = corners[exchange(given.rows_at(corners), _determined(given.rows_at(corners), count, rng)).chosen]
    else:
        x = choose(given, candidates(), METHODS[name], count, None, rng)
    return given.regressors.at(x)


def _determined(rows: NDArray, count: int, rng: np.random.Generator) -> NDArray:
    """Return random candidates that determine every parameter, as ten corners at random may not."""
    while True:
        start = rng.choice(len(rows), count, replace=False)
        if np.isfinite(sum_log_det(information_of(rows[start]))):
            return start


@cache
def simulate(name: str, count: int, sets: int = SETS) -> Outcome:
    """Return the accuracies of calibrations at ``sets`` choices of ``count`` configurations by one method."""
    rng = np.random.default_rng([count, list(METHODS).index(name)])
    return Outcome(*np.array([judged(chosen(name, count, rng), rng) for _ in range(sets)]).T)


def table_3() -> Placed:
    """Return the report's configurations."""
    given = problem()
    return given.placed_at(given.regressors.machine.legs.rho0 + published().calibration)


@cache
def table_3_again(sets: int = SETS) -> Outcome:
    """Return the accuracies of calibrations at the report's configurations, with fresh noise each time."""
    rng = np.random.default_rng(3)
    return Outcome(*np.array([judged(table_3(), rng) for _ in range(sets)]).T)


def judged(placed: Placed, rng: np.random.Generator) -> tuple[float, float, float]:
    """Return the accuracy (m) of calibrations at some configurations, the share lost, and the D-efficiency."""
    given, best = problem(), candidates().upper
    found = sum_log_det(information_of(given.rows(placed))) - given.size * np.log(len(placed.p))
    return *accuracy(placed, rng), efficiency(found, best, given.size)


def accuracy(placed: Placed, rng: np.random.Generator) -> tuple[float, float]:
    """Return the rms error of position, m, all over the range, of machines calibrated at some configurations.

    Second, the share of the calibrations that found no minimum.
    """
    machine = problem().regressors.machine
    legs = machine.legs.count
    names = ParameterSet(tuple(LegParameter(name, leg, "", 1.0) for name in SEVEN for leg in range(legs)))
    true = names.values(machine).reshape(len(SEVEN), legs).T
    p = placed.p + NOISE * rng.normal(size=(DRAWS, *placed.p.shape))
    R = exp_so3(NOISE / LEVER * rng.normal(size=p.shape)) @ placed.R
    start = true + GUESS * rng.normal(size=(DRAWS, *true.shape))
    fits = recalibrate(machine, names, p, R, placed.rho[None], start=start)
    good = fits.ok.all(1)
    identified = names.machine(machine, np.swapaxes(fits.values[good], 1, 2).reshape(good.sum(), 1, -1))
    p_true, rho = tested()
    reached = forward(identified.legs, rho[None])
    wrong = np.sum((reached.p - p_true) ** 2, -1)[reached.converged]
    return float(np.sqrt(np.mean(wrong))), 1.0 - float(good.mean())


@cache
def tested() -> tuple[NDArray, NDArray]:
    """Return positions (TESTED, 3) and readings (TESTED, L), m, all over the range."""
    given = problem()
    placed = given.regressors.at(given.region.draw(TESTED, np.random.default_rng(6)))
    return placed.p, placed.rho


def accuracy_table() -> str:
    """Return accuracies and D-efficiencies, mean and deviation over the sets, as a table of the docs."""
    lines = ["| configurations | " + " | ".join(METHODS) + " |", "| --- |" + " --- |" * len(METHODS)]
    for count in COUNTS:
        cells = [_cell(simulate(name, count)) for name in METHODS]
        lines.append(f"| {count} | {' | '.join(cells)} |")
    lines.append(f"| Table 3 (40) | {_cell(table_3_again())} |" + " |" * (len(METHODS) - 1))
    return "\n".join(lines)


def _cell(outcome: Outcome) -> str:
    um = 1e6 * outcome.accuracy
    lost = f", {100 * outcome.lost.mean():.1f} % lost" if outcome.lost.any() else ""
    return f"{um.mean():.2f} ± {um.std(ddof=1):.2f} µm, {100 * outcome.share.mean():.1f} %{lost}"


def order_table() -> str:
    """Return the table of travel and correlation with time, by trade-off of the order of measurement.

    The order is that of 40 configurations within all limits of the sample.
    """
    given, bound = problem("workspace"), candidates("workspace")
    x = choose(given, bound, "exchange", 40, None, np.random.default_rng(0))
    placed = given.regressors.at(x)
    rho0 = given.regressors.machine.legs.rho0
    groups = np.concatenate([np.moveaxis(given.rows(placed), 1, 0), _drives(placed.rho - rho0)])
    lines = ["| trade-off | travel | of a line in time, imitated by the worst leg |", "| --- | --- | --- |"]
    for share in (0.0, 0.25, 0.5, 0.75, 0.9, 1.0):
        found = order_poses(placed.rho, rho0, groups, np.random.default_rng(0), share)
        lines.append(f"| {share:g} | {1e3 * found.travel:.1f} mm | {100 * found.drift:.1f} % |")
    return "\n".join(
        [*lines, f"| random order | {1e3 * found.random_travel:.1f} mm | {100 * found.random_drift:.1f} % |"]
    )


def _drives(moved: NDArray) -> NDArray:
    return np.pad(moved, ((0, 0), (0, len(SEVEN) - moved.shape[1])))[None]


def draw(path: Path) -> None:
    """Draw accuracy and D-efficiency against the number of configurations, with Table 3."""
    found = {name: [simulate(name, count) for count in COUNTS] for name in METHODS}
    accuracies = {name: [1e6 * outcome.accuracy for outcome in each] for name, each in found.items()}
    shares = {name: [100 * outcome.share for outcome in each] for name, each in found.items()}
    printed = table_3_again()
    panels = [
        _panel("position after calibration", "rms error, µm", accuracies, 1e6 * float(printed.accuracy.mean())),
        _panel("share of the best possible", "D-efficiency, %", shares, 100 * float(printed.share.mean())),
    ]
    write_chart(path, panels, columns=2, x_label="number of configurations")


def _panel(title: str, label: str, values: dict[str, list[NDArray]], printed: float) -> Panel:
    series = [
        Series(name, [float(v.mean()) for v in each], [float(v.std(ddof=1)) for v in each])
        for name, each in values.items()
    ]
    series.append(Series("Table 3", [printed if count == 40 else np.nan for count in COUNTS]))
    return Panel(title, label, list(COUNTS), series)


TABLES = {"accuracy": accuracy_table, "order": order_table}


def main() -> None:
    """Renew the figure and the tables."""
    draw(DOCS / "figures" / "figure14.svg")
    renew(DOCS / "design.md", TABLES)


if __name__ == "__main__":
    main()
