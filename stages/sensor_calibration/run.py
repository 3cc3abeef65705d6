"""The calibrate stage of a force sensor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from schemas.artifacts import ARTIFACTS
from stages.declaration import Outcome, Progress
from stages.sensor.reading_arrays import LOAD_COLUMNS, LOADS
from stages.sensor_calibration.choice_rows import choice_rows
from stages.sensor_calibration.contenders import SensorCalibrations, calibrations
from stages.sensor_calibration.error_rows import error_class_rows
from stages.sensor_calibration.matrix_rows import leg_matrix, matrix_rows, merit_rows
from stages.sensor_calibration.recorded import Recorded, recorded
from stages.sensor_calibration.theory import theory

if TYPE_CHECKING:
    import pyarrow as pa

    from schemas.campaign import Campaign

LEAVES = ("sensor_matrix", "sensor_merit", "sensor_choice", "error_classes")


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
    words = [f"{found.left_out} load steps with a gross error in a signal"] if found.left_out else []
    words += [f"{found.excluded} with a signal excluded by a person"] if found.excluded else []
    words += [f"no load of {found.put_right} steps that were exchanged: they are put right"] if found.put_right else []
    left_out = "; ".join(words) or "nothing"
    read = f"{len(found.steps.run)} load steps with {found.signal.shape[1]} signals"
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


def ranges_of(settings: Campaign, found: Recorded) -> np.ndarray:
    """The range (6,) of every axis: as [loading] has it, else its largest load; NaN where it was never loaded."""
    largest = np.abs(found.steps.load).max(axis=0)
    stated = [getattr(settings.loading, name) for name in LOAD_COLUMNS]
    return np.array([one or (own if own > 0.0 else np.nan) for one, own in zip(stated, largest, strict=True)])


def _figure(fitted: SensorCalibrations, ranges: np.ndarray) -> str:
    held = 100.0 * fitted.choice.chosen.rms / ranges
    worst = int(np.nanargmax(held))
    return (
        f"G_B by {fitted.chosen.model.name}; held out {fitted.left_out}: "
        f"at most {held[worst]:.2g} % of the range rms ({LOADS[worst]})"
    )


def nothing(why: str) -> Outcome:
    """Return the outcome of a campaign without anything to calibrate, or whose data cannot be used."""
    empty = {name: ARTIFACTS[name].empty() for name in LEAVES}
    return Outcome.not_evaluated(empty, why)
