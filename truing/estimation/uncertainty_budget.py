"""Uncertainty budgets in the terms of the GUM (JCGM 100:2008): what each source gives to results, and all together.

A linear(ised) estimate is ``x = sum_g A_g y_g`` of independent groups g of inputs, tolerances used as a prior being
one more group. What a group gives is ``A_g S_g A_g^T``, and the covariance of the estimate is the sum of these.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array

COVERAGE = 0.95  # probability of the interval of an expanded uncertainty
# Why a cause is in no budget, where estimates are off by it, and their uncertainty does not cover that.
NOT_HELD = "the diagnosis found it, and these results are of a model without it"
Evaluation = Literal["A", "B"]


@dataclass(frozen=True)
class Source:
    """A source of uncertainty: evaluated from observations of this campaign (A), or declared (B).

    dof: degrees of freedom of its size, infinite where it is taken as known.
    """

    name: str
    evaluation: Evaluation
    dof: float = np.inf
    distribution: str = "normal"


Covariances = Mapping[Source, NDArray]


@dataclass(frozen=True)
class Budget:
    """Standard uncertainties (S, N) that S independent sources give to N results."""

    sources: tuple[Source, ...]
    contributions: NDArray

    @property
    def standard(self) -> NDArray:
        """Return the combined standard uncertainties (N,)."""
        return np.sqrt(np.sum(self.contributions**2, axis=0))

    @property
    def shares(self) -> NDArray:
        """Return the share (S, N) of each source in the variance; zero where there is none."""
        total = self.standard**2
        return self.contributions**2 / np.where(total > 0.0, total, 1.0)

    @property
    def dof(self) -> NDArray:
        """Return the effective degrees of freedom (N,) by Welch and Satterthwaite (GUM G.4.1)."""
        own = np.array([1.0 / source.dof for source in self.sources])
        lost = own @ self.shares**2
        return np.divide(1.0, lost, out=np.full(len(lost), np.inf), where=lost > 0.0)

    @property
    def coverage(self) -> NDArray:
        """Return the coverage factors (N,): of Student's distribution with the effective degrees of freedom."""
        return coverage_factor(self.dof)

    @property
    def expanded(self) -> NDArray:
        """Return the expanded uncertainties (N,)."""
        return self.coverage * self.standard

    def scaled(self, factor: NDArray) -> Budget:
        """Return the budget of the results in other units, (N,) times as large."""
        return Budget(self.sources, self.contributions * np.abs(factor))

    def with_source(self, source: Source, contribution: NDArray) -> Budget:
        """Return the budget with one more source that gives (N,)."""
        return Budget((*self.sources, source), np.concatenate([self.contributions, contribution[None]]))

    def filled(self) -> Budget:
        """Return the budget without the sources that give nothing to any result."""
        some = np.any(self.contributions > 0.0, axis=1)
        return Budget(tuple(s for s, own in zip(self.sources, some, strict=True) if own), self.contributions[some])


def coverage_factor(dof: NDArray, probability: float = COVERAGE) -> NDArray:
    """Return the coverage factors (N,) of Student's distribution, both sides; not below one degree of freedom."""
    from scipy.special import ndtri, stdtrit

    upper = 0.5 + 0.5 * probability
    bounded = np.maximum(np.where(np.isfinite(dof), dof, 1e9), 1.0)
    return np.where(np.isfinite(dof), stdtrit(bounded, upper), ndtri(upper))


def linear_estimate(
    jacobian: NDArray, noise: Covariances, prior: Covariances | None = None, loadings: NDArray | None = None
) -> dict[Source, NDArray]:
    """Return the covariance (P, P) that each source gives to the least-squares estimate of P values.

    jacobian (B, m, P): equations or readings by values, B independent sets of them; noise: the covariance (B, n, n) of
    each group of inputs, seen through loadings (B, m, n) where these are not the equations themselves; prior: the
    precision (P, P) of each group of what was known before. The values have to be determined by all of it together.
    """
    seen = {
        source: covariance if loadings is None else loadings @ covariance @ np.swapaxes(loadings, -1, -2)
        for source, covariance in noise.items()
    }
    weighted = np.linalg.solve(sum(seen.values(), np.zeros(())), jacobian)  # W J
    known = dict(prior or {})
    precision = np.einsum("bmp,bmq->pq", jacobian, weighted) + sum(known.values(), np.zeros(()))
    covariance = _inverse(precision)
    found = {
        source: covariance @ np.einsum("bmp,bmn,bnq->pq", weighted, own, weighted, optimize=True) @ covariance
        for source, own in seen.items()
    }
    return found | {source: covariance @ own @ covariance for source, own in known.items()}


def _inverse(precision: NDArray) -> NDArray:
    """Return the inverse, of a matrix whose values may differ by many powers of ten."""
    scale = np.sqrt(np.diag(precision))
    return np.linalg.inv(precision / np.outer(scale, scale)) / np.outer(scale, scale)


def beyond_declared(covariances: Covariances, noisy: Source, ratio: float, found: Source) -> dict[Source, NDArray]:
    """Return covariances where what ``noisy`` gives, at ``ratio`` times its declared noise, is split in two.

    What its declared noise gives stays its own, and what the scatter has beyond that is of the source ``found``.
    """
    declared = 1.0 / max(ratio, 1.0) ** 2
    whole = covariances[noisy]
    return {**covariances, noisy: declared * whole, found: (1.0 - declared) * whole}


def budget(covariances: Covariances, by_values: NDArray | None = None) -> Budget:
    """Return the budget of N results that follow the values by (N, P), of the values themselves without it.

    Sources that give nothing to any result are left out.
    """
    rows = np.eye(len(next(iter(covariances.values())))) if by_values is None else by_values
    variances = {
        source: np.einsum("np,pq,nq->n", rows, own, rows, optimize=True) for source, own in covariances.items()
    }
    reported = {source: np.sqrt(np.maximum(own, 0.0)) for source, own in variances.items() if np.any(own > 0.0)}
    return Budget(tuple(reported), np.array(list(reported.values())).reshape(len(reported), len(rows)))


def root_mean_square(errors: Array) -> tuple[float, Budget]:
    """The root mean square of N errors and its budget: the scatter of their squares, of N - 1 degrees of freedom."""
    squares = errors**2
    value = float(np.sqrt(np.mean(squares)))
    spread = float(np.std(squares, ddof=1) / np.sqrt(len(squares)))
    own = spread / (2.0 * value) if value > 0.0 else 0.0
    source = Source("scatter from pose to pose, noise of the measurement included", "A", float(len(errors) - 1))
    return value, Budget((source,), np.array([[own]]))
