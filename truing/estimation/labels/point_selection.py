"""Gross errors and exchanged labels among a body's measured points, before the diagnosis.

A fit of poses rejects every point that does not fit. A moved target and exchanged labels are causes that the diagnosis
must find, so their points are kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.labels.exchanges import Exchange, exchanges, residuals_after_exchange
from truing.estimation.rigid_poses.points import PointResiduals, PosePoints
from truing.inference.screening import alone_in_time


@dataclass(frozen=True)
class PointSelection:
    """Mask (B, T) of a body's kept points, and the exchanges of labels among them."""

    kept: NDArray
    exchanges: list[Exchange]


def select_points(residuals: PointResiduals, pose_points: PosePoints, shape: NDArray, order: NDArray) -> PointSelection:
    """Return the selection of a body's points (B, T) from their residuals; shape (T, 3) m, order (B,): rank of the
    poses in time."""
    is_observed = pose_points.is_observed & ~residuals.excluded
    sigma = _typical_sigma(pose_points, residuals.values, is_observed)
    swapped = exchanges(residuals.values, pose_points.points, is_observed, shape, sigma)
    values, is_refitted = residuals_after_exchange(residuals.values, pose_points.points, is_observed, shape, swapped)
    rejected = residuals.rejected.copy()
    rejected[is_refitted] = False
    for exchange in swapped:
        rejected[exchange.pose, [exchange.first, exchange.second]] = False
    alone = alone_in_time(np.where(is_observed[..., None], values, np.nan), order, rejected & is_observed)
    unknown = rejected & ~np.isfinite(values).all(-1)
    return PointSelection(is_observed & ~alone & ~unknown, swapped)


def _typical_sigma(pose_points: PosePoints, values: NDArray, is_observed: NDArray) -> float:
    """Return the standard deviation of a point, m: as declared, or that of most residuals if larger."""
    declared = (
        np.sqrt(np.median(np.trace(pose_points.cov[is_observed], axis1=-2, axis2=-1)) / 3) if is_observed.any() else 0.0
    )
    length = np.sqrt(np.sum(values[is_observed & np.isfinite(values).all(-1)] ** 2, -1))
    scatter = np.median(length) / 1.538 if len(length) else 0.0  # the median length of three unit normals
    return float(max(np.nan_to_num(declared), scatter, 1e-9))
