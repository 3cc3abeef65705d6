"""A body's shape from its poses alone, however few targets two poses share and however many were moved between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rigid_poses.rigid import FitStatus, RigidFit
from truing.estimation.rigid_poses.robust import consensus
from truing.estimation.rigid_poses.umeyama import umeyama

# Noise ratios at which poses are taken in: bodies may flex by more than their noise.
_RATIOS = (1.0, 3.0, 10.0, 30.0)
_REFINEMENTS = 10
_SETTLED = 0.01  # of the noise
_TURNS = 3
# Distance, in standard deviations per coordinate of one point, up to which two noisy points are the same.
_LIMIT = 6.0


def common_shape(points: NDArray, mask: NDArray, sigma: float) -> NDArray:
    """Return the shape (N, 3), in m, of targets seen in poses that hang together; NaN for the others.

    points (B, N, 3) in m, mask (B, N), sigma: standard deviation per coordinate of a point, in m. Starts from the pose
    that shares most targets with the others, takes the others in by consensus with the shape so far, those with most
    targets in common first, and puts each target at its median over the poses: where most saw it, if it was moved. Axes
    of the first pose's measurement frame, origin at the mean of its targets. All NaN where no pose has three targets.
    """
    points = np.where(mask[..., None], points, 0.0)
    first = int(np.argmax((mask.astype(float) @ mask.T.astype(float)).sum(axis=1) * (mask.sum(axis=1) >= 3)))
    if mask[first].sum() < 3 or sigma <= 0.0:
        return np.full(points.shape[1:], np.nan)
    known, needed = mask[first].copy(), sigma
    shape = np.where(known[:, None], points[first] - points[first][known].mean(axis=0), 0.0)
    agreed = np.zeros_like(mask)  # which points of which poses agree with the shape
    agreed[first] = known
    for ratio in _RATIOS:
        while _take_in(shape, known, points, mask, agreed, ratio * sigma):
            needed = ratio * sigma
            shape, known = _renewed(shape, known, points, mask, agreed, needed)
    return np.where(known[:, None], _refined(shape, known, points, mask, agreed, needed), np.nan)


def _take_in(shape: NDArray, known: NDArray, points: NDArray, mask: NDArray, agreed: NDArray, sigma: float) -> bool:
    """Add to agreed (B, N) the poses that agree with at least half as many targets as the best; whether any do."""
    rows = np.flatnonzero(~agreed.any(axis=1) & ((mask & known).sum(axis=1) >= 3))
    if not rows.size:
        return False
    source = np.broadcast_to(shape, points[rows].shape)
    inlier, status = consensus(source, points[rows], mask[rows] & known, sigma * np.sqrt(2.0))
    count = np.where(status == FitStatus.OK, inlier.sum(axis=1), 0)
    taken = (count > 0) & (2 * count >= count.max())
    agreed[rows[taken]] = inlier[taken]
    return bool(taken.any())


def _renewed(
    shape: NDArray, known: NDArray, points: NDArray, mask: NDArray, agreed: NDArray, sigma: float
) -> tuple[NDArray, NDArray]:
    """Return the medians (N, 3) over the agreeing poses, on the frame of the shape so far, and which are known (N,).

    Renews agreed (B, N) on the way.
    """
    rows = np.flatnonzero(agreed.any(axis=1))
    fit, agreed[rows] = _followed(shape, points[rows], mask[rows] & known, agreed[rows], sigma)
    seen = mask[rows] & fit.ok[:, None]
    back = (points[rows] - fit.t[:, None]) @ fit.R
    renewed = shape.copy()
    for k in np.flatnonzero(seen.any(axis=0)):
        values = back[seen[:, k], k]
        # an odd number of values: the median is then one of them, not the middle between two places
        renewed[k] = np.median(values[: len(values) - 1 + len(values) % 2], axis=0)
    onto, _ = _followed(renewed, shape[None], known[None], known[None], sigma)
    return (onto.apply(renewed)[0] if onto.ok[0] else renewed), known | seen.any(axis=0)


def _followed(
    shape: NDArray, points: NDArray, usable: NDArray, agreed: NDArray, sigma: float
) -> tuple[RigidFit, NDArray]:
    """Return the motions of the agreeing points, and which points (B, N) agree with them, taken in turns."""
    for _ in range(_TURNS):
        fit = umeyama(shape, points, agreed)
        off = np.linalg.norm(points - fit.apply(shape), axis=-1)
        agreed = np.where(fit.ok[:, None], usable & (off <= _LIMIT * sigma), agreed)
    return umeyama(shape, points, agreed), agreed


def _refined(shape: NDArray, known: NDArray, points: NDArray, mask: NDArray, agreed: NDArray, sigma: float) -> NDArray:
    """Return the shape (N, 3) renewed until it stays."""
    for _ in range(_REFINEMENTS):
        renewed, _ = _renewed(shape, known, points, mask, agreed, sigma)
        change = np.median(np.linalg.norm((renewed - shape)[known], axis=-1))
        shape = renewed
        if change < _SETTLED * sigma:
            break
    return shape
