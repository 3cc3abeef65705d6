"""Error classes of a calibrated sensor as laboratories report them, per axis, each with its uncertainty.

Each class is the largest of several linear combinations of readings, as a share of the range. Its uncertainty is that
of this combination. ``limit`` is the value that noise alone exceeds with 5 % probability, given the number of
combinations. Definitions and sources: docs/error-classes.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array
from truing.estimation.sensor.load_table import RecordedLoads

_CHANCE = 0.05
_SAME_LOAD = 1e-9  # relative to the largest load: loads with a smaller difference are the same step
Combinations = tuple[NDArray, NDArray]  # (M, N) of readings, and the load (M,) of each
CREEP_S = (30.0, 300.0)  # ISO 376, as commonly cited


@dataclass(frozen=True)
class AxisSeries:
    """Readings under loads along one axis: N steps in the order of measurement, in cycles that each begin unloaded.

    load (N,): applied along the axis; reading (N, W): indicated wrench, as read; axis: index of the loaded component;
    cycle (N,): cycle of each step; sigma (W,): standard deviation of one reading; full_scale (W,): range.
    """

    load: NDArray
    reading: NDArray
    axis: int
    cycle: NDArray
    sigma: NDArray
    full_scale: NDArray

    @property
    def is_loading(self) -> NDArray:
        """Mask (N,) of steps reached by loading: the load moved away from zero, or changed its sign.

        A held load keeps its branch.
        """
        before = np.concatenate([[0.0], self.load[:-1]])
        start = np.concatenate([[True], self.cycle[1:] != self.cycle[:-1]])
        before = np.where(start, 0.0, before)
        away = (np.abs(self.load) > np.abs(before) + self._load_tolerance) | (self.load * before < 0) | start
        moved = start | (np.abs(self.load - before) > self._load_tolerance)
        return away[np.maximum.accumulate(np.where(moved, np.arange(len(moved)), 0))]

    @property
    def _load_tolerance(self) -> float:
        return _SAME_LOAD * float(np.abs(self.load).max(initial=0.0))

    @property
    def unloaded(self) -> NDArray:
        """Mask (N,) of steps without load."""
        return np.abs(self.load) <= self._load_tolerance

    @property
    def levels(self) -> NDArray:
        """Applied loads (K,), ascending, without zero."""
        loaded = np.sort(self.load[~self.unloaded])
        return loaded[np.concatenate([[True], np.diff(loaded) > 10 * self._load_tolerance])] if len(loaded) else loaded

    def at(self, level: float) -> NDArray:
        """Return the mask (N,) of steps with a load."""
        return np.asarray(np.abs(self.load - level) <= 10 * self._load_tolerance)

    def from_zero(self) -> NDArray:
        """Return the matrix (N, N) that refers readings to the first unloaded one of their cycle.

        Raises ValueError for a cycle without unloaded reading.
        """
        rows = np.eye(len(self.load))
        for cycle in np.unique(self.cycle):
            mask = self.cycle == cycle
            zeros = np.flatnonzero(mask & self.unloaded)
            if not len(zeros):
                raise ValueError(f"cycle {cycle}: found no unloaded reading, expected one to count from")
            rows[mask, zeros[0]] -= 1.0
        return rows


@dataclass(frozen=True)
class ErrorClass:
    """One error of one axis, as a share of its range (interpolation: of the load itself).

    value: the largest one; sigma: its standard deviation; limit: exceeded by noise alone with 5 % probability; load: at
    the largest value; component: index of the component that indicated it.
    """

    name: str
    axis: int
    component: int
    value: float
    sigma: float
    limit: float
    load: float


def error_classes(series: AxisSeries) -> list[ErrorClass]:
    """Return the error classes that the series determines: nonlinearity, interpolation, hysteresis, repeatability, zero
    return, crosstalk.

    Classes without readings for them (no unloading, a single cycle) are omitted.
    """
    axis = series.axis
    scale = series.full_scale[axis]
    classes = [
        _largest("nonlinearity", series, axis, *_curve(series, 1, absolute=True), scale),
        _largest("interpolation", series, axis, *_curve(series, 3, absolute=False), 1.0),
        _largest("hysteresis", series, axis, *_branches(series), scale),
        _largest("repeatability", series, axis, *_repeats(series), scale),
        _largest("zero return", series, axis, *_returns(series), scale),
    ]
    combinations, loads = _largest_load_means(series)
    for other in np.flatnonzero(np.arange(series.reading.shape[1]) != axis):
        classes.append(_largest("crosstalk", series, int(other), combinations, loads, series.full_scale[other]))
    return [error for error in classes if error is not None]


def reading_sigma(series: AxisSeries) -> NDArray:
    """Return the standard deviation (W,) of one reading, from cycles that repeat the same steps; NaN without any.

    It is the scatter about the mean of each load and branch and a zero per cycle.
    """
    step = np.stack([np.round(series.load / max(series._load_tolerance, 1e-300) / 10), series.is_loading], axis=1)
    kind = np.unique(step, axis=0, return_inverse=True)[1].ravel()
    columns = np.concatenate([np.eye(kind.max() + 1)[kind], series.cycle[:, None] == np.unique(series.cycle)], axis=1)
    values, _, rank, _ = np.linalg.lstsq(columns, series.reading, rcond=None)
    spare = len(series.load) - int(rank)
    residual = series.reading - columns @ values
    return np.sqrt(np.sum(residual**2, 0) / spare) if spare else np.full(series.reading.shape[1], np.nan)


def creep(
    time_s: NDArray, reading: NDArray, sigma: float, full_scale: float, from_s: float = 30.0, to_s: float = 300.0
) -> ErrorClass:
    """Return the change of a reading (N,) under constant load between two times after loading (at time 0).

    Readings are interpolated linearly. Raises ValueError if the readings do not span both times.
    """
    if time_s[0] > from_s or time_s[-1] < to_s:
        raise ValueError(f"found readings from {time_s[0]:g} to {time_s[-1]:g} s, expected {from_s:g} to {to_s:g} s")
    row = _interpolating(time_s, to_s) - _interpolating(time_s, from_s)
    deviation = sigma * float(np.linalg.norm(row)) / full_scale
    limit = float(_two_sided(np.array([deviation])))
    return ErrorClass("creep", 0, 0, float(row @ reading) / full_scale, deviation, limit, float("nan"))


def _interpolating(time_s: NDArray, at: float) -> NDArray:
    return np.array([np.interp(at, time_s, unit_row) for unit_row in np.eye(len(time_s))])


def _curve(series: AxisSeries, degree: int, *, absolute: bool) -> Combinations:
    """Return the mean readings on loading at each level minus their polynomial through zero; not absolute: relative to
    the level."""
    levels, mean = _branch_means(series, series.is_loading)
    share = levels / np.abs(levels).max()
    powers = share[:, None] ** np.arange(1, min(degree, len(levels) - 1) + 1)
    left = (np.eye(len(levels)) - powers @ np.linalg.pinv(powers)) @ mean
    return (left if absolute else left / levels[:, None]), levels


def _branch_means(series: AxisSeries, branch: NDArray) -> Combinations:
    """Return the levels (K,) of a branch and the matrix (K, N) of its mean readings, relative to zero."""
    from_zero = series.from_zero()
    rows, levels = [], []
    for level in series.levels:
        steps = series.at(level) & branch
        if steps.any():
            rows.append(from_zero[steps].mean(0))
            levels.append(level)
    return np.array(levels), np.array(rows).reshape(len(rows), len(series.load))


def _branches(series: AxisSeries) -> Combinations:
    """Return the unloading means minus the loading means at levels present on both branches."""
    up, rising = _branch_means(series, series.is_loading)
    down, falling = _branch_means(series, ~series.is_loading)
    both, at_up, at_down = np.intersect1d(up, down, return_indices=True)
    return falling[at_down] - rising[at_up], both


def _repeats(series: AxisSeries) -> Combinations:
    """Return the differences of readings on loading between cycles, at equal levels."""
    from_zero = series.from_zero()
    rows, loads = [], []
    for level in series.levels:
        steps = np.flatnonzero(series.at(level) & series.is_loading)
        first, second = np.triu_indices(len(steps), 1)
        rows.append(from_zero[steps[first]] - from_zero[steps[second]])
        loads.append(np.full(len(first), level))
    return np.concatenate(rows), np.concatenate(loads)


def _returns(series: AxisSeries) -> Combinations:
    """Return the last unloaded reading of every cycle minus its first."""
    from_zero = series.from_zero()
    rows = []
    for cycle in np.unique(series.cycle):
        zeros = np.flatnonzero((series.cycle == cycle) & series.unloaded)
        if len(zeros) > 1:
            rows.append(from_zero[zeros[-1]])
    return np.array(rows).reshape(len(rows), len(series.load)), np.zeros(len(rows))


def _largest_load_means(series: AxisSeries) -> Combinations:
    """Return the mean readings on loading at the largest load of each sign."""
    levels, mean = _branch_means(series, series.is_loading)
    ends = np.flatnonzero((levels == levels.max(initial=0.0)) | (levels == levels.min(initial=0.0)))
    return mean[ends], levels[ends]


def _largest(
    name: str, series: AxisSeries, component: int, combinations: NDArray, loads: NDArray, scale: float
) -> ErrorClass | None:
    """Return the largest of combinations (M, N) of a component's readings, over a scale; None without any."""
    if not len(combinations):
        return None
    value = combinations @ series.reading[:, component] / scale
    deviation = series.sigma[component] * np.linalg.norm(combinations, axis=1) / scale
    worst = int(np.argmax(np.abs(value)))
    limit = float(_two_sided(deviation))
    size = abs(float(value[worst]))
    return ErrorClass(name, series.axis, component, size, float(deviation[worst]), limit, float(loads[worst]))


