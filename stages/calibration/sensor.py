"""Calibration of a force sensor: G from its drawing, G_B from signals, and remaining errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import compress
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.estimation.interferometry.recorded_steps import CHANNELS, LOADS, READING_SI, READING_UNITS
from truing.estimation.sensor.calibrated_sensor import calibrated_sensor, sensor_text
from truing.estimation.sensor.calibration import (
    Figures,
    LegMatrix,
    MatrixEstimate,
    angles_to_theory,
    condition_number,
    leg_force_matrix,
    per_length,
    relative_errors,
    sensitivities,
)
from truing.estimation.sensor.contenders import (
    HeldOutPredictions,
    SensorCalibrations,
    calibrations,
    errors_by_run,
    predicted_loads,
)
from truing.estimation.sensor.error_classes import CREEP_S, ErrorClass, axis_errors
from truing.estimation.sensor.load_table import RecordedLoads
from truing.report.numbers import count as counted
from truing.report.numbers import listed, percent
from truing.schemas.artifacts import ARTIFACTS
from truing.simulation.bench.six_upur.influence import merit
from truing.simulation.bench.six_upur.nominal_sensor import NominalSensor, Theory, farthest, theory_of
from truing.stages.calibration.model_rows import limit_rows
from truing.stages.common.applied_findings import AS_RECORDED, WITH_FINDINGS
from truing.stages.common.nominal_sensor import nominal_sensor
from truing.stages.common.point_arrays import number_columns
from truing.stages.common.reading_arrays import LOAD_COLUMNS, MOVED_COLUMNS, MOVED_SI
from truing.stages.common.recorded_signals import ranges_of, recorded, recorded_with_other_loads
from truing.stages.common.rows import Rows
from truing.stages.declaration import Outcome, Progress

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import SensorMechanism

Array = NDArray[np.float64]
Name = tuple[str, str]  # a matrix and its model
NOMINAL, SYNTHETIC, WITH_JOINTS = "nominal", "synthetic error", "elastic joints"
_PER_MV = ("N/mV", "N m/mV")
_UNITS = {"f": "N", "m": "N m"}
_GROSS = "it deviates from a smooth curve of load and time through its run"
_LEGS = tuple(f"leg{number + 1}" for number in range(6))
LEAVES = ("sensor_matrix", "sensor_merit", "sensor_choice", "error_classes")
CLASSES = ("nonlinearity", "interpolation", "hysteresis", "repeatability", "zero return", "crosstalk", "creep")
_NOT_AS_RECORDED = (
    "the diagnosis found that other loads acted than those recorded, and errors are those against recorded loads; "
    "record the loads that act, or apply the finding ([diagnosis] apply)"
)
_WHY_NOT = {
    "nonlinearity": "fewer than two loads on the way up",
    "interpolation": "fewer than two loads on the way up",
    "hysteresis": "no load was repeated on the way back",
    "repeatability": "the axis was loaded only once",
    "zero return": "no run came back to zero",
    "crosstalk": "no other component has a range",
    "creep": f"no load was held from {CREEP_S[0]:g} to {CREEP_S[1]:g} s",
}


def leg_matrix(
    sensor_calibrations: SensorCalibrations, sensitivity: float | tuple[float, ...] | None, tolerance: float | None
) -> LegMatrix | None:
    """G_B' of the chosen calibration (eq. 33, 34) in mV per N, as k / c; None without a stated sensitivity."""
    if sensitivity is None:
        return None
    newton_per_mv = 1.0 / np.asarray(sensitivity, float)
    return LegMatrix(
        sensor_calibrations.chosen.model.name,
        leg_force_matrix(sensor_calibrations.matrix, newton_per_mv, 1.0, tolerance or 0.0),
    )


@dataclass(frozen=True)
class OtherCalibrations:
    """Alternative calibrations: with the loads as recorded, or with those that the findings give."""

    found: RecordedLoads
    fitted: SensorCalibrations


