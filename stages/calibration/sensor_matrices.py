"""Rows of a sensor's matrices, and their figures of merit: G from the drawing, G_B from signals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.recorded_steps import CHANNELS, LOADS, READING_SI, READING_UNITS
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
from truing.estimation.sensor.contenders import SensorCalibrations
from truing.estimation.sensor.load_table import RecordedLoads
from truing.simulation.bench.six_upur.influence import merit
from truing.simulation.bench.six_upur.nominal_sensor import Theory
from truing.stages.common.rows import Rows

Array = NDArray[np.float64]
Name = tuple[str, str]  # a matrix and its model
NOMINAL, SYNTHETIC, WITH_JOINTS = "nominal", "synthetic error", "elastic joints"
_PER_MV = ("N/mV", "N m/mV")
_LEGS = tuple(f"leg{number + 1}" for number in range(6))


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
        for length in lengths:
            _merit(rows, name, per_length(estimate, length), length)
    if sensor_calibrations is not None:
        for length in lengths:
            condition = _pair(condition_number(per_length(sensor_calibrations.matrix, length)))
            _MeritRows(rows, ("G_B", sensor_calibrations.chosen.model.name), length).add("condition", *condition)
    if theory is None:
        return rows
    if legs is not None and legs.estimate.value.shape == (6, 6):
        for name, estimate in sorted(drawn, key=lambda drawing: drawing[0][0] != "G'"):
            _theory_errors(rows, name, estimate, legs, lengths)
    motion = theory.synthetic / READING_SI
    for subject, value, unit in zip(CHANNELS, motion.tolist(), READING_UNITS, strict=True):
        _MeritRows(rows, ("G'", SYNTHETIC), None).add("synthetic_error", value, None, subject, unit)
    return rows


def _merit(rows: Rows, name: Name, estimate: MatrixEstimate, length: float) -> None:
    value, sigma = _pair(condition_number(estimate))
    merits = _MeritRows(rows, name, length)
    merits.add("condition", value, sigma)
    merits.add("isotropy", 1.0 / value, sigma / value**2)
    of_channels = sensitivities(estimate)
    if estimate.value.shape == (6, 6):
        figures = merit(estimate.value)
        merits.add("force_isotropy", float(figures.force_isotropy), None)
        merits.add("torque_isotropy", float(figures.torque_isotropy), None)
    for k, load in enumerate(LOADS):
        unit = "1" if k < 3 or length != 1.0 else "1/m"
        merits.add("sensitivity", float(of_channels.value[k]), float(of_channels.sigma[k]), load, unit)


def _theory_errors(
    rows: Rows, name: Name, estimate: MatrixEstimate, legs: LegMatrix, lengths: tuple[float, ...]
) -> None:
    """Difference of theory and calibration as in the paper's Table 5, with and without the synthetic error."""
    figure = "type_1_error" if name[0] == "G'" else "type_2_error"
    figures = relative_errors(sensitivities(estimate).value, sensitivities(legs.estimate))
    for load, value, sigma in zip(LOADS, figures.value.tolist(), figures.sigma.tolist(), strict=True):
        _MeritRows(rows, name, None).add(figure, 100 * value, 100 * sigma, load, "%")
    angles = angles_to_theory(np.linalg.inv(estimate.value), legs.estimate)
    for load, value, sigma in zip(LOADS, np.degrees(angles.value), np.degrees(angles.sigma), strict=True):
        angle = figure.replace("error", "angle")
        _MeritRows(rows, name, None).add(angle, float(value), float(sigma), load, "deg")
    for length in lengths:
        condition = condition_number(per_length(estimate, length)).value
        value, sigma = _pair(relative_errors(condition, condition_number(per_length(legs.estimate, length))))
        _MeritRows(rows, name, length).add(figure, 100 * value, 100 * sigma, "condition", "%")


def _pair(figures: Figures) -> tuple[float, float]:
    return float(figures.value[0]), float(figures.sigma[0])


@dataclass(frozen=True)
class _MeritRows:
    """Rows of the figures of one matrix, with moments divided by a length; None: the figure has no such length."""

    rows: Rows
    name: Name
    length: float | None

    def add(self, figure: str, value: float, sigma: float | None, subject: str | None = None, unit: str = "1") -> None:
        finite = None if sigma is None or not np.isfinite(sigma) else sigma
        where = {"matrix": self.name[0], "model": self.name[1], "length_m": self.length, "subject": subject}
        self.rows.add(**where, figure=figure, value=value, sigma=finite, unit=unit)
