"""Tests of single rays for gross errors (Baarda 1968, Pope 1976): statistics, p-values and critical values.

Both coordinates of a ray are tested together, since a wrong code or a merged target corrupts both: T = v^T Q_vv^-1 v
has two degrees of freedom, or one if the network checks the ray in one direction only.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.estimation.bundle.adjustment import Adjustment
from truing.estimation.bundle.variance_components import VarianceComponents

_CHECKED = 0.01  # share of an error that must appear in the residuals for a direction to count as tested


@dataclass(frozen=True)
class RayTests:
    """Test statistics per ray: T (N,) with degrees of freedom (N,) 0, 1 or 2; w (N, 2) of an error in one coordinate,
    redundancy numbers (N, 2), and Q_vv C^-1 (N, 2, 2); whether the ray is used (N,).

    Unused rays have the values that they would have if they were used. scale_redundancy (N,): redundancy from which the
    scale of a ray is estimated, None if it is stated.
    """

    T: Array
    freedom: Index
    w: Array
    redundancy: Array
    redundancy_blocks: Array
    used: Mask
    scale_redundancy: Array | None = None

    @cached_property
    def p_value(self) -> Array:
        """P-value (N,) of T, NaN without degrees of freedom."""
        return p_values(self.T, self.freedom, self.scale_redundancy, self.used)

    def critical(self, alpha: float) -> Array:
        """Return the critical value (N,) of T at level alpha, NaN without degrees of freedom."""
        return critical_values(alpha, self.freedom, self.scale_redundancy, self.used)


def passing_share(alpha: float) -> float:
    """Return the mean square of good rays that pass a test at level alpha, relative to that of all good rays: truncated
    chi-square of two degrees of freedom."""
    return (1 - alpha * (1 - np.log(alpha))) / (1 - alpha)


def ray_tests(adjusted: Adjustment, components: VarianceComponents) -> RayTests:
    """Return the tests of all rays of an adjustment with the components' variance factors."""
    C = adjusted.network.rays.cov_px2 * components.ray_factors()[:, None, None]
    A, used, v = adjusted.covariance.computed_px2(), adjusted.used, adjusted.residuals_px
    is_finite = np.asarray(np.isfinite(A).all(axis=(1, 2)) & np.isfinite(v).all(axis=1))
    A, v = np.where(is_finite[:, None, None], A, 0.0), np.where(is_finite[:, None], v, 0.0)
    # Q_vv P of a used ray, else the same as it would be if the ray were used: (1 + A P)^-1 = C (C + A)^-1.
    P, R = _inverse(C), np.where(used[:, None, None], C - A, C + A)
    weight_redundancy = P @ R @ P
    S = np.where(used[:, None, None], weight_redundancy, _inverse(np.where(used[:, None, None], C, R)))
    blocks = np.where(used[:, None, None], R @ P, C @ S)
    with np.errstate(divide="ignore", invalid="ignore"):
        sigma = np.sqrt(np.maximum(S[:, [0, 1], [0, 1]], 0))
        w = (np.where(used[:, None, None], P, S) @ v[..., None])[..., 0] / sigma
    T, freedom = _two_directions(C, A, v, used)
    T[~is_finite], w[~is_finite], blocks[~is_finite], freedom[~is_finite] = np.nan, np.nan, np.nan, 0
    return RayTests(T, freedom, w, blocks[:, [0, 1], [0, 1]], blocks, used)


def _inverse(M: Array) -> Array:
    """Return the inverses (n, 2, 2) of symmetric matrices."""
    a, b, d = M[:, 0, 0], M[:, 0, 1], M[:, 1, 1]
    return np.stack([d, -b, -b, a], -1).reshape(-1, 2, 2) / (a * d - b * b)[:, None, None]


