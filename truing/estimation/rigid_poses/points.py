"""Points of a body over all poses, its survey, and the errors that points have in common: dense arrays in m."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.arrays import Array, Index, Mask

LEAST_FRAME = 3  # targets that make a frame
_ROUNDING = 1e-6  # of a variance, below which a difference of two is none


@dataclass(frozen=True)
class SurveyPoints:
    """One body's survey: targets (T names), points (T, 3) in m in the body frame, cov (T, 3, 3) in m^2, leg
    (T,), 0 for none."""

    targets: tuple[str, ...]
    points: Array
    cov: Array
    leg: Index

    @property
    def frame(self) -> Mask:
        """(T,) which targets make the body's frame: those away from the legs, or all where these are too few."""
        away = self.leg == 0
        return away if away.sum() >= LEAST_FRAME else np.ones_like(away)


@dataclass(frozen=True)
class PosePoints:
    """One body over all poses: poses (B ids), targets (T names), points (B, T, 3) in m as measured, zero where
    not seen; cov (B, T, 3, 3) in m^2; seen (B, T)."""

    poses: tuple[int | str, ...]
    targets: tuple[str, ...]
    points: Array
    cov: Array
    seen: Mask


@dataclass(frozen=True)
class FittedPoints:
    """Points of a body over B poses, as the fit of its frame left them.

    residual (B, T, 3) in m in the body's axes, NaN where a target was not seen or was rejected; used (B, T): entered
    the fit; R (B, 3, 3) and t (B, 3) in m from the body to the measurement, NaN where a pose has none.
    """

    points: PosePoints
    residual: Array
    used: Mask
    R: Array
    t: Array

    @property
    def rotation(self) -> Array:
        """(B, 3, 3) from the body to the measurement, identity where a pose has none."""
        return np.where(np.isfinite(self.t[:, :1, None]), self.R, np.eye(3))

    @property
    def noise(self) -> Array:
        """(B, T, 3, 3) covariance of the points as measured, in the body's axes."""
        return np.einsum("bji,btjk,bkl->btil", self.rotation, self.points.cov, self.rotation)


@dataclass(frozen=True)
class PointErrors:
    """Errors of the rows of observations (N): sigma (N, 3) in m and own (N, 3, 3) correlations; first, second (M,) rows
    whose errors are correlated by between (M, 3, 3), in the order of poses with start (P + 1,), pose (N,) by number;
    parameters (K) common to all poses, effect (N, 3, K) in m of one standard deviation of each."""

    pose: Index
    sigma: Array
    own: Array
    first: Index
    second: Index
    between: Array
    start: Index
    parameters: tuple[str, ...]
    effect: Array

    def covariance(self, rows: Index) -> Array:
        """The covariance (3n, 3n) in m^2 of n rows of one pose."""
        count = len(rows)
        correlation = np.zeros((count, 3, count, 3))
        each = np.arange(count)
        correlation[each, :, each, :] = self.own[rows]
        pose = self.pose[rows[0]]
        pairs = slice(self.start[pose], self.start[pose + 1])
        place = np.full(len(self.pose), -1)
        place[rows] = each
        a, b = place[self.first[pairs]], place[self.second[pairs]]
        both = (a >= 0) & (b >= 0)
        a, b, between = a[both], b[both], self.between[pairs][both]
        correlation[a, :, b, :] = between
        correlation[b, :, a, :] = np.swapaxes(between, 1, 2)
        sigma = self.sigma[rows].ravel()
        return np.asarray(correlation.reshape(3 * count, 3 * count) * sigma[:, None] * sigma)

    def effects(self, rows: Index) -> Array:
        """What one standard deviation of each common parameter does to n rows: (3n, K) in m."""
        return self.effect[rows].reshape(3 * len(rows), -1)

    def of_each(self, correlation: Array) -> Array:
        """The covariance (N, 3, 3) in m^2 of each row by itself but for what is common to all poses, whose parameters
        have correlation (K, K): what makes one pose differ from another."""
        whole = self.own * self.sigma[:, :, None] * self.sigma[:, None, :]
        values, vectors = np.linalg.eigh(whole - self.effect @ correlation @ np.swapaxes(self.effect, 1, 2))
        least = _ROUNDING * np.trace(whole, axis1=1, axis2=2)
        return np.asarray(vectors * np.maximum(values, least[:, None])[:, None, :] @ np.swapaxes(vectors, 1, 2))


@dataclass(frozen=True)
class PointResiduals:
    """What a fit of poses said of a body's points (B, T): values (B, T, 3), m, in the body's frame, NaN where there is
    none; which it rejected, and which a person excluded."""

    values: Array
    rejected: Mask
    excluded: Mask

    @property
    def fitted(self) -> Mask:
        """Return which points have a residual and were not rejected."""
        return np.asarray(np.isfinite(self.values).all(-1) & ~self.rejected)


def with_declared_noise(cov: Array, sigma: float) -> Array:
    """Return covariances (..., 3, 3), m^2, with that of a declared sigma, m, where a point carries none."""
    known = np.isfinite(cov).all((-1, -2)) & (np.trace(np.nan_to_num(cov), axis1=-2, axis2=-1) > 0)
    return np.where(known[..., None, None], cov, np.eye(3) * sigma**2)
