"""Classes of errors of each axis of a sensor that was loaded by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from truing.estimation.sensor.error_classes import AxisSeries, ErrorClass, creep, error_classes
from truing.estimation.sensor.recorded_signals import Recorded

Array = NDArray[np.float64]
CREEP_S = (30.0, 300.0)  # ISO 376, by common account


def axis_errors(found: Recorded, indicated: Array, sigma: Array, ranges: Array, axis: int) -> list[ErrorClass] | None:
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


def _series(found: Recorded, indicated: Array, sigma: Array, ranges: Array, axis: int) -> AxisSeries | None:
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


def _creeps(found: Recorded, indicated: Array, sigma: Array, ranges: Array, axis: int) -> list[ErrorClass]:
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
