"""Errors that object points have in common: within a pose, and through what is common to all poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_ROUNDING = 1e-6  # of a variance, below which a difference of two is none


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
