"""Evidence of an effect some of whose parameters are of like size, as those of parts that were made alike.

Legs of one make drift, lag or bend by like amounts, of one sign or of either; a leg that does not is spared, and its
cause concerns the others. Independent parameters would pay for each leg as if nothing were known of its size, and
leave it open whether a leg that shows nothing is spared or happens to be small.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

# Sizes in plausible scales, all equally likely beforehand; neighbours overlap by the smallest spread about them.
_SIZES = tuple(3.0 / 2.0 ** (step / 2) for step in range(13))
# Parameters of like size scatter by one of these shares of it, each as likely: parts of one batch, or of one make only.
_SPREADS = (0.15, 0.45)
# Half the probability is that of one sign for all; with more parameters than these there is no other.
_ONE_SIGN, _MOST_SIGNS = 0.5, 8


def alike_log_evidence(
    scores: NDArray, gram: NDArray, alike: Sequence[int], total: float, freedom: float, stretch: float = 1.0
) -> float:
    """Return the log ratio of marginal likelihoods with and without an effect with parameters of like size.

    scores (P,): products of the parameters' columns with the residual, gram (P, P): with each other, in plausible
    scales; ``alike``: positions of the parameters of like size, the others are N(0, size^2). ``total``, ``freedom`` and
    ``stretch`` as in `evidence.log_evidence`.
    """
    sizes = stretch * np.array(_SIZES)
    logs = np.array([_of_spread(scores, gram, alike, total, freedom, sizes, spread) for spread in _SPREADS])
    largest = logs.max()
    return float(largest + np.log(np.mean(np.exp(logs - largest))))


def _of_spread(
    scores: NDArray, gram: NDArray, alike: Sequence[int], total: float, freedom: float, sizes: NDArray, spread: float
) -> float:
    """Return the same for one spread of the parameters of like size, all sizes (S,) equally likely."""
    signs, weights = _patterns(len(alike))
    patterns = np.zeros((len(signs), len(scores)))
    patterns[:, alike] = signs
    spreads = np.ones(len(scores))
    spreads[list(alike)] = spread
    values, vectors = np.linalg.eigh(spreads[:, None] * gram * spreads)
    power = np.multiply.outer(sizes**2, np.maximum(values, 0.0))  # (S, P)
    # Squares gained by a mean, size times a pattern: 2 g.m - m'Am; then by what is left along the spread.
    linear, square = patterns @ scores, np.einsum("ni,ij,nj->n", patterns, gram, patterns)
    along = ((scores * spreads) @ vectors, (patterns @ gram * spreads) @ vectors)
    left = sizes[:, None, None] * (along[0] - sizes[:, None, None] * along[1])  # (S, N, P)
    gained = 2 * np.outer(sizes, linear) - np.outer(sizes**2, square)
    gained += np.sum(left**2 / (1 + power)[:, None], -1)
    after = np.maximum(total - gained, 1e-9 * total)
    logs = -0.5 * np.sum(np.log1p(power), -1)[:, None] - freedom / 2 * np.log(after / total) + np.log(weights)
    largest = logs.max()
    return float(largest + np.log(np.sum(np.exp(logs - largest)) / len(sizes)))


@lru_cache(maxsize=64)
def _patterns(parts: int) -> tuple[NDArray, NDArray]:
    """Return signs (N, parts) and their probabilities; either sign of all is as likely as the other."""
    if not 1 < parts <= _MOST_SIGNS:
        return np.array([[1.0], [-1.0]]) * np.ones(parts), np.full(2, 0.5)
    signs = np.array(list(product((1.0, -1.0), repeat=parts)))
    one = np.abs(signs.sum(1)) == parts
    return signs, np.where(one, _ONE_SIGN / one.sum(), (1 - _ONE_SIGN) / (~one).sum())
