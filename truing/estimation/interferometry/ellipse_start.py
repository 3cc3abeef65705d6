"""Where the fit of an ellipse begins: the direct least-squares conic that is an ellipse, for a batch of channels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_CONSTRAINT = np.array([[0.0, 0.0, 0.5], [0.0, -1.0, 0.0], [0.5, 0.0, 0.0]])  # inverse of that of 4ac - b^2 = 1


def ellipse_start(signals: Array, weight: Array) -> Array:
    """Return x0, y0, a, b, lag (B, 5) of ``x = x0 + a cos p, y = y0 + b sin(p + lag)``; NaN where nothing fits.

    signals (B, N, 2), weight (B, N) 0 or 1. A. Fitzgibbon, M. Pilu and R. Fisher (1999), solved as R. Halíř and
    J. Flusser (1998) do. It shrinks short arcs, so it is no more than a start.
    """
    total = np.maximum(weight.sum(-1), 1.0)[:, None]
    centre = np.einsum("bn,bnk->bk", weight, signals) / total
    size = np.sqrt(np.einsum("bn,bnk->bk", weight, (signals - centre[:, None]) ** 2) / total)
    size = np.where(size > 0.0, size, 1.0)
    conic = _conic((signals - centre[:, None]) / size[:, None], weight)
    found = _shape(conic)
    return np.column_stack([centre + size * found[:, :2], size * found[:, 2:4], found[:, 4]])


def _conic(z: Array, weight: Array) -> Array:
    """Return the coefficients (B, 6) of x^2, xy, y^2, x, y, 1."""
    x, y = z[..., 0], z[..., 1]
    quadratic = weight[..., None] * np.stack([x * x, x * y, y * y], -1)
    linear = weight[..., None] * np.stack([x, y, np.ones_like(x)], -1)
    S1, S2, S3 = (np.swapaxes(left, 1, 2) @ right for left, right in _pairs(quadratic, linear))
    T = -np.linalg.pinv(S3, hermitian=True) @ np.swapaxes(S2, 1, 2)
    vectors = np.real(np.linalg.eig(_CONSTRAINT @ (S1 + S2 @ T))[1])
    definite = 4.0 * vectors[:, 0] * vectors[:, 2] - vectors[:, 1] ** 2
    best = np.take_along_axis(vectors, definite.argmax(1)[:, None, None], 2)[..., 0]
    return np.concatenate([best, np.einsum("bij,bj->bi", T, best)], -1)


def _pairs(quadratic: Array, linear: Array) -> tuple[tuple[Array, Array], ...]:
    return (quadratic, quadratic), (quadratic, linear), (linear, linear)


def _shape(conic: Array) -> Array:
    """Return x0, y0, a, b, lag (B, 5) of conics (B, 6)."""
    A, B, C, D, E, F = conic.T
    with np.errstate(divide="ignore", invalid="ignore"):
        determinant = 4.0 * A * C - B**2
        x0, y0 = (B * E - 2.0 * C * D) / determinant, (B * D - 2.0 * A * E) / determinant
        level = -(F + 0.5 * (D * x0 + E * y0))
        # z' Q z = 1 with Q^-1 = [[a^2, a b sin lag], [., b^2]]
        a, b = np.sqrt(4.0 * C * level / determinant), np.sqrt(4.0 * A * level / determinant)
        lag = np.arcsin(np.clip(-2.0 * B * level / determinant / (a * b), -1.0, 1.0))
    return np.column_stack([x0, y0, a, b, lag])
