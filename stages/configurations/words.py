"""A choice of configurations in words: what was chosen, how good it is, and beside what."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.estimation.design.design_bound import efficiency
from truing.report.numbers import count as counted
from truing.report.numbers import percent
from truing.simulation.mechanisms.parameters import Parameter
from truing.stages.configurations.chosen import Design, Judged

_UNITS = {"mm": " mm", "1": ""}
_WITHIN = {"workspace": "within the limits of pose and readings in [workspace]", "actuators": "within rho_mm alone"}


def words_of(design: Design) -> list[str]:
    """Return the lines that a design is told in."""
    return [*_chosen(design), *_quality(design), *_sigmas(design), *_order(design), *_existing(design)]


def _chosen(design: Design) -> list[str]:
    wish, names = design.wish, [entry.name for entry in design.problem.names]
    kept = "" if design.kept is None else f" beside {design.kept.count} that are kept"
    held = f" and {wish.verification} for verification" if wish.verification else ""
    first = f"{counted(wish.poses, 'configuration')}{held} by {wish.method}{kept}, {_WITHIN[wish.within]}"
    if design.kept is not None and design.kept.outside:
        first += f" ({design.kept.outside} of those kept lie outside)"
    held = ", ".join(design.problem.held)
    if design.kept is None and "reference" not in design.table.column("role").to_pylist():
        first += "; the reference configuration is forbidden, and left out"
    left = f"; held: {held}, {'not asked for' if wish.parameters else 'not told apart from these'}" if held else ""
    return [
        first,
        f"parameters of each leg: {' '.join(names)} ({len(names)} x {counted(design.problem.legs, 'leg')}){left}",
    ]


def _quality(design: Design) -> list[str]:
    best = design.candidates.upper
    return [
        f"O1 = log det J'J = {design.whole.log_det:.3f} (parameters in tolerances, residuals in their noise: "
        f"{_noise(design)})",
        f"D-efficiency {_percent(design.efficiency)} of the best possible, {best:.3f} ({_bound(design)})",
    ]


def _bound(design: Design) -> str:
    """Return what the bound is about."""
    candidates, size = design.candidates, design.problem.size
    found = f", {candidates.climbed} that climbs between them found" if candidates.climbed else ""
    missed = f", {candidates.unreached} more out of reach" if candidates.unreached else ""
    points = f"{counted(candidates.corners, 'corner')} of the range, {counted(candidates.dense, 'point')} in it"
    over = f"equivalence theorem over {points}{missed}{found}"
    if candidates.raised <= 1e-9 * size:
        return f"{over}; climbs find nothing more sensitive"
    return f"{over}; raised by the {percent(100 * float(np.expm1(candidates.raised / size)))} that climbs find beyond"


def _noise(design: Design) -> str:
    least, most = design.problem.noise.min() * 1e6, design.problem.noise.max() * 1e6
    size = f"{least:.2f} um" if most - least < 0.005 else f"{least:.2f} to {most:.2f} um"
    return f"{size}, {design.problem.noise_from}"


def _percent(share: float) -> str:
    return f"{100 * share:.2f} %"


def _sigmas(design: Design) -> list[str]:
    """Return the table of predicted standard deviations: best and worst leg of each parameter."""
    lines = ["predicted sigma of   best leg           worst leg          tolerance"]
    return lines + [_sigma_line(design, k, entry) for k, entry in enumerate(design.problem.names)]


def _sigma_line(design: Design, k: int, entry: Parameter) -> str:
    tolerance = design.problem.tolerance[k]
    sigma = predicted_sigma(design.whole)[:, k] * tolerance / entry.si
    best, worst = int(np.argmin(sigma)), int(np.argmax(sigma))
    unit = _UNITS[entry.unit]
    cells = [f"{sigma[leg]:.3g}{unit} (leg {leg + 1})" for leg in (best, worst)]
    return f"  {entry.name:18} {cells[0]:18} {cells[1]:18} {tolerance / entry.si:.3g}{unit}"


def predicted_sigma(found: Judged) -> NDArray:
    """Return the standard deviations (L, q), in tolerances, that data alone will leave."""
    return np.sqrt(np.diagonal(np.linalg.inv(found.information), axis1=1, axis2=2))


def _order(design: Design) -> list[str]:
    order = design.order
    return [
        f"travel {order.travel * 1e3:.1f} mm in this order, {order.random_travel * 1e3:.1f} mm in a random one "
        "(the longest drive of each move)",
        f"drift: of a line in time, regressors of the worst leg can imitate {_percent(order.drift)} "
        f"({_percent(order.random_drift)} in a random order)",
    ]


def _existing(design: Design) -> list[str]:
    found, share = design.existing, design.existing_efficiency
    if found is None or share is None:
        return []
    line = (
        f"the campaign's own {counted(found.count, 'pose')}: O1 = {found.log_det:.3f}, "
        f"{_percent(share)} of the best of as many"
    )
    if found.outside:
        line += f"; {found.outside} of them lie outside of these limits, which the bound is not about"
    alike = design.whole.log_det + design.problem.size * np.log(found.count / design.whole.count)
    ratio = efficiency(alike, found.log_det, design.problem.size)
    return [line, f"one chosen pose tells as much as {ratio:.2f} of the campaign's own"]
