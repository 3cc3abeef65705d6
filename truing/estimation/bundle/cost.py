"""Time and memory that the adjustment of a network will take, from its size alone.

Processor time is that of a usual run, from start values to the last test of the rays, on one core of 2024; gross
errors take more rounds of tests and up to twice as long. Measured by
`python -m benchmarks.large_network` and on a public network (romabundledemo of DBAT).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.arrays import Index
from truing.estimation.bundle.row_blocks import is_large

_STEPS, _COVARIANCES = 200, 20  # of a run
_PER_RAY = 1.7e-6  # s per ray and step
_RATE = 2e10  # floating-point operations per second in products of matrices
_BASE = 250e6  # bytes, for the program
_BYTES_PER_RAY = 7e3  # for all tables and arrays of a ray
_DOUBLE = 8


@dataclass(frozen=True)
class AdjustmentCost:
    """Expected processor time in s and peak memory in bytes."""

    seconds: float
    bytes: float


def adjustment_cost(images: Index, points: Index, rays: Index) -> AdjustmentCost:
    """Return the expected cost of a network from its numbers of images, points and rays per pose (S,)."""
    i, p = 6.0 * images, 3.0 * points
    smaller = np.minimum(i, p)
    by_ray = is_large(images, points)
    step = np.where(by_ray, 0.0, np.maximum(i, p) * smaller**2) + smaller**3 / 3
    operations = smaller**3 + np.where(by_ray, 0.0, 2 * p**2 * smaller)
    seconds = _STEPS * (_PER_RAY * float(rays.sum()) + float(step.sum()) / _RATE)
    seconds += _COVARIANCES * float(operations.sum()) / _RATE
    arrays = smaller**2 * 3 + np.where(by_ray, 0.0, 3 * i * p + p**2)
    largest = float(np.max(np.where(by_ray, 0.0, 3 * p**2), initial=0.0))
    return AdjustmentCost(
        seconds, _BASE + _BYTES_PER_RAY * float(rays.sum()) + _DOUBLE * (float(arrays.sum()) + largest)
    )
