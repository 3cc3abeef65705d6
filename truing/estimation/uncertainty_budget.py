"""Uncertainty budgets by the GUM (JCGM 100:2008): contributions of each source to results, and their combination.

A linear(ised) estimate is ``x = sum_g A_g y_g`` of independent groups g of inputs; prior tolerances are one more group.
The contribution of a group is ``A_g S_g A_g^T``; the covariance of the estimate is their sum.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array

COVERAGE = 0.95  # probability of the interval of an expanded uncertainty
# Reasons to leave a cause out of all budgets: it biases the estimates, and their uncertainty does not include that.
NOT_HELD = "the diagnosis found it, and the model of these results does not contain it"
Evaluation = Literal["A", "B"]


@dataclass(frozen=True)
class Source:
    """A source of uncertainty: evaluated from observations of this campaign (A), or declared (B).

    dof: degrees of freedom of its size, infinite if it is taken as known.
    """

    name: str
    evaluation: Evaluation
    dof: float = np.inf
    distribution: str = "normal"


Covariances = Mapping[Source, NDArray]


@dataclass(frozen=True)
class Budget:
    """Standard uncertainties (S, N) of N results due to S independent sources."""

    sources: tuple[Source, ...]
    contributions: NDArray

    @property
    def standard(self) -> NDArray:
        """Combined standard uncertainties (N,)."""
        return np.sqrt(np.sum(self.contributions**2, axis=0))

    @property
    def shares(self) -> NDArray:
        """Shares (S, N) of the sources in the variance; zero for zero variance."""
        total = self.standard**2
        return self.contributions**2 / np.where(total > 0.0, total, 1.0)

    @property
    def dof(self) -> NDArray:
        """Effective degrees of freedom (N,) by Welch and Satterthwaite (GUM G.4.1)."""
        inverse_dof = np.array([1.0 / source.dof for source in self.sources])
        lost = inverse_dof @ self.shares**2
        return np.divide(1.0, lost, out=np.full(len(lost), np.inf), where=lost > 0.0)

    @property
    def coverage(self) -> NDArray:
        """Coverage factors (N,) of Student's distribution with the effective degrees of freedom."""
        return coverage_factor(self.dof)

    @property
    def expanded(self) -> NDArray:
        """Expanded uncertainties (N,)."""
        return self.coverage * self.standard

    def scaled(self, factor: NDArray) -> Budget:
        """Return the budget of the results in other units, (N,) times as large."""
        return Budget(self.sources, self.contributions * np.abs(factor))

    def with_source(self, source: Source, contribution: NDArray) -> Budget:
        """Return the budget with one more source that contributes (N,)."""
        return Budget((*self.sources, source), np.concatenate([self.contributions, contribution[None]]))

    def filled(self) -> Budget:
        """Return the budget without sources that contribute nothing."""
        some = np.any(self.contributions > 0.0, axis=1)
        return Budget(
            tuple(s for s, is_used in zip(self.sources, some, strict=True) if is_used), self.contributions[some]
        )


def coverage_factor(dof: NDArray, probability: float = COVERAGE) -> NDArray:
    """Return the two-sided coverage factors (N,) of Student's distribution, with at least one degree of freedom."""
    from scipy.special import ndtri, stdtrit

    upper = 0.5 + 0.5 * probability
    bounded = np.maximum(np.where(np.isfinite(dof), dof, 1e9), 1.0)
    return np.where(np.isfinite(dof), stdtrit(bounded, upper), ndtri(upper))


def linear_estimate(
    jacobian: NDArray, noise: Covariances, prior: Covariances | None = None, loadings: NDArray | None = None
) -> dict[Source, NDArray]:
    """Return the covariance (P, P) of the least-squares estimate of P values due to each source.

    jacobian (B, m, P): derivative of B independent sets of equations or readings by the values; noise: covariance (B,
    n, n) of each group of inputs, which act through loadings (B, m, n) if they are not the equations themselves; prior:
    precision (P, P) of each group of prior knowledge. All of it together has to determine the values.
    """
    seen = {
        source: covariance if loadings is None else loadings @ covariance @ np.swapaxes(loadings, -1, -2)
        for source, covariance in noise.items()
    }
    weighted = np.linalg.solve(sum(seen.values(), np.zeros(())), jacobian)  # W J
    known = dict(prior or {})
    precision = np.einsum("bmp,bmq->pq", jacobian, weighted) + sum(known.values(), np.zeros(()))
    covariance = _inverse(precision)
    parts = {
        source: covariance @ np.einsum("bmp,bmn,bnq->pq", weighted, derivative, weighted, optimize=True) @ covariance
        for source, derivative in seen.items()
    }
    return parts | {source: covariance @ information @ covariance for source, information in known.items()}


def _inverse(precision: NDArray) -> NDArray:
    """Return the inverse of a matrix whose values may differ by many powers of ten."""
    scale = np.sqrt(np.diag(precision))
    return np.linalg.inv(precision / np.outer(scale, scale)) / np.outer(scale, scale)


def beyond_declared(covariances: Covariances, noisy: Source, ratio: float, source: Source) -> dict[Source, NDArray]:
    """Return covariances with the contribution of ``noisy``, at ``ratio`` times its declared noise, split in two.

    The declared noise keeps its contribution; the excess scatter belongs to the source ``source``.
    """
    declared = 1.0 / max(ratio, 1.0) ** 2
    covariance = covariances[noisy]
    return {**covariances, noisy: declared * covariance, source: (1.0 - declared) * covariance}


def budget(covariances: Covariances, by_values: NDArray | None = None) -> Budget:
    """Return the budget of N results with derivative (N, P) by the values, or of the values themselves.

    Sources that contribute nothing are left out.
    """
    rows = np.eye(len(next(iter(covariances.values())))) if by_values is None else by_values
    variances = {
        source: np.einsum("np,pq,nq->n", rows, covariance, rows, optimize=True)
        for source, covariance in covariances.items()
    }
    reported = {
        source: np.sqrt(np.maximum(variance, 0.0)) for source, variance in variances.items() if np.any(variance > 0.0)
    }
    return Budget(tuple(reported), np.array(list(reported.values())).reshape(len(reported), len(rows)))


def root_mean_square(errors: Array) -> tuple[float, Budget]:
    """Return the root mean square of N errors and its budget: the scatter of their squares, with N - 1 degrees of
    freedom."""
    squares = errors**2
    value = float(np.sqrt(np.mean(squares)))
    spread = float(np.std(squares, ddof=1) / np.sqrt(len(squares)))
    relative = spread / (2.0 * value) if value > 0.0 else 0.0
    source = Source("scatter from pose to pose, noise of the measurement included", "A", float(len(errors) - 1))
    return value, Budget((source,), np.array([[relative]]))
