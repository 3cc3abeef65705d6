"""Least squares of several responses on the same columns, with full covariance, weights and prior.

Responses (N, W) are columns (N, Q) times B^T, B (W, Q); coefficients are B row by row, (W Q,).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.errors_in_variables.descent import Prior


@dataclass(frozen=True)
class LinearFit:
    """B (W, Q), covariance (W Q, W Q), noise (W, W) of one row as estimated, chi_square under the noise that was
    declared (of freedom dof; both of the residuals alone where none was)."""

    matrix: NDArray
    covariance: NDArray
    noise: NDArray
    chi_square: float
    dof: float


def least_squares_fit(columns: NDArray, response: NDArray) -> LinearFit:
    """Return the fit with equal weights, ``B = Y^T X (X^T X)^-1``, the noise being that of the residuals.

    Solved by QR of the columns, scaled to unit length, and never by that inverse. There have to be more rows than
    columns.
    """
    spare = columns.shape[0] - columns.shape[1]
    inverse, root = _scaled_inverse(columns)
    matrix = (root @ response).T
    residual = response - columns @ matrix.T
    noise = residual.T @ residual / spare
    return LinearFit(matrix, np.kron(noise, inverse), noise, float(np.trace(residual.T @ residual)), float(spare))


def _scaled_inverse(columns: NDArray) -> tuple[NDArray, NDArray]:
    """Return (X^T X)^-1 (Q, Q) and its product with X^T (Q, N)."""
    scale = np.linalg.norm(columns, axis=0)
    Q, R = np.linalg.qr(columns / scale)
    back = np.linalg.inv(R) / scale[:, None]
    return back @ back.T, back @ Q.T


def weighted_fit(columns: NDArray, response: NDArray, cov: NDArray, prior: Prior | None = None) -> LinearFit:
    """Return the fit under covariances cov (N, W, W) or (W, W) of the responses, and a prior of the coefficients.

    The covariance is that of declared noise; ``noise`` is estimated from the residuals.
    """
    rows, width = response.shape
    if prior is None and cov.ndim == 2:
        return _alike(columns, response, cov)
    factor = np.linalg.inv(np.linalg.cholesky(np.broadcast_to(cov, (rows, width, width))))
    whole = np.einsum("nwi,nq->nwiq", factor, columns).reshape(rows * width, -1)
    target = np.einsum("nwi,ni->nw", factor, response).ravel()
    if prior is not None:
        root = _root(prior.information)
        whole, target = np.concatenate([whole, root]), np.concatenate([target, root @ prior.mean])
    covariance, solve = _scaled_inverse(whole)
    values = solve @ target
    matrix = values.reshape(width, -1)
    residual = response - columns @ matrix.T
    squares = float(np.sum((target - whole @ values) ** 2))
    dof = float(len(target) - len(values))
    return LinearFit(matrix, covariance, residual.T @ residual / max(dof / width, 1.0), squares, dof)


def _alike(columns: NDArray, response: NDArray, cov: NDArray) -> LinearFit:
    """Return the weighted fit where all rows have one covariance: that of least squares, as weights drop out of it."""
    inverse, root = _scaled_inverse(columns)
    matrix = (root @ response).T
    residual = response - columns @ matrix.T
    squares = float(np.sum(np.linalg.solve(cov, residual.T) * residual.T))
    spare = float(len(columns) - columns.shape[1])
    noise = residual.T @ residual / max(spare, 1.0)
    return LinearFit(matrix, np.kron(cov, inverse), noise, squares, spare * response.shape[1])


def _root(information: NDArray) -> NDArray:
    """Return rows (r, P) whose squares add up to an information (P, P) that may be singular."""
    strength, axes = np.linalg.eigh(information)
    kept = strength > 1e-14 * max(strength[-1], 0.0)
    return np.sqrt(strength[kept])[:, None] * axes[:, kept].T
