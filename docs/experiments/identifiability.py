"""What a calibration of the telescope can know, and who swallows what it leaves out: tables and figure of a page.

    python -m docs.experiments.identifiability

computes everything for the nominal telescope of sample_data/telescope at the 40 configurations of Table 3 of its
report, draws docs/figures/absorption-map.svg and renews the tables of docs/identifiability.md.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docs.experiments.heat_map import HeatMap, write_heat_map
from docs.experiments.marked_tables import renew
from docs.experiments.telescope_report_data import published
from truing.estimation.absorption import Absorption, absorb
from truing.estimation.combinations import inseparable
from truing.estimation.identifiable_set import choose_identifiable
from truing.estimation.observability import Observability, indices, observe
from truing.simulation.beam_model import BeamModel
from truing.simulation.calibration_problem import CalibrationProblem
from truing.simulation.kinematic_model import KinematicModel
from truing.simulation.mechanisms import mechanism
from truing.simulation.parameters import Parameter, ParameterSet
from truing.simulation.recalibration import recalibrate
from truing.simulation.structure import Machine, Structure, poses_at

DOCS = Path(__file__).resolve().parents[1]
CAMPAIGN = DOCS.parent / "sample_data" / "telescope" / "campaign.toml"
NOISE_M = 5e-6  # of a leg's closing in one pose
SIX = ("a_x", "a_y", "b_x", "b_y", "u_x", "l")
ALL = ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "u_x", "u_y", "l")
SETS = {
    "joints, direction, length": ALL,
    "the same and ρ⁰": (*ALL, "rho0"),
    "without heights": ("a_x", "a_y", "b_x", "b_y", "u_x", "u_y", "l"),
    "the report's, u_x": SIX,
    "the report's, κ": ("a_x", "a_y", "b_x", "b_y", "kappa", "l"),
    "both u_x and κ": ("a_x", "a_y", "b_x", "b_y", "u_x", "l", "kappa"),
}
RIGID = KinematicModel("6-pus")
LEGS = range(6)
DRAWS = 300


@cache
def nominal() -> Machine:
    """The telescope of the sample campaign, with a rigid platform."""
    legs = tomllib.loads(CAMPAIGN.read_text(encoding="utf-8"))["mechanism"]["legs"]
    arrays = {
        name: np.array([leg[f"{name}_mm"] for leg in legs]) * 1e-3
        for name in ("a", "b", "length", "rho0", "flexure_length")
    }
    geometry = mechanism(
        "6-pus", arrays["a"], arrays["b"], [leg["u"] for leg in legs], arrays["length"], arrays["rho0"]
    )
    return Machine(geometry, np.zeros((6, 6)), flexure_length=arrays["flexure_length"])


@cache
def tolerances() -> dict[str, float]:
    """What the drawing leaves of a, b, l (m), u, by the first letter; of kappa what the published K scatters by."""
    given = tomllib.loads(CAMPAIGN.read_text(encoding="utf-8"))["mechanism"]["tolerance"]
    length = 1e-3 * given["length_mm"]
    return {"a": 1e-3 * given["a_mm"], "b": 1e-3 * given["b_mm"], "l": length, "r": length, "u": given["u"], "k": 0.01}


def parameters(names: tuple[str, ...]) -> ParameterSet:
    """Parameters of every leg, leg by leg."""
    units = {"u": ("1", 1.0), "k": ("1", 1.0)}
    return ParameterSet(
        tuple(Parameter(name, leg, *units.get(name[0], ("mm", 1e-3))) for leg in LEGS for name in names)
    )


def readings() -> NDArray:
    """Actuators (40, 6) at Table 3, m."""
    return nominal().legs.rho0 + published().calibration


def problem(names: tuple[str, ...], truth: Machine | None = None, model: Structure = RIGID) -> CalibrationProblem:
    """The calibration of the rigid telescope on exact poses of a true one."""
    found = poses_at(model, nominal() if truth is None else truth, readings())
    if not found.converged.all():
        raise ArithmeticError("a configuration of Table 3 does not close")
    return CalibrationProblem(RIGID, nominal(), parameters(names), found.p, found.R, readings())


def closings(of: CalibrationProblem) -> tuple[NDArray, NDArray]:
    """Closings (40, 6), m, at nominal values and derivatives (40, 6, P), per unit of the tables: mm and 1."""
    at = of.constrain(of.start, np.zeros((len(of.rho), of.deviations)))
    return at.value, at.by_values * of.parameters.units


def leg_jacobian(names: tuple[str, ...], leg: int) -> NDArray:
    """Whitened derivatives (40, P) of a leg's closings by its own parameters."""
    own = slice(leg * len(names), (leg + 1) * len(names))
    return closings(problem(names))[1][:, leg, own] / NOISE_M


def scales(names: tuple[str, ...], wide: float = 1.0) -> NDArray:
    """Tolerances (P,) of one leg's parameters in the tables' units, or so many times as wide ones."""
    return wide * np.array([tolerances()[name[0]] for name in names]) / parameters(names).units[: len(names)]


