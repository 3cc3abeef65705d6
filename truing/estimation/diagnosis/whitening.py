"""One whitened linear problem: what was measured, what is not known exactly, and the projection onto what is left.

Rows are measurements and priors, each divided by its standard deviation; unknowns are counted in prior standard
deviations (so a prior is a row of the identity). Unknowns of one pose are eliminated pose by pose, those that all poses
share by one QR: `Whitened.rest` is then what no nuisance explains.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Linearised:
    """Measured minus predicted, and derivatives, at some values of the unknowns; whitened, zero where missing."""

    residual: NDArray  # (B, M) rows of each pose
    by_local: NDArray  # (B, M, H)
    by_shared: NDArray  # (B, M, G)
    local_value: NDArray  # (B, H) present distance from the prior's mean, in prior sigmas
    shared_value: NDArray  # (G,)
    extra_residual: NDArray  # (E,) rows that concern no pose
    extra_by_shared: NDArray  # (E, G)
    present: NDArray  # (B, M) which rows were measured
    local_known: NDArray  # (H,) whose prior is knowledge, and not merely there to keep the equations scaled
    shared_known: NDArray  # (G,)


@dataclass(frozen=True)
class Whitened:
    """The problem with its local unknowns eliminated; rows: those of poses with local priors, extra ones, priors."""

    problem: Linearised
    local_basis: NDArray  # (B, M + H, H) orthonormal
    local_factor: NDArray  # (B, H, H) triangular
    rows: NDArray  # (N, G) shared derivatives
    residual: NDArray  # (N,)

    @cached_property
    def _gram(self) -> NDArray:
        """Return the products (G + 1, G + 1) of rows and residual: all that a step needs.

        The priors among the rows keep it regular; its condition is the square of theirs, which leaves nine digits.
        """
        together = np.column_stack([self.rows, self.residual])
        return together.T @ together

    @cached_property
    def _inverse(self) -> NDArray:
        return np.linalg.inv(np.linalg.cholesky(self._gram[:-1, :-1]).T)

    @cached_property
    def _along(self) -> NDArray:
        """Return the parts (G,) of the residual along the basis."""
        return self._inverse.T @ self._gram[:-1, -1]

    @cached_property
    def basis(self) -> NDArray:
        """Return an orthonormal basis (N, G) of what the shared unknowns explain."""
        nearly = self.rows @ self._inverse
        return nearly @ np.linalg.inv(np.linalg.cholesky(nearly.T @ nearly).T)

    @cached_property
    def rest(self) -> NDArray:
        """Return the residual (N,) that is left after all unknowns were fitted."""
        return self.residual - self.basis @ (self.basis.T @ self.residual)

    @cached_property
    def explained(self) -> float:
        """Return by how much the unknowns' next step lowers the sum of squares."""
        local = np.einsum(
            "bmh,bm->bh", self.local_basis, _with_priors(self.problem.residual, -self.problem.local_value)
        )
        return float(np.sum(local**2) + np.sum(self._along**2))

    @cached_property
    def leverage(self) -> NDArray:
        """Return the share (N,) of each row that the unknowns follow; 1 where nothing of it is left to test."""
        local = np.sum(self.local_basis**2, -1).ravel()
        shared = np.sum(self.basis**2, -1)
        shared[: len(local)] += local
        return np.minimum(shared, 1.0)

    @cached_property
    def present(self) -> NDArray:
        """Return which rows (N,) say something: what was measured, and priors that are knowledge."""
        priors = np.broadcast_to(self.problem.local_known, self.problem.local_value.shape)
        pose_rows = np.concatenate([self.problem.present, priors], 1).ravel()
        extra = np.ones(len(self.problem.extra_residual), bool)
        return np.concatenate([pose_rows, extra, self.problem.shared_known])

    @cached_property
    def freedom(self) -> float:
        """Return the degrees of freedom of `rest`."""
        return float(np.sum((1.0 - self.leverage)[self.present]))

    def step(self) -> tuple[NDArray, NDArray]:
        """Return the least-squares step of the shared (G,) and local (B, H) unknowns, in prior sigmas."""
        shared = self._inverse @ self._along
        left = _with_priors(self.problem.residual - self.problem.by_shared @ shared, -self.problem.local_value)
        local = np.linalg.solve(self.local_factor, np.einsum("bmh,bm->bh", self.local_basis, left)[..., None])
        return shared, local[..., 0]

    def fitted(self, rows: NDArray) -> NDArray:
        """Return the shared unknowns (G, ...) that fit rows (N, ...) best, in prior sigmas."""
        return self._inverse @ (self.basis.T @ rows)

    def from_basis(self, parts: NDArray) -> NDArray:
        """Return the shared unknowns (G, ...) whose rows are the basis times parts (G, ...), in prior sigmas."""
        return self._inverse @ parts

    def covariance(self) -> NDArray:
        """Return the covariance (G, G) of the shared unknowns, in prior sigmas squared."""
        return self._inverse @ self._inverse.T

    def without_local(self, columns: NDArray) -> NDArray:
        """Return columns (B, M + H, P) less what the local unknowns explain of them."""
        return columns - self.local_basis @ (np.swapaxes(self.local_basis, 1, 2) @ columns)


def whiten(problem: Linearised) -> Whitened:
    """Return the problem with its local unknowns eliminated (batched QR of each pose's rows and priors)."""
    poses, _, count = problem.by_local.shape
    identity = np.broadcast_to(np.eye(count), (poses, count, count))
    basis, factor = np.linalg.qr(np.concatenate([problem.by_local, identity], 1))
    bare = Whitened(problem, basis, factor, np.empty(0), np.empty(0))
    shared = np.concatenate([problem.by_shared, np.zeros((poses, count, problem.by_shared.shape[-1]))], 1)
    residual = _with_priors(problem.residual, -problem.local_value)[..., None]
    size = len(problem.shared_value)
    rows = np.concatenate([bare.without_local(shared).reshape(-1, size), problem.extra_by_shared, np.eye(size)])
    stacked = np.concatenate([bare.without_local(residual).ravel(), problem.extra_residual, -problem.shared_value])
    return Whitened(problem, basis, factor, rows, stacked)


def _with_priors(rows: NDArray, priors: NDArray) -> NDArray:
    return np.concatenate([rows, priors], 1)
