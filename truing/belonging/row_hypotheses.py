"""Hypotheses about rows: readings that stand beside another pose than theirs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_SHIFTS = (1, -1, 2, -2, 3, -3)
_MOST_ROWS = 600  # whose every exchange is looked at; of longer tables the rows that fit worst
_CLEAR = 50.0  # log likelihood by which an exchange of rows has to win
_NEARLY = 1.5  # times the misfit of a free order, up to which a simple shift is the better word
_FIFTH = 0.2
_WORSE = 8.0  # times the typical misfit, from which on a row of a long table may be another one's


@dataclass(frozen=True)
class RowOrder:
    """Rows (B,) of the recorded readings that belong to each pose; -1 where none does.

    ``gain``: log likelihood over the order as recorded, less the penalty for its choice. ``shift``: where all rows are
    shifted, by how many they stand too far down.
    """

    rows: Index
    gain: float
    shift: int = 0

    @property
    def moved(self) -> Index:
        """Return the poses whose readings stand elsewhere."""
        return np.flatnonzero((self.rows != np.arange(len(self.rows))) & (self.rows >= 0))


def best_order(readings: Array, asked: Array, noise: float) -> RowOrder:
    """Return the order of rows under which readings (B, L) are most likely those asked for (B, L), both in m.

    The mean of each leg does not depend on the order of rows and is taken out. ``noise`` is the least that a row may
    be off by, one standard deviation.
    """
    shifted = [_shifted(readings, asked, noise, shift) for shift in _SHIFTS if 3 * abs(shift) < len(readings)]
    simple = max(shifted, key=lambda order: order.gain, default=None)
    free = _exchanged(readings, asked, noise)
    if simple is not None and simple.gain > _CLEAR:
        left, least = (_left(order, readings, asked) for order in (simple, free))
        if left <= _NEARLY * least:
            return simple
    return free if free.gain > _CLEAR else RowOrder(np.arange(len(readings)), 0.0)


def _left(order: RowOrder, readings: Array, asked: Array) -> float:
    """Median misfit, m, that an order leaves, about the median of each leg."""
    kept = order.rows >= 0
    misfit = readings[order.rows[kept]] - asked[kept]
    return float(np.median(np.abs(misfit - np.median(misfit, axis=0))))


def _about(values: Array, rows: Index) -> Array:
    return values[rows] - np.mean(values[rows], axis=0)


def _log_likelihood(misfit: Array, noise: float) -> float:
    """Of misfits (N, L) with one free level per leg, not below the noise."""
    level = np.maximum(np.sqrt(np.mean(misfit**2, axis=0)), noise)
    return float(-np.sum(len(misfit) * np.log(level)) - 0.5 * np.sum((misfit / level) ** 2))


def _shifted(readings: Array, asked: Array, noise: float, shift: int) -> RowOrder:
    """Readings that stand ``shift`` rows too far down, in the rows that overlap."""
    count = len(readings)
    poses = np.arange(max(0, -shift), count - max(0, shift))
    rows = np.full(count, -1, np.int64)
    rows[poses] = poses + shift
    kept = _log_likelihood(_about(readings, poses) - _about(asked, poses), noise)
    moved = _log_likelihood(_about(readings, poses + shift) - _about(asked, poses), noise)
    return RowOrder(rows, moved - kept - np.log(len(_SHIFTS)), shift)


def _exchanged(readings: Array, asked: Array, noise: float) -> RowOrder:
    """The assignment of rows to poses with the smallest squares, with only those exchanges that clearly pay."""
    every = np.arange(len(readings))
    offset, level = np.mean(readings - asked, axis=0), np.maximum(np.std(asked, axis=0), noise)
    suspects = every if len(every) <= _MOST_ROWS else _worst(readings - asked - np.median(readings - asked, axis=0))
    for _ in range(2):  # the second time with the level and the zero that the first assignment leaves
        between = (readings[suspects] - offset)[None] - asked[suspects][:, None]
        cost = np.sum(np.log1p((between / level) ** 2), axis=2)  # bounded growth: one wild leg decides nothing
        poses, rows = linear_sum_assignment(cost)
        left = readings[suspects[rows]] - asked[suspects[poses]]
        if len(suspects) == len(every):
            offset = np.median(left, axis=0)
            level = np.maximum(1.4826 * np.median(np.abs(left - offset), axis=0), noise)
    order = every.copy()
    order[suspects[poses]] = suspects[rows]
    paid = 0.0
    place = {int(row): at for at, row in enumerate(suspects)}
    for cycle in _cycles(order):
        at = np.array([place[pose] for pose in cycle])
        now = np.array([place[int(order[pose])] for pose in cycle])
        gain = 0.5 * float(np.sum(cost[at, at] - cost[at, now])) * readings.shape[1]
        gain -= len(cycle) * np.log(len(every))
        if gain > _CLEAR and _consistent(between[at, now], between[at, at]):
            paid += gain
        else:
            order[cycle] = cycle
    return RowOrder(order, paid)


def _worst(misfit: Array) -> Index:
    level = np.maximum(1.4826 * np.median(np.abs(misfit), axis=0), 1e-300)
    size = np.sqrt(np.mean((misfit / level) ** 2, axis=1))
    order = np.argsort(-size)[:_MOST_ROWS]
    return np.sort(order[size[order] > _WORSE])


def _consistent(after: Array, before: Array) -> bool:
    """Whether exchanged rows (N, L) leave a fifth of their misfit at most, as no exchange of random rows does."""
    return bool(np.mean(after**2) < _FIFTH**2 * np.mean(before**2))


def _cycles(order: Index) -> list[list[int]]:
    """The cycles of a permutation that move anything."""
    left, found = set(np.flatnonzero(order != np.arange(len(order))).tolist()), []
    while left:
        cycle, at = [], min(left)
        while at in left:
            left.remove(at)
            cycle.append(at)
            at = int(order[at])
        found.append(cycle)
    return found
