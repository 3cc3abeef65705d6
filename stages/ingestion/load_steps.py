"""Load steps in the order in which they were taken: one row per step and channel, times that go forward."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.formats.faultlog import FaultLog
from truing.formats.gather import Gathered
from truing.stages.ingestion.gathered_columns import numbered, numbers

Array = NDArray[np.float64]


def check_once(found: Gathered, log: FaultLog, *key: str, cure: str = "") -> None:
    """A fault at every row whose key stood in a row before; cure: what to do where that is meant."""
    rows = np.flatnonzero(found.sound(*key))
    _, first = np.unique(numbered(found, *key)[rows], return_index=True)
    again = found.sound(*key)
    again[rows[first]] = False
    found.fault(log, again, key[-1], f"every {', '.join(key)} once{cure}")


def check_times(found: Gathered, log: FaultLog) -> None:
    """A fault at every row that was not taken after the step before it in its run."""
    if "time_s" not in found.table.column_names:
        return
    run, step, time = numbered(found, "run"), numbers(found, "step"), numbers(found, "time_s")
    wrong = np.zeros(len(run), dtype=bool)
    order = np.lexsort((time, step, run))
    order = order[found.sound("run", "step", "time_s")[order]]
    for rows in np.split(order, np.flatnonzero(np.diff(run[order])) + 1):
        known = rows[np.isfinite(time[rows])]
        before = np.searchsorted(step[known], step[known])  # the first row of the same step: before it, the latest
        wrong[known] = (before > 0) & (time[known] <= time[known[before - 1]])
    found.fault(log, wrong, "time_s", "a time after that of the step before: steps are in the order taken")


def check_roles(found: Gathered, log: FaultLog) -> None:
    """A fault at every row whose role is not that of its run's first row."""
    if "role" not in found.table.column_names:
        return
    rows = np.flatnonzero(found.sound("run", "role"))
    role = numbered(found, "role")[rows]
    _, first, at = np.unique(numbered(found, "run")[rows], return_index=True, return_inverse=True)
    other = np.zeros(len(found.table), dtype=bool)
    other[rows] = role != role[first[at]]
    found.fault(log, other, "role", "one role for all of a run: it is held out as a whole, or not")


def times_from_order(run: NDArray[np.int64], step: Array, known: Array) -> Array:
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
            time[rows] = _filled(step[rows], known[rows], seen)
    return time


def _filled(step: Array, time: Array, seen: NDArray[np.bool_]) -> Array:
    """Times between known ones by steps, beyond them at the mean pace (1 s where there is but one)."""
    first, last = np.flatnonzero(seen)[[0, -1]]
    pace = (time[last] - time[first]) / (step[last] - step[first]) if last > first else 1.0
    filled = np.interp(step, step[seen], time[seen])
    filled = filled + pace * (np.minimum(step - step[first], 0.0) + np.maximum(step - step[last], 0.0))
    return np.asarray(filled)