def _two_sided(deviation: NDArray) -> float:
    """Return the limit that the largest of normal errors (M,) exceeds with a small probability; an upper bound if
    correlated. Sidak (1967): the product of the single probabilities bounds the joint one for any correlation."""
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
    recorded_loads: RecordedLoads, indicated: Array, sigma: Array, ranges: Array, axis: int
) -> list[ErrorClass] | None:
    """Return the error classes of one axis; None without a run that loaded only this axis and has unloaded readings.

    indicated (B, 6): loads from a calibration, N and N m; sigma (6,): from the noise of signals; ranges (6,): NaN for
    an axis without range.
    """
    series = _series(recorded_loads, indicated, sigma, ranges, axis)
    return None if series is None else [*_classes_of(series), *_creeps(recorded_loads, indicated, sigma, ranges, axis)]


def _classes_of(series: AxisSeries) -> list[ErrorClass]:
    """Return the classes of a series; components without a range have no crosstalk."""
    classes = error_classes(series) if len(series.levels) else []
    return [error for error in classes if np.isfinite(error.value)]


def _series(
    recorded_loads: RecordedLoads, indicated: Array, sigma: Array, ranges: Array, axis: int
) -> AxisSeries | None:
    """Return the runs that loaded one axis alone, each as a cycle; None without any that has unloaded readings."""
    steps = recorded_loads.steps
    is_loaded_elsewhere = np.delete(steps.load, axis, axis=1) != 0.0
    runs = [
        run
        for run in np.unique(steps.run)
        if (of_run := steps.run == run).any()
        and not is_loaded_elsewhere[of_run].any()
        and np.any(steps.load[of_run, axis])
        and steps.load[np.flatnonzero(of_run)[0], axis] == 0.0
    ]
    rows = np.isin(steps.run, runs)
    if not rows.any():
        return None
    return AxisSeries(steps.load[rows, axis], indicated[rows], axis, steps.run[rows], sigma, ranges)


def _creeps(
    recorded_loads: RecordedLoads, indicated: Array, sigma: Array, ranges: Array, axis: int
) -> list[ErrorClass]:
    """Return the largest creep of loads along the axis that were held long enough; a load starts after the previous
    step."""
    steps = recorded_loads.steps
    same = (np.diff(steps.load, axis=0) == 0.0).all(axis=1) & (np.diff(steps.run) == 0)
    parts = np.split(np.arange(len(steps.run)), np.flatnonzero(~same) + 1)
    creeps = []
    for part in parts:
        first = part[0]
        if not steps.load[first, axis] or not first or steps.run[first - 1] != steps.run[first]:
            continue
        age = steps.time_s[part] - steps.time_s[first - 1]
        if age[0] <= CREEP_S[0] and age[-1] >= CREEP_S[1]:
            error_class = creep(age, indicated[part, axis], float(sigma[axis]), float(ranges[axis]), *CREEP_S)
            creeps.append(replace(error_class, axis=axis, component=axis, load=float(steps.load[first, axis])))
    return [max(creeps, key=lambda error: abs(error.value))] if creeps else []
