"""Rows on a sensor's calibrations: the choice of a model, errors of loads, error classes, and signals left out."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import compress
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.recorded_steps import LOADS
from truing.estimation.sensor.contenders import (
    HeldOutPredictions,
    SensorCalibrations,
    errors_by_run,
    predicted_loads,
)
from truing.estimation.sensor.error_classes import CREEP_S, ErrorClass, axis_errors
from truing.estimation.sensor.load_table import GrossSignal, RecordedLoads
from truing.stages.calibration.model_rows import ComponentErrors, limit_rows
from truing.stages.calibration.sensor_matrices import OtherCalibrations
from truing.stages.common.applied_findings import AS_RECORDED, WITH_FINDINGS
from truing.stages.common.rows import Rows

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

Array = NDArray[np.float64]
_UNITS = {"f": "N", "m": "N m"}
_GROSS = (
    "it deviates from a smooth curve of load and time through its run; no nonlinear term of the loads predicts it, and "
    "it shares no input with other such signals"
)
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


def left_out_rows(recorded_loads: RecordedLoads) -> Rows:
    """One row per signal with a gross error, whose load step the calibration left out."""
    rows = Rows("calibration_left_out")
    for gross_error in recorded_loads.left_out:
        where = {"run": gross_error.run, "step": gross_error.step}
        rows.add(
            **where,
            subject=f"signal {gross_error.signal}",
            reason=_GROSS,
            value=abs(gross_error.deviation),
            unit="sigma",
        )
    return rows


def kept_rows(recorded_loads: RecordedLoads) -> Rows:
    """One row per signal that looks like a gross error, and that the calibration uses because it is an effect."""
    rows = Rows("calibration_kept")
    for kept_signal in recorded_loads.kept:
        rows.add(
            run=kept_signal.run,
            step=kept_signal.step,
            subject=f"signal {kept_signal.signal}",
            kept_because="predicted" if kept_signal.is_predicted else "shared input",
            shared_input=kept_signal.follows,
            value=abs(kept_signal.deviation),
            unit="sigma",
            p_value=kept_signal.p_value,
        )
    return rows


def runs_type(signals: Sequence[GrossSignal]) -> str:
    """Return the type of the labels of runs in tables of these signals."""
    return "int64" if all(isinstance(signal.run, int) for signal in signals) else "string"


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
    return limit_rows(ComponentErrors(units, errors, variances, every, "runs"), limits, key, why)


def _misrecorded(recorded_loads: RecordedLoads, other_calibrations: OtherCalibrations | None) -> list[str]:
    """Components of the load that acted otherwise than recorded by a finding that the calibration leaves out.

    Every run has the same bias then, so that held-out errors do not show it.
    """
    if other_calibrations is None or recorded_loads.causes:
        return []
    differs = (other_calibrations.found.load != other_calibrations.found.steps.load).any(axis=0)
    return [name for name, is_other in zip(LOADS, differs, strict=True) if is_other]


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
    moved = {
        name
        for calibration_data, _ in both
        for name in compress(_steps(calibration_data), calibration_data.moved.tolist())
    }
    same = set(_held_out_steps(recorded_loads)) & set(_held_out_steps(other_calibrations.found)) - moved
    for calibration_data, result in both:
        errors, names = result.choice.chosen.errors, result.table.load_names
        errors_used = errors[[name in same for name in _held_out_steps(calibration_data)]]
        common = {
            "data": WITH_FINDINGS if calibration_data.causes else AS_RECORDED,
            "is_main": calibration_data is recorded_loads,
            "findings": " and ".join(calibration_data.causes) or None,
            "model": result.chosen.model.name,
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
        if np.isfinite(result.verification).all():
            count = int(calibration_data.steps.held_out.sum())
            rows.add(**common, tested_on="verification runs", rms_error=result.verification, count=count)
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
    is_unweighted = predictions.fit.model.estimator == "least squares"
    _add_figure(rows, predictions, "noise_from_residuals", None, float(is_unweighted), "1")
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