def matrix_rows(
    theory: Theory | None,
    sensor_calibrations: SensorCalibrations | None,
    legs: LegMatrix | None,
    other_calibrations: OtherCalibrations | None,
) -> Rows:
    """Every matrix entry by entry."""
    rows = Rows("sensor_matrix")
    for name, estimate in _drawn(theory):
        _entries(rows, name, estimate, _LEGS, ("1", "m"))
    if sensor_calibrations is not None:
        names = sensor_calibrations.table.signal_names
        for k, (matrix_name, matrix) in enumerate(
            zip(sensor_calibrations.choice.contenders, sensor_calibrations.matrices, strict=True)
        ):
            chosen = k == sensor_calibrations.choice.choice.chosen
            more = {"sigma_by_case": sensor_calibrations.by_case.sigma.ravel()} if chosen else {}
            _entries(rows, ("G_B", matrix_name.fit.model.name), matrix, names, _PER_MV, chosen=chosen, **more)
        if other_calibrations is not None:
            loads = "loads as written" if not other_calibrations.found.causes else "findings applied"
            name = "G_B", f"{other_calibrations.fitted.chosen.model.name}, {loads}"
            _entries(rows, name, other_calibrations.fitted.matrix, names, _PER_MV)
        _term_rows(rows, sensor_calibrations)
    if legs is not None:
        _entries(rows, ("G_B'", legs.model), legs.estimate, _names_of(legs.estimate), ("1", "m"), chosen=True)
    return rows


def _drawn(theory: Theory | None) -> list[tuple[Name, MatrixEstimate]]:
    """Matrices from the drawing, by name and model."""
    if theory is None:
        return []
    matrices = [(("G", NOMINAL), theory.nominal), (("G'", SYNTHETIC), theory.with_error)]
    joints = theory.with_joints
    return matrices if joints is None else [*matrices, (("G", WITH_JOINTS), _without_uncertainty(joints))]


def _without_uncertainty(matrix: Array) -> MatrixEstimate:
    """A matrix without stated uncertainty."""
    return MatrixEstimate(matrix, np.full((matrix.size, matrix.size), np.nan))


def _finite_or_none(sigma: Array) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in sigma]


def _names_of(matrix: MatrixEstimate) -> tuple[str, ...]:
    count = matrix.value.shape[1]
    return _LEGS if count == len(_LEGS) else tuple(f"v{number + 1}" for number in range(count))


def _entries(
    rows: Rows,
    name: Name,
    estimate: MatrixEstimate,
    columns: tuple[str, ...],
    units: tuple[str, str],
    *,
    chosen: bool = False,
    **more: object,
) -> None:
    row, column = (index.ravel() for index in np.indices(estimate.value.shape))
    rows.add(
        matrix=name[0],
        model=name[1],
        row=[LOADS[i] for i in row],
        column_name=[columns[j] for j in column],
        value=estimate.value.ravel(),
        sigma=_finite_or_none(estimate.sigma.ravel()),
        unit=[units[int(i > 2)] for i in row],
        chosen=chosen,
        **more,
    )


def _term_rows(rows: Rows, sensor_calibrations: SensorCalibrations) -> None:
    """Coefficients of the chosen fit: response = coefficients . terms + zero."""
    fit = sensor_calibrations.chosen
    spread = np.sqrt(np.diag(fit.covariance)).reshape(len(fit.matrix), -1)
    labels = (*fit.terms.labels, *(("zero",) if fit.zeros.shape[1] == 1 else ()))
    values = np.concatenate([fit.matrix, fit.zeros], axis=1)[:, : len(labels)]
    row, column = (index.ravel() for index in np.indices(values.shape))
    unit = ["N" if name.startswith("f") else "N m" if name.startswith("m") else "mV" for name in fit.response_names]
    rows.add(
        matrix="terms",
        model=fit.model.name,
        row=[fit.response_names[i] for i in row],
        column_name=[labels[j] for j in column],
        value=values.ravel(),
        sigma=spread[:, : len(labels)].ravel(),
        unit=[unit[i] + ("" if labels[j] == "zero" else f" per {labels[j]}") for i, j in zip(row, column, strict=True)],
        chosen=True,
    )


def merit_rows(theory: Theory | None, sensor_calibrations: SensorCalibrations | None, legs: LegMatrix | None) -> Rows:
    """Condition, isotropy and sensitivities of every matrix, for moments in N m and over a characteristic length."""
    rows, drawn = Rows("sensor_merit"), _drawn(theory)
    length = 1.0 if theory is None else theory.length_m
    lengths = (1.0,) if length == 1.0 else (1.0, length)
    for name, estimate in [*drawn, *([] if legs is None else [(("G_B'", legs.model), legs.estimate)])]:
        for one in lengths:
            _merit(rows, name, per_length(estimate, one), one)
    if sensor_calibrations is not None:
        for one in lengths:
            condition = _pair(condition_number(per_length(sensor_calibrations.matrix, one)))
            _merit_row(rows, ("G_B", sensor_calibrations.chosen.model.name), one, "condition", *condition)
    if theory is None:
        return rows
    if legs is not None and legs.estimate.value.shape == (6, 6):
        for name, estimate in sorted(drawn, key=lambda one: one[0][0] != "G'"):
            _theory_errors(rows, name, estimate, legs, lengths)
    motion = theory.synthetic / READING_SI
    for subject, value, unit in zip(CHANNELS, motion.tolist(), READING_UNITS, strict=True):
        _merit_row(rows, ("G'", SYNTHETIC), None, "synthetic_error", value, None, subject, unit)
    return rows


