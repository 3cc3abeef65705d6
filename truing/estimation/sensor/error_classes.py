"""The errors of a calibrated sensor as laboratories report them, per axis, each with its uncertainty.

Every class is the largest of several linear combinations of readings, as a share of the range. Its uncertainty is that
of the combination which is largest; ``limit`` is what noise alone would exceed once in twenty times, by being the
largest of so many. Definitions and sources: docs/error-classes.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array
from truing.estimation.sensor.load_table import RecordedLoads

_CHANCE = 0.05
_SAME = 1e-9  # of the largest load: loads that differ by less are the same step
Combinations = tuple[NDArray, NDArray]  # (M, N) of readings, and the load (M,) that each is about
CREEP_S = (30.0, 300.0)  # ISO 376, by common account


@dataclass(frozen=True)
class AxisSeries:
    """Readings of one loaded axis: N steps in the order taken, in cycles that each begin unloaded.

    load (N,): applied along the axis; reading (N, W): indicated wrench, as read; axis: which of the W was loaded; cycle
    (N,): which cycle a step belongs to; sigma (W,): standard deviation of one reading; full_scale (W,): range.
    """

    load: NDArray
    reading: NDArray
    axis: int
    cycle: NDArray
    sigma: NDArray
    full_scale: NDArray

    @property
    def rising(self) -> NDArray:
        """Return which steps (N,) were reached by loading: the load moved away from zero, or turned its sign.

        A load that was held stays on the branch on which it was reached.
        """
        before = np.concatenate([[0.0], self.load[:-1]])
        start = np.concatenate([[True], self.cycle[1:] != self.cycle[:-1]])
        before = np.where(start, 0.0, before)
        away = (np.abs(self.load) > np.abs(before) + self._same) | (self.load * before < 0) | start
        moved = start | (np.abs(self.load - before) > self._same)
        return away[np.maximum.accumulate(np.where(moved, np.arange(len(moved)), 0))]

    @property
    def _same(self) -> float:
        return _SAME * float(np.abs(self.load).max(initial=0.0))

    @property
    def unloaded(self) -> NDArray:
        """Return which steps (N,) are without load."""
        return np.abs(self.load) <= self._same

    @property
    def levels(self) -> NDArray:
        """Return the loads (K,) that were applied, ascending, without zero."""
        loaded = np.sort(self.load[~self.unloaded])
        return loaded[np.concatenate([[True], np.diff(loaded) > 10 * self._same])] if len(loaded) else loaded

    def at(self, level: float) -> NDArray:
        """Return which steps (N,) carry a load."""
        return np.asarray(np.abs(self.load - level) <= 10 * self._same)

    def from_zero(self) -> NDArray:
        """Return the matrix (N, N) that counts readings from the first unloaded one of their cycle.

        Raises ValueError for a cycle that was not read unloaded.
        """
        rows = np.eye(len(self.load))
        for cycle in np.unique(self.cycle):
            own = self.cycle == cycle
            zeros = np.flatnonzero(own & self.unloaded)
            if not len(zeros):
                raise ValueError(f"cycle {cycle}: found no unloaded reading, expected one to count from")
            rows[own, zeros[0]] -= 1.0
        return rows


@dataclass(frozen=True)
class ErrorClass:
    """One error of one axis, as a share of its range (interpolation: of the load itself).

    value: the largest; sigma: its standard deviation; limit: exceeded by noise alone once in twenty times; load: where
    it is largest; component: which of the W indicated it.
    """

    name: str
    axis: int
    component: int
    value: float
    sigma: float
    limit: float
    load: float


def error_classes(series: AxisSeries) -> list[ErrorClass]:
    """Return what the series can tell: nonlinearity, interpolation, hysteresis, repeatability, zero return, crosstalk.

    A class for which there are no readings (no unloading, one cycle alone) is left out.
    """
    own = series.axis
    scale = series.full_scale[own]
    found = [
        _largest("nonlinearity", series, own, *_curve(series, 1, absolute=True), scale),
        _largest("interpolation", series, own, *_curve(series, 3, absolute=False), 1.0),
        _largest("hysteresis", series, own, *_branches(series), scale),
        _largest("repeatability", series, own, *_repeats(series), scale),
        _largest("zero return", series, own, *_returns(series), scale),
    ]
    combinations, loads = _at_range(series)
    for other in np.flatnonzero(np.arange(series.reading.shape[1]) != own):
        found.append(_largest("crosstalk", series, int(other), combinations, loads, series.full_scale[other]))
    return [one for one in found if one is not None]


def reading_sigma(series: AxisSeries) -> NDArray:
    """Return the standard deviation (W,) of one reading, from cycles that repeat the same steps; NaN without any.

    What is left beside the mean of each load and branch and a zero for each cycle.
    """
    step = np.stack([np.round(series.load / max(series._same, 1e-300) / 10), series.rising], axis=1)
    kind = np.unique(step, axis=0, return_inverse=True)[1].ravel()
    columns = np.concatenate([np.eye(kind.max() + 1)[kind], series.cycle[:, None] == np.unique(series.cycle)], axis=1)
    values, _, rank, _ = np.linalg.lstsq(columns, series.reading, rcond=None)
    spare = len(series.load) - int(rank)
    left = series.reading - columns @ values
    return np.sqrt(np.sum(left**2, 0) / spare) if spare else np.full(series.reading.shape[1], np.nan)


def creep(
    time_s: NDArray, reading: NDArray, sigma: float, full_scale: float, from_s: float = 30.0, to_s: float = 300.0
) -> ErrorClass:
    """Return the change of a reading (N,) under constant load between two times after the load came (at time 0).

    Between readings it is interpolated. Raises ValueError where the readings do not reach from one time to the other.
    """
    if time_s[0] > from_s or time_s[-1] < to_s:
        raise ValueError(f"found readings from {time_s[0]:g} to {time_s[-1]:g} s, expected {from_s:g} to {to_s:g} s")
    row = _interpolating(time_s, to_s) - _interpolating(time_s, from_s)
    deviation = sigma * float(np.linalg.norm(row)) / full_scale
    limit = float(_two_sided(np.array([deviation])))
    return ErrorClass("creep", 0, 0, float(row @ reading) / full_scale, deviation, limit, float("nan"))


def _interpolating(time_s: NDArray, at: float) -> NDArray:
    return np.array([np.interp(at, time_s, one) for one in np.eye(len(time_s))])


def _curve(series: AxisSeries, degree: int, *, absolute: bool) -> Combinations:
    """Return the mean rising readings at each level less their polynomial through zero; over the level if relative."""
    levels, mean = _means(series, series.rising)
    share = levels / np.abs(levels).max()
    powers = share[:, None] ** np.arange(1, min(degree, len(levels) - 1) + 1)
    left = (np.eye(len(levels)) - powers @ np.linalg.pinv(powers)) @ mean
    return (left if absolute else left / levels[:, None]), levels


def _means(series: AxisSeries, branch: NDArray) -> Combinations:
    """Return the levels (K,) of a branch and what takes its mean readings (K, N), counted from zero."""
    from_zero = series.from_zero()
    rows, levels = [], []
    for level in series.levels:
        steps = series.at(level) & branch
        if steps.any():
            rows.append(from_zero[steps].mean(0))
            levels.append(level)
    return np.array(levels), np.array(rows).reshape(len(rows), len(series.load))


def _branches(series: AxisSeries) -> Combinations:
    """Return falling less rising means at the levels that were met on both."""
    up, rising = _means(series, series.rising)
    down, falling = _means(series, ~series.rising)
    both, at_up, at_down = np.intersect1d(up, down, return_indices=True)
    return falling[at_down] - rising[at_up], both


def _repeats(series: AxisSeries) -> Combinations:
    """Return differences of rising readings of the same level in different cycles."""
    from_zero = series.from_zero()
    rows, loads = [], []
    for level in series.levels:
        steps = np.flatnonzero(series.at(level) & series.rising)
        first, second = np.triu_indices(len(steps), 1)
        rows.append(from_zero[steps[first]] - from_zero[steps[second]])
        loads.append(np.full(len(first), level))
    return np.concatenate(rows), np.concatenate(loads)


def _returns(series: AxisSeries) -> Combinations:
    """Return the last unloaded reading of every cycle less its first."""
    from_zero = series.from_zero()
    rows = []
    for cycle in np.unique(series.cycle):
        zeros = np.flatnonzero((series.cycle == cycle) & series.unloaded)
        if len(zeros) > 1:
            rows.append(from_zero[zeros[-1]])
    return np.array(rows).reshape(len(rows), len(series.load)), np.zeros(len(rows))


def _at_range(series: AxisSeries) -> Combinations:
    """Return mean rising readings at the largest load of either sign."""
    levels, mean = _means(series, series.rising)
    ends = np.flatnonzero((levels == levels.max(initial=0.0)) | (levels == levels.min(initial=0.0)))
    return mean[ends], levels[ends]


def _largest(
    name: str, series: AxisSeries, component: int, combinations: NDArray, loads: NDArray, scale: float
) -> ErrorClass | None:
    """Return the largest of combinations (M, N) of a component's readings, over a scale; None where there is none."""
    if not len(combinations):
        return None
    value = combinations @ series.reading[:, component] / scale
    deviation = series.sigma[component] * np.linalg.norm(combinations, axis=1) / scale
    worst = int(np.argmax(np.abs(value)))
    limit = float(_two_sided(deviation))
    found = abs(float(value[worst]))
    return ErrorClass(name, series.axis, component, found, float(deviation[worst]), limit, float(loads[worst]))


