"""Which model of a sensor predicts loads it was not fitted to: whole load cases are left out, never single rows.

Rows of one load case share its load, its zero and its mounting. A model with many terms learns them by heart, and a
random row of the same case cannot catch it at that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.held_out import Choice, Contender, choose_model
from truing.estimation.least_squares.solver import SolverStatus
from truing.estimation.sensor.calibrate import fit_calibration
from truing.estimation.sensor.calibration import Calibration, CalibrationModel
from truing.estimation.sensor.calibration_matrix import (
    MatrixEstimate,
    UnreachedSignalsError,
    Wrenches,
    calibration_matrix,
    wrenches,
)
from truing.estimation.sensor.determined import UndeterminedCalibrationError
from truing.estimation.sensor.load_table import LoadTable


@dataclass(frozen=True)
class HeldOut:
    """A model's predictions of loads by fits that have not seen their case, and the fit to all rows.

    errors (N, W): predicted less applied, less the case's mean where every case has a zero of its own. squares,
    freedom (B,) of each case under the noise that the fits without it declare or find; log_density of all errors.
    """

    fit: Calibration
    errors: NDArray
    squares: NDArray
    freedom: NDArray
    log_density: float

    @property
    def rms(self) -> NDArray:
        """Return the root mean square error (W,) of each component of the load."""
        return np.sqrt(np.mean(self.errors**2, 0))


@dataclass(frozen=True)
class CalibrationChoice:
    """Held-out predictions of every contender, which of them is chosen, and why others could not contend, by name."""

    contenders: tuple[HeldOut, ...]
    choice: Choice
    refused: Mapping[str, str]

    @property
    def chosen(self) -> HeldOut:
        """Return the contender that is chosen."""
        return self.contenders[self.choice.chosen]


def hold_out(table: LoadTable, model: CalibrationModel) -> HeldOut:
    """Return the predictions of every load case by a fit to all others.

    Raises UndeterminedCalibrationError, naming the case, where the others do not determine the model, and ValueError
    where a case has but the row that tells its own zero.
    """
    alone = [case for case in table.cases if np.sum(table.case == case) < 2]
    if model.zero == "case" and alone:
        raise ValueError(f"case {alone[0]}: found one row, expected two at least where every case has its own zero")
    errors = np.empty_like(table.loads)
    squares, freedom, log_density = np.zeros(len(table.cases)), np.zeros(len(table.cases)), 0.0
    for place, case in enumerate(table.cases):
        out = table.case == case
        fit = _without(table.rows(~out), model, case)
        found = predicted_loads(fit, table.rows(out))
        miss = found.value - table.loads[out]
        spread = _spread(fit, found, table.rows(out))
        squares[place], freedom[place], density = _judged(miss, spread, model.zero == "case")
        log_density += density
        errors[out] = miss - miss.mean(0) if model.zero == "case" else miss
    return HeldOut(fit_calibration(table, model), errors, squares, freedom, log_density)


def covariance_by_case(table: LoadTable, model: CalibrationModel) -> MatrixEstimate:
    """Return G_B with the covariance that its change from case to case gives it: a jackknife over whole load cases.

    Honest where rows of a case share an error of load, lever arm or mounting, which the covariance of a fit takes for
    independent; a little too large where they do not, and itself uncertain by 1 / sqrt(2 cases). Raises as `hold_out`.
    """
    values = []
    for case in table.cases:
        rest = table.rows(table.case != case)
        values.append(calibration_matrix(_without(rest, model, case), table.signal_cov).value.ravel())
    whole = calibration_matrix(fit_calibration(table, model), table.signal_cov)
    apart = np.array(values) - np.mean(values, axis=0)
    count = len(values)
    return MatrixEstimate(whole.value, (count - 1) / count * apart.T @ apart)


def predicted_loads(fit: Calibration, table: LoadTable) -> Wrenches:
    """Return the wrenches of a table's signals, with the errors declared of these; a forward fit's own where none."""
    cov = table.signal_cov
    if cov is None:
        count = table.signals.shape[1]
        cov = fit.noise if fit.model.direction == "forward" else np.zeros((count, count))
    return wrenches(fit, table.signals, table.covariates, cov)


def choose_calibration(table: LoadTable, models: Sequence[CalibrationModel]) -> CalibrationChoice:
    """Return the model that held-out load cases speak for, by the same rule as for the calibrations of mechanisms.

    A model is refuted where it misses held-out cases by more than the declared noise (where none is declared: than the
    best contender's errors) and is worse than the best, case against case; of the others the one whose predictions were
    most probable beforehand (the log density of what was held out, Geisser and Eddy 1979), the simplest of equals.
    Models that the loads do not determine, or that cannot be inverted at held-out signals, are left out; raises
    UndeterminedCalibrationError where none is left.
    """
    held, refused = _contending(table, models)
    undeclared = None if table.load_cov is not None else _smallest(held)
    contenders = [
        Contender(
            one.squares if undeclared is None else _by_case(table, one.errors, undeclared),
            one.freedom,
            one.log_density,
            one.fit.matrix.size + one.fit.zeros.size,
            one.fit.status == SolverStatus.CONVERGED,
        )
        for one in held
    ]
    return CalibrationChoice(held, choose_model(contenders), refused)


def _contending(table: LoadTable, models: Sequence[CalibrationModel]) -> tuple[tuple[HeldOut, ...], dict[str, str]]:
    held, refused = [], {}
    for model in models:
        try:
            held.append(hold_out(table, model))
        except (UndeterminedCalibrationError, UnreachedSignalsError) as error:
            refused[model.name] = str(error)
    if not held:
        raise UndeterminedCalibrationError(
            "; ".join(dict.fromkeys(refused.values())) or "found no model, expected at least one"
        )
    return tuple(held), refused


def _without(table: LoadTable, model: CalibrationModel, case: object) -> Calibration:
    try:
        return fit_calibration(table, model)
    except UndeterminedCalibrationError as error:
        raise UndeterminedCalibrationError(f"without case {case} nothing determines it: {error}") from error


@dataclass(frozen=True)
class _Spread:
    """Covariance of predicted less applied loads: of each row by itself (N, W, W), and what the calibration's error
    gives all rows together, U U^T with U (N W, R)."""

    own: NDArray
    common: NDArray

    def whitened(self, values: NDArray) -> tuple[NDArray, float]:
        """Return the inverse covariance's product with columns of values (N W, K), and its log determinant.

        By the matrix inversion lemma, for rows are many beside the numbers of a calibration. Raises LinAlgError where
        a row's own covariance is not positive.
        """
        rows, width = self.own.shape[:2]
        root = np.linalg.cholesky(self.own)
        inverse = np.linalg.inv(root)

        def apart(columns: NDArray) -> NDArray:
            split = columns.reshape(rows, width, -1)
            return np.asarray(np.swapaxes(inverse, 1, 2) @ (inverse @ split)).reshape(rows * width, -1)

        by_own = apart(self.common)
        inner = np.eye(self.common.shape[1]) + self.common.T @ by_own
        found = apart(values)
        found = found - by_own @ np.linalg.solve(inner, self.common.T @ found)
        log_det = 2.0 * float(np.log(np.einsum("nii->ni", root)).sum()) + float(np.linalg.slogdet(inner)[1])
        return found, log_det


def _spread(fit: Calibration, found: Wrenches, table: LoadTable) -> _Spread:
    """Return the covariance of predicted less applied loads."""
    rows, width = found.value.shape
    noise = np.zeros((width, width)) if table.load_cov is None else table.load_cov
    own = found.own + noise
    if fit.model.direction == "direct" and (fit.model.estimator == "least squares" or table.load_cov is None):
        own = np.broadcast_to(fit.noise, (rows, width, width))  # residuals hold the signals' errors too
    by = np.einsum("nwr,nq->nwrq", found.gain, found.columns).reshape(rows * width, -1)
    strength, axes = np.linalg.eigh(found.coefficients)
    return _Spread(own, by @ (axes * np.sqrt(np.maximum(strength, 0.0))))


def _judged(miss: NDArray, spread: _Spread, own_zero: bool) -> tuple[float, float, float]:
    """Return chi-square, freedom and log density of errors (N, W), a zero being free or not.

    A fit with too few rows left over to tell its noise holds most errors for impossible: its density is zero.
    """
    rows, width = miss.shape
    zero = np.tile(np.eye(width), (rows, 1))
    try:
        solved, log_det = spread.whitened(np.column_stack([miss.ravel(), zero]))
    except np.linalg.LinAlgError:
        return float("inf"), float(miss.size), -float("inf")
    squares, freedom = float(miss.ravel() @ solved[:, 0]), float(miss.size)
    if own_zero:
        told = zero.T @ solved[:, 1:]
        by_zero = zero.T @ solved[:, 0]
        squares -= float(by_zero @ np.linalg.solve(told, by_zero))
        freedom -= width
        log_det += float(np.linalg.slogdet(told)[1])
    return squares, freedom, -0.5 * (squares + log_det + freedom * float(np.log(2 * np.pi)))


def _smallest(held: Sequence[HeldOut]) -> NDArray:
    """Return the covariance (W, W) of the errors of the contender whose errors are smallest by volume.

    Of those with rows enough to tell their noise: errors of the others lie in a few directions, and have no volume.
    """
    told = [one for one in held if np.isfinite(one.log_density)]
    if not told:
        raise ValueError("found no model that leaves rows enough to tell the noise, expected one with fewer terms")
    spreads = [one.errors.T @ one.errors / len(one.errors) for one in told]
    return min(spreads, key=lambda spread: float(np.linalg.slogdet(spread)[1]))


def _by_case(table: LoadTable, errors: NDArray, noise: NDArray) -> NDArray:
    """Return the chi-square (B,) of each case's errors (N, W) under one noise (W, W)."""
    rows = np.einsum("ni,ij,nj->n", errors, np.linalg.inv(noise), errors)
    return np.array([rows[table.case == case].sum() for case in table.cases])
