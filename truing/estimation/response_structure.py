"""What a fitted response says: which entries are real, which model earns its parameters, which shape it has."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.response import ResponseFit

Array = NDArray[np.float64]
FALSE_ALARM = 0.05  # family-wise, over all entries of one table


def entry_p_values(fit: ResponseFit, widened: float = 1.0) -> Array:
    """(L, D) two-sided p-value of each entry of K against zero; NaN where it is not in the model or not determined.

    ``widened`` multiplies the standard deviations, where the noise proved larger than declared.
    """
    from scipy.special import ndtr

    p = np.full(fit.free.shape, np.nan)
    sigma = np.sqrt(np.diag(fit.covariance)) * widened
    z = np.divide(fit.coefficients[fit.free], sigma, out=np.full(len(sigma), np.nan), where=sigma > 0.0)
    p[fit.free] = 2.0 * ndtr(-np.abs(z))
    return p


def holm_significant(p: Array, false_alarm: float) -> NDArray[np.bool_]:
    """Which of many tests hold together at the stated family-wise false-alarm rate (Holm 1979); NaN is never one."""
    flat = np.where(np.isfinite(p), p, 1.0).ravel()
    order = np.argsort(flat)
    m = int(np.isfinite(p).sum())
    rank = np.arange(len(flat))
    passed = flat[order] * np.maximum(m - rank, 1) <= false_alarm
    significant = np.zeros(len(flat), bool)
    significant[order] = np.logical_and.accumulate(passed)
    return significant.reshape(p.shape)


_EXACT = 1e-6  # residuals, in declared standard deviations, that no measurement has


def gain_p_value(smaller: ResponseFit, larger: ResponseFit) -> float:
    """p-value of the larger of two nested models against the smaller: F where the noise level is estimated too.

    The noise level comes from the larger model's residuals, so noise declared 10 % wrong does not decide the test.
    Where these are nothing but rounding, as of points that repeat exactly, the declared noise decides (chi-square).
    """
    from scipy.special import chdtrc, fdtrc

    extra = smaller.dof - larger.dof
    if extra <= 0 or larger.dof <= 0:
        return float("nan")
    if larger.chi_square <= _EXACT**2 * larger.dof:
        return float(chdtrc(extra, max(smaller.chi_square - larger.chi_square, 0.0)))
    ratio = (smaller.chi_square - larger.chi_square) / extra / (larger.chi_square / larger.dof)
    return float(fdtrc(extra, larger.dof, max(ratio, 0.0)))


@dataclass(frozen=True)
class Symmetry:
    """Wald test of K = K transposed: chi-square, degrees of freedom, p-value, and the relative asymmetry."""

    chi_square: float
    dof: int
    p_value: float
    relative: float


def symmetry(fit: ResponseFit) -> Symmetry:
    """Whether K is symmetric within its uncertainty; for a full square K."""
    n = fit.free.shape[0]
    upper = np.triu_indices(n, 1)
    contrast = np.zeros((len(upper[0]), n * n))
    contrast[np.arange(len(upper[0])), upper[0] * n + upper[1]] = 1.0
    contrast[np.arange(len(upper[0])), upper[1] * n + upper[0]] = -1.0
    chi_square, p_value = _wald(contrast, fit)
    k = fit.coefficients
    return Symmetry(chi_square, len(contrast), p_value, float(np.linalg.norm(k - k.T) / 2.0 / np.linalg.norm(k)))


def pair_couplings(fit: ResponseFit) -> list[tuple[int, int, float, float]]:
    """For every pair of legs (from 0): i, j, coupling sqrt((K_ij^2 + K_ji^2)/2), and the p-value of no coupling."""
    n = fit.free.shape[0]
    rows = []
    for i, j in zip(*np.triu_indices(n, 1), strict=True):
        contrast = np.zeros((2, n * n))
        contrast[0, i * n + j] = contrast[1, j * n + i] = 1.0
        strength = float(np.sqrt(0.5 * (fit.coefficients[i, j] ** 2 + fit.coefficients[j, i] ** 2)))
        rows.append((int(i), int(j), strength, _wald(contrast, fit)[1]))
    return rows


def _wald(contrast: Array, fit: ResponseFit) -> tuple[float, float]:
    from scipy.special import chdtrc

    value = contrast @ fit.coefficients.ravel()
    chi_square = float(value @ np.linalg.solve(contrast @ fit.covariance @ contrast.T, value))
    return chi_square, float(chdtrc(len(contrast), chi_square))


def significant_rank(fit: ResponseFit, false_alarm: float) -> int:
    """Number of independent shapes in K: the smallest rank that leaves no more than noise.

    K is whitened by its average row and column covariance; what the first r singular values leave is held against
    chi-square with (L - r)(D - r) degrees of freedom.
    """
    from scipy.special import chdtrc

    rows, columns = fit.free.shape
    blocks = fit.covariance.reshape(rows, columns, rows, columns)
    row_cov = np.einsum("iaja->ij", blocks) / columns
    column_cov = np.einsum("iajb,ji->ab", blocks, np.linalg.inv(row_cov)) / rows
    white = np.linalg.solve(np.linalg.cholesky(row_cov), fit.coefficients)
    white = np.linalg.solve(np.linalg.cholesky(column_cov), white.T).T
    left = np.append(np.cumsum((np.linalg.svd(white, compute_uv=False) ** 2)[::-1])[::-1], 0.0)
    for r in range(min(rows, columns)):
        if chdtrc((rows - r) * (columns - r), left[r]) > false_alarm:
            return r
    return min(rows, columns)


@dataclass(frozen=True)
class RingShape:
    """How the attachments' shifts look round the ring: shares of the mean square, and the principal shape.

    lift, tilt, buckle sum to 1; buckle is what no plane explains. principal (L,): unit shape with the largest
    share over poses, principal_share its share, amplitude_um its largest amplitude.
    """

    lift: float
    tilt: float
    buckle: float
    principal: Array
    principal_share: float
    amplitude: float


def ring_shape(shifts: Array, attachments: Array) -> RingShape:
    """Split shifts (N, L) at attachment points (L, 3) into a lift, a tilt of the ring's plane, and its buckling."""
    plane = np.column_stack([np.ones(len(attachments)), attachments[:, :2] - attachments[:, :2].mean(axis=0)])
    basis = np.linalg.qr(plane)[0]
    parts = shifts @ basis
    total = float((shifts**2).sum()) or 1.0
    lift, tilt = float((parts[:, 0] ** 2).sum()) / total, float((parts[:, 1:] ** 2).sum()) / total
    left, values, shapes = np.linalg.svd(shifts, full_matrices=False)
    amplitude = float(np.abs(left[:, 0] * values[0]).max())
    share = float(values[0] ** 2 / total)
    return RingShape(lift, tilt, max(0.0, 1.0 - lift - tilt), shapes[0], share, amplitude)


def birge(fit: ResponseFit) -> float:
    """Factor on the standard deviations: above 1 only where the residuals are larger than declared noise allows."""
    from scipy.special import chdtrc

    if fit.dof <= 0 or chdtrc(fit.dof, fit.chi_square) > 0.01:
        return 1.0
    return float(np.sqrt(fit.chi_square / fit.dof))


def entry_tests(fit: ResponseFit) -> tuple[Array, Array, NDArray[np.bool_]]:
    """(L, D) sigma, p-value and significance of every entry, widened where the noise is larger than declared."""
    factor = birge(fit)
    p = entry_p_values(fit, factor)
    return fit.sigma * factor, p, holm_significant(p, FALSE_ALARM)
