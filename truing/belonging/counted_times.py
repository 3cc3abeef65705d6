"""Were times recorded, or do they merely count what was measured? And missing ones that the order of steps tells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask


def merely_counts(time: Array, step: NDArray[np.number], run: Index) -> bool:
    """Whether times (B,) of steps (B,), in order within runs (B,), only count what was measured.

    They do where every run begins at the same time, and goes on by one a row or by one a step.
    """
    begins = np.flatnonzero(np.diff(run, prepend=run[:1] - 1))
    within = np.diff(run) == 0
    pace = np.diff(time)[within]
    if not len(pace) or np.ptp(time[begins]) != 0.0:
        return False
    return bool((pace == 1.0).all() or np.array_equal(pace, np.diff(step)[within]))


def times_from_order(run: Index, step: Array, known: Array) -> Array:
    """Times (N,) in s of steps (N,) from those known (NaN elsewhere), between which they count by steps.

    A run without any known time counts its steps, one per second: their order is all there is.
    """
    time = known.copy()
    for one in np.unique(run):
        rows = np.flatnonzero(run == one)
        rows = rows[np.argsort(step[rows], kind="stable")]
        seen = np.isfinite(known[rows])
        if not seen.any():
            time[rows] = np.arange(len(rows), dtype=float)
        elif not seen.all():
            time[rows] = _between_known(step[rows], known[rows], seen)
    return time


def _between_known(step: Array, time: Array, seen: Mask) -> Array:
    """Times between known ones by steps, beyond them at the mean pace (1 s where there is but one)."""
    first, last = np.flatnonzero(seen)[[0, -1]]
    pace = (time[last] - time[first]) / (step[last] - step[first]) if last > first else 1.0
    filled = np.interp(step, step[seen], time[seen])
    filled = filled + pace * (np.minimum(step - step[first], 0.0) + np.maximum(step - step[last], 0.0))
    return np.asarray(filled)
