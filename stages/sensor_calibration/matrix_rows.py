"""Matrices of a sensor and their figures of merit as table rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.recorded_steps import LOADS
from truing.estimation.sensor.calibration_matrix import MatrixEstimate
from truing.estimation.sensor.contenders import SensorCalibrations
from truing.estimation.sensor.figures_of_merit import (
    LegMatrix,
    condition_number,
    leg_force_matrix,
    per_length,
    relative_errors,
    sensitivities,
)
from truing.simulation.bench.six_upur.influence import merit
from truing.simulation.bench.six_upur.nominal_sensor import Theory
from truing.stages.common.rows import Rows

Array = NDArray[np.float64]

NOMINAL, SYNTHETIC, WITH_JOINTS = "nominal", "synthetic error", "elastic joints"
_LEGS = tuple(f"leg{number + 1}" for number in range(6))


def leg_matrix(
    found: SensorCalibrations, sensitivity: float | tuple[float, ...] | None, tolerance: float | None
) -> LegMatrix | None:
    """G_B' of the chosen calibration (eq. 33, 34), mV per N being k / c; None where no sensitivity is stated."""
    if sensitivity is None:
        return None
    newton_per_mv = 1.0 / np.asarray(sensitivity, float)
    return LegMatrix(found.chosen.model.name, leg_force_matrix(found.matrix, newton_per_mv, 1.0, tolerance or 0.0))


def matrix_rows(theory: Theory | None, found: SensorCalibrations | None, legs: LegMatrix | None) -> Rows:
    """Every matrix entry by entry."""
    rows = Rows("sensor_matrix")
    if theory is not None:
        _entries(rows, "G", NOMINAL, theory.nominal, _LEGS, ("1", "m"))
        _entries(rows, "G'", SYNTHETIC, theory.with_error, _LEGS, ("1", "m"))
        if theory.with_joints is not None:
            _entries(rows, "G", WITH_JOINTS, _exactly(theory.with_joints), _LEGS, ("1", "m"))
    if found is not None:
        names = found.table.signal_names
        for k, (one, matrix) in enumerate(zip(found.choice.contenders, found.matrices, strict=True)):
            chosen = k == found.choice.choice.chosen
            more = {"sigma_by_case": found.by_case.sigma.ravel()} if chosen else {}
            _entries(rows, "G_B", one.fit.model.name, matrix, names, ("N/mV", "N m/mV"), chosen=chosen, **more)
        if found.as_written is not None:
            model = f"{found.chosen.model.name}, loads as written"
            _entries(rows, "G_B", model, found.as_written, names, ("N/mV", "N m/mV"))
        _term_rows(rows, found)
    if legs is not None:
        _entries(rows, "G_B'", legs.model, legs.estimate, _names_of(legs.estimate), ("1", "m"), chosen=True)
    return rows


def _exactly(matrix: Array) -> MatrixEstimate:
    """A matrix of which nobody says how sure it is."""
    return MatrixEstimate(matrix, np.full((matrix.size, matrix.size), np.nan))


def _known(sigma: Array) -> list[float | None]:
    return [float(one) if np.isfinite(one) else None for one in sigma]


def _names_of(matrix: MatrixEstimate) -> tuple[str, ...]:
    count = matrix.value.shape[1]
    return _LEGS if count == len(_LEGS) else tuple(f"v{number + 1}" for number in range(count))


def _entries(
    rows: Rows,
    matrix: str,
    model: str,
    estimate: MatrixEstimate,
    columns: tuple[str, ...],
    units: tuple[str, str],
    *,
    chosen: bool = False,
    **more: object,
) -> None:
    row, column = (index.ravel() for index in np.indices(estimate.value.shape))
    rows.add(
        matrix=matrix,
        model=model,
        row=[LOADS[i] for i in row],
        column_name=[columns[j] for j in column],
        value=estimate.value.ravel(),
        sigma=_known(estimate.sigma.ravel()),
        unit=[units[int(i > 2)] for i in row],
        chosen=chosen,
        **more,
    )


def _term_rows(rows: Rows, found: SensorCalibrations) -> None:
    """The coefficients of the chosen fit as it was made: response = coefficients . terms + zero."""
    fit = found.chosen
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


