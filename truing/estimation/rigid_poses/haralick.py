"""Robust pose of corresponding points by iteratively reweighted least squares, with noise on both point sets.

Haralick, Joo, Lee, Zhuang, Vaidya and Kim, "Pose estimation from corresponding point data", IEEE Trans. Systems, Man
and Cybernetics 19 (1989) 1426: weighted singular value decomposition of the 3D-3D problem, iterated to convergence.
Weights follow from the residuals by Tukey's biweight (Beaton and Tukey, Technometrics 16 (1974) 147). The constant of
the biweight and the scale of the residuals are chosen for three dimensions.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.estimation.rigid_poses.rigid import (
    FitStatus,
    RigidFit,
    check_correspondences,
    solve_motion,
    solve_weighted,
)

# Relative to the length of a three-dimensional residual in units of its noise: 95 % efficiency for Gaussian noise.
TUNING = 5.4902
# Median of the length of a standard normal vector in three dimensions.
MEDIAN_LENGTH = 1.5381722544550522
MAX_ITERATIONS = 200
# Largest movement of a fitted point per iteration, in units of its noise, at convergence.
_SETTLED = 1e-6


def haralick(
    source: ArrayLike,
    target: ArrayLike,
    sigma_source: ArrayLike,
    sigma_target: ArrayLike,
    weight: ArrayLike | None = None,
    *,
    tuning: float = TUNING,
) -> tuple[RigidFit, NDArray]:
    """Return the robust rigid motion ``target = R source + t`` and its final weights (B, N), 0 to 1.

    source, target: (B, N, 3) or (N, 3) in m; sigma_source, sigma_target: standard deviation per coordinate in m
    (scalar, (N,), (B, 1) or (B, N)); weight 0 marks a missing point. The start is the least-squares fit, so the method
    fails if gross errors dominate it. The scale of the residuals is their median, at least the declared noise. The
    covariance holds for the points kept, at the efficiency of the biweight. Raises ValueError as `umeyama`, and for
    noise that is not positive.
    """
    fit, robust, _ = reweighted_fit(source, target, np.hypot(sigma_source, sigma_target), weight, tuning)
    return fit, robust


def reweighted_fit(
    source: ArrayLike, target: ArrayLike, sigma: ArrayLike, weight: ArrayLike | None, tuning: float = TUNING
) -> tuple[RigidFit, NDArray, NDArray]:
    """Return the fit and the weights of `haralick`, and the ratio (B,) of its covariance to that of a plain fit to the
    points kept.

    sigma: noise of both clouds together, in m.
    """
    x, y, w = check_correspondences(source, target, weight)
    noise = np.broadcast_to(np.asarray(sigma, np.float64), w.shape)
    if not np.all(noise > 0):
        raise ValueError("sigma_source, sigma_target: found noise of 0 on both clouds, expected more")
    base = w / noise**2
    return _conclude(x, y, base, noise, tuning, _iterate_weights(x, y, base, noise, tuning))


def tukey_biweight(length: NDArray, tuning: float) -> NDArray:
    """Return the weights ``(1 - (length / tuning)^2)^2`` of residual lengths in units of their scale, 0 beyond."""
    return np.maximum(0.0, 1.0 - (length / tuning) ** 2) ** 2


@cache
def biweight_efficiency(tuning: float) -> float:
    """Return the asymptotic efficiency of the biweight for Gaussian noise in three dimensions.

    ``E[w + w' d / 3]^2 / (E[w^2 d^2] / 3)`` over the length d (Maronna, Martin, Yohai, Robust Statistics, 2006).
    """
    nodes, share = np.polynomial.legendre.leggauss(200)
    d = tuning * (nodes + 1) / 2
    density = tuning / 2 * share * np.sqrt(2 / np.pi) * d**2 * np.exp(-(d**2) / 2)
    w = tukey_biweight(d, tuning)
    slope = -4 * d / tuning**2 * (1 - (d / tuning) ** 2)
    return float(np.sum(density * (w + slope * d / 3)) ** 2 / (np.sum(density * w**2 * d**2) / 3))


def residual_scale(length: NDArray, used: NDArray) -> NDArray:
    """Return the robust scale (B,) of residual lengths (B, N) of a rigid fit, 1 if they scatter as declared.

    The median of the used (B, N) points relative to that of Gaussian noise, corrected for the six fitted parameters.
    """
    count = np.count_nonzero(used, axis=-1)
    ordered = np.sort(np.where(used, length, np.inf), axis=-1)
    last = ordered.shape[-1] - 1
    low = np.take_along_axis(ordered, np.clip((count - 1) // 2, 0, last)[:, None], axis=-1)[:, 0]
    high = np.take_along_axis(ordered, np.clip(count // 2, 0, last)[:, None], axis=-1)[:, 0]
    share = np.sqrt(np.maximum(1 - 2 / np.maximum(count, 1), 1 / 3))
    return np.where(count > 2, (low + high) / 2, MEDIAN_LENGTH) / MEDIAN_LENGTH / share


def lengths(vectors: NDArray) -> NDArray:
    """Return the lengths (B, N) of vectors (B, N, 3), faster than the norm along a short axis."""
    return np.sqrt(np.einsum("bni,bni->bn", vectors, vectors))


class _FinalWeights(NamedTuple):
    """Robust weights (B, N), number of iterations (B,) and mask of converged fits (B,)."""

    robust: NDArray
    steps: NDArray
    converged: NDArray


def _iterate_weights(x: NDArray, y: NDArray, base: NDArray, noise: NDArray, tuning: float) -> _FinalWeights:
    """Return the weights after reweighted fits until no point moves, or the iterations are used up."""
    fitted, ok = _fitted(x, y, base)
    robust = (base > 0).astype(np.float64)
    steps, converged = np.zeros(len(x), np.int64), ~ok
    for _ in range(MAX_ITERATIONS):
        rows = np.flatnonzero(~converged)
        if not rows.size:
            break
        base_weights = base[rows]
        robust[rows] = _reweighted(y[rows] - fitted[rows], base_weights, noise[rows], tuning)
        renewed, ok = _fitted(x[rows], y[rows], base_weights * robust[rows])
        moved = lengths(renewed - fitted[rows]) / noise[rows]
        fitted[rows] = renewed
        steps[rows] += 1
        converged[rows] = ~ok | (np.max(np.where(base_weights > 0, moved, 0.0), axis=-1) < _SETTLED)
    return _FinalWeights(robust, steps, converged)


def _fitted(x: NDArray, y: NDArray, w: NDArray) -> tuple[NDArray, NDArray]:
    """Return the source points (B, N, 3) moved by the weighted fit, and the mask (B,) of valid fits."""
    R, t, _, status = solve_motion(x, y, w)
    return x @ np.swapaxes(R, -1, -2) + t[:, None], status == FitStatus.OK


def _reweighted(residual: NDArray, base: NDArray, noise: NDArray, tuning: float) -> NDArray:
    length = lengths(residual) / noise
    scale = np.maximum(residual_scale(length, base > 0), 1.0)
    return (base > 0) * tukey_biweight(length / scale[:, None], tuning)


def _conclude(
    x: NDArray, y: NDArray, base: NDArray, noise: NDArray, tuning: float, weights: _FinalWeights
) -> tuple[RigidFit, NDArray, NDArray]:
    """Return the result of `reweighted_fit` from the final weights."""
    robust, steps, converged = weights
    fit = solve_weighted(x, y, base * robust)
    length = lengths(y - fit.apply(x)) / noise
    scale = np.maximum(residual_scale(np.where(fit.ok[:, None], length, 1.0), base > 0), 1.0)
    plain = solve_weighted(x, y, base * (robust > 0), sigma=noise).covariance
    factor = scale**2 / biweight_efficiency(tuning)
    covariance = plain * factor[:, None, None]
    status = np.where(fit.ok & ~converged, str(FitStatus.NOT_CONVERGED), fit.status)
    result = replace(fit, covariance=covariance, status=status, iterations=steps).masked()
    return result, np.where(result.ok[:, None], robust, 0.0), np.where(result.ok, factor, np.nan)