def _two_sided(deviation: NDArray) -> float:
    """Return what the largest of normal errors (M,) exceeds with a small chance; at most that where they correlate.

    Sidak (1967): the product of the single chances bounds the joint one for any correlation.
    """
    from scipy.special import ndtr, ndtri

    spread = deviation[deviation > 0]
    if not len(spread):
        return 0.0
    low, high = 0.0, float(spread.max() * -ndtri(_CHANCE / (2 * len(spread)))) * 1.001
    for _ in range(60):
        middle = 0.5 * (low + high)
        inside = float(np.sum(np.log1p(-2.0 * ndtr(-middle / spread))))
        low, high = (middle, high) if inside < np.log1p(-_CHANCE) else (low, middle)
    return high


def axis_errors(
    found: RecordedLoads, indicated: Array, sigma: Array, ranges: Array, axis: int
) -> list[ErrorClass] | None:
    """Return the classes of errors of one axis; None where no run loaded it by itself and was also read unloaded.

    indicated (B, 6): loads as a calibration tells them, N and N m; sigma (6,) by the noise of signals; ranges (6,),
    NaN where an axis has none.
    """
    series = _series(found, indicated, sigma, ranges, axis)
    return None if series is None else [*_classes_of(series), *_creeps(found, indicated, sigma, ranges, axis)]