def _merit(rows: Rows, name: Name, estimate: MatrixEstimate, length: float) -> None:
    value, sigma = _pair(condition_number(estimate))
    _merit_row(rows, name, length, "condition", value, sigma)
    _merit_row(rows, name, length, "isotropy", 1.0 / value, sigma / value**2)
    each = sensitivities(estimate)
    if estimate.value.shape == (6, 6):
        figures = merit(estimate.value)
        _merit_row(rows, name, length, "force_isotropy", float(figures.force_isotropy), None)
        _merit_row(rows, name, length, "torque_isotropy", float(figures.torque_isotropy), None)
    for k, load in enumerate(LOADS):
        unit = "1" if k < 3 or length != 1.0 else "1/m"
        _merit_row(rows, name, length, "sensitivity", float(each.value[k]), float(each.sigma[k]), load, unit)


def _theory_errors(
    rows: Rows, name: Name, estimate: MatrixEstimate, legs: LegMatrix, lengths: tuple[float, ...]
) -> None:
    """Difference of theory and calibration as in the paper's Table 5, with and without the synthetic error."""
    figure = "type_1_error" if name[0] == "G'" else "type_2_error"
    figures = relative_errors(sensitivities(estimate).value, sensitivities(legs.estimate))
    for load, value, sigma in zip(LOADS, figures.value.tolist(), figures.sigma.tolist(), strict=True):
        _merit_row(rows, name, None, figure, 100 * value, 100 * sigma, load, "%")
    angles = angles_to_theory(np.linalg.inv(estimate.value), legs.estimate)
    for load, value, sigma in zip(LOADS, np.degrees(angles.value), np.degrees(angles.sigma), strict=True):
        angle = figure.replace("error", "angle")
        _merit_row(rows, name, None, angle, float(value), float(sigma), load, "deg")
    for length in lengths:
        condition = condition_number(per_length(estimate, length)).value
        value, sigma = _pair(relative_errors(condition, condition_number(per_length(legs.estimate, length))))
        _merit_row(rows, name, length, figure, 100 * value, 100 * sigma, "condition", "%")


def _pair(figures: Figures) -> tuple[float, float]:
    return float(figures.value[0]), float(figures.sigma[0])


def _merit_row(
    rows: Rows,
    name: Name,
    length: float | None,
    figure: str,
    value: float,
    sigma: float | None,
    subject: str | None = None,
    unit: str = "1",
) -> None:
    finite = None if sigma is None or not np.isfinite(sigma) else sigma
    where = {"matrix": name[0], "model": name[1], "length_m": length, "subject": subject}
    rows.add(**where, figure=figure, value=value, sigma=finite, unit=unit)


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
        artifacts["calibration_left_out"] = left_out_rows(recorded_loads).table(_runs_type(recorded_loads))
    requirements = requirement_rows_of_loads(settings, recorded_loads, fitted, other_calibrations)
    if requirements.count:
        artifacts["requirements"] = requirements.table()
    sensor = calibrated_sensor(
        fitted.choice.chosen, fitted.table, settings.mechanism.reference_temperature_c, recorded_loads.tared
    )
    text = {"sensor": sensor_text(sensor, about)}
    words = (
        [f"{counted(recorded_loads.steps_left_out, 'load step')} with a gross error in a signal"]
        if recorded_loads.left_out
        else []
    )
    words += [f"{recorded_loads.excluded} with a signal excluded by a person"] if recorded_loads.excluded else []
    left_out = "; ".join(words) or "nothing"
    signals = counted(recorded_loads.signal.shape[1], "signal")
    read = f"{counted(len(recorded_loads.steps.run), 'load step')} with {signals}"
    return Outcome(
        artifacts | text, read=read, left_out=left_out, figure=_figure_of_sensor(recorded_loads, fitted, ranges)
    )


