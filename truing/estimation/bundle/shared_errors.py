"""Split point errors into parts shared by all poses or within one pose, and an independent part of each point."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask
from truing.estimation.bundle.ray_statistics import shared_errors
from truing.estimation.rigid_poses.points import PointErrors
from truing.inference.observations import Epochs

# Common errors that move points by less than this rms, m, are neglected.
_LEAST_EFFECT = 1e-8
# Least share of a point's own covariance that remains after subtracting the common errors.
_LEAST_OWN = 0.05
# Number of common error patterns within a pose (its scale, ..), and least number of points to have any.
MOST_PATTERNS, _FEWEST_POINTS = 6, 4


def with_shared_errors(poses: Epochs, rows: Index, common: Array, errors: PointErrors | None) -> Epochs:
    """Return poses with the shared errors of points as conditions, instead of in the covariance of single points.

    rows (B, K): index among N points, -1 for none; common (N, 3, Q): errors shared by all poses, m per standard
    deviation; ``errors`` correlates the points of each pose.
    """
    measured, conditions = poses.measured, poses.conditions
    known = (rows >= 0)[..., None, None]
    shared = np.where(known, common[rows], 0.0)
    unshared = measured.covariance - shared @ np.swapaxes(shared, -1, -2)
    of_pose = None
    if errors is not None:
        of_pose = np.zeros((*rows.shape, 3, MOST_PATTERNS))
        for pose, of_points in enumerate(rows):
            seen = np.flatnonzero(of_points >= 0)
            if len(seen) < _FEWEST_POINTS:
                continue
            by_common = shared[pose, seen].reshape(3 * len(seen), -1)
            covariance = errors.covariance(of_points[seen]) - by_common @ by_common.T
            shared_patterns = shared_errors(covariance, measured.values[pose, seen], MOST_PATTERNS)
            of_pose[pose, seen, :, : shared_patterns.patterns.shape[-1]] = shared_patterns.patterns
            unshared[pose, seen] = shared_patterns.own
    turned = np.swapaxes(poses.frames.R, 1, 2)[:, None]
    return replace(
        poses,
        measured=replace(measured, covariance=_bounded_below(unshared, measured.covariance, measured.is_observed)),
        conditions=replace(
            conditions,
            common_errors=turned @ shared,
            pose_errors=None if of_pose is None else turned @ of_pose,
        ),
    )


def _bounded_below(variance: Array, total: NDArray[np.floating], is_observed: Mask) -> Array:
    """Return covariances (B, K, 3, 3) of single points, at least a share of the full one in each direction."""
    factor = np.linalg.cholesky(np.where(is_observed[..., None, None], total, np.eye(3)))
    inverse = np.linalg.inv(factor)
    values, vectors = np.linalg.eigh(inverse @ variance @ np.swapaxes(inverse, -1, -2))
    spread = factor @ vectors * np.sqrt(np.maximum(values, _LEAST_OWN))[..., None, :]
    return np.where(is_observed[..., None, None], spread @ np.swapaxes(spread, -1, -2), total)


def independent_errors(by_shared: Array) -> Array:
    """Return the independent combinations (N, 3, Q), m, of common errors (N, 3, G) that move points enough."""
    rows = by_shared.reshape(-1, by_shared.shape[-1])
    values, vectors = np.linalg.eigh(rows.T @ rows)
    mask = values > _LEAST_EFFECT**2 * max(len(rows), 1)
    return np.asarray(by_shared @ vectors[:, mask])