def _classes_of(series: AxisSeries) -> list[ErrorClass]:
    """The classes of a series; components without a range have no crosstalk to be told."""
    found = error_classes(series) if len(series.levels) else []
    return [one for one in found if np.isfinite(one.value)]


def _series(found: RecordedLoads, indicated: Array, sigma: Array, ranges: Array, axis: int) -> AxisSeries | None:
    """The runs that loaded one axis alone, each a cycle; None without any that was also read unloaded."""
    steps = found.steps
    other = np.delete(steps.load, axis, axis=1) != 0.0
    runs = [
        run
        for run in np.unique(steps.run)
        if (own := steps.run == run).any()
        and not other[own].any()
        and np.any(steps.load[own, axis])
        and steps.load[np.flatnonzero(own)[0], axis] == 0.0
    ]
    rows = np.isin(steps.run, runs)
    if not rows.any():
        return None
    return AxisSeries(steps.load[rows, axis], indicated[rows], axis, steps.run[rows], sigma, ranges)


def _creeps(found: RecordedLoads, indicated: Array, sigma: Array, ranges: Array, axis: int) -> list[ErrorClass]:
    """The largest creep of all loads along the axis that were held long enough; a load comes after the step before."""
    steps = found.steps
    same = (np.diff(steps.load, axis=0) == 0.0).all(axis=1) & (np.diff(steps.run) == 0)
    parts = np.split(np.arange(len(steps.run)), np.flatnonzero(~same) + 1)
    held = []
    for part in parts:
        first = part[0]
        if not steps.load[first, axis] or not first or steps.run[first - 1] != steps.run[first]:
            continue
        age = steps.time_s[part] - steps.time_s[first - 1]
        if age[0] <= CREEP_S[0] and age[-1] >= CREEP_S[1]:
            one = creep(age, indicated[part, axis], float(sigma[axis]), float(ranges[axis]), *CREEP_S)
            held.append(replace(one, axis=axis, component=axis, load=float(steps.load[first, axis])))
    return [max(held, key=lambda one: abs(one.value))] if held else []
