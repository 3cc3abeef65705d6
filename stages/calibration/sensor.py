"""Calibration of a force sensor: G from its drawing, G_B from signals, and remaining errors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.estimation.interferometry.recorded_steps import LOADS
from truing.estimation.sensor.calibrated_sensor import calibrated_sensor, sensor_text
from truing.estimation.sensor.contenders import SensorCalibrations, calibrations
from truing.estimation.sensor.load_table import RecordedLoads
from truing.report.numbers import count_text, listed, percent
from truing.schemas.artifacts import ARTIFACTS
from truing.simulation.bench.six_upur.nominal_sensor import NominalSensor, Theory, farthest, theory_of
from truing.stages.calibration.sensor_choices import (
    choice_rows,
    compared_rows,
    error_class_rows,
    kept_rows,
    left_out_rows,
    requirement_rows_of_loads,
    runs_type,
)
from truing.stages.calibration.sensor_matrices import OtherCalibrations, leg_matrix, matrix_rows, merit_rows
from truing.stages.common.applied_findings import AS_RECORDED, WITH_FINDINGS
from truing.stages.common.nominal_sensor import nominal_sensor
from truing.stages.common.point_arrays import number_columns
from truing.stages.common.reading_arrays import LOAD_COLUMNS, MOVED_COLUMNS, MOVED_SI
from truing.stages.common.recorded_signals import ranges_of, recorded, recorded_with_other_loads
from truing.stages.declaration import Outcome, Progress

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import SensorMechanism

Array = NDArray[np.float64]
LEAVES = ("sensor_matrix", "sensor_merit", "sensor_choice", "error_classes")


def calibrate_sensor(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress) -> Outcome:
    """Evaluate the drawing of the sensor, and calibrate it if its signals were recorded."""
    progress(0, 2, "theory")
    drawn = theory(settings, tables)
    recorded_loads, fitted, why = _fitted(tables, settings, progress)
    if drawn is None and fitted is None:
        return outcome_without_sensor(why)
    sensitivity, tolerance = settings.signals.sensitivity_mv_per_n, settings.signals.sensitivity_tolerance
    legs = None if fitted is None else leg_matrix(fitted, sensitivity, tolerance)
    other_calibrations = None if fitted is None else _with_other_loads(tables, settings)
    artifacts = {
        "sensor_matrix": matrix_rows(drawn, fitted, legs, other_calibrations).table(),
        "sensor_merit": merit_rows(drawn, fitted, legs).table(),
    }
    if recorded_loads is None or fitted is None:
        empty = {name: ARTIFACTS[name].empty() for name in ("sensor_choice", "error_classes")}
        figure = f"G by [mechanism]; G_B not evaluated: {why}"
        return Outcome(artifacts | empty, "the drawing", "nothing", figure, why_not=why)
    if other_calibrations is not None:
        artifacts["calibrations_compared"] = compared_rows(recorded_loads, fitted, other_calibrations).table()
    ranges = ranges_of(settings, recorded_loads)
    artifacts["sensor_choice"] = choice_rows(recorded_loads, fitted).table()
    artifacts["error_classes"] = error_class_rows(recorded_loads, fitted, ranges).table()
    about = {"calibration": fitted.chosen.model.name, "data": WITH_FINDINGS if recorded_loads.causes else AS_RECORDED}
    if recorded_loads.left_out:
        artifacts["calibration_left_out"] = left_out_rows(recorded_loads).table(runs_type(recorded_loads.left_out))
    if recorded_loads.kept:
        artifacts["calibration_kept"] = kept_rows(recorded_loads).table(runs_type(recorded_loads.kept))
    requirements = requirement_rows_of_loads(settings, recorded_loads, fitted, other_calibrations)
    if requirements.count:
        artifacts["requirements"] = requirements.table()
    sensor = calibrated_sensor(
        fitted.choice.chosen, fitted.table, settings.mechanism.reference_temperature_c, recorded_loads.tared
    )
    text = {"sensor": sensor_text(sensor, about)}
    signals = count_text(recorded_loads.signal.shape[1], "signal")
    read = f"{count_text(len(recorded_loads.steps.run), 'load step')} with {signals}"
    return Outcome(
        artifacts | text,
        read=read,
        left_out=_left_out_words(recorded_loads),
        figure=_figure_of_sensor(recorded_loads, fitted, ranges),
    )


def _left_out_words(recorded_loads: RecordedLoads) -> str:
    """Words on the load steps that the calibration leaves out, and on outlying signals that it uses."""
    words = []
    if recorded_loads.left_out:
        words.append(f"{count_text(recorded_loads.steps_left_out, 'load step')} with a gross error in a signal")
    if recorded_loads.excluded:
        words.append(f"{recorded_loads.excluded} with a signal excluded by a person")
    used = count_text(len(recorded_loads.kept), "outlying signal")
    follows = f" ({used} used: an effect of loads or runs)" if recorded_loads.kept else ""
    return ("; ".join(words) or "nothing") + follows


def _with_other_loads(tables: Mapping[str, pa.Table], settings: Campaign) -> OtherCalibrations | None:
    """Calibrations with the other loads; None if no finding changes a load, or these loads determine none."""
    try:
        with_findings = recorded_with_other_loads(tables, settings)
        return None if with_findings is None else OtherCalibrations(with_findings, calibrations(with_findings))
    except ValueError:
        return None


def _fitted(
    tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress
) -> tuple[RecordedLoads | None, SensorCalibrations | None, str]:
    """Signals and their calibrations, or the reason for their absence."""
    if "signals" not in tables or not tables["signals"].num_rows:
        return None, None, "the campaign holds no signals"
    progress(1, 2, "calibrations")
    try:
        loads = recorded(tables, settings)
        if loads.steps.held_out.all():
            return loads, None, "every run is for verification, so none may be fitted"
        return loads, calibrations(loads), ""
    except ValueError as error:
        return None, None, str(error)


def _figure_of_sensor(recorded_loads: RecordedLoads, fitted: SensorCalibrations, ranges: np.ndarray) -> str:
    error_share = 100.0 * fitted.choice.chosen.rms / ranges
    worst = int(np.nanargmax(error_share))
    return (
        f"G_B by {fitted.chosen.model.name}; held out {fitted.left_out}: "
        f"largest rms error {percent(error_share[worst])} of the range ({LOADS[worst]})"
        f"{f'; with {listed(recorded_loads.causes)} applied' if recorded_loads.causes else ''}"
    )


def outcome_without_sensor(why: str) -> Outcome:
    """Outcome of a campaign without data for a calibration, or with unusable data."""
    empty = {name: ARTIFACTS[name].empty() for name in LEAVES}
    return Outcome.not_evaluated(empty, why)


def theory(settings: Campaign, tables: Mapping[str, pa.Table]) -> Theory | None:
    """Theory of [mechanism]; None for other mechanisms."""
    if settings.mechanism.type != "6-upur":
        return None
    section: SensorMechanism = settings.mechanism  # type: ignore[assignment]
    compliance = tables.get("given_compliance")
    sensor = nominal_sensor(section, compliance if compliance is not None and compliance.num_rows else None)
    return theory_of(sensor, _largest(sensor, tables))


def _largest(sensor: NominalSensor, tables: Mapping[str, pa.Table]) -> Array:
    """Largest displacement (6,) of any load case: measured, else simulated, else none."""
    largest = np.zeros(6)
    cases = tables.get("displacement")
    load = None
    if cases is not None and cases.num_rows:
        load = _loads(cases)
        moved = number_columns(cases, MOVED_COLUMNS) * MOVED_SI
        largest = np.where(np.isfinite(moved).any(0), farthest(np.nan_to_num(moved)), np.nan)
    elif "signals" in tables:
        load = _loads(tables["signals"])
    if load is not None and sensor.compliance is not None:
        largest = np.where(np.isfinite(largest) & (largest != 0.0), largest, farthest(load @ sensor.compliance.T))
    return np.nan_to_num(largest)


def _loads(table: pa.Table) -> Array:
    return np.nan_to_num(number_columns(table, LOAD_COLUMNS))
