"""Columns with constant values while the loads change that normally move them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from truing.arrays import Array, Index
from truing.belonging.chance_equality import chance_of_equality, noise_of_neighbours

_CHANCE = 1e-6  # probability below which noise does not explain equal values in a whole run
_FEWEST = 4  # fewest successive equal values
_OVER_NOISE, _OVER_STEP = 20.0, 5.0
_OF_RANGE = 0.1  # share of the column's largest response
_AT_END = 0.01  # share of a column's range
_CORRECTION = 2e-5  # largest relative correction of a reading from one step to the next
_BEYOND = 0.9  # share of rows on one side of the value, as for a clipped signal


@dataclass(frozen=True)
class Frozen:
    """A column that is constant in a run (index) from some row on; expected movement over its largest response."""

    column: int
    run: int
    whole: bool
    share: float


def frozen(load: Array, run: Index, value: Array, matrix: Array, noise: Array) -> Iterator[Frozen]:
    """Yield columns (N, K) that are constant where loads (N, 6) should move them by their response matrix (K, 6).

    noise (K,): one standard deviation, NaN where unknown. A constant value beyond which the load would lead is a limit
    of the instrument, and is not reported.
    """
    for column, response in enumerate(matrix):
        is_observed = np.isfinite(value[:, column])
        expected = load @ response
        most = float(np.abs(expected[is_observed]).max(initial=0.0))
        enough = max(_OF_RANGE * most, _OVER_STEP * _step(value[is_observed, column]))
        enough = max(enough, _OVER_NOISE * float(np.nan_to_num(noise[column])))
        for number in np.unique(run[is_observed]):
            rows = np.flatnonzero(is_observed & (run == number))
            constant_slice = _longest(value[rows, column])
            moves = (
                float(np.ptp(expected[rows][constant_slice]))
                if constant_slice.stop - constant_slice.start >= _FEWEST
                else 0.0
            )
            if most > 0.0 and moves > enough and not _is_limit(value[:, column], rows, expected, constant_slice):
                yield Frozen(column, int(number), constant_slice.stop - constant_slice.start == len(rows), moves / most)


def constant_columns(load: Array, run: Index, value: Array) -> Iterator[Frozen]:
    """Yield columns (N, K) with one value in a whole run (N,) of changing loads (N, 6), whatever their response; or in
    whole runs of different loads.

    Their noise in other runs gives the probability of this; a coarse converter may well show a constant value.
    """
    for column, column_values in enumerate(value.T):
        runs = [
            rows
            for number in np.unique(run)
            if len(rows := np.flatnonzero((run == number) & np.isfinite(column_values)))
        ]
        moving = [rows for rows in runs if np.ptp(column_values[rows]) > 0.0]
        noise = [_noise_of_run(load[rows], column_values[rows]) for rows in moving]
        step = _step(column_values[np.isfinite(column_values)])
        least = min((noise_size for noise_size in noise if np.isfinite(noise_size)), default=0.0)
        if max((float(np.ptp(column_values[rows])) for rows in moving), default=0.0) <= _OVER_NOISE * step:
            continue
        chance = float(chance_of_equality(*np.array([step, least, least])))
        for rows in runs:
            alike = np.concatenate(
                [other for other in runs if np.ptp(column_values[np.append(rows, other)]) == 0.0] or [rows]
            )
            is_constant = np.ptp(column_values[rows]) == 0.0 and np.ptp(load[alike], axis=0).any()
            if is_constant and chance ** (len(alike) - 1) < _CHANCE:
                yield Frozen(column, int(run[rows[0]]), True, 1.0)


def _noise_of_run(load: Array, value: Array) -> float:
    """Return the noise of a run's values (N,): from neighbours by their loads (N, 6), or, at one load, by their order;
    NaN where neither gives it."""
    if np.ptp(load, axis=0).any() or len(value) < _FEWEST:
        return float(noise_of_neighbours(load, value[:, None])[0])
    return float(np.std(np.diff(value)) / np.sqrt(2.0))


def _step(value: Array) -> float:
    """Return the smallest difference of values that is larger than a correction for air or temperature."""
    steps = np.diff(np.unique(value))
    return float(min(steps[steps > _CORRECTION * np.abs(value).max(initial=0.0)], default=0.0))


def _longest(value: Array) -> slice:
    """Return the longest stretch of successive equal values."""
    ends = np.flatnonzero(np.concatenate([[True], np.diff(value) != 0.0, [True]]))
    length = np.diff(ends)
    if not len(length):
        return slice(0, 0)
    at = int(length.argmax())
    return slice(int(ends[at]), int(ends[at + 1]))


def _is_limit(value: Array, rows: Index, expected: Array, constant_slice: slice) -> bool:
    """Return True if values stay at an end of their column's range beyond which the expected values lead."""
    rest = np.ones(len(rows), bool)
    rest[constant_slice] = False
    level = value[rows][constant_slice][0]
    low, high = np.nanmin(value), np.nanmax(value)
    if rest.sum() < 2 or min(level - low, high - level) > _AT_END * (high - low):
        return False
    zero = np.median((value - expected)[rows][rest])
    beyond = expected[rows][constant_slice] + zero - level
    return max(float(np.mean(beyond > 0.0)), float(np.mean(beyond < 0.0))) > _BEYOND
