"""Combinations of a cause's parameters that the data determine although they determine no single parameter.

Few epochs see a matrix of parameters along few directions. The eigenvectors of the parameters' covariance are
independent combinations, and those with the smallest variances are the best determined.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from truing.inference.arrays import Array

# Probability that chance makes any of the parameters, or of the combinations, differ from zero.
_LEVEL = 0.05


@dataclass(frozen=True)
class Combination:
    """A combination of parameters: coefficients (P,) of unit length, value and standard uncertainty."""

    coefficients: Array
    value: float
    sigma: float


def determined_combinations(values: Array, covariance: Array) -> list[Combination]:
    """Return the combinations that differ significantly from zero, the best determined first.

    values (P,) with covariance (P, P), all in one unit. Empty where a single parameter differs significantly from zero.
    Both tests are corrected for the number of parameters (Bonferroni).
    """
    bound = NormalDist().inv_cdf(1.0 - 0.5 * _LEVEL / max(len(values), 1))
    sigmas = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    if len(values) < 2 or not sigmas.all() or np.any(np.abs(values) > bound * sigmas):
        return []
    variances, vectors = np.linalg.eigh(covariance)
    combinations = []
    for variance, vector in zip(variances, vectors.T, strict=True):
        direction = vector * np.sign(vector[np.argmax(np.abs(vector))])
        value, sigma = float(direction @ values), float(np.sqrt(max(variance, 0.0)))
        if 0.0 < bound * sigma < abs(value):
            combinations.append(Combination(direction, value, sigma))
    return combinations
