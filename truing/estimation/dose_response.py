"""Effect size that is found with a given probability, from detection counts at several sizes; bounds of rates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interval import Interval

# The size found with probability 1/2 may differ from the theoretical one by this much, in natural logarithms.
_FAR, _STEPS = np.log(6.0), 121
# Slopes of the curve over the natural logarithm of the size: from a rise over a decade to one over a tenth.
_SLOPES = np.geomspace(0.8, 16.0, 33)


def rate_bounds(found: int, count: int, level: float = 0.95) -> tuple[float, float]:
    """Return the bounds of a rate from ``found`` of ``count`` trials (Clopper and Pearson, 1934)."""
    from scipy.special import betaincinv

    tail = (1.0 - level) / 2.0
    lower = 0.0 if found == 0 else float(betaincinv(found, count - found + 1, tail))
    upper = 1.0 if found == count else float(betaincinv(found + 1, count - found, 1.0 - tail))
    return lower, upper


def size_found(sizes: NDArray, found: NDArray, counts: NDArray, expected: float, power: float) -> Interval:
    """Return the size found with probability ``power``: posterior median and 95 % interval.

    sizes (S,), found and counts (S,). The detection probability is a normal distribution function of the logarithm of
    the size, with unknown centre and slope. Prior: centre uniform within a factor of six of ``expected``, the
    theoretical size at probability 1/2.
    """
    from scipy.special import ndtr, ndtri

    middle = np.linspace(-_FAR, _FAR, _STEPS)[:, None]
    reached = ndtr(_SLOPES[:, None] * (np.log(sizes / expected) - middle[..., None]))
    safe = np.clip(reached, 1e-12, 1.0 - 1e-12)
    logs = np.sum(found * np.log(safe) + (counts - found) * np.log1p(-safe), -1)
    weights = np.exp(logs - logs.max())
    values = np.broadcast_to(middle + ndtri(power) / _SLOPES, weights.shape)
    order = np.argsort(values, axis=None)
    until = np.cumsum(weights.ravel()[order]) / weights.sum()
    at = np.exp(np.interp([0.5, 0.025, 0.975], until, values.ravel()[order])) * expected
    return Interval(*(float(value) for value in at))
