"""Least-squares fit of image models to many small patches at once, with the noise of each pixel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask

Model = Callable[[Array, NDArray[np.intp]], tuple[Array, Array]]
"""Grey values (n, M) and their derivatives (n, M, U) at unknowns (n, U) of the patches (n,) by number."""
Equations = Callable[[Array, NDArray[np.intp]], tuple[Array, Array, Array]]
"""Sum of squares (n,), normal matrices (n, U, U) and right-hand sides (n, U) at unknowns (n, U) of the patches (n,)."""

_STEPS = 25
# Convergence: the sum of squares falls by less than a thirtieth of a standard deviation, or than its rounding.
_SMALL, _ROUNDING = 1e-3, 1e-6
SHARPEST, SOFTEST = 0.15, 8.0
_DAMPING, _MOST_DAMPING = 1e-3, 1e6


@dataclass(frozen=True)
class PatchFit:
    """Unknowns (P, U) with covariance (P, U, U) from pixel noise; sum of squares (P,) over noise, its degrees of
    freedom (P,), and whether the patch converged (P,)."""

    values: Array
    covariance: Array
    chi2: Array
    freedom: Array
    converged: Mask

    @property
    def covariance_factor(self) -> Array:
        """Factors (P,) of the covariance for patches with residuals beyond their noise and chance; 1 elsewhere."""
        ratio = self.chi2 / np.maximum(self.freedom, 1.0)
        return np.where(ratio > 1.0 + 4.0 * np.sqrt(2.0 / np.maximum(self.freedom, 1.0)), ratio, 1.0)


def fit_patches(equations: Equations, start: Array, pixels: Index) -> PatchFit:
    """Return the fit of the unknowns (P, U) of P patches with pixels (P,) each, by Levenberg-Marquardt.

    Each patch has its own damping and stops at its own convergence.
    """
    values = start.copy()
    cost, normal, gradient = equations(values, np.arange(len(start)))
    damping = np.full(len(start), _DAMPING)
    settled_state = np.zeros(len(start), dtype=bool)
    moving = np.flatnonzero(np.isfinite(cost))
    for _ in range(_STEPS):
        if not len(moving):
            break
        trial = values[moving] + _step(normal[moving], gradient[moving], damping[moving])
        new_cost, new_normal, new_gradient = equations(trial, moving)
        fall = cost[moving] - new_cost
        better = fall >= 0.0
        is_better = moving[better]
        values[is_better], cost[is_better] = trial[better], new_cost[better]
        normal[is_better], gradient[is_better] = new_normal[better], new_gradient[better]
        damping[moving] = np.where(better, 0.1, 10.0) * damping[moving]
        done = better & (fall <= np.maximum(_SMALL, _ROUNDING * new_cost))
        settled_state[moving[done]] = True
        moving = moving[~done & (damping[moving] < _MOST_DAMPING)]
    freedom = pixels - start.shape[1]
    return PatchFit(values, _inverse(normal), cost, freedom.astype(float), settled_state & (freedom > 0))


def bounded_blur(blur: Array) -> tuple[Array, Array]:
    """Return the blur of a model, px, and its derivative, limited from below: pixels do not resolve sharper images."""
    return np.clip(blur, SHARPEST, SOFTEST), ((blur > SHARPEST) & (blur < SOFTEST)).astype(float)


def equations_of(model: Model, grey: Array, weight: Array, prior: Array) -> Equations:
    """Return the equations of a model of grey values (P, M) with weights (P, M), 1 / variance of a pixel, 0 for unused.

    ``prior`` (U,): 1 / variance of the prior of each unknown, with mean zero.
    """

    def equations(values: Array, patches: NDArray[np.intp]) -> tuple[Array, Array, Array]:
        picture, jacobian = model(values, patches)
        own_weight = weight[patches]
        residual = grey[patches] - picture
        weighted = jacobian * own_weight[:, :, None]
        cost = np.einsum("nm,nm,nm->n", residual, residual, own_weight) + np.square(values) @ prior
        normal = np.swapaxes(weighted, 1, 2) @ jacobian + np.diag(prior)
        gradient = np.einsum("nmu,nm->nu", weighted, residual) - values * prior
        return np.where(np.isfinite(cost), cost, np.inf), normal, gradient

    return equations


def _step(normal: Array, gradient: Array, damping: Array) -> Array:
    diagonal = np.arange(normal.shape[1])
    damped = normal.copy()
    diagonal_values = np.maximum(normal[:, diagonal, diagonal], 1e-12)
    damped[:, diagonal, diagonal] = diagonal_values * (1.0 + damping[:, None])
    try:
        return np.asarray(np.linalg.solve(damped, gradient[:, :, None])[:, :, 0])
    except np.linalg.LinAlgError:
        return np.zeros_like(gradient)


def _inverse(normal: Array) -> Array:
    """Return inverses (P, U, U) of normal matrices after scaling; NaN for singular ones."""
    diagonal = np.einsum("nuu->nu", normal)
    scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, np.nan))
    scaled = normal * scale[:, :, None] * scale[:, None, :]
    good = np.asarray(np.isfinite(scaled).all((1, 2)))
    inverse = np.full_like(normal, np.nan)
    good[good] = np.linalg.cond(scaled[good]) < 1e12
    inverse[good] = np.linalg.inv(scaled[good]) * (scale[:, :, None] * scale[:, None, :])[good]
    return inverse
