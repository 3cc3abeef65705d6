"""Whether what a fit leaves is more than the declared noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from truing.estimation.evidence import NOISE_PRIOR_FREEDOM
from truing.estimation.whitening import Whitened


@dataclass(frozen=True)
class NoiseLevel:
    """The noise found over the declared one, its standard deviation, and the chance of so much where the declared
    one is right to within what it is taken to be known."""

    ratio: float
    sigma: float
    p_value: float


def noise_level(whitened: Whitened) -> NoiseLevel:
    """Return the level of the noise that a fit leaves; its logarithm is tested, one-sided."""
    freedom = whitened.freedom
    ratio = float(np.sqrt(whitened.rest @ whitened.rest / freedom))
    spread = math.sqrt(0.5 / NOISE_PRIOR_FREEDOM + 0.5 / freedom)
    p_value = 0.5 * math.erfc(math.log(ratio) / spread / math.sqrt(2.0))
    return NoiseLevel(ratio, ratio * math.sqrt(0.5 / freedom), p_value)
