"""Recorded times: are they real or only a count of the measurements? Missing times follow from the order of steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask


def merely_counts(time: Array, step: NDArray[np.number], run: Index) -> bool:
    """Return True if times (B,) of steps (B,), in order within runs (B,), only count the measurements.

    They do if every run begins at the same time and advances by one per row or by one per step.
    """
    begins = np.flatnonzero(np.diff(run, prepend=run[:1] - 1))
    within = np.diff(run) == 0
    pace = np.diff(time)[within]
    if not len(pace) or np.ptp(time[begins]) != 0.0:
        return False
    return bool((pace == 1.0).all() or np.array_equal(pace, np.diff(step)[within]))


def times_from_order(run: Index, step: Array, known: Array) -> Array:
    """Return times (N,) in s of steps (N,), interpolated by step between known ones (NaN elsewhere).

    In a run without any known time, steps count one second each: only their order is known.
    """
    time = known.copy()
    for number in np.unique(run):
        rows = np.flatnonzero(run == number)
        rows = rows[np.argsort(step[rows], kind="stable")]
        is_observed = np.isfinite(known[rows])
        if not is_observed.any():
            time[rows] = np.arange(len(rows), dtype=float)
        elif not is_observed.all():
            time[rows] = _between_known(step[rows], known[rows], is_observed)
    return time


def _between_known(step: Array, time: Array, is_observed: Mask) -> Array:
    """Return times interpolated by step between known ones, extrapolated at the mean pace (1 s if only
    one is known)."""
    first, last = np.flatnonzero(is_observed)[[0, -1]]
    pace = (time[last] - time[first]) / (step[last] - step[first]) if last > first else 1.0
    filled = np.interp(step, step[is_observed], time[is_observed])
    filled = filled + pace * (np.minimum(step - step[first], 0.0) + np.maximum(step - step[last], 0.0))
    return np.asarray(filled)
