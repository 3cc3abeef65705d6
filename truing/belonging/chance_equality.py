"""Probability that readings of two runs are equal by chance, from resolution, noise and range of each
run's channels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from truing.arrays import Array, Index
from truing.belonging.responses import directions

_RANGE = 10.0  # factor on the probability for uniform readings, because readings cluster
_PLACES = 10  # decimal places before and after the point in which a step is sought
_PARTS = 10  # most steps in the smallest difference, where values are few
_OFF_GRID = 0.01  # largest deviation from a grid, in steps; less is rounding
_RESOLVED = 1.0  # noise in steps below which rounding alone explains the scatter
_FEWEST = 4  # fewest windows of neighbours
_UNSEEN = 0.2  # share of a declared noise that is assumed where the rows do not show noise
_MEDIAN = 1.4826
_NOISES = 3.0  # noise levels within which readings under nearly equal loads are alike


@dataclass(frozen=True)
class ChanceEquality:
    """Resolution, declared and observed noise, and range (R, K) of the columns in each run; its loads (N, 6).

    A noise is NaN where none is declared or observed. All values are separate for each run, because a column may hold
    another channel in each.
    """

    step: Array
    declared: Array
    noise: Array
    span: Array
    loads: tuple[Array, ...]

    @classmethod
    def of_runs(cls, value: Array, rows: Sequence[Index], load: Array, declared: Array) -> Self:
        """Return the statistics of columns (N, K), for the rows of each run, under loads (N, 6); declared
        noise (K,)."""
        shape = len(rows), value.shape[1]
        noise = np.array([noise_of_neighbours(load[run_rows], value[run_rows]) for run_rows in rows]).reshape(shape)
        return cls(
            np.array([[resolution(column) for column in value[there].T] for there in rows]).reshape(shape),
            np.where(np.isnan(noise), _UNSEEN * declared, np.minimum(declared, noise)),
            noise,
            np.array([[_span(column) for column in value[there].T] for there in rows]).reshape(shape),
            tuple(load[run_rows] for run_rows in rows),
        )

    def between(self, first: int, second: int) -> Array:
        """Return the probability (K,) that a reading of one run equals one of another, under the loads of both."""
        alike = self.under_equal_loads(first, second)
        if self._equal_loads(first, second):
            return alike
        span = np.minimum(self.span[first], self.span[second])
        by_range = _share(_RANGE * np.maximum(self.step[first], self.step[second]), span)
        # a symmetric machine answers two axes alike; then readings differ by noise only
        noise = np.where(np.isnan(self.declared), self.noise, self.declared)
        return np.maximum(by_range, self._by_noise(noise, first, second, unknown=0.0))

    def under_equal_loads(self, first: int, second: int) -> Array:
        """Return the probability (K,) that two readings under the same load are equal, 1 where it is unknown."""
        return self._by_noise(self.declared, first, second, unknown=1.0)

    def typical(self) -> Array:
        """Return the probability (K,) that two readings under the same load are equal, in the typical run."""
        if not len(self.declared):
            return np.ones(self.step.shape[1])
        return np.median([self.under_equal_loads(run, run) for run in range(len(self.declared))], axis=0)

    def _by_noise(self, noise: Array, first: int, second: int, unknown: float) -> Array:
        """Return the probability (K,) that two readings are equal that differ by noise (R, K) alone."""
        step, both = np.maximum(self.step[first], self.step[second]), noise[[first, second]]
        return np.where(np.isfinite(both).all(axis=0), chance_of_equality(step, *both), unknown)

    def _equal_loads(self, first: int, second: int) -> bool:
        """Return True if the loads of two runs differ by less than readings resolve."""
        count = min(len(self.loads[first]), len(self.loads[second]))
        difference = np.abs(self.loads[first][:count] - self.loads[second][:count]).max(initial=0.0)
        if difference == 0.0:
            return True
        pair = [first, second]
        moved = max(float(np.ptp(self.loads[run], axis=0).max(initial=0.0)) for run in pair)
        noise = np.nan_to_num(self.declared[pair]).max(axis=0)
        resolved = self.step[pair].max(axis=0) + _NOISES * noise
        return moved > 0.0 and bool(np.all(self.span[pair].max(axis=0) * difference / moved <= resolved))


def resolution(value: Array) -> float:
    """Return the step of the grid on which values (N,) lie, or their smallest difference where there is no grid."""
    levels = np.unique(_finite_values(value))
    if len(levels) < 2:
        return 0.0
    distance, least = levels - levels[0], float(np.diff(levels).min())
    decimals = (part * 10.0**-index for index in range(-_PLACES, _PLACES) for part in (5.0, 2.5, 2.0, 1.0))
    fitting = (
        step for step in (*(least / part for part in range(1, _PARTS)), *decimals) if step <= least * (1.0 + _OFF_GRID)
    )
    return next(
        (step for step in fitting if np.abs(distance / step - np.round(distance / step)).max() < _OFF_GRID), least
    )


def chance_of_equality(step: Array, first: Array, second: Array) -> Array:
    """Return the probability that readings in steps are equal if they differ by noise alone; 1 where steps
    are coarser."""
    is_coarse = (np.fmin(first, second) < _RESOLVED * step) | (step <= 0.0)
    return np.where(is_coarse, 1.0, _share(step, np.sqrt(2.0 * np.pi) * np.hypot(first, second)))


def noise_of_neighbours(load: Array, value: Array) -> Array:
    """Return the noise (K,) of columns (N, K): each reading against the cubic through two neighbours on each side.

    load (N, 6). Only rows count whose load lies between those of the neighbours; NaN where too few do. Hysteresis and
    curvature, which a repeated run repeats, do not count as noise.
    """
    count = len(value) - 4
    if count < _FEWEST or not len(way := directions(load)[1].T):
        return np.full(value.shape[1], np.nan)
    at = np.arange(count)[:, None] + np.arange(5)
    place = way[0][at]
    steps = np.diff(place, axis=1)
    at, place = (values[(steps > 0.0).all(axis=1) | (steps < 0.0).all(axis=1)] for values in (at, place))
    others = place[:, [0, 1, 3, 4]]
    weight = np.ones_like(others)
    for column in range(4):
        for other in range(4):
            if other != column:
                weight[:, column] *= (place[:, 2] - others[:, other]) / (others[:, column] - others[:, other])
    residual = value[at[:, 2]] - np.einsum("nm,nmk->nk", weight, value[at[:, [0, 1, 3, 4]]])
    residual /= np.sqrt(1.0 + np.sum(weight**2, axis=1))[:, None]
    return np.array(
        [
            _MEDIAN * np.median(size) if len(size) >= _FEWEST else np.nan
            for size in map(_finite_values, np.abs(residual).T)
        ]
    )


def _share(part: Array, total: Array) -> Array:
    return part / np.maximum(np.maximum(part, total), 1e-300)


def _span(value: Array) -> float:
    finite = _finite_values(value)
    return float(np.ptp(finite)) if len(finite) else 0.0


def _finite_values(value: Array) -> Array:
    return value[np.isfinite(value)]
