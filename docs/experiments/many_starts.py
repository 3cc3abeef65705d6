"""Calibrations of the telescope's legs from many start values, by both methods: the minima that they find.

    python -m docs.experiments.many_starts

takes the poses and readings behind sample_data/telescope, calibrates every leg from random starts around its drawing,
and renews the table of docs/solver.md.
"""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from docs.experiments.marked_tables import renew
from docs.experiments.sample_telescope import PROJECT, nominal
from truing.estimation.least_squares.solver import Method
from truing.estimation.rotation import exp_so3
from truing.simulation.mechanisms.parameters import LegParameter, ParameterSet, report_set
from truing.simulation.mechanisms.recalibration import minima_from, nominal_values
from truing.simulation.mechanisms.structures.structure import Machine

METHODS: tuple[Method, ...] = ("levenberg-marquardt", "trust-region")
STARTS = 100
POSITION_M, ORIENTATION_RAD = 2e-6, 1e-5  # noise of a pose
TOLERANCE = {"mm": 5e-4, "1": 2e-3}  # of the drawing, by the unit of a parameter in the tables; m and 1
KAPPA = 0.011


@dataclass(frozen=True)
class Campaign:
    """Nominal telescope, true deformation K, and measured poses (N, 3), (N, 3, 3) and readings (N, 6), m."""

    nominal: Machine
    K: NDArray
    p: NDArray  # (N, 3) m
    R: NDArray  # (N, 3, 3)
    rho: NDArray  # (N, L) m


def sample_campaign() -> Campaign:
    """Return the calibration poses of the sample, with noise of a pose as photogrammetry leaves it."""
    folder = PROJECT / "sample_data"
    truth = json.loads((folder / "telescope.truth.json").read_text(encoding="utf-8"))
    with (folder / "telescope" / "configurations.csv").open(encoding="utf-8") as file:
        roles = {int(row["pose"]): row["role"] for row in csv.DictReader(file)}
    poses = [pose for pose in truth["poses"] if roles[pose["pose"]] == "calibration"]
    entries = truth["effects"][0]["parameters"]
    K = np.array([[entries[f"K{i}{j}"]["value"] for j in range(1, 7)] for i in range(1, 7)])
    p, turn, moved = (
        np.array([pose[name] for pose in poses]) for name in ("p_mm", "rotation_vector_rad", "delta_rho_mm")
    )
    rng = np.random.default_rng(truth["seed"])
    p = p * 1e-3 + POSITION_M * rng.normal(size=p.shape)
    R = exp_so3(ORIENTATION_RAD * rng.normal(size=p.shape)) @ exp_so3(turn)
    return Campaign(nominal(), K, p, R, nominal().legs.rho0 + moved * 1e-3)


def cases(campaign: Campaign) -> dict[str, tuple[Machine, ParameterSet]]:
    """Return machine and identified parameters by the name of the row in the table."""
    legs, none = campaign.nominal.legs, report_set(campaign.nominal, "none")
    both = ParameterSet((*none.entries, *(LegParameter("u_y", leg, "1", 1.0) for leg in range(legs.count))))
    linear, matrix = Machine(legs, KAPPA * np.eye(legs.count)), Machine(legs, campaign.K)
    return {
        "κ, the rest of K known": (matrix, report_set(matrix, "matrix")),
        "κ, the rest of K ignored": (linear, report_set(linear, "linear")),
        "u_x, K ignored": (campaign.nominal, none),
        "u_x and u_y, K ignored": (campaign.nominal, both),
    }


def starts(machine: Machine, parameters: ParameterSet, tolerances: float) -> NDArray:
    """Return starts (S, L, P), evenly within so many tolerances of the drawing."""
    units = [entry.unit for entry in parameters.entries if entry.leg == 0]
    reach = tolerances * np.array([TOLERANCE[unit] for unit in units])
    nominal = nominal_values(machine, parameters)
    return nominal + reach * np.random.default_rng(1).uniform(-1.0, 1.0, (STARTS, *nominal.shape))


def table(campaign: Campaign) -> str:
    """Return shares of the starts that end in the deepest minimum, in another one, or in none, as a table."""
    lines = [
        "| a_x a_y b_x b_y l and | starts within | damping: deepest / other / none | trust region | minima of a leg |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, (machine, parameters) in cases(campaign).items():
        for tolerances in (1, 10, 100):
            begin = starts(machine, parameters, tolerances)
            reach = f"{tolerances * TOLERANCE['mm'] * 1e3:g} mm, {tolerances * TOLERANCE['1']:g}"
            lines.append(f"| {name} | {reach} | {' | '.join(_cells(campaign, machine, parameters, begin))} |")
    return "\n".join(lines)


def _cells(campaign: Campaign, machine: Machine, parameters: ParameterSet, begin: NDArray) -> list[str]:
    found = [
        minima_from(machine, parameters, campaign.p, campaign.R, campaign.rho, begin, method) for method in METHODS
    ]
    deepest = [min(one.cost[0] for one in leg) for leg in zip(*found, strict=True)]
    cells = []
    for method in found:
        low = sum(
            int(leg.reached[leg.cost <= least * (1.0 + 1e-6)].sum()) for leg, least in zip(method, deepest, strict=True)
        )
        failed = sum(leg.failed for leg in method)
        total = STARTS * len(method)
        cells.append(" / ".join(f"{100.0 * n / total:.1f} %" for n in (low, total - low - failed, failed)))
    return [*cells, ", ".join(str(max(len(one.x) for one in leg)) for leg in zip(*found, strict=True))]


def main() -> None:
    """Renew the table."""
    renew(PROJECT / "docs" / "solver.md", {"starts": lambda: table(sample_campaign())})


if __name__ == "__main__":
    main()
