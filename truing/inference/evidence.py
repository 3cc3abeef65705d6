"""Evidence for an effect in a residual: marginal likelihood of the model with it over that of the model without it.

Parameters are N(0, size^2) in plausible scales. The size is shared by an effect's parameters and marginalised, so no
single scale decides. The noise level is free, with the declared noise as prior.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np

from truing.inference.arrays import Array

# Prior of the size of an effect, in plausible scales: these values, with equal probability. They reach as far up as
# down: an effect far above its plausible scale is no proof of a cause that happens to have a wider one.
SIZES = (30.0, 10.0, 3.0, 1.0, 1 / 3, 1 / 10, 1 / 30)
# Largest size of properties of materials, whose range is known.
_LARGEST_KNOWN = 3.0
_LEAST_LEFT = 1e-12
# The same for parameters of like size; neighbouring sizes overlap within the smallest spread about them.
LIKE_SIZES = tuple(3.0 / 2.0 ** (step / 2) for step in range(-7, 13))
# Relative scatter of parameters of like size, with equal probability: parts of one batch, or only of one make.
_SPREADS = (0.15, 0.45)
# Probability that all parameters have the same sign; with more parameters than the second it is 1.
_ONE_SIGN, _MOST_SIGNS = 0.5, 8


def log_evidence(
    along: Array, strengths: Array, total: Array | float, freedom: float, sizes: Sequence[float] = SIZES
) -> Array:
    """Return the log ratio (...) of marginal likelihoods with and without an effect.

    ``along`` (..., r): parts of a residual along directions of strengths (..., r); ``total`` (...): its sum of squares;
    ``freedom``: its degrees of freedom, including those of the declared noise; ``sizes``: equally probable ones.
    """
    return sized_effect(strengths, sizes).log_evidence(along, total, freedom)


@dataclass(frozen=True)
class SizedEffect:
    """An effect of S equally probable sizes, as far as it does not depend on residuals.

    ``shares`` (..., r, S): shares of the squares along its directions that it explains; ``log_volumes`` (..., S): half
    the log determinants of the covariance with it, in units of that without it.
    """

    shares: Array
    log_volumes: Array

    def log_evidence(self, along: Array, total: Array | float, freedom: float) -> Array:
        """Return the log ratio (...) of `log_evidence` for parts (..., r) of a residual with squares ``total``."""
        before = np.asarray(total)[..., None]
        after = before - (np.square(along)[..., None, :] @ self.shares)[..., 0, :]
        after = np.maximum(after, _LEAST_LEFT * before)  # rounding may make an almost complete reduction negative
        logs = -self.log_volumes - freedom / 2.0 * np.log(after / before)
        largest = logs.max(-1, keepdims=True)
        return np.asarray(largest[..., 0] + np.log(np.mean(np.exp(logs - largest), -1)))


def sized_effect(strengths: Array, sizes: Sequence[float]) -> SizedEffect:
    """Return the effect with directions of strengths (..., r) for each of equally probable ``sizes``."""
    power = np.multiply.outer(strengths**2, np.square(sizes))  # (..., r, S)
    return SizedEffect(power / (1.0 + power), 0.5 * np.sum(np.log1p(power), -2))


def log_evidence_of_products(
    gram: Array, scores: Array, total: float, freedom: float, sizes: Sequence[float] = SIZES
) -> float:
    """Return the log ratio of `log_evidence` from products of an effect's columns, without its directions.

    ``gram`` (P, P): products of the columns in plausible scales; ``scores`` (P,): those with the residual.
    """
    powers = np.square(sizes)
    factor = np.linalg.cholesky(np.eye(len(gram)) + powers[:, None, None] * gram)
    gained = powers * np.sum(np.linalg.solve(factor, np.broadcast_to(scores, factor.shape[:2])[..., None]) ** 2, (1, 2))
    after = np.maximum(total - gained, _LEAST_LEFT * total)
    logs = -np.sum(np.log(np.diagonal(factor, axis1=1, axis2=2)), 1) - freedom / 2.0 * np.log(after / total)
    return float(np.logaddexp.reduce(logs) - np.log(len(logs)))


def sizes_of(sizes: Sequence[float], stretch: float, *, is_known: bool) -> list[float]:
    """Return the ``sizes`` that are possible, stretched: none above three plausible scales if the range is known."""
    return [stretch * size for size in sizes if not is_known or size <= _LARGEST_KNOWN]


def log_possible(values: Array, covariance: Array, places: Sequence[int], left: float, freedom: float) -> float:
    """Return the gain in log evidence from the knowledge that some parameters are not negative.

    values (P,) with covariance (P, P) at the declared noise; ``left``: sum of squares that the effect leaves;
    ``freedom``: its degrees of freedom, including those of the declared noise. Half the prior is excluded, so the gain
    is the log of twice the posterior probability of the allowed side: about a hundredth at 2.5 sigma on the wrong side.
    The noise is that of `log_evidence`, so that a single parameter of the wrong sign has no evidence, however large.
    Student's t as a normal deviate: Wallace, Ann. Math. Statist. 30 (1959) 1124.
    """
    from scipy.special import log_ndtr

    at = list(places)
    sigma = np.sqrt(np.maximum(covariance[at, at], _LEAST_LEFT) * left / freedom)
    deviates = values[at] / sigma
    normal = np.copysign(np.sqrt(freedom * np.log1p(deviates**2 / freedom)), deviates)
    return float(np.sum(np.log(2.0) + log_ndtr((8.0 * freedom + 1.0) / (8.0 * freedom + 3.0) * normal)))


def probabilities(log_evidence: Mapping[str, float]) -> dict[str, float]:
    """Return the probability of each candidate among all of them and none, all with equal prior."""
    values = np.array([0.0, *log_evidence.values()])
    weights = np.exp(values - values.max())
    return dict(zip(log_evidence, (float(w) for w in weights[1:] / weights.sum()), strict=True))


def like_sized_log_evidence(
    scores: Array, gram: Array, alike: Sequence[int], total: float, freedom: float, sizes: Sequence[float] = LIKE_SIZES
) -> Array:
    """Return the log ratio (...) of marginal likelihoods with and without an effect whose parameters have like size.

    scores (..., P): products of the parameters' columns with the residual; gram (..., P, P): products with each other,
    in plausible scales; ``alike``: positions of the parameters of like size, the others are N(0, size^2). ``total``,
    ``freedom`` and ``sizes`` as in `log_evidence`.
    """
    size, places = np.array(sizes), list(alike)
    signs, weights = _patterns(len(alike))
    spreads = np.ones((len(_SPREADS), scores.shape[-1]))
    spreads[:, places] = np.array(_SPREADS)[:, None]
    values, vectors = np.linalg.eigh(spreads[:, :, None] * gram[..., None, :, :] * spreads[:, None])
    power = np.maximum(values, 0.0)[..., None] * size**2  # (..., 2, P, S), for both spreads
    # Reduction of squares by a mean m (size times a pattern): 2 g.m - m'Am; then by the rest along the spread.
    pulled = signs @ gram[..., places, :]  # (..., N, P)
    linear, square = scores[..., places] @ signs.T, np.sum(pulled[..., places] * signs, -1)
    of_scores = ((scores[..., None, :] * spreads)[..., None, :] @ vectors)[..., 0, :]  # (..., 2, P)
    of_patterns = (pulled[..., None, :, :] * spreads[:, None]) @ vectors  # (..., 2, N, P)
    held = size**2 / (1 + power)
    gained = of_scores[..., None, :] ** 2 @ held + of_patterns**2 @ (held * size**2)
    gained -= 2 * ((of_scores[..., None, :] * of_patterns) @ (held * size))
    gained += (2 * linear[..., None] * size - square[..., None] * size**2)[..., None, :, :]  # (..., 2, N, S)
    after = np.maximum(total - gained, 1e-9 * total)
    logs = -0.5 * np.sum(np.log1p(power), -2)[..., None, :] - freedom / 2 * np.log(after / total)
    logs += np.log(weights / (len(size) * len(_SPREADS)))[:, None]
    largest = logs.max((-3, -2, -1), keepdims=True)
    return np.asarray(largest[..., 0, 0, 0] + np.log(np.sum(np.exp(logs - largest), (-3, -2, -1))))


@lru_cache(maxsize=64)
def _patterns(parts: int) -> tuple[Array, Array]:
    """Return sign patterns (N, parts) and their probabilities; a pattern and its opposite are equally likely."""
    if not 1 < parts <= _MOST_SIGNS:
        return np.array([[1.0], [-1.0]]) * np.ones(parts), np.full(2, 0.5)
    signs = np.array(list(product((1.0, -1.0), repeat=parts)))
    is_one_sign = np.abs(signs.sum(1)) == parts
    return signs, np.where(is_one_sign, _ONE_SIGN / is_one_sign.sum(), (1 - _ONE_SIGN) / (~is_one_sign).sum())
