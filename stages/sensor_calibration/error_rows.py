"""The errors of a calibrated sensor, class by class and axis by axis, as table rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from stages.responses.tables import Rows
from stages.sensor.reading_arrays import LOADS
from stages.sensor_calibration.contenders import SensorCalibrations
from stages.sensor_calibration.recorded import Recorded
from truing.estimation.sensor.error_classes import AxisSeries, ErrorClass, creep, error_classes
from truing.estimation.sensor.held_out_loads import predicted_loads

Array = NDArray[np.float64]

CLASSES = ("nonlinearity", "interpolation", "hysteresis", "repeatability", "zero return", "crosstalk", "creep")
_CREEP_S = (30.0, 300.0)  # ISO 376, by common account
_WHY_NOT = {
    "nonlinearity": "fewer than two loads on the way up",
    "interpolation": "fewer than two loads on the way up",
    "hysteresis": "no load was met on the way back",
    "repeatability": "the axis was loaded but once",
    "zero return": "no run came back to zero",
    "crosstalk": "no other component has a range",
    "creep": f"no load was held from {_CREEP_S[0]:g} to {_CREEP_S[1]:g} s",
}


def error_class_rows(found: Recorded, fitted: SensorCalibrations, ranges: Array) -> Rows:
    """Every class of every axis that was loaded by itself; ranges (6,) N and N m, NaN where an axis has none."""
    rows = Rows("error_classes")
    every = found.table(np.ones(len(found.steps.run), bool), found.steps.run)
    # less what acted beside the loads: the axis alone is meant to be loaded
    indicated = predicted_loads(fitted.chosen, every).value - (found.load - found.steps.load)
    matrix = fitted.matrix.value
    sigma = np.sqrt(np.einsum("wc,c->w", matrix**2, found.sigma**2))
    for axis in range(len(LOADS)):
        series = _series(found, indicated, sigma, ranges, axis)
        if series is None:
            continue
        told = [*_told(series), *_creeps(found, indicated, sigma, ranges, axis)]
        for one in told:
            rows.add(**_row(one))
        for name in CLASSES:
            if name not in {one.name for one in told}:
                rows.add(error_class=name, load=LOADS[axis], indicated=LOADS[axis], unit="%", reason=_WHY_NOT[name])
    return rows


def _told(series: AxisSeries) -> list[ErrorClass]:
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
        if age[0] <= _CREEP_S[0] and age[-1] >= _CREEP_S[1]:
            one = creep(age, indicated[part, axis], float(sigma[axis]), float(ranges[axis]), *_CREEP_S)
            held.append(replace(one, axis=axis, component=axis, load=float(steps.load[first, axis])))
    return [max(held, key=lambda one: abs(one.value))] if held else []


def _row(one: ErrorClass) -> dict[str, object]:
    return {
        "error_class": one.name,
        "load": LOADS[one.axis],
        "indicated": LOADS[one.component],
        "value": 100.0 * one.value,
        "sigma": 100.0 * one.sigma,
        "limit": 100.0 * one.limit,
        "unit": "%",
        "applied": one.load,
    }
