"""The calibrate stage of a force sensor: the fits, and the rows that they leave on choice and classes of errors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.recorded_steps import LOADS
from truing.estimation.sensor.axis_errors import CREEP_S, axis_errors
from truing.estimation.sensor.contenders import SensorCalibrations, calibrations
from truing.estimation.sensor.error_classes import ErrorClass
from truing.estimation.sensor.held_out_loads import HeldOut, predicted_loads
from truing.estimation.sensor.recorded_signals import Recorded
from truing.report.numbers import count as counted
from truing.report.numbers import percent
from truing.schemas.artifacts import ARTIFACTS
from truing.simulation.bench.six_upur.nominal_sensor import NominalSensor, Theory, farthest, theory_of
from truing.stages.common.nominal_sensor import nominal_sensor
from truing.stages.common.point_arrays import number_column
from truing.stages.common.reading_arrays import LOAD_COLUMNS
from truing.stages.common.recorded_signals import ranges_of, recorded
from truing.stages.common.rows import Rows
from truing.stages.declaration import Outcome, Progress
from truing.stages.sensor_calibration.matrix_rows import leg_matrix, matrix_rows, merit_rows

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign
    from truing.schemas.sensor_mechanism import SensorMechanism

LEAVES = ("sensor_matrix", "sensor_merit", "sensor_choice", "error_classes")
Array = NDArray[np.float64]
CLASSES = ("nonlinearity", "interpolation", "hysteresis", "repeatability", "zero return", "crosstalk", "creep")
_WHY_NOT = {
    "nonlinearity": "fewer than two loads on the way up",
    "interpolation": "fewer than two loads on the way up",
    "hysteresis": "no load was met on the way back",
    "repeatability": "the axis was loaded but once",
    "zero return": "no run came back to zero",
    "crosstalk": "no other component has a range",
    "creep": f"no load was held from {CREEP_S[0]:g} to {CREEP_S[1]:g} s",
}
_MOVED = (*((f"d{axis}_mm", 1e-3) for axis in "xyz"), *((f"r{axis}_rad", 1.0) for axis in "xyz"))


def calibrate_sensor(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress) -> Outcome:
    """Say what the drawing says of the sensor, and calibrate it where its signals were recorded."""
    progress(0, 2, "theory")
    drawn = theory(settings, tables)
    found, fitted, why = _fitted(tables, settings, progress)
    if drawn is None and fitted is None:
        return nothing(why)
    sensitivity, tolerance = settings.signals.sensitivity_mv_per_n, settings.signals.sensitivity_tolerance
    legs = None if fitted is None else leg_matrix(fitted, sensitivity, tolerance)
    artifacts = {
        "sensor_matrix": matrix_rows(drawn, fitted, legs).table(),
        "sensor_merit": merit_rows(drawn, fitted, legs).table(),
    }
    if found is None or fitted is None:
        empty = {name: ARTIFACTS[name].empty() for name in ("sensor_choice", "error_classes")}
        figure = f"G by [mechanism]; G_B not evaluated: {why}"
        return Outcome(artifacts | empty, "the drawing", "nothing", figure, why_not=why)
    ranges = ranges_of(settings, found)
    artifacts["sensor_choice"] = choice_rows(found, fitted).table()
    artifacts["error_classes"] = error_class_rows(found, fitted, ranges).table()
    words = [f"{counted(found.left_out, 'load step')} with a gross error in a signal"] if found.left_out else []
    words += [f"{found.excluded} with a signal excluded by a person"] if found.excluded else []
    words += [f"no load of {counted(found.put_right, 'step')}, exchanged and put right"] if found.put_right else []
    left_out = "; ".join(words) or "nothing"
    read = f"{counted(len(found.steps.run), 'load step')} with {counted(found.signal.shape[1], 'signal')}"
    return Outcome(artifacts, read=read, left_out=left_out, figure=_figure(fitted, ranges))


def _fitted(
    tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress
) -> tuple[Recorded | None, SensorCalibrations | None, str]:
    """The signals and their calibrations, or why there are none."""
    if "signals" not in tables or not tables["signals"].num_rows:
        return None, None, "the campaign holds no signals"
    progress(1, 2, "calibrations")
    try:
        found = recorded(tables, settings)
        if found.steps.held_out.all():
            return found, None, "every run is for verification, and nothing may be fitted to those"
        return found, calibrations(found), ""
    except ValueError as error:
        return None, None, str(error)


def _figure(fitted: SensorCalibrations, ranges: np.ndarray) -> str:
    held = 100.0 * fitted.choice.chosen.rms / ranges
    worst = int(np.nanargmax(held))
    return (
        f"G_B by {fitted.chosen.model.name}; held out {fitted.left_out}: "
        f"at most {percent(held[worst])} of the range rms ({LOADS[worst]})"
    )


def nothing(why: str) -> Outcome:
    """Return the outcome of a campaign without anything to calibrate, or whose data cannot be used."""
    empty = {name: ARTIFACTS[name].empty() for name in LEAVES}
    return Outcome.not_evaluated(empty, why)


def choice_rows(found: Recorded, fitted: SensorCalibrations) -> Rows:
    """The figures of every contender, and why others could not contend."""
    rows = Rows("sensor_choice")
    equal = fitted.choice.choice.indistinguishable
    for k, one in enumerate(fitted.choice.contenders):
        chosen = k == fitted.choice.choice.chosen
        _figures(rows, fitted, one)
        for figure, value in (("chosen", chosen), ("indistinguishable", bool(equal[k]))):
            _add_figure(rows, one, figure, None, float(value), "1")
        if chosen:
            _load_rows(rows, one, "verification_rms", fitted.verification, fitted)
            _add_figure(rows, one, "tared", None, float(found.tared), "1")
            if found.causes:
                words = " and ".join(found.causes)
                rows.add(model=one.fit.model.name, figure="loads_as_diagnosed", value=1.0, unit="1", reason=words)
            _add_figure(rows, one, "noise_ratio", None, one.fit.noise_ratio, "1")
    for model, why in fitted.choice.refused.items():
        rows.add(model=model, figure="refused", value=1.0, unit="1", reason=why)
    return rows


def _figures(rows: Rows, fitted: SensorCalibrations, one: HeldOut) -> None:
    _load_rows(rows, one, "heldout_rms", one.rms, fitted)
    if one.fit.model.direction == "direct":
        _load_rows(rows, one, "fitted_rms", np.sqrt(np.mean(one.fit.residuals**2, axis=0)), fitted)
    _add_figure(rows, one, "heldout_log_density", None, one.log_density, "1")
    _add_figure(rows, one, "heldout_chi_square", None, float(one.squares.sum()), "1")
    _add_figure(rows, one, "heldout_freedom", None, float(one.freedom.sum()), "1")
    _add_figure(rows, one, "parameters", None, float(one.fit.matrix.size + one.fit.zeros.size), "1")


def _load_rows(rows: Rows, one: HeldOut, figure: str, values: NDArray, fitted: SensorCalibrations) -> None:
    for name, value in zip(fitted.table.load_names, values, strict=True):
        if np.isfinite(value):
            _add_figure(rows, one, figure, name, float(value), "N" if name.startswith("f") else "N m")


def _add_figure(rows: Rows, one: HeldOut, figure: str, subject: str | None, value: float, unit: str) -> None:
    finite = value if np.isfinite(value) else None
    rows.add(model=one.fit.model.name, figure=figure, subject=subject, value=finite, unit=unit)


def error_class_rows(found: Recorded, fitted: SensorCalibrations, ranges: Array) -> Rows:
    """Every class of every axis that was loaded by itself; ranges (6,) N and N m, NaN where an axis has none."""
    rows = Rows("error_classes")
    every = found.table(np.ones(len(found.steps.run), bool), found.steps.run)
    # less what acted beside the loads: the axis alone is meant to be loaded
    indicated = predicted_loads(fitted.chosen, every).value - (found.load - found.steps.load)
    matrix = fitted.matrix.value
    sigma = np.sqrt(np.einsum("wc,c->w", matrix**2, found.sigma**2))
    for axis in range(len(LOADS)):
        told = axis_errors(found, indicated, sigma, ranges, axis)
        if told is None:
            continue
        for one in told:
            rows.add(**_class_row(one))
        for name in CLASSES:
            if name not in {one.name for one in told}:
                rows.add(error_class=name, load=LOADS[axis], indicated=LOADS[axis], unit="%", reason=_WHY_NOT[name])
    return rows


def _class_row(one: ErrorClass) -> dict[str, object]:
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


def theory(settings: Campaign, tables: Mapping[str, pa.Table]) -> Theory | None:
    """The theory of [mechanism]; None where it is no such sensor."""
    if settings.mechanism.type != "6-upur":
        return None
    section: SensorMechanism = settings.mechanism  # type: ignore[assignment]
    given = tables.get("given_compliance")
    sensor = nominal_sensor(section, given if given is not None and given.num_rows else None)
    return theory_of(sensor, _largest(sensor, tables))


def _largest(sensor: NominalSensor, tables: Mapping[str, pa.Table]) -> Array:
    """The largest displacement (6,) of any load case: measured, else simulated, else none."""
    found = np.zeros(6)
    cases = tables.get("displacement")
    load = None
    if cases is not None and cases.num_rows:
        load = _loads(cases)
        moved = np.column_stack([number_column(cases, name) * unit for name, unit in _MOVED])
        found = np.where(np.isfinite(moved).any(0), farthest(np.nan_to_num(moved)), np.nan)
    elif "signals" in tables:
        load = _loads(tables["signals"])
    if load is not None and sensor.compliance is not None:
        found = np.where(np.isfinite(found) & (found != 0.0), found, farthest(load @ sensor.compliance.T))
    return np.nan_to_num(found)


def _loads(table: pa.Table) -> Array:
    return np.nan_to_num(np.column_stack([number_column(table, name) for name in LOAD_COLUMNS]))
