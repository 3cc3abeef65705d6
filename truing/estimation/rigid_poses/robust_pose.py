"""Default pose estimator: consensus of points, robust against gross errors, then maximum likelihood on agreeing
points."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.estimation.blocks import pose_blocks
from truing.estimation.covariance import apply_rotation, extreme_variances, symmetric
from truing.estimation.rigid_poses.haralick import MEDIAN_LENGTH, lengths, residual_scale
from truing.estimation.rigid_poses.likelihood import maximum_likelihood
from truing.estimation.rigid_poses.rigid import FitStatus, RigidFit, join_fits
from truing.estimation.rigid_poses.robust import chi_square_limit, consensus
from truing.estimation.rotation import rigid_motions
from truing.threads import in_order

# Probability that a pose without gross errors loses any of its points.
FALSE_ALARM = 1e-4
_ROUNDS = 10
_WORTH_ANOTHER_ROUND = 1.2
_FEWEST_POSES = 6
_MOST_PAIRS = 4_000_000  # pairs of points over all poses whose distances are compared
# Share of poses that gross errors may leave without consensus, and the noise ratios tried if there are more.
_WITHOUT_AGREEMENT = 0.02
_WIDER = 1.5 ** np.arange(1, 7)
# Median of the absolute value of a standard normal number.
_MEDIAN_ABSOLUTE = 0.6744897501960817


def robust_pose(
    source: NDArray,
    target: NDArray,
    cov_source: NDArray,
    cov_target: NDArray,
    mask: NDArray,
    *,
    always_used: NDArray | None = None,
    noise_ratio: float = 1.0,
    false_alarm: float = FALSE_ALARM,
) -> tuple[RigidFit, NDArray]:
    """Return the maximum-likelihood motion of the points that agree on one, and the mask (B, N) of these.

    source (N, 3) or (B, N, 3) and target (B, N, 3) in m; their covariances (N, 3, 3) and (B, N, 3, 3) in m^2, mask (B,
    N). A point is kept while its studentised residual passes a chi-square test with the declared noise times
    ``noise_ratio``; points of ``always_used`` (B, N) always enter the last fit. Status as of `consensus` if no set of
    points agrees; even then the mask shows the points that do. Raises ValueError as `maximum_likelihood`.
    """
    mask = np.asarray(mask, bool)
    clouds = (source, target, cov_source, cov_target)
    sigma = noise_ratio * _largest_sigma(cov_source, cov_target, mask)
    members, status = consensus(np.broadcast_to(source, target.shape), target, mask, sigma)
    has_consensus = status == FitStatus.OK
    limit = noise_ratio**2 * chi_square_limit(false_alarm, mask)
    fit = maximum_likelihood(*clouds, members & has_consensus[:, None])
    for _ in range(_ROUNDS):
        passes_test = squared_residuals(fit, *clouds, members) <= limit[:, None]
        renewed = np.where(fit.ok[:, None], mask & passes_test, members)
        if np.array_equal(renewed, members):
            break
        members = renewed
        fit = maximum_likelihood(*clouds, members & has_consensus[:, None], start=fit)
    if always_used is not None and always_used.any():
        members = members | always_used & mask & has_consensus[:, None]
        fit = maximum_likelihood(*clouds, members & has_consensus[:, None], start=fit)
    return replace(fit, status=np.where(has_consensus, fit.status, status)).masked(), members


def squared_residuals(
    fit: RigidFit,
    source: NDArray,
    target: NDArray,
    cov_source: NDArray,
    cov_target: NDArray,
    inliers: NDArray,
) -> NDArray:
    """Return the squared studentised residuals (B, N), chi-square with 3 degrees of freedom for pure noise.

    The fit's own error enlarges the residual of an excluded point and reduces that of a kept one. Zero in entries
    without a pose.
    """
    ok = fit.ok
    R = np.where(ok[:, None, None], fit.R, np.eye(3))
    arm = source @ np.swapaxes(R, -1, -2)
    r = np.where(ok[:, None, None], target - arm - fit.t[:, None], 0.0)
    noise = cov_target + R[:, None] @ cov_source @ np.swapaxes(R, -1, -2)[:, None]
    J = rigid_motions(arm)
    pose = J @ np.where(ok[:, None, None], fit.covariance, 0.0)[:, None] @ np.swapaxes(J, -1, -2)
    residual_cov = symmetric(noise + np.where(inliers, -1.0, 1.0)[..., None, None] * pose)
    floor = 1e-6 * np.trace(noise, axis1=-2, axis2=-1)
    floor = np.where(floor > 0, floor, 1.0)[..., None, None] * np.eye(3)
    return np.einsum("bni,bni->bn", r, apply_rotation(np.linalg.inv(residual_cov + floor), r))


@dataclass(frozen=True)
class RobustBody:
    """One body over many poses, arguments of `robust_poses`.

    source (N, 3), cov_source (N, 3, 3); mask and keep (B, N), as marked by a person; ``points`` returns the target (b,
    N, 3) and its covariances (b, N, 3, 3) in some of the poses.
    """

    source: NDArray
    cov_source: NDArray
    mask: NDArray
    keep: NDArray
    points: Callable[[slice | NDArray], tuple[NDArray, NDArray]]

    def blocks(self, rows: NDArray | None = None) -> list[slice | NDArray]:
        """Return the poses, or some of them by number, in blocks."""
        blocks = pose_blocks(len(self.mask) if rows is None else len(rows), self.mask.shape[1])
        return [block if rows is None else rows[block] for block in blocks]

    def sigma(self) -> NDArray:
        """Return the largest standard deviation (B, N) of each point."""
        sigmas = (_largest_sigma(self.cov_source, self.points(rows)[1], self.mask[rows]) for rows in self.blocks())
        return np.concatenate(list(sigmas))


@dataclass(frozen=True)
class RobustFit:
    """Motions of B poses, the agreeing points (B, N), and the scatter (B,) of all points in units of their noise."""

    fit: RigidFit
    kept: NDArray
    scatter: NDArray


def robust_poses(
    source: NDArray,
    target: NDArray,
    cov_source: NDArray,
    cov_target: NDArray,
    mask: NDArray,
    *,
    always_used: NDArray | None = None,
) -> tuple[RigidFit, NDArray, float]:
    """Return the results of `robust_pose` for one body over many poses, and the ratio of its scatter to the declared
    noise.

    source (N, 3), target (B, N, 3), covariances and masks as there. Underestimated noise, or a body that is not quite
    rigid, is not a gross error: if the poses together scatter more than declared, that scatter is the criterion for
    points. The covariances stay those of the declared noise.
    """
    always_used = np.zeros_like(mask) if always_used is None else always_used
    return fit_robustly(
        RobustBody(source, cov_source, mask, always_used, lambda rows: (target[rows], cov_target[rows]))
    )


def fit_robustly(body: RobustBody) -> tuple[RigidFit, NDArray, float]:
    """Return the results of `robust_poses`."""
    ratio = 1.0
    for _ in range(_ROUNDS):
        blocks = _fit_in_blocks(body, body.blocks(), ratio)
        new_ratio = _noise_ratio(blocks, body)
        if new_ratio < _WORTH_ANOTHER_ROUND * ratio:
            break
        ratio = new_ratio
    enlarged_ratio = _ratio_that_most_poses_need(blocks.fit, body, ratio)
    if enlarged_ratio != ratio:
        blocks = _fit_in_blocks(body, body.blocks(), enlarged_ratio)
    return blocks.fit, blocks.kept, enlarged_ratio


def _fit_in_blocks(body: RobustBody, blocks: Sequence[slice | NDArray], ratio: float) -> RobustFit:
    """Return the results of `robust_pose` in blocks of poses with limited memory."""
    parts = list(in_order(lambda rows: _fit_block(body, rows, ratio), blocks))
    kept, scatter = (np.concatenate(values) for values in zip(*((p.kept, p.scatter) for p in parts), strict=True))
    return RobustFit(join_fits([part.fit for part in parts]), kept, scatter)


def _fit_block(body: RobustBody, rows: slice | NDArray, ratio: float) -> RobustFit:
    target, cov_target = body.points(rows)
    mask, clouds = body.mask[rows], (body.source, target, body.cov_source, cov_target)
    fit, members = robust_pose(*clouds, mask, always_used=body.keep[rows], noise_ratio=ratio)
    distance = lengths(target - fit.apply(body.source))
    scatter = residual_scale(distance / _largest_sigma(body.cov_source, cov_target, mask), mask)
    return RobustFit(fit, members, scatter)


def _ratio_that_most_poses_need(fit: RigidFit, body: RobustBody, ratio: float) -> float:
    """Return the least larger noise ratio with which nearly all poses have a consensus, or the given one. A flexing
    body has longer tails than noise, and three or four targets in one pose do not separate these from gross errors.
    Gross errors stay gross at any moderate ratio."""
    without_consensus = np.flatnonzero(np.isin(fit.status, [str(FitStatus.NO_CONSENSUS), str(FitStatus.AMBIGUOUS)]))
    max_failures = max(1.0, _WITHOUT_AGREEMENT * (body.mask.sum(-1) >= 3).sum())
    if len(without_consensus) <= max_failures:
        return ratio
    for enlarged_ratio in ratio * _WIDER:
        refitted = _fit_in_blocks(body, body.blocks(without_consensus), enlarged_ratio)
        if np.sum(~refitted.fit.ok) <= max_failures:
            return float(enlarged_ratio)
    return ratio


def _noise_ratio(robust_fit: RobustFit, body: RobustBody) -> float:
    """Return the scatter in units of the noise, at least 1, from the poses in which most points agree. If most poses
    have no consensus, it comes from the distances between points."""
    fit, mask = robust_fit.fit, body.mask
    usable = mask.sum(-1) >= 3
    if not usable.any():
        return 1.0
    majority = fit.ok & (2 * robust_fit.kept.sum(-1) > mask.sum(-1))
    if 2 * np.sum(fit.ok & usable) < usable.sum():
        return max(sigma_of_some_poses(body) / float(np.median(body.sigma()[mask])), 1.0)
    return float(max(np.median(robust_fit.scatter[majority]), 1.0)) if majority.any() else 1.0


def scatter_of_lengths(length: NDArray, variance: NDArray, observed: NDArray) -> NDArray:
    """Return tau (N,), in m: scatter of each target over the poses beyond its noise, from its median residual.

    length (B, N) of residuals, m; variance (B, N) per coordinate; observed (B, N). A target is assumed to move along
    one line, so that its movement is not underestimated. Zero if too few poses see it.
    """
    tau = np.zeros(observed.shape[1])
    for k in np.flatnonzero(observed.sum(axis=0) >= _FEWEST_POSES):
        rows = observed[:, k]
        noise = np.median(variance[rows, k]) * MEDIAN_LENGTH**2
        tau[k] = np.sqrt(max(np.median(length[rows, k]) ** 2 - noise, 0.0)) / _MEDIAN_ABSOLUTE
    return tau


def sigma_of_some_poses(body: RobustBody) -> float:
    """Return the result of `sigma_from_distances`, of evenly spaced poses if there are too many pairs of points."""
    poses, targets = body.mask.shape
    max_poses = min(poses, max(1, 2 * _MOST_PAIRS // max(targets * (targets - 1), 1)))
    rows = np.linspace(0, poses - 1, max_poses).astype(np.int64)
    return sigma_from_distances(body.source, body.points(rows)[0], body.mask[rows])


def sigma_from_distances(source: NDArray, target: NDArray, mask: NDArray) -> float:
    """Return the standard deviation per coordinate, in m, from the changes of distances between points.

    source (N, 3), target (B, N, 3), mask (B, N); noise of both clouds together, for undeclared noise. The median over
    all pairs tolerates a quarter of wrong points. Zero without pairs.
    """
    i, j = np.triu_indices(source.shape[-2], 1)
    change = np.linalg.norm(target[:, i] - target[:, j], axis=-1) - np.linalg.norm(source[i] - source[j], axis=-1)
    is_observed = mask[:, i] & mask[:, j]
    return float(np.median(np.abs(change[is_observed])) / _MEDIAN_ABSOLUTE / np.sqrt(2)) if is_observed.any() else 0.0


def _largest_sigma(cov_source: NDArray, cov_target: NDArray, mask: NDArray) -> NDArray:
    """Return the standard deviations (B, N) along the worst direction, both clouds together."""
    used = mask[..., None, None]
    return np.sqrt(sum(extreme_variances(np.where(used, C, np.eye(3)))[1] for C in (cov_source, cov_target)))
