"""Which measured points of a body are gross errors, and which labels were exchanged, before anything is diagnosed.

A fit of poses rejects whatever does not fit a pose; but a target that was moved, or two labels that were exchanged,
are causes to be found and told, and their points are kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.labels.exchanges import Exchange, exchanges, residuals_once_exchanged
from truing.estimation.rigid_poses.points import PointResiduals, PosePoints
from truing.inference.screening import alone_in_time


@dataclass(frozen=True)
class PointSelection:
    """Which points (B, T) of a body are kept, and the exchanges of labels among them."""

    kept: NDArray
    exchanges: list[Exchange]


def select_points(residuals: PointResiduals, found: PosePoints, shape: NDArray, order: NDArray) -> PointSelection:
    """Judge a body's points (B, T) by their residuals; shape (T, 3) m, order (B,) rank of the poses in time."""
    seen = found.seen & ~residuals.excluded
    sigma = _typical_sigma(found, residuals.values, seen)
    swapped = exchanges(residuals.values, found.points, seen, shape, sigma)
    values, anew = residuals_once_exchanged(residuals.values, found.points, seen, shape, swapped)
    rejected = residuals.rejected.copy()
    rejected[anew] = False
    for one in swapped:
        rejected[one.pose, [one.first, one.second]] = False
    alone = alone_in_time(np.where(seen[..., None], values, np.nan), order, rejected & seen)
    unknown = rejected & ~np.isfinite(values).all(-1)
    return PointSelection(seen & ~alone & ~unknown, swapped)


def _typical_sigma(found: PosePoints, values: NDArray, seen: NDArray) -> float:
    """One standard deviation of a point, m: as declared, or as most residuals are where that is more."""
    declared = np.sqrt(np.median(np.trace(found.cov[seen], axis1=-2, axis2=-1)) / 3) if seen.any() else 0.0
    length = np.sqrt(np.sum(values[seen & np.isfinite(values).all(-1)] ** 2, -1))
    scatter = np.median(length) / 1.538 if len(length) else 0.0  # the median length of three unit normals
    return float(max(np.nan_to_num(declared), scatter, 1e-9))
