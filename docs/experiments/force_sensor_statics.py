"""Tables of docs/force-sensor-paper.md on G: its merit, limits of six legs, and the effect of elastic joints."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from docs.experiments.force_sensor_sets import LOADS, SETS, UNITS, published, three_fold
from docs.experiments.marked_tables import table
from truing.simulation.bench.six_upur.geometry import JointCentres, outward
from truing.simulation.bench.six_upur.influence import (
    characteristic_length,
    force_bound,
    influence_matrix,
    influence_with_error,
    merit,
    moments_about,
    sensitivities,
)

BASE_CENTRE = np.array([0.0, 0.0, -0.3])


def row(values: NDArray, digits: int = 3) -> list[str]:
    """Return numbers as cells."""
    return [f"{value:.{digits}f}" for value in values]


def conditions() -> str:
    """Return the condition number of G by the unit of length and the centre of moments."""
    rows = []
    for name, each in SETS.items():
        G = influence_matrix(each.joints())
        length = float(characteristic_length(G))
        raw, scaled = merit(G), merit(G, length)
        at_base = merit(moments_about(G, BASE_CENTRE))
        numbers = [raw.condition, at_base.condition, merit(G, 1e-3).condition, scaled.condition]
        isotropies = [scaled.isotropy, scaled.force_isotropy, scaled.torque_isotropy]
        cells = [f"{number:.4f}" if number < 100 else f"{number:.0f}" for number in numbers]
        rows.append([name, *cells, f"{length:.3f}", *row(np.array(isotropies))])
    head = ["set", "cond(G), m", "the same about the base's centre", "in mm", "moments over the characteristic length"]
    return table([*head, "that length, m", "isotropy", "of forces", "of torques"], rows)


def scaled_sensitivities() -> str:
    """Return the sensitivities of the sets, raw and with moments over the characteristic length."""
    rows = []
    for name, each in SETS.items():
        G = influence_matrix(each.joints())
        length = float(characteristic_length(G))
        rows.append([name, "1 m", *row(merit(G).sensitivity)])
        rows.append([name, f"{length:.3f} m", *row(merit(G, length).sensitivity)])
    return table(["set", "moments over", *(f"S {load}" for load in LOADS)], rows)


def twists() -> str:
    """Return the twists of three-fold legs at which cond(G) is what the paper prints."""
    wanted, rows = published().condition.G, []
    for twist in twists_of(wanted):
        G = influence_matrix(three_fold(20.0, 20.0 + twist).joints())
        rows.append([f"{twist:.4f}", f"{merit(G).condition:.4f}", *row(sensitivities(G))])
    return table(["twist, °", "cond(G), m", *(f"S {load}" for load in LOADS)], rows)


def twists_of(condition: float) -> list[float]:
    """Return all twists between platform and base, degrees up to 90, that give a condition number."""
    grid = np.linspace(0.5, 90.0, 358)
    off = [_condition(twist) - condition for twist in grid]
    found = []
    for low, high, before, after in zip(grid[:-1], grid[1:], off[:-1], off[1:], strict=True):
        if before * after < 0.0:
            found.append(_between(float(low), float(high), condition))
    return found


def _between(low: float, high: float, condition: float) -> float:
    rising = _condition(high) > _condition(low)
    for _ in range(50):
        middle = 0.5 * (low + high)
        above = _condition(middle) > condition
        low, high = (low, middle) if above == rising else (middle, high)
    return low


def _condition(twist: float) -> float:
    return float(merit(influence_matrix(three_fold(20.0, 20.0 + twist).joints())).condition)


def bound() -> str:
    """Return sensitivities in print and of the sets, with the sum that six unit screws bound by 6."""
    printed = published().table4
    entries = {f"{name}, Table 4": np.array(getattr(printed, key)) for name, key in
               (("J", "J"), ("J'", "J_prime"), ("J_B'", "J_B_prime"))}  # fmt: skip
    entries |= {f"J, set {name}": sensitivities(influence_matrix(each.joints())) for name, each in SETS.items()}
    rows = [[name, *row(values), f"{force_bound(values):.2f}"] for name, values in entries.items()]
    return table(["", *(f"S {load}" for load in LOADS), "Σ 1/S² of forces"], rows)


def synthetic() -> str:
    """Return the table of factors by which the largest printed errors change cond(G) and the sensitivities."""
    rows = []
    for name, each in SETS.items():
        plain = merit(influence_matrix(each.joints()))
        displaced = merit(np.concatenate(list(with_errors(each.joints()))))
        by_condition = np.abs(displaced.condition / plain.condition - 1.0).max()
        by_sensitivity = np.abs(displaced.sensitivity / plain.sensitivity - 1.0).max()
        rows.append([f"set {name}", f"{1 + by_condition:.4f}", f"{1 + by_sensitivity:.4f}"])
    printed, sensitivity = published().condition, published().table4
    ratio = np.array(sensitivity.J_prime) / np.array(sensitivity.J)
    rows.append(["in print", f"{printed.G_prime / printed.G:.4f}", f"{ratio.min():.2f} to {ratio.max():.2f}"])
    return table(["G' over G", "condition, factor at most", "sensitivity, factor at most"], rows)


def with_errors(joints: JointCentres) -> NDArray:
    """Return G' of the largest printed displacements with both radii off by their full tolerance, signs in all ways.

    (4, 64, 6, 6): signs of the radii, then of the displacement.
    """
    print_ = published()
    largest = np.abs([print_.maxima.theory, print_.maxima.positive, print_.maxima.negative]).max(0) / UNITS
    displaced = largest * np.array(list(product((-1.0, 1.0), repeat=6)))
    above, below = (1e-6 * width for width in print_.tolerances.full_width_um[:2])
    found = []
    for up, down in product((-1.0, 1.0), repeat=2):
        lower = joints.lower + down * below * outward(joints.lower)
        arm = joints.arm + up * above * outward(joints.arm)
        found.append(influence_with_error(JointCentres(lower, arm, joints.origin), displaced))
    return np.stack(found)


def gauges() -> str:
    """Return the table of the effect of elastic joints on G: legs then carry more than axial forces."""
    rows = []
    for name, each in SETS.items():
        sensor = each.sensor()
        G, elastic = influence_matrix(sensor.joints), np.linalg.inv(sensor.axial_forces)
        off = np.abs(sensor.axial_forces @ G - np.eye(6)).max()
        found, seen = merit(G), merit(elastic)
        cells = [f"{found.condition:.3f}", f"{seen.condition:.3f}", f"{force_bound(seen.sensitivity):.2f}"]
        rows.append([name, *cells, f"{100 * off:.1f} %"])
    head = ["set", "cond(G) of free joints", "of elastic joints", "Σ 1/S² of forces"]
    return table([*head, "largest error of a leg's force by G alone"], rows)
