"""Tests of single rays: what their residuals show of gross errors, with redundancy numbers, both coordinates
together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.estimation.bundle.adjustment import Adjustment
from truing.estimation.bundle.intersection import Mask
from truing.estimation.bundle.network import Array, Index
from truing.estimation.bundle.variance_components import VarianceComponents

_CHECKED = 0.01  # share of an error that must show in the residuals for a direction to count as tested


@dataclass(frozen=True)
class RayTests:
    """Per ray: T (N,) and its degrees of freedom (N,) 0, 1 or 2, the p-value (N,), w (N, 2) of an error in either
    coordinate alone, redundancy numbers (N, 2), and Q_vv C^-1 (N, 2, 2). For rays that take no part: as if they did."""

    T: Array
    freedom: Index
    p_value: Array
    w: Array
    redundancy: Array
    redundancy_blocks: Array


def passing_share(alpha: float) -> float:
    """Return the mean square of good rays that pass a test at level alpha, over that of all: chi-square of two degrees
    of freedom, cut off at its critical value."""
    return (1 - alpha * (1 - np.log(alpha))) / (1 - alpha)


def ray_tests(adjusted: Adjustment, components: VarianceComponents) -> RayTests:
    """Return the tests of all rays of an adjustment whose covariances had the components' factors."""
    C = adjusted.network.rays.cov_px2 * components.of_rays()[:, None, None]
    A, used, v = adjusted.covariance.computed_px2(), adjusted.used, adjusted.residuals_px
    sound = np.isfinite(np.concatenate([A.reshape(-1, 4), v], axis=1)).all(axis=1)
    A, v = np.where(sound[:, None, None], A, 0.0), np.where(sound[:, None], v, 0.0)
    inverse = np.linalg.inv(np.linalg.cholesky(C))
    share, U = np.linalg.eigh(inverse @ A @ inverse.transpose(0, 2, 1))
    rho = np.where(used[:, None], 1 - share, 1 / (1 + np.maximum(share, 0.0)))  # of the errors shows in the residuals
    y = np.einsum("nji,njk,nk->ni", U, inverse, v)
    checked = (rho > _CHECKED) & sound[:, None]
    squares = y**2 * np.where(used[:, None], 1 / np.where(checked, rho, 1.0), rho)
    T, freedom = np.where(checked, squares, 0.0).sum(axis=1), checked.sum(axis=1)
    P = np.linalg.inv(C)
    AP = A @ P
    blocks = np.where(used[:, None, None], np.eye(2) - AP, np.linalg.inv(np.eye(2) + AP))
    S = np.where(used[:, None, None], P - P @ AP, np.linalg.inv(C + A))  # P Q_vv P, the same either way
    with np.errstate(divide="ignore", invalid="ignore"):
        w = np.einsum("nij,nj->ni", np.where(used[:, None, None], P, S), v) / np.sqrt(
            np.maximum(np.einsum("nii->ni", S), 0)
        )
    blind = ~sound
    T[blind], w[blind], blocks[blind] = np.nan, np.nan, np.nan
    return RayTests(T, freedom, p_values(T, freedom), w, np.einsum("nii->ni", blocks), blocks)


def p_values(T: Array, freedom: Index, redundancy: Array | None = None, used: Mask | None = None) -> Array:
    """Return the p-value (N,) of T; where the scale is estimated with a redundancy (N,), the ray's own part in it is
    taken into account if it was used (Pope 1976). NaN without degrees of freedom."""
    from scipy.special import betainc, betaincc, chdtrc

    f = np.maximum(freedom, 1)
    if redundancy is None or used is None:
        p_value = chdtrc(f, T)
    else:
        r = np.maximum(redundancy, f + 1.0)
        inside = betaincc(f / 2, (r - f) / 2, np.clip(T / r, 0.0, 1.0))
        p_value = np.where(used, inside, betainc(r / 2, f / 2, r / (r + T)))
    return np.where(freedom > 0, p_value, np.nan)