def left_out_rows(recorded_loads: RecordedLoads) -> Rows:
    """One row per signal with a gross error, whose load step the calibration left out."""
    rows = Rows("calibration_left_out")
    for one in recorded_loads.left_out:
        where = {"run": one.run, "step": one.step}
        rows.add(**where, subject=f"signal {one.signal}", reason=_GROSS, value=abs(one.deviation), unit="sigma")
    return rows


def _runs_type(recorded_loads: RecordedLoads) -> str:
    """Type of the labels of runs in tables."""
    return "int64" if all(isinstance(one.run, int) for one in recorded_loads.left_out) else "string"


def requirement_rows_of_loads(
    settings: Campaign,
    recorded_loads: RecordedLoads,
    fitted: SensorCalibrations,
    other_calibrations: OtherCalibrations | None,
) -> Rows:
    """One row per required component of the load, by errors of runs that were not fitted."""
    keys = {name: f"{name}_{'n' if name.startswith('f') else 'nm'}" for name in fitted.table.load_names}
    limits = [getattr(settings.requirement, key) for key in keys.values()]
    units = {name: _UNITS[name[0]] for name in keys}
    errors = errors_by_run(recorded_loads, fitted)
    variances = np.broadcast_to(recorded_loads.load_sigma**2, errors.shape)
    every = np.ones(len(errors), bool)
    key, why = (
        (fitted.chosen.model.name, "none"),
        dict.fromkeys(_misrecorded(recorded_loads, other_calibrations), _NOT_AS_RECORDED),
    )
    return limit_rows(units, limits, key, errors, variances, every, why, "runs")


def _misrecorded(recorded_loads: RecordedLoads, other_calibrations: OtherCalibrations | None) -> list[str]:
    """Components of the load that acted otherwise than recorded by a finding that the calibration leaves out.

    Every run has the same bias then, so that held-out errors do not show it.
    """
    if other_calibrations is None or recorded_loads.causes:
        return []
    differs = (other_calibrations.found.load != other_calibrations.found.steps.load).any(axis=0)
    return [name for name, is_other in zip(LOADS, differs, strict=True) if is_other]


def _with_other_loads(tables: Mapping[str, pa.Table], settings: Campaign) -> OtherCalibrations | None:
    """Calibrations with the other loads; None if no finding changes a load, or these loads determine none."""
    try:
        other = recorded_with_other_loads(tables, settings)
        return None if other is None else OtherCalibrations(other, calibrations(other))
    except ValueError:
        return None


def compared_rows(
    recorded_loads: RecordedLoads, fitted: SensorCalibrations, other_calibrations: OtherCalibrations
) -> Rows:
    """Errors of held-out loads of the main calibration and of the alternative one.

    ``rms_unchanged`` is over the load steps of both that no finding changes.
    """
    rows, both = (
        Rows("calibrations_compared"),
        ((recorded_loads, fitted), (other_calibrations.found, other_calibrations.fitted)),
    )
    moved = {name for one, _ in both for name in compress(_steps(one), one.moved.tolist())}
    same = set(_held_out_steps(recorded_loads)) & set(_held_out_steps(other_calibrations.found)) - moved
    for calibration_data, own in both:
        errors, names = own.choice.chosen.errors, own.table.load_names
        errors_used = errors[[name in same for name in _held_out_steps(calibration_data)]]
        common = {
            "data": WITH_FINDINGS if calibration_data.causes else AS_RECORDED,
            "is_main": calibration_data is recorded_loads,
            "findings": " and ".join(calibration_data.causes) or None,
            "model": own.chosen.model.name,
            "quantity": list(names),
            "unit": [_UNITS[name[0]] for name in names],
        }
        rows.add(
            **common,
            tested_on="held-out load cases",
            rms_error=np.sqrt(np.mean(errors**2, axis=0)),
            largest_error=np.abs(errors).max(axis=0),
            rms_unchanged=np.sqrt(np.mean(errors_used**2, axis=0)) if len(errors_used) else None,
            count=len(errors),
        )
        if np.isfinite(own.verification).all():
            count = int(calibration_data.steps.held_out.sum())
            rows.add(**common, tested_on="verification runs", rms_error=own.verification, count=count)
    return rows


def _steps(recorded_loads: RecordedLoads) -> list[tuple[int | str, int]]:
    """The load steps (B,) by run and step."""
    return list(
        zip(
            [recorded_loads.steps.runs[run] for run in recorded_loads.steps.run],
            recorded_loads.steps.step.tolist(),
            strict=True,
        )
    )


