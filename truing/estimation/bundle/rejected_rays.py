"""What is said of rays that take no part: what the others foretell of them, and why they were left out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.estimation.bundle.adjustment import Adjustment
from truing.estimation.bundle.intersection import Mask
from truing.estimation.bundle.network import Array, Index, Network, State
from truing.estimation.bundle.ray_tests import RayTests
from truing.estimation.bundle.robust_start import meeting, possible_rays, tolerance_px
from truing.estimation.bundle.variance_components import VarianceComponents

GROSS = "gross error: its test value is above the critical value"
ONE_OF_TWO = "one of two rays that do not meet: which is wrong cannot be told"
NO_IMAGE = "its image is not oriented"
NO_POINT = "its point has no coordinates"
BEHIND = "its point lies behind the camera"
NOT_PREDICTED = "rejected, and too few other rays of its point or image are left to tell by how much it is off"
SECOND_TARGET = "meets other rejected rays of its name in another place: a second target bears the name"
NOT_DETERMINED = "its point or its image keeps too few other rays"
_SECOND = 3  # rejected rays that meet elsewhere: two meet too easily
_APART = 5.0  # tolerances from the point's own place


@dataclass(frozen=True)
class RejectedRays:
    """Rays left out: ray (R,) by number, w (R, 2), T (R,) and its p-value (R,), redundancy numbers (R, 2), estimated
    gross error (R, 2) in px, and the reason (R,). Numbers are NaN where the network predicts nothing for a ray."""

    ray: Index
    w: Array
    T: Array
    p_value: Array
    redundancy: Array
    gross_error_px: Array
    reason: tuple[str, ...]


def _elsewhere(adjusted: Adjustment, components: VarianceComponents, rejected: Mask) -> Mask:
    """Return the rejected rays (N,) of points on whose other place at least three of them agree."""
    network, state = adjusted.network, adjusted.state
    rays = network.rays
    limit = max(float(np.median(tolerance_px(network, np.arange(rays.count), components))), 1.0)
    with np.errstate(invalid="ignore"):
        rejected = rejected & (np.linalg.norm(adjusted.residuals_px, axis=1) > _APART * limit)
    rejected &= np.bincount(rays.point[rejected], minlength=len(network.point_pose))[rays.point] >= _SECOND
    out, found = np.flatnonzero(rejected), np.zeros(rays.count, bool)
    if len(out):
        X, agrees = meeting(network, state, out, np.array([limit]))
        found[out] = agrees & (np.bincount(rays.point[out], agrees, minlength=len(X)) >= _SECOND)[rays.point[out]]
    return found


def rejected_rays(
    network: Network, start: State, adjusted: Adjustment, components: VarianceComponents, active: Mask, tests: RayTests
) -> RejectedRays:
    """Return all rays that take no part, with what the others say of them."""
    rays, used = network.rays, adjusted.used
    placed, oriented = np.isfinite(start.points[rays.point, 0]), np.isfinite(start.centre[rays.image, 0])
    on_point = np.bincount(rays.point[used], minlength=len(network.point_pose))[rays.point]
    of_point = np.bincount(rays.point[placed & oriented], minlength=len(network.point_pose))[rays.point]
    gone = np.bincount(rays.point[~active & placed & oriented], minlength=len(network.point_pose))[rays.point] > 0
    reason = np.where(active, NOT_DETERMINED, np.where(np.isnan(tests.T), NOT_PREDICTED, GROSS))
    reason = np.where((of_point == 2) & (on_point < 2) & gone, ONE_OF_TWO, reason)
    reason = np.where(possible_rays(network, start), reason, BEHIND)
    reason = np.where(_elsewhere(adjusted, components, ~used & ~active & placed & oriented), SECOND_TARGET, reason)
    reason = np.where(placed, reason, NO_POINT)
    reason = np.where(oriented, reason, NO_IMAGE)
    out = np.flatnonzero(~used)
    error = np.where(np.isfinite(tests.T)[:, None], adjusted.residuals_px, np.nan)
    return RejectedRays(
        out,
        tests.w[out],
        tests.T[out],
        tests.p_value[out],
        tests.redundancy[out],
        error[out],
        tuple(reason[out].tolist()),
    )
