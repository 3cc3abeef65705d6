"""Size of the motion that follows the drives in a fitted response, its upper limit, and the size that a test finds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.arrays import Array
from truing.estimation.response import ResponseFit, birge

POWER, LIMIT = 0.95, 0.95
TESTED_AT = 0.01  # p-value below which the motion counts as found
_PATTERNS = 64
_NORMAL = 1.6448536269514722  # one-sided 95 % of a normal error


@dataclass(frozen=True)
class DrivenShift:
    """Root mean square of K u over rows and components, in the unit of the response.

    rms: without the part that noise of K adds, zero if noise explains all; upper: one-sided 95 % limit; detectable: the
    rms that the F test of the matrix against no motion finds with 95 % probability, on average over random K.
    """

    rms: float
    upper: float
    detectable: float


def driven_shift(fit: ResponseFit, u: Array) -> DrivenShift:
    """Return the size of the motion that follows the drives u (N, D) of a matrix fit; NaN without degrees of freedom.

    Q = K' A K is the mean square of K u, and C the covariance of K. Q less its expectation by noise has the variance 2
    tr (A C)^2 + 4 K' A C A K. The limit takes A C at its mean eigenvalue in the second term.
    """
    responses, rows = fit.free.shape[0], len(u)
    A = np.kron(np.eye(responses), u.T @ u) / (rows * responses)
    covariance = birge(fit) ** 2 * fit.covariance
    spread = A @ covariance
    noise, square = float(np.trace(spread)), float(np.einsum("ij,ji->", spread, spread))
    if not noise > 0.0 or fit.dof <= 0:
        return DrivenShift(*(float("nan"),) * 3)
    K = fit.coefficients[fit.free]
    size = max(float(K @ A @ K) - noise, 0.0)
    # upper - size = z sqrt(2 square + 4 (square / noise) upper)
    middle = size + 2.0 * _NORMAL**2 * square / noise
    upper = middle + np.sqrt(middle**2 - size**2 + 2.0 * _NORMAL**2 * square)
    return DrivenShift(float(np.sqrt(size)), float(np.sqrt(upper)), _detectable(fit, covariance, A))


def _detectable(fit: ResponseFit, covariance: Array, A: Array) -> float:
    """Return the rms K u that the F test finds with its power, averaged over random K of this rms."""
    from scipy.optimize import brentq
    from scipy.special import fdtri, ncfdtr

    count = len(covariance)
    K = np.random.default_rng(0).standard_normal((_PATTERNS, count))
    information = np.linalg.pinv(covariance, hermitian=True)
    strength = np.einsum("pi,ij,pj->p", K, information, K) / np.einsum("pi,ij,pj->p", K, A, K)
    if not (np.isfinite(strength).all() and strength.min() > 0.0):
        return float("nan")
    critical = float(fdtri(count, fit.dof, 1.0 - TESTED_AT))
    unit = 1.0 / float(np.sqrt(strength.mean()))

    def missed(size: float) -> float:
        chance = ncfdtr(count, fit.dof, (size * unit) ** 2 * strength, critical)
        return float(np.mean(np.nan_to_num(chance, nan=0.0))) - (1.0 - POWER)  # NaN far above the critical value

    high = 2.0 * np.sqrt(count * max(critical, 1.0)) + 10.0
    while missed(high) > 0.0:  # patterns along the worst known directions need more
        high *= 2.0
    return unit * float(brentq(missed, 1e-6, high, xtol=1e-4))