def _held_out_steps(recorded_loads: RecordedLoads) -> list[tuple[int | str, int]]:
    """Calibrating steps in the order of their held-out errors."""
    return list(compress(_steps(recorded_loads), (~recorded_loads.steps.held_out).tolist()))


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


def choice_rows(recorded_loads: RecordedLoads, fitted: SensorCalibrations) -> Rows:
    """Figures of every candidate, and reasons why others were not fitted."""
    rows = Rows("sensor_choice")
    equal = fitted.choice.choice.indistinguishable
    for k, contender in enumerate(fitted.choice.contenders):
        chosen = k == fitted.choice.choice.chosen
        _figures(rows, fitted, contender)
        for figure, value in (("chosen", chosen), ("indistinguishable", bool(equal[k]))):
            _add_figure(rows, contender, figure, None, float(value), "1")
        if chosen:
            _load_rows(rows, contender, "verification_rms", fitted.verification, fitted)
            _add_figure(rows, contender, "tared", None, float(recorded_loads.tared), "1")
            if recorded_loads.causes:
                words = " and ".join(recorded_loads.causes)
                rows.add(model=contender.fit.model.name, figure="loads_as_diagnosed", value=1.0, unit="1", reason=words)
            _add_figure(rows, contender, "noise_ratio", None, contender.fit.noise_ratio, "1")
    for model, why in fitted.choice.refused.items():
        rows.add(model=model, figure="refused", value=1.0, unit="1", reason=why)
    return rows


def _figures(rows: Rows, fitted: SensorCalibrations, predictions: HeldOutPredictions) -> None:
    _load_rows(rows, predictions, "heldout_rms", predictions.rms, fitted)
    if predictions.fit.model.direction == "direct":
        _load_rows(rows, predictions, "fitted_rms", np.sqrt(np.mean(predictions.fit.residuals**2, axis=0)), fitted)
    _add_figure(rows, predictions, "heldout_log_density", None, predictions.log_density, "1")
    _add_figure(rows, predictions, "heldout_chi_square", None, float(predictions.squares.sum()), "1")
    _add_figure(rows, predictions, "heldout_freedom", None, float(predictions.freedom.sum()), "1")
    _add_figure(
        rows, predictions, "parameters", None, float(predictions.fit.matrix.size + predictions.fit.zeros.size), "1"
    )


def _load_rows(
    rows: Rows, predictions: HeldOutPredictions, figure: str, values: NDArray, fitted: SensorCalibrations
) -> None:
    for name, value in zip(fitted.table.load_names, values, strict=True):
        if np.isfinite(value):
            _add_figure(rows, predictions, figure, name, float(value), "N" if name.startswith("f") else "N m")


def _add_figure(
    rows: Rows, predictions: HeldOutPredictions, figure: str, subject: str | None, value: float, unit: str
) -> None:
    finite = value if np.isfinite(value) else None
    rows.add(model=predictions.fit.model.name, figure=figure, subject=subject, value=finite, unit=unit)


def error_class_rows(recorded_loads: RecordedLoads, fitted: SensorCalibrations, ranges: Array) -> Rows:
    """Every error class of every axis that was loaded alone; ranges (6,) in N and N m, NaN if undeclared."""
    rows = Rows("error_classes")
    every = recorded_loads.table(np.ones(len(recorded_loads.steps.run), bool), recorded_loads.steps.run)
    # without other acting loads, because only the axis should be loaded
    indicated = predicted_loads(fitted.chosen, every).value - (recorded_loads.load - recorded_loads.steps.load)
    matrix = fitted.matrix.value
    sigma = np.sqrt(np.einsum("wc,c->w", matrix**2, recorded_loads.sigma**2))
    for axis in range(len(LOADS)):
        reported = axis_errors(recorded_loads, indicated, sigma, ranges, axis)
        if reported is None:
            continue
        for row in reported:
            _add_class(rows, row)
        for name in CLASSES:
            if name not in {reported_class.name for reported_class in reported}:
                rows.add(error_class=name, load=LOADS[axis], indicated=LOADS[axis], unit="%", reason=_WHY_NOT[name])
    return rows


def _add_class(rows: Rows, error_class: ErrorClass) -> None:
    rows.add(
        error_class=error_class.name,
        load=LOADS[error_class.axis],
        indicated=LOADS[error_class.component],
        value=100.0 * error_class.value,
        sigma=100.0 * error_class.sigma,
        limit=100.0 * error_class.limit,
        unit="%",
        applied=error_class.load,
    )


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
