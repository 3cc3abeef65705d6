"""Exact comparison of two rates, from counts of several sizes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Pair:
    """Counts of successes of two methods, and their numbers of trials."""

    first: int
    of_first: int
    second: int
    of_second: int


def unlike(pairs: Iterable[Pair]) -> float:
    """Return the p-value of the difference between two sums of counts, if both rates are equal within each pair.

    Rates may differ from pair to pair. The test is exact: Fisher's, with the counts added over the pairs.
    """
    from scipy.stats import hypergeom

    chance, least, seen = np.ones(1), 0, 0
    for pair in pairs:
        both, trials = pair.first + pair.second, pair.of_first + pair.of_second
        low, high = max(0, both - pair.of_second), min(both, pair.of_first)
        chance = np.convolve(chance, hypergeom.pmf(np.arange(low, high + 1), trials, both, pair.of_first))
        least, seen = least + low, seen + pair.first
    as_much = chance <= chance[seen - least] * (1.0 + 1e-9)
    return float(min(chance[as_much].sum(), 1.0))
