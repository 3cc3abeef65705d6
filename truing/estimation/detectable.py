"""How large an effect has to be for a search to see it."""

from __future__ import annotations

import numpy as np

from truing.estimation.evidence import NOISE_PRIOR_FREEDOM, Signature


def smallest_detectable(signature: Signature, freedom: float, level: float, power: float = 0.8) -> float | None:
    """Return the size, in plausible scales, that is found with the given power at a level per test; None if never.

    The size is the root mean square of the parameters of a pattern in no particular direction; F test, noncentral.
    """
    from scipy.special import fdtri, ncfdtr

    count = len(signature.strengths)
    if count == 0:
        return None
    left = freedom + NOISE_PRIOR_FREEDOM - count
    critical = fdtri(count, left, 1.0 - level)
    low, high = 0.0, 1e4
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if ncfdtr(count, left, middle, critical) > 1.0 - power else (low, middle)
    return float(np.sqrt(high / np.sum(signature.strengths**2)))
