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
    sizes, places = stretch * np.array(_SIZES), list(alike)
    signs, weights = _patterns(len(alike))
    spreads = np.ones((len(_SPREADS), len(scores)))
    spreads[:, places] = np.array(_SPREADS)[:, None]
    values, vectors = np.linalg.eigh(spreads[:, :, None] * gram * spreads[:, None])
    power = np.multiply.outer(sizes**2, np.maximum(values, 0.0))  # (S, 2, P), for both spreads
    # Squares gained by a mean, size times a pattern: 2 g.m - m'Am; then by what is left along the spread.
    pulled = signs @ gram[places]  # (N, P)
    linear, square = signs @ scores[places], np.sum(pulled[:, places] * signs, 1)
    of_scores = np.einsum("p,zp,zpq->zq", scores, spreads, vectors)
    of_patterns = (pulled * spreads[:, None]) @ vectors  # (2, N, P)
    held = (sizes[:, None, None] ** 2 / (1 + power)).transpose(1, 2, 0)  # (2, P, S)
    gained = of_scores[:, None] ** 2 @ held + of_patterns**2 @ (held * sizes**2)
    gained -= 2 * ((of_scores[:, None] * of_patterns) @ (held * sizes))
    gained += 2 * np.outer(linear, sizes) - np.outer(square, sizes**2)  # (2, N, S)
    after = np.maximum(total - gained, 1e-9 * total)
    logs = -0.5 * np.sum(np.log1p(power), -1).T[:, None] - freedom / 2 * np.log(after / total)
    logs += np.log(weights / (len(sizes) * len(_SPREADS)))[:, None]
    largest = logs.max()
    return float(largest + np.log(np.sum(np.exp(logs - largest))))


@lru_cache(maxsize=64)
def _patterns(parts: int) -> tuple[NDArray, NDArray]:
    """Return signs (N, parts) and their probabilities; either sign of all is as likely as the other."""
    if not 1 < parts <= _MOST_SIGNS:
        return np.array([[1.0], [-1.0]]) * np.ones(parts), np.full(2, 0.5)
    signs = np.array(list(product((1.0, -1.0), repeat=parts)))
    one = np.abs(signs.sum(1)) == parts
    return signs, np.where(one, _ONE_SIGN / one.sum(), (1 - _ONE_SIGN) / (~one).sum())
