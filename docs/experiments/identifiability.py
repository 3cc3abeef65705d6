"""Tables and figure of docs/identifiability.md: identifiable parameters of the telescope, and bias by omitted effects.

    python -m docs.experiments.identifiability

computes everything for the nominal telescope of sample_data/telescope at the 40 configurations of Table 3 of its
report, draws docs/figures/absorption-map.svg and renews the tables of docs/identifiability.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docs.experiments.absorption_map import absorbed_by_leg, draw
from docs.experiments.marked_tables import renew
from docs.experiments.sample_telescope import (
    LEGS,
    NOISE_M,
    SIX,
    closings,
    leg_jacobian,
    leg_observability,
    nominal,
    problem,
    readings,
    scales,
)
from docs.experiments.telescope_report_data import published
from truing.estimation.design.observability import choose_identifiable, indices, inseparable
from truing.simulation.mechanisms.recalibration import recalibrate

DOCS = Path(__file__).resolve().parents[1]
ALL = ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "u_x", "u_y", "l")
SETS = {
    "joints, direction, length": ALL,
    "the same and ρ⁰": (*ALL, "rho0"),
    "without heights": ("a_x", "a_y", "b_x", "b_y", "u_x", "u_y", "l"),
    "the report's, u_x": SIX,
    "the report's, κ": ("a_x", "a_y", "b_x", "b_y", "kappa", "l"),
    "both u_x and κ": ("a_x", "a_y", "b_x", "b_y", "u_x", "l", "kappa"),
}
DRAWS = 300


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
    """Inseparable parameters of each leg, with everything free and the drawing's tolerances."""
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


def table_of_absorption() -> str:
    """Bias of the parameters of each leg by ignoring K, predicted and fitted."""
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
