"""Points of a body over all poses, its survey, and correlated point errors, as dense arrays in m."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from truing.arrays import Array, Index, Mask

LEAST_FRAME = 3  # targets that define a frame
_ROUNDING = 1e-6  # relative to a variance: smaller differences are zero


@dataclass(frozen=True)
class SurveyPoints:
    """One body's survey: targets (T names), points (T, 3) in m in the body frame, cov (T, 3, 3) in m^2, leg (T,), 0 for
    none."""

    targets: tuple[str, ...]
    points: Array
    cov: Array
    leg: Index

    @property
    def frame(self) -> Mask:
        """Mask (T,) of targets that define the body frame: those away from the legs, or all if these are too few."""
        away = self.leg == 0
        return away if away.sum() >= LEAST_FRAME else np.ones_like(away)


@dataclass(frozen=True)
class PosePoints:
    """One body over all poses: poses (B ids), targets (T names), points (B, T, 3) in m as measured, zero if not seen;
    cov (B, T, 3, 3) in m^2; is_observed (B, T)."""

    poses: tuple[int | str, ...]
    targets: tuple[str, ...]
    points: Array
    cov: Array
    is_observed: Mask

    @property
    def variance(self) -> Array:
        """Sum (B, T) of the variances of the three coordinates, in m^2."""
        return np.asarray(np.trace(self.cov, axis1=-2, axis2=-1))

    def block(self, rows: slice | Index) -> PosePoints:
        """Return the points of some poses."""
        return PosePoints(
            some_poses(self.poses, rows), self.targets, self.points[rows], self.cov[rows], self.is_observed[rows]
        )


@dataclass(frozen=True)
class CompactPoints:
    """`PosePoints` without matrices, for many poses: sigma (B, T, 3), or (1, 1, 3) for all, in m; correlation (B, T, 3)
    of xy, xz, yz, or None."""

    poses: tuple[int | str, ...]
    targets: tuple[str, ...]
    points: Array
    sigma: Array
    correlation: Array | None
    is_observed: Mask

    @property
    def variance(self) -> Array:
        """Sum (B, T) of the variances of the three coordinates, in m^2."""
        return np.where(self.is_observed, np.sum(self.sigma * self.sigma, axis=-1), 0.0)

    def block(self, rows: slice | Index) -> PosePoints:
        """Return the points of some poses, with their covariances."""
        is_observed = self.is_observed[rows]
        sigma = np.broadcast_to(self.sigma if len(self.sigma) == 1 else self.sigma[rows], (*is_observed.shape, 3))
        cov = np.zeros((*is_observed.shape, 3, 3))
        for i in range(3):
            cov[..., i, i] = np.where(is_observed, sigma[..., i] * sigma[..., i], 0.0)
        if self.correlation is not None:
            correlation = self.correlation[rows]
            for k, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
                cov[..., i, j] = cov[..., j, i] = np.where(
                    is_observed, correlation[..., k] * sigma[..., i] * sigma[..., j], 0.0
                )
        return PosePoints(some_poses(self.poses, rows), self.targets, self.points[rows], cov, is_observed)


def some_poses(poses: tuple[int | str, ...], rows: slice | Index) -> tuple[int | str, ...]:
    """Return the ids of some poses."""
    return poses[rows] if isinstance(rows, slice) else tuple(poses[row] for row in rows)


@dataclass(frozen=True)
class FittedPoints:
    """Points of a body over B poses, relative to its fitted frame.

    residual (B, T, 3) in m in body axes, NaN for a target not seen or rejected; used (B, T): in the fit; R (B, 3, 3)
    and t (B, 3) in m from the body to the measurement, NaN without a pose.
    """

    points: PosePoints
    residual: Array
    used: Mask
    R: Array
    t: Array

    @property
    def rotation(self) -> Array:
        """Rotation (B, 3, 3) from the body to the measurement, identity without a pose."""
        return np.where(np.isfinite(self.t[:, :1, None]), self.R, np.eye(3))

    @property
    def noise(self) -> Array:
        """Covariance (B, T, 3, 3) of the measured points, in body axes."""
        return np.einsum("bji,btjk,bkl->btil", self.rotation, self.points.cov, self.rotation)


@dataclass(frozen=True)
class PointErrors:
    """Errors of the rows of observations (N), with correlations.

    sigma (N, 3) in m and own (N, 3, 3): correlations within a row; first, second (M,): correlated rows with between (M,
    3, 3), in the order of poses from start (P + 1,), pose (N,) by number; parameters (K) common to all poses with
    effect (N, 3, K) in m of one standard deviation of each.
    """

    pose: Index
    sigma: Array
    own: Array
    first: Index
    second: Index
    between: Array
    start: Index
    parameters: tuple[str, ...]
    effect: Array

    @cached_property
    def is_sampled(self) -> Mask:
        """Mask (P,) of poses in which pairs of some points only are known, because all would be too many."""
        rows = np.bincount(self.pose, minlength=len(self.start) - 1)
        return np.asarray(np.diff(self.start) < rows * (rows - 1) // 2)

    @cached_property
    def is_paired(self) -> Mask:
        """Mask (N,) of rows whose covariance with the other such rows of their pose is known."""
        paired = ~self.is_sampled[self.pose]
        paired[self.first] = paired[self.second] = True
        return np.asarray(paired)

    def covariance(self, rows: Index) -> Array:
        """Return the covariance (3n, 3n) in m^2 of n paired rows of one pose."""
        count = len(rows)
        correlation = np.zeros((count, 3, count, 3))
        each = np.arange(count)
        correlation[each, :, each, :] = self.own[rows]
        pose = self.pose[rows[0]]
        pairs = slice(self.start[pose], self.start[pose + 1])
        index = np.full(len(self.pose), -1)
        index[rows] = each
        a, b = index[self.first[pairs]], index[self.second[pairs]]
        both = (a >= 0) & (b >= 0)
        a, b, between = a[both], b[both], self.between[pairs][both]
        correlation[a, :, b, :] = between
        correlation[b, :, a, :] = np.swapaxes(between, 1, 2)
        sigma = self.sigma[rows].ravel()
        return np.asarray(correlation.reshape(3 * count, 3 * count) * sigma[:, None] * sigma)

    def effects(self, rows: Index) -> Array:
        """Return the effect (3n, K) in m of one standard deviation of each common parameter on n rows."""
        return self.effect[rows].reshape(3 * len(rows), -1)

    def of_each(self, correlation: Array) -> Array:
        """Return the covariance (N, 3, 3) in m^2 of each row without the parameters common to all poses.

        correlation (K, K) of these parameters. The result is the part that differs between poses.
        """
        covariance = self.own * self.sigma[:, :, None] * self.sigma[:, None, :]
        values, vectors = np.linalg.eigh(covariance - self.effect @ correlation @ np.swapaxes(self.effect, 1, 2))
        least = _ROUNDING * np.trace(covariance, axis1=1, axis2=2)
        return np.asarray(vectors * np.maximum(values, least[:, None])[:, None, :] @ np.swapaxes(vectors, 1, 2))


@dataclass(frozen=True)
class PointResiduals:
    """Residuals of a body's points (B, T) from a fit of poses: values (B, T, 3), m, in the body's frame, NaN if
    missing; points rejected by the fit, and excluded by a person."""

    values: Array
    rejected: Mask
    excluded: Mask

    @property
    def fitted(self) -> Mask:
        """Mask of points with a residual that were not rejected."""
        return np.asarray(np.isfinite(self.values).all(-1) & ~self.rejected)


def with_declared_noise(cov: Array, sigma: float) -> Array:
    """Return covariances (..., 3, 3), m^2, with that of a declared sigma, m, for points without their own."""
    known = np.isfinite(cov).all((-1, -2)) & (np.trace(np.nan_to_num(cov), axis1=-2, axis2=-1) > 0)
    return np.where(known[..., None, None], cov, np.eye(3) * sigma**2)
