"""Which load steps are the same load case: the same loads, reached the same way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stages.sensor.reading_arrays import RecordedSteps
from truing.estimation.interferometry.load_run import branches

Array = NDArray[np.float64]

BRANCHES = ("unloading", "unloaded", "loading")
# Of the largest load of its axis: loads that differ by less are the same.
_SAME = 1e-6


@dataclass(frozen=True)
class LoadCases:
    """K load cases: which one each of B steps belongs to, the loads (K, 6), the branch (K,) of BRANCHES, and whether
    nothing may be fitted to it (K,). ``branch_of_step`` (B,)."""

    of_step: NDArray[np.int64]
    load: Array
    branch: NDArray[np.int64]
    held_out: NDArray[np.bool_]
    branch_of_step: NDArray[np.int64]


def load_cases(steps: RecordedSteps) -> LoadCases:
    """The load cases in order of appearance; without load there is but one, whatever came before."""
    scale = np.abs(steps.load).max(axis=0, initial=0.0)
    share = np.round(steps.load / np.where(scale > 0.0, scale, 1.0) / _SAME)
    way = np.zeros(len(share), np.int64)
    for run in range(len(steps.runs)):
        way[steps.run == run] = branches(share[steps.run == run])
    branch = np.where((share == 0.0).all(axis=1), 1, np.where(way < 0, 0, 2))
    kind = np.column_stack([share, branch, steps.held_out])
    _, first, number = np.unique(kind, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    place = np.argsort(order)
    first = first[order]
    return LoadCases(place[number.ravel()], steps.load[first], branch[first], steps.held_out[first], branch)