def _two_directions(C: Array, A: Array, v: Array, used: Mask) -> tuple[Array, Index]:
    """Return T (n,) and its degrees of freedom (n,). It sums over the two directions in which the covariances C of
    measured and A of computed image points (n, 2, 2) are both diagonal; v (n, 2): residuals."""
    l11 = np.sqrt(C[:, 0, 0])
    l21 = C[:, 1, 0] / l11
    l22 = np.sqrt(C[:, 1, 1] - l21 * l21)
    # M = L^-1 A L^-T and y = L^-1 v with the Cholesky factor L of C.
    xx = A[:, 0, 0] / (l11 * l11)
    xy = (A[:, 0, 1] / l11 - l21 * xx) / l22
    yy = (A[:, 1, 1] / l22 - l21 * (2 * xy + l21 * xx / l22)) / l22
    x = v[:, 0] / l11
    y = (v[:, 1] - l21 * x) / l22
    half_difference, mean = np.hypot((xx - yy) / 2, xy), (xx + yy) / 2
    mean_square, difference = x * x + y * y, (xx - yy) / 2 * (x * x - y * y) + 2 * xy * x * y
    difference = np.divide(difference, half_difference, out=np.zeros_like(half_difference), where=half_difference > 0)
    T, freedom = np.zeros(len(v)), np.zeros(len(v), np.int64)
    for eigenvalue, square in (
        (mean + half_difference, (mean_square + difference) / 2),
        (mean - half_difference, (mean_square - difference) / 2),
    ):
        redundancy = np.where(
            used, 1 - eigenvalue, 1 / (1 + np.maximum(eigenvalue, 0.0))
        )  # of the errors shows in the residuals
        is_tested = redundancy > _CHECKED
        T += np.where(is_tested, square * np.where(used, 1 / np.where(is_tested, redundancy, 1.0), redundancy), 0.0)
        freedom += is_tested
    return T, freedom


def p_values(T: Array, freedom: Index, redundancy: Array | None = None, used: Mask | None = None) -> Array:
    """Return the p-value (N,) of T, NaN without degrees of freedom.

    If the scale is estimated with a redundancy (N,), the contribution of a used ray to it is taken into account (Pope
    1976).
    """
    from scipy.special import betainc, betaincc, chdtrc

    f = np.maximum(freedom, 1)
    if redundancy is None or used is None:
        # The tail of two degrees of freedom is elementary; the few of one need a special function.
        p_value, is_single = np.exp(-T / 2), f == 1
        p_value[is_single] = chdtrc(1, T[is_single])
        return np.where(freedom > 0, p_value, np.nan)
    r = np.maximum(redundancy, f + 1.0)
    with np.errstate(divide="ignore"):
        log_inside = (r / 2 - 1) * np.log1p(-np.minimum(T / r, 1.0))
    p_value, is_single = np.exp(np.where(used, log_inside, -r / 2 * np.log1p(T / r))), f == 1
    r, T, used = r[is_single], T[is_single], used[is_single]
    inside = betaincc(0.5, (r - 1) / 2, np.clip(T / r, 0.0, 1.0))
    p_value[is_single] = np.where(used, inside, betainc(r / 2, 0.5, r / (r + T)))
    return np.where(freedom > 0, p_value, np.nan)


def critical_values(alpha: float, freedom: Index, redundancy: Array | None, used: Mask) -> Array:
    """Return the T (N,) whose p-value by `p_values` is alpha, NaN without degrees of freedom."""
    from scipy.special import betainccinv, betaincinv, chdtri

    if redundancy is None:
        return np.array([np.nan, *chdtri([1, 2], alpha)])[freedom]
    levels, level_index = np.unique(redundancy, return_inverse=True)
    r_single, r_double = np.maximum(levels, 2.0), np.maximum(levels, 3.0)
    no_freedom = np.full((2, len(levels)), np.nan)  # of used rays, then of the others
    single = (
        r_single * betainccinv(0.5, (r_single - 1) / 2, alpha),
        r_single * (1 / betaincinv(r_single / 2, 0.5, alpha) - 1),
    )
    double = (
        -r_double * np.expm1(2 / (r_double - 2) * np.log(alpha)),
        r_double * np.expm1(-2 / r_double * np.log(alpha)),
    )
    return np.stack([no_freedom, single, double])[freedom, np.where(used, 0, 1), level_index]
