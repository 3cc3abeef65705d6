"""How much a residual speaks for an effect: its marginal likelihood over that of the model without it.

Parameters are N(0, size^2) in plausible scales. The size is shared by an effect's parameters and marginalised, so that
the answer hangs on no one scale; the noise level is free, with declared knowledge as prior.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

# Effects may be this many times as large as plausible, all equally likely beforehand.
SIZES = (3.0, 1.0, 1 / 3, 1 / 10, 1 / 30)
_LEAST_LEFT = 1e-12


def log_evidence(
    along: NDArray, strengths: NDArray, total: NDArray | float, freedom: float, stretch: float = 1.0
) -> NDArray:
    """Return the log ratio of marginal likelihoods with and without an effect, (...).

    ``along`` (..., r) are a residual's parts along directions of strengths (..., r), ``total`` (...) its sum of squares
    and ``freedom`` its degrees of freedom, declared knowledge included; ``stretch`` multiplies the plausible scales.
    """
    power = np.square(stretch) * np.multiply.outer(strengths**2, np.square(SIZES))  # (..., r, sizes)
    before = np.asarray(total)[..., None]
    after = before - np.sum(np.square(along)[..., None] * (power / (1.0 + power)), -2)
    after = np.maximum(after, _LEAST_LEFT * before)  # what is all but the whole residual may round to more than that
    logs = -0.5 * np.sum(np.log1p(power), -2) - freedom / 2.0 * np.log(after / before)
    largest = logs.max(-1, keepdims=True)
    return np.asarray(largest[..., 0] + np.log(np.mean(np.exp(logs - largest), -1)))


def log_possible(values: NDArray, covariance: NDArray, places: Sequence[int]) -> float:
    """Return what log evidence gains where parameters at some places are known to be no less than zero.

    Half of what is probable beforehand is not, so the gain is twice the probability that the data, values (P,) in units
    of the noise with covariance (P, P), leave to what is: a hundredth at two and a half sigma on the wrong side.
    """
    from scipy.special import log_ndtr

    at = list(places)
    sigma = np.sqrt(np.maximum(covariance[at, at], _LEAST_LEFT))
    return float(np.sum(np.log(2.0) + log_ndtr(values[at] / sigma)))


def probabilities(log_evidence: Mapping[str, float]) -> dict[str, float]:
    """Return the probability of each candidate, and of none of them, all equally likely beforehand."""
    values = np.array([0.0, *log_evidence.values()])
    weights = np.exp(values - values.max())
    return dict(zip(log_evidence, (float(w) for w in weights[1:] / weights.sum()), strict=True))