def leg_observability(names: tuple[str, ...], leg: int, wide: float = 1.0) -> Observability:
    """What is seen of a leg."""
    labels = [Parameter(name, leg, "", 1.0).label for name in names]
    return observe(leg_jacobian(names, leg), scales(names, wide), labels)


def table_of_sets() -> str:
    """Rank and indices of leg 1 for several sets of parameters."""
    lines = [
        "| parameters of leg 1 | rank | weakest direction, tolerances | condition | O1 | O2 | O3 | O4 | O5 |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for title, names in SETS.items():
        found = leg_observability(names, 0)
        s = found.singular_values
        weakest = f"{1 / s[-1]:.3g}" if s[-1] > found.rounding else "nothing is seen"
        o = indices(np.where(s > found.rounding, s, 0.0), len(readings()))
        figures = " | ".join(f"{value:.2g}" for value in (o.o1, o.o2, o.o3, o.o4, o.o5))
        condition = f"{found.condition:.3g}" if np.isfinite(found.condition) else "∞"
        lines.append(f"| {title}: {len(names)} | {found.rank} | {weakest} | {condition} | {figures} |")
    return "\n".join(lines)


def table_of_combinations() -> str:
    """What cannot be told apart on each leg, with everything free and the drawing's tolerances."""
    lines = ["| leg | unidentifiable: each direction's σ from the data alone, in tolerances |", "| --- | --- |"]
    for leg in LEGS:
        for group in inseparable(leg_observability((*ALL, "rho0"), leg)):
            sigma = ", ".join("∞" if np.isinf(s) else f"{s:.2g}" for s in group.sigma)
            lines.append(f"| {leg + 1} | {group.text} ({sigma}) |")
    return "\n".join(lines)


def table_of_choices() -> str:
    """The maximal identifiable set of each leg, by tolerances."""
    lines = [
        "| leg | within the drawing | ten times as wide | ten times as wide, κ free as well |",
        "| --- | --- | --- | --- |",
    ]
    for leg in LEGS:
        cells = [_chosen(ALL, leg, 1.0), _chosen(ALL, leg, 10.0), _chosen((*ALL, "kappa"), leg, 10.0)]
        lines.append(f"| {leg + 1} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _chosen(names: tuple[str, ...], leg: int, wide: float) -> str:
    return " ".join(choose_identifiable(leg_jacobian(names, leg), scales(names, wide), names).observability.labels)


@cache
def scatter(draws: int = DRAWS) -> tuple[NDArray, NDArray]:
    """Standard deviations (6, P) of simulated calibrations, and those predicted, in the tables' units."""
    of, rng = problem(SIX), np.random.default_rng(1)
    start = closings(of)[0]
    # a reading off by e / (z u) moves the closing by e
    z_u = of.constrain(of.start, np.zeros((len(of.rho), of.deviations))).by_deviation[
        :, LEGS, [6 + leg for leg in LEGS]
    ]
    noisy = of.rho + NOISE_M * rng.normal(size=(draws, *start.shape)) / z_u
    found = recalibrate(nominal(), of.parameters, of.p[None], of.R[None], noisy)
    if not found.ok.all():
        raise ArithmeticError("a simulated calibration did not converge")
    units = of.parameters.units.reshape(6, -1)
    predicted = np.stack([leg_observability(SIX, leg).sigma for leg in LEGS])
    return found.values.std(axis=0) / units, predicted


def table_of_sigmas() -> str:
    """Predicted and simulated standard deviations, and what the tolerances make of them."""
    simulated, predicted = scatter()
    both = np.stack([leg_observability(SIX, leg).sigma_with_prior for leg in LEGS])
    lines = ["| | a_x | a_y | b_x | b_y | u_x | l |", "| --- | --- | --- | --- | --- | --- | --- |"]
    rows = [("tolerance", scales(SIX))]
    for leg in (0, 2):
        rows += [(f"leg {leg + 1}, data alone, predicted", predicted[leg])]
        rows += [(f"leg {leg + 1}, {DRAWS} simulated calibrations", simulated[leg])]
        rows += [(f"leg {leg + 1}, data and tolerances, predicted", both[leg])]
    lines += [f"| {title} | {' | '.join(f'{value:.2g}' for value in row)} |" for title, row in rows]
    return "\n".join(lines)


@dataclass(frozen=True)
class Effect:
    """Something that is true of the telescope and not of the model: its name, and the poses that it leads to."""

    name: str
    truth: Callable[[], CalibrationProblem]


def _deforming(K: NDArray) -> Callable[[], CalibrationProblem]:
    return lambda: problem(SIX, replace(nominal(), deformation=K))


def _changed(**arrays: NDArray) -> Callable[[], CalibrationProblem]:
    return lambda: problem(SIX, replace(nominal(), legs=nominal().legs.replace(**arrays)))


def _gained(gain: float) -> CalibrationProblem:
    of, legs = problem(SIX), nominal().legs
    return replace(of, rho=legs.rho0 + (of.rho - legs.rho0) / (1.0 + gain))


def effects() -> list[Effect]:
    """The effects of the map, at sizes that a laboratory meets."""
    legs, K = nominal().legs, published().K
    turned = np.broadcast_to([0.0, tolerances()["u"], np.sqrt(1 - tolerances()["u"] ** 2)], (6, 3))
    lifted = legs.a + np.array([0.0, 0.0, tolerances()["a"]])
    return [
        Effect("platform\nfollows K", _deforming(K)),
        Effect("K off its\ndiagonal", _deforming(K - np.diag(np.diag(K)))),
        Effect("flexures of\n10 mm bend", lambda: problem(SIX, nominal(), BeamModel())),
        Effect("actuators\ngo 1e-3 far", lambda: _gained(1e-3)),
        Effect("platform\n10 K warmer", _changed(b=legs.b * (1 + 10 * 12e-6))),
        Effect("a_z off by a\ntolerance", _changed(a=lifted)),
        Effect("u_y off by a\ntolerance", _changed(u=turned)),
    ]


def absorbed_by_leg(of: CalibrationProblem) -> list[Absorption]:
    """What the report's parameters of each leg do with the closings that they are not made for."""
    value, slope = closings(of)
    columns = [slice(6 * leg, 6 * leg + 6) for leg in LEGS]
    return [absorb(slope[:, leg, columns[leg]] / NOISE_M, value[:, leg] / NOISE_M, SIX) for leg in LEGS]


@cache
def absorption_map() -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Root mean squares over legs: shifts (P, E) in the tables' units, closings before and after (E,), um; shares."""
    found = [absorbed_by_leg(effect.truth()) for effect in effects()]
    shift = np.array([[leg.shift[:, 0] for leg in legs] for legs in found])
    left = np.array([[np.sqrt(np.mean(leg.left**2)) for leg in legs] for legs in found]) * NOISE_M * 1e6
    share = np.array([[leg.absorbed[0] for leg in legs] for legs in found])
    whole = left / np.sqrt(1 - share)
    rms = [np.sqrt(np.mean(array**2, axis=1)) for array in (shift, whole, left)]
    return rms[0].T, rms[1], rms[2], 1 - (rms[2] / rms[1]) ** 2


def draw(path: Path) -> None:
    """Draw the absorption map."""
    shift, whole, left, share = absorption_map()
    words = [[_word(value, name) for value in row] for name, row in zip(SIX, shift, strict=True)]
    words += [[_small(v) for v in whole], [_small(v) for v in left], [f"{100 * v:.2f} %" for v in share]]
    colour = [*(shift / scales(SIX)[:, None]).tolist(), *([[np.nan] * len(whole)] * 3)]
    write_heat_map(
        path,
        HeatMap(
            "Who swallows what the model leaves out (rms over the six legs)",
            [*SIX, "closing before the fit", "and after it", "absorbed"],
            [effect.name for effect in effects()],
            words,
            colour,
            (0.01, 100.0),
            "shift, tolerances",
        ),
    )


def _word(value: float, name: str) -> str:
    if value < 1e-4 * scales(SIX)[SIX.index(name)]:
        return "nothing"
    return f"{value:.2g}" if name == "u_x" else f"{value:.2g} mm"


def _small(value: float) -> str:
    return f"{value:.2f} µm" if value < 100 else f"{value:.0f} µm"


def table_of_absorption() -> str:
    """What ignoring K does to the parameters of each leg, predicted and fitted."""
    of = problem(SIX, replace(nominal(), deformation=published().K))
    fit = recalibrate(nominal(), of.parameters, of.p[None], of.R[None], of.rho[None])
    if not fit.ok.all():
        raise ArithmeticError("a calibration did not converge")
    fitted = ((fit.values[0] - of.start.reshape(6, -1)) / of.parameters.units.reshape(6, -1)).T
    predicted = np.stack([leg.shift[:, 0] for leg in absorbed_by_leg(of)], axis=1)
    lines = [f"| | {' | '.join(f'leg {leg + 1}' for leg in LEGS)} |", "| --- |" + " --- |" * 6]
    for name, linear, full in zip(SIX, predicted, fitted, strict=True):
        digits = 3 if name == "u_x" else 2
        cells = [f"{a:.{digits}f} → {b:.{digits}f}" for a, b in zip(linear, full, strict=True)]
        lines.append(f"| {name}{'' if name == 'u_x' else ', mm'} | {' | '.join(cells)} |")
    return "\n".join(lines)


TABLES: dict[str, Callable[[], str]] = {
    "sets": table_of_sets,
    "combinations": table_of_combinations,
    "choices": table_of_choices,
    "sigmas": table_of_sigmas,
    "absorption": table_of_absorption,
}


def main() -> None:
    """Renew the figure and the tables."""
    draw(DOCS / "figures" / "absorption-map.svg")
    renew(DOCS / "identifiability.md", TABLES)


if __name__ == "__main__":
    main()