def merit_rows(theory: Theory | None, found: SensorCalibrations | None, legs: LegMatrix | None) -> Rows:
    """Condition, isotropy and sensitivities of every matrix, moments as they are and over a characteristic length."""
    rows = Rows("sensor_merit")
    length = 1.0 if theory is None else theory.length_m
    lengths = (1.0,) if length == 1.0 else (1.0, length)
    whole = [] if theory is None else [("G", NOMINAL, theory.nominal), ("G'", SYNTHETIC, theory.with_error)]
    if theory is not None and theory.with_joints is not None:
        whole.append(("G", WITH_JOINTS, _exactly(theory.with_joints)))
    whole += [] if legs is None else [("G_B'", legs.model, legs.estimate)]
    for name, model, estimate in whole:
        for one in lengths:
            _merit(rows, name, model, per_length(estimate, one), one)
    if found is not None:
        for one in lengths:
            condition = condition_number(per_length(found.matrix, one))
            _add(rows, "G_B", found.chosen.model.name, one, "condition", None, *_pair(condition.value, condition.sigma))
    if theory is not None and legs is not None and legs.estimate.value.shape == (6, 6):
        _types(rows, theory, legs, lengths)
    if theory is not None:
        for k, (name, unit) in enumerate(zip(_MOTION, _MOTION_UNITS, strict=True)):
            value = theory.synthetic[k] * (1e6 if k < 3 else 180.0 * 3600.0 / np.pi)
            _add(rows, "G'", SYNTHETIC, None, "synthetic_error", name, float(value), None, unit)
    return rows


_MOTION = ("dx", "dy", "dz", "rx", "ry", "rz")
_MOTION_UNITS = ("um", "um", "um", "arcsec", "arcsec", "arcsec")


def _merit(rows: Rows, matrix: str, model: str, estimate: MatrixEstimate, length: float) -> None:
    condition = condition_number(estimate)
    value, sigma = _pair(condition.value, condition.sigma)
    _add(rows, matrix, model, length, "condition", None, value, sigma)
    _add(rows, matrix, model, length, "isotropy", None, 1.0 / value, sigma / value**2)
    if estimate.value.shape != (6, 6):
        return
    figures = merit(estimate.value)
    _add(rows, matrix, model, length, "force_isotropy", None, float(figures.force_isotropy), None)
    _add(rows, matrix, model, length, "torque_isotropy", None, float(figures.torque_isotropy), None)
    each = sensitivities(estimate)
    for k, load in enumerate(LOADS):
        unit = "1" if k < 3 or length != 1.0 else "1/m"
        _add(rows, matrix, model, length, "sensitivity", load, float(each.value[k]), float(each.sigma[k]), unit)


def _types(rows: Rows, theory: Theory, legs: LegMatrix, lengths: tuple[float, ...]) -> None:
    """How far theory is from calibration, as the paper's Table 5 has it: with the synthetic error, and without."""
    pairs = [("type_1_error", "G'", SYNTHETIC, theory.with_error), ("type_2_error", "G", NOMINAL, theory.nominal)]
    if theory.with_joints is not None:
        pairs.append(("type_2_error", "G", WITH_JOINTS, _exactly(theory.with_joints)))
    for figure, matrix, model, estimate in pairs:
        measured, own = sensitivities(legs.estimate), sensitivities(estimate)
        found = relative_errors(own.value, measured)
        for k, load in enumerate(LOADS):
            _add(rows, matrix, model, None, figure, load, 100 * float(found.value[k]), 100 * float(found.sigma[k]), "%")
        for length in lengths:
            condition = condition_number(per_length(legs.estimate, length))
            theirs = condition_number(per_length(estimate, length)).value
            one = relative_errors(theirs, condition)
            value, sigma = _pair(one.value, one.sigma)
            _add(rows, matrix, model, length, figure, "condition", 100 * value, 100 * sigma, "%")


def _pair(value: Array, sigma: Array) -> tuple[float, float]:
    return float(value[0]), float(sigma[0])


def _add(
    rows: Rows,
    matrix: str,
    model: str,
    length: float | None,
    figure: str,
    subject: str | None,
    value: float,
    sigma: float | None,
    unit: str = "1",
) -> None:
    rows.add(
        matrix=matrix,
        model=model,
        length_m=length,
        figure=figure,
        subject=subject,
        value=value,
        sigma=None if sigma is None or not np.isfinite(sigma) else sigma,
        unit=unit,
    )
