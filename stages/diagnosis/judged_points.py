"""Which measured points of a body are gross errors, and which labels were exchanged, before anything is diagnosed.

The pose stage rejects whatever does not fit a pose; but a target that was moved, or two labels that were exchanged,
are causes to be found and told, and their points are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.estimation.labels.exchanges import Exchange, exchanges, residuals_once_exchanged
from truing.estimation.rigid_poses.points import PosePoints
from truing.inference.screening import alone_in_time
from truing.simulation.mechanisms.causes.targets import TargetsSwapped
from truing.stages.common.point_arrays import number_column, positions, text_column

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class Judged:
    """Which points (B, T) of a body are kept, and the exchanges of labels among them."""

    kept: NDArray
    exchanges: list[Exchange]


def judged_points(residuals: pa.Table, body: str, found: PosePoints, shape: NDArray, order: NDArray) -> Judged:
    """Judge a body's points (B, T) by the pose stage's residuals; shape (T, 3) m, order (B,) rank of the poses."""
    values, rejected, excluded = _residuals(residuals, body, found)
    seen = found.seen & ~excluded
    sigma = _typical_sigma(found, values, seen)
    swapped = exchanges(values, found.points, seen, shape, sigma)
    values, anew = residuals_once_exchanged(values, found.points, seen, shape, swapped)
    rejected[anew] = False
    for one in swapped:
        rejected[one.pose, [one.first, one.second]] = False
    alone = alone_in_time(np.where(seen[..., None], values, np.nan), order, rejected & seen)
    unknown = rejected & ~np.isfinite(values).all(-1)
    return Judged(seen & ~alone & ~unknown, swapped)


def swapped_targets(
    body: str, targets: Sequence[str], poses: Sequence[int | str], order: NDArray, found: Sequence[Exchange]
) -> list[TargetsSwapped]:
    """Return one cause per pair of targets that bear each other's label, with all poses in which they do."""
    rows: dict[tuple[int, int], list[int]] = {}
    for one in found:
        rows.setdefault((one.first, one.second), []).append(one.pose)
    return [
        TargetsSwapped(
            body,
            (targets[first], targets[second]),
            tuple(poses[row] for row in own),
            tuple(float(order[row]) for row in own),
        )
        for (first, second), own in rows.items()
    ]


def _residuals(table: pa.Table, body: str, found: PosePoints) -> tuple[NDArray, NDArray, NDArray]:
    """Residuals (B, T, 3) in m, body frame, NaN where there is none; rejected, and excluded by a person (B, T)."""
    import pyarrow.compute as pc

    rows = table.filter(pc.equal(table.column("body"), body))
    at = positions(rows.column("pose"), found.poses), positions(rows.column("target"), found.targets)
    known = (at[0] >= 0) & (at[1] >= 0)
    place = at[0][known], at[1][known]
    values = np.full((*found.seen.shape, 3), np.nan)
    rejected, excluded = np.zeros(found.seen.shape, bool), np.zeros(found.seen.shape, bool)
    values[place] = np.column_stack([number_column(rows, f"d{a}_mm") for a in "xyz"])[known] * 1e-3
    rejected[place] = np.asarray(rows.column("rejected").to_pylist(), bool)[known]
    by_person = text_column(rows, "decision") == "excluded"
    excluded[place] = by_person[known]
    return values, rejected, excluded


def _typical_sigma(found: PosePoints, values: NDArray, seen: NDArray) -> float:
    """One standard deviation of a point, m: as declared, or as most residuals are where that is more."""
    declared = np.sqrt(np.median(np.trace(found.cov[seen], axis1=-2, axis2=-1)) / 3) if seen.any() else 0.0
    length = np.sqrt(np.sum(values[seen & np.isfinite(values).all(-1)] ** 2, -1))
    scatter = np.median(length) / 1.538 if len(length) else 0.0  # the median length of three unit normals
    return float(max(np.nan_to_num(declared), scatter, 1e-9))
