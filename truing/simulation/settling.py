"""Exponential settling with one time constant, normalised to a finite interval."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def settling(passed: NDArray, rate: NDArray | complex) -> tuple[NDArray, NDArray]:
    """Return the course (1 - exp(-rate x)) / (1 - exp(-rate)), (B,), and its derivative by the log of its time
    constant.

    passed: x (B,), 0 at the start and 1 at the end; rate: length of the interval over the time constant.
    """
    total = -np.expm1(-rate)
    value = -np.expm1(-rate * passed) / total
    by_rate = (passed * np.exp(-rate * passed) - value * np.exp(-rate)) / total
    return value, -rate * by_rate
