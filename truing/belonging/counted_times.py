"""Were times recorded, or do they merely count what was measured?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def merely_counts(time: Array, step: NDArray[np.number], run: NDArray[np.int64]) -> bool:
    """Return whether times (B,) of steps (B,), in order within runs (B,), only count what was measured.

    They do where every run begins at the same time, and goes on by one a row or by one a step.
    """
    begins = np.flatnonzero(np.diff(run, prepend=run[:1] - 1))
    within = np.diff(run) == 0
    pace = np.diff(time)[within]
    if not len(pace) or np.ptp(time[begins]) != 0.0:
        return False
    return bool((pace == 1.0).all() or np.array_equal(pace, np.diff(step)[within]))
