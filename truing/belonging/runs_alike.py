"""What columns answer to loads as most runs have it: the expectation where nothing else predicts it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.belonging.responses import Responses
from truing.belonging.slip_search import Expected

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_MOST_LEVERAGE = 0.6  # of one response over the others: two others of its kind leave 0.5
_ROUNDS = 30
_CLOSE = 1e-3  # of a typical response: nearer to it, a response gains no more weight
_OPEN = 1e-6
_CROSS, _MAIN, _LINEAR = 0.03, 0.07, 0.05  # runs of the same loads answer alike, but for drift, creep and warmth


def typical(found: Responses, count: int) -> tuple[Expected, Mask]:
    """Return what columns (count) answer by most runs, and which responses (C,) at least two other runs vouch for."""
    of_load = 1.0 / np.maximum(np.abs(found.direction).max(axis=0, initial=0.0), 1e-300)
    share = found.direction * of_load
    matrix, vouched = np.zeros((count, 6)), np.zeros(len(found), bool)
    for column in range(count):
        mine = found.column == column
        if mine.any():
            matrix[column] = _least_absolute(share[mine], found.size[mine])
            vouched[mine] = _vouched(share[mine], found.run[mine])
    of_column = np.maximum(np.abs(matrix).max(axis=1), 1e-300)
    expected = Expected(
        matrix * of_load, of_column, np.where(of_load < 1e200, of_load, 0.0), cross=_CROSS, main=_MAIN, linear=_LINEAR
    )
    return expected, vouched


def _least_absolute(share: Array, size: Array) -> Array:
    """Coefficients (6,) of least absolute deviations of sizes (C,) by shares (C, 6), by reweighting."""
    weight = np.ones(len(size))
    floor = _CLOSE * max(float(np.median(np.abs(size))), 1e-300)
    found: Array = np.zeros(6)
    for _ in range(_ROUNDS):
        found = np.asarray(np.linalg.lstsq(weight[:, None] * share, weight * size, rcond=_OPEN)[0])
        weight = 1.0 / np.sqrt(np.maximum(np.abs(size - share @ found), floor))
    return found


def _vouched(share: Array, run: NDArray[np.int64]) -> Mask:
    """Whether the responses of other runs determine each, at least twice."""
    out = np.zeros(len(share), bool)
    for one in np.unique(run):
        mine, others = run == one, share[run != one]
        if len(others):
            size, right = np.linalg.svd(others, full_matrices=False)[1:]
            good = size > _OPEN * max(size[0], 1.0)
            along = share[mine] @ right[good].T
            leverage = np.sum((along / size[good]) ** 2, axis=1)
            outside = np.sum(share[mine] ** 2, axis=1) - np.sum(along**2, axis=1)
            out[mine] = (leverage <= _MOST_LEVERAGE) & (outside <= _OPEN)
    return out
