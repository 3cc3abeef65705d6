"""One implicit model at some values: linearised at the deviations of each pose, which are then eliminated.

A pose's equations ``g(x, d) = 0`` hold for the values x that all poses share and for the deviations d of the truth
from what was measured there, of covariance C. With ``A = dg/dd``, ``B = dg/dx`` and ``V = A C A'`` the smallest
deviations that close the linearised equations are ``d = -C A' V^-1 e``, ``e = g - A d``, and they cost ``e' V^-1 e``;
C is never inverted. Lenzmann and Lenzmann (2004) say why the derivatives have to be taken at the estimated deviations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

_MAX_PROJECTIONS = 30


class Constrained(Protocol):
    """Equations of all poses and their exact derivatives."""

    @property
    def value(self) -> NDArray:
        """Return the equations (B, m), zero where all belongs together."""

    @property
    def by_deviation(self) -> NDArray:
        """Return their derivatives (B, m, n) by the deviations."""

    @property
    def by_values(self) -> NDArray:
        """Return their derivatives (B, m, P) by the values."""


class Constraint(Protocol):
    """An implicit model; a method of this form serves as well."""

    def __call__(self, values: NDArray, deviation: NDArray, /) -> Constrained:
        """Return the equations at values (P,) and deviations (B, n) of the truth from what was measured."""


@dataclass(frozen=True)
class Measured:
    """An implicit model with the covariance (B, n, n), possibly singular, of what was measured in each pose."""

    constrain: Constraint
    covariance: NDArray


@dataclass(frozen=True)
class Eliminated:
    """The model at values (P,), linearised at deviations ``C pull``, in units of its equations' own noise."""

    values: NDArray
    pull: NDArray  # (B, n) where it was linearised: C^-1 d, where C has an inverse
    rows: NDArray  # (B, m, n) equations by deviations, G with G C G' = 1
    residual: NDArray  # (B, m)
    jacobian: NDArray  # (B, m, P)
    unsettled: NDArray  # (B,) squared change, in sigmas, by which the deviations are not yet those of the values

    @property
    def chi_square(self) -> NDArray:
        """Return what the deviations of each pose cost (B,)."""
        return np.einsum("bm,bm->b", self.residual, self.residual)

    @property
    def settled_pull(self) -> NDArray:
        """Return the pull (B, n) that closes the linearised equations."""
        return _closing(self.rows, self.residual)

    def pull_after(self, step: NDArray) -> NDArray:
        """Return the pull (B, n) that closes the linearised equations after a step (P,) of the values."""
        return _closing(self.rows, self.residual + self.jacobian @ step)


def linearise(measured: Measured, values: NDArray, pull: NDArray) -> Eliminated:
    """Return the model at values (P,) with its derivatives at the deviations of a pull (B, n).

    Raises LinAlgError where some equation of a pose contains nothing that was measured with an error.
    """
    deviation = times(measured.covariance, pull)
    found = measured.constrain(values, deviation)
    A = found.by_deviation
    factor = np.linalg.inv(np.linalg.cholesky(A @ measured.covariance @ np.swapaxes(A, 1, 2)))
    rows = factor @ A
    residual = times(factor, found.value - times(A, deviation))
    change = _closing(rows, residual) - pull
    unsettled = np.einsum("bi,bi->b", change, times(measured.covariance, change))
    return Eliminated(values, pull, rows, residual, factor @ found.by_values, unsettled)


def project(measured: Measured, values: NDArray, pull: NDArray, weight: NDArray, allowed: float) -> Eliminated:
    """Return the model linearised where the deviations have settled, to a weighted squared change that is allowed.

    It has not settled where `unsettled` is larger still.
    """
    for _ in range(_MAX_PROJECTIONS):
        found = linearise(measured, values, pull)
        if not weight @ found.unsettled > allowed:
            break
        pull = found.settled_pull
    return found


def _closing(rows: NDArray, residual: NDArray) -> NDArray:
    return -np.einsum("bmn,bm->bn", rows, residual)


def times(matrix: NDArray, vector: NDArray) -> NDArray:
    """Return the products (B, i) of matrices (B, i, j) with vectors (B, j)."""
    return (matrix @ vector[..., None])[..., 0]
