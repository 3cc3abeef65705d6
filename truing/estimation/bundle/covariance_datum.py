"""Transformation of the covariance of a pose's points into a datum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dgemm

from truing.arrays import Array, Mask
from truing.estimation.bundle.datum import Freedom, into_datum


@dataclass(frozen=True)
class Datum:
    """Transformation of points into a datum: S = 1 - G F with the freedoms G (3 p, d) and F (d, 3 p). certain (3 p,):
    coordinates that the datum fixes."""

    freedoms: Array
    back: Array
    certain: Mask

    @classmethod
    def of(cls, free: Freedom, constraints: Array) -> Datum:
        """Return the datum with conditions B (3 p, d)."""
        # A condition on a single coordinate fixes it.
        return cls(
            free.points.reshape(constraints.shape), into_datum(free, constraints), np.any(constraints == 1.0, axis=1)
        )

    def points(self, covariance: Array) -> Array:
        """Return the covariance (3 p, 3 p) of points in this datum; overwrites the input."""
        drawn = self.back @ covariance
        drawn -= (drawn @ self.back.T / 2) @ self.freedoms.T
        # The transposed matrix, equal by symmetry, is column-major as BLAS needs it.
        factors = np.hstack([self.freedoms, drawn.T]), np.hstack([drawn.T, self.freedoms])
        propagated_points = dgemm(-1.0, *factors, 1.0, covariance.T, trans_b=1, overwrite_c=1).T
        propagated_points[self.certain] = propagated_points[:, self.certain] = 0.0
        return propagated_points

    def by_common(self, by_common: Array) -> Array:
        """Return the derivatives of points (3 p, c) by the common unknowns in this datum."""
        reduced = by_common - self.freedoms @ (self.back @ by_common)
        reduced[self.certain] = 0.0
        return reduced
