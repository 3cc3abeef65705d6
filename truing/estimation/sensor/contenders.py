"""Selection of a sensor calibration: candidate models, their predictions of held-out load cases, and the choice.

Rows of one load case share load, zero and mounting. A model with many terms can fit these individually, which a
held-out random row of the same case would not show; so whole cases are held out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Mask
from truing.estimation.held_out import Contender, ContenderChoice, choose_model
from truing.estimation.interferometry.recorded_steps import LOADS
from truing.estimation.least_squares.solver import SolverStatus
from truing.estimation.sensor.calibrate import UndeterminedCalibrationError, check_loads, check_signals, fit_calibration
from truing.estimation.sensor.calibration import (
    Calibration,
    CalibrationModel,
    MatrixEstimate,
    UnreachedSignalsError,
    Wrenches,
    Zero,
    calibration_matrix,
    wrenches,
)
from truing.estimation.sensor.load_table import LoadTable, RecordedLoads

AS_PRINTED = CalibrationModel()
_RIDGE = 1.0
_MOST_CASES = 48  # with more runs, several are held out together
_OVER_NOISE = 2.0  # ratio of a signal combination to its noise, below which it counts as noise
_SIGNS = {-1: "negative", 0: "unloaded", 1: "positive"}
# Groups to hold out: the first kind whose removal leaves all load directions covered.
WHOLE_RUNS, HALF_RUNS = "whole runs", "either sign of the load in a run"
ONE_LOADS = "one load after the other"


@dataclass(frozen=True)
class HeldOutPredictions:
    """A model's predictions of loads by fits without their case, and the fit to all rows.

    errors (N, W): predicted minus applied, minus the case's mean if every case has its own zero. squares, freedom (B,):
    of each case, with the noise declared for or estimated by the fit without it; log_density: of all errors.
    """

    fit: Calibration
    errors: NDArray
    squares: NDArray
    freedom: NDArray
    log_density: float

    @property
    def rms(self) -> NDArray:
        """Root mean square error (W,) of each component of the load."""
        return np.sqrt(np.mean(self.errors**2, 0))


@dataclass(frozen=True)
class CalibrationChoice:
    """Held-out predictions of all contenders, the chosen one, and the reasons for excluded models, by name."""

    contenders: tuple[HeldOutPredictions, ...]
    choice: ContenderChoice
    refused: Mapping[str, str]

    @property
    def chosen(self) -> HeldOutPredictions:
        """The chosen contender."""
        return self.contenders[self.choice.chosen]


def hold_out(table: LoadTable, model: CalibrationModel) -> HeldOutPredictions:
    """Return the predictions of every load case by a fit to all others.

    Raises UndeterminedCalibrationError, naming the case, if the others do not determine the model. Raises ValueError
    if a case has only the row that determines its own zero.
    """
    alone = [case for case in table.cases if np.sum(table.case == case) < 2]
    if model.zero == "case" and alone:
        raise ValueError(f"case {alone[0]}: found 1 row, expected at least 2, because each case has its own zero")
    errors = np.empty_like(table.loads)
    squares, freedom, log_density = np.zeros(len(table.cases)), np.zeros(len(table.cases)), 0.0
    for index, case in enumerate(table.cases):
        out = table.case == case
        fit = _calibration_without_case(table.rows(~out), model, case)
        predicted = predicted_loads(fit, table.rows(out))
        miss = predicted.value - table.loads[out]
        spread = _spread(fit, predicted, table.rows(out))
        squares[index], freedom[index], density = _misfit(miss, spread, model.zero == "case")
        log_density += density
        errors[out] = miss - miss.mean(0) if model.zero == "case" else miss
    return HeldOutPredictions(fit_calibration(table, model), errors, squares, freedom, log_density)


def covariance_by_case(table: LoadTable, model: CalibrationModel) -> MatrixEstimate:
    """Return G_B with its covariance from the jackknife over whole load cases.

    Valid if rows of a case share an error of load, lever arm or mounting, which a fit assumes independent; slightly too
    large otherwise, and itself uncertain by 1 / sqrt(2 cases). Raises as `hold_out`.
    """
    values = []
    for case in table.cases:
        other_cases = table.rows(table.case != case)
        values.append(
            calibration_matrix(_calibration_without_case(other_cases, model, case), table.signal_cov).value.ravel()
        )
    matrix = calibration_matrix(fit_calibration(table, model), table.signal_cov)
    deviations = np.array(values) - np.mean(values, axis=0)
    count = len(values)
    return MatrixEstimate(matrix.value, (count - 1) / count * deviations.T @ deviations)


def predicted_loads(fit: Calibration, table: LoadTable) -> Wrenches:
    """Return the wrenches of a table's signals with declared errors; if none are declared, with those of a forward
    fit."""
    cov = table.signal_cov
    if cov is None:
        count = table.signals.shape[1]
        cov = fit.noise if fit.model.direction == "forward" else np.zeros((count, count))
    return wrenches(fit, table.signals, table.covariates, cov)


def choose_calibration(table: LoadTable, models: Sequence[CalibrationModel]) -> CalibrationChoice:
    """Return the choice by held-out load cases, with the same rule as for calibrations of mechanisms.

    A model is refuted if it misses held-out cases by more than the declared noise (without one: than the best
    contender's errors) and is worse than the best, case by case. Among the others, the one with the largest predictive
    log density (Geisser and Eddy 1979) is chosen, the simplest of equals. Models that the loads do not determine, or
    that cannot be inverted at held-out signals, are excluded; raises UndeterminedCalibrationError if none is left.
    """
    held, refused = _contending(table, models)
    undeclared = None if table.load_cov is not None else _smallest(held)
    contenders = [
        Contender(
            contender.squares if undeclared is None else _errors_by_case(table, contender.errors, undeclared),
            contender.freedom,
            contender.log_density,
            contender.fit.matrix.size + contender.fit.zeros.size,
            contender.fit.status == SolverStatus.CONVERGED,
        )
        for contender in held
    ]
    return CalibrationChoice(held, choose_model(contenders), refused)


def _contending(
    table: LoadTable, models: Sequence[CalibrationModel]
) -> tuple[tuple[HeldOutPredictions, ...], dict[str, str]]:
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


def _calibration_without_case(table: LoadTable, model: CalibrationModel, case: object) -> Calibration:
    try:
        return fit_calibration(table, model)
    except UndeterminedCalibrationError as error:
        raise UndeterminedCalibrationError(
            f"the other cases do not determine it without case {case}: {error}"
        ) from error


@dataclass(frozen=True)
class _Spread:
    """Covariance of predicted minus applied loads: ``own`` (N, W, W) of each row, and a common part U U^T.

    ``common``: U (N W, R), by the calibration and the zeros of runs. ``taken``: freedom that the zeros of runs take.
    """

    own: NDArray
    common: NDArray
    taken: int = 0

    def whitened(self, values: NDArray) -> tuple[NDArray, float]:
        """Return the product of the inverse covariance with columns of values (N W, K), and the log determinant. Uses
        the matrix inversion lemma, since rows outnumber the coefficients of a calibration. Raises LinAlgError if a
        row's own covariance is not positive."""
        rows, width = self.own.shape[:2]
        root = np.linalg.cholesky(self.own)
        inverse = np.linalg.inv(root)

        def apart(columns: NDArray) -> NDArray:
            split = columns.reshape(rows, width, -1)
            return np.asarray(np.swapaxes(inverse, 1, 2) @ (inverse @ split)).reshape(rows * width, -1)

        by_own = apart(self.common)
        inner = np.eye(self.common.shape[1]) + self.common.T @ by_own
        whitened_values = apart(values)
        whitened_values = whitened_values - by_own @ np.linalg.solve(inner, self.common.T @ whitened_values)
        log_det = 2.0 * float(np.log(np.einsum("nii->ni", root)).sum()) + float(np.linalg.slogdet(inner)[1])
        return whitened_values, log_det


def _spread(fit: Calibration, found: Wrenches, table: LoadTable) -> _Spread:
    """Return the covariance of predicted minus applied loads.

    The error of a run's zero is common to its loaded rows. Its unloaded rows scatter about it: they count as
    independent, with one row's freedom less.
    """
    rows, width = found.value.shape
    noise = np.zeros((width, width)) if table.load_cov is None else table.load_cov
    variance = found.own + noise
    by = np.einsum("nwr,nq->nwrq", found.gain, found.columns).reshape(rows * width, -1)
    common = by @ _factor(found.coefficients)
    if fit.model.direction == "direct" and (fit.model.estimator == "least squares" or table.load_cov is None):
        # residuals include the errors of signals and zeros
        return _Spread(np.broadcast_to(fit.noise, (rows, width, width)), common)
    if table.zeros is None or table.zero_share is None:
        return _Spread(variance, common)
    member = (table.zeros[:, None] == np.unique(table.zeros)) * table.zero_share[:, None]
    of_zeros = np.einsum("ng,nwv->nwgv", member, np.stack([_factor(one) for one in found.own]))
    is_unloaded = (table.zero_share == 0.0) & np.isin(table.zeros, table.zeros[table.zero_share > 0.0])
    taken = width * len(np.unique(table.zeros[is_unloaded]))
    return _Spread(variance, np.hstack([common, of_zeros.reshape(rows * width, -1)]), taken)


def _factor(covariance: NDArray) -> NDArray:
    """Return F (P, P) with F F^T equal to a covariance that may be singular."""
    try:
        return np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        strength, axes = np.linalg.eigh(covariance)
        return np.asarray(axes * np.sqrt(np.maximum(strength, 0.0)))


def _misfit(miss: NDArray, spread: _Spread, own_zero: bool) -> tuple[float, float, float]:
    """Return chi-square, freedom and log density of errors (N, W), with or without a free zero. With too few rows to
    estimate the noise, most errors appear impossible and the density is zero."""
    rows, width = miss.shape
    zero = np.tile(np.eye(width), (rows, 1))
    try:
        solved, log_det = spread.whitened(np.column_stack([miss.ravel(), zero]))
    except np.linalg.LinAlgError:
        return float("inf"), float(miss.size), -float("inf")
    squares, freedom = float(miss.ravel() @ solved[:, 0]), float(miss.size - spread.taken)
    if own_zero:
        reported = zero.T @ solved[:, 1:]
        by_zero = zero.T @ solved[:, 0]
        squares -= float(by_zero @ np.linalg.solve(reported, by_zero))
        freedom -= width
        log_det += float(np.linalg.slogdet(reported)[1])
    return squares, freedom, -0.5 * (squares + log_det + freedom * float(np.log(2 * np.pi)))


def _smallest(held_out_predictions: Sequence[HeldOutPredictions]) -> NDArray:
    """Return the error covariance (W, W) of the contender with the smallest error volume. Only models with enough rows
    to estimate their noise count: errors of the others lie in few directions, and have zero volume."""
    reported = [prediction for prediction in held_out_predictions if np.isfinite(prediction.log_density)]
    if not reported:
        raise ValueError("found no model with fewer terms than rows, expected one, to estimate the noise")
    spreads = [row.errors.T @ row.errors / len(row.errors) for row in reported]
    return min(spreads, key=lambda spread: float(np.linalg.slogdet(spread)[1]))


def _errors_by_case(table: LoadTable, errors: NDArray, noise: NDArray) -> NDArray:
    """Return the chi-square (B,) of each case's errors (N, W) for one noise (W, W)."""
    rows = np.einsum("ni,ij,nj->n", errors, np.linalg.inv(noise), errors)
    return np.array([rows[table.case == case].sum() for case in table.cases])


@dataclass(frozen=True)
class SensorCalibrations:
    """All calibrations that the loads determine, the chosen one, and their held-out tests.

    ``left_out``: kind of groups held out, in words. matrices: G_B of each contender, with sigma from the fit; by_case:
    that of the chosen one from the jackknife over load cases. verification (W,): rms error of the chosen one in
    verification runs, NaN without any.
    """

    table: LoadTable
    choice: CalibrationChoice
    left_out: str
    matrices: tuple[MatrixEstimate, ...]
    by_case: MatrixEstimate
    verification: Array

    @property
    def chosen(self) -> Calibration:
        """Fit of the chosen model to all calibration runs."""
        return self.choice.chosen.fit

    @property
    def matrix(self) -> MatrixEstimate:
        """G_B of the chosen model."""
        return self.matrices[self.choice.choice.chosen]


def calibrations(recorded_loads: RecordedLoads) -> SensorCalibrations:
    """Return the fits and tests of all contenders; raises UndeterminedCalibrationError, naming missing data."""
    rows = ~recorded_loads.steps.held_out
    table, words = by_cases(recorded_loads, rows)
    choice = choose_calibration(table, contenders(recorded_loads))
    matrices = tuple(calibration_matrix(contender.fit, table.signal_cov) for contender in choice.contenders)
    by_case = covariance_by_case(table, choice.chosen.fit.model)
    return SensorCalibrations(table, choice, words, matrices, by_case, _verified(recorded_loads, choice.chosen.fit))


def contenders(recorded_loads: RecordedLoads) -> list[CalibrationModel]:
    """Return the candidate models: the printed formula, estimators that use noise, and terms that must improve
    predictions."""
    zero: Zero = "none" if recorded_loads.tared else "common"
    noisy_loads = bool((recorded_loads.load_sigma > 0.0).all())
    plain = CalibrationModel("weighted", "forward", zero=zero)
    models = [AS_PRINTED, CalibrationModel(zero=zero)]
    # with dependent channels a prior gives good predictions but an undetermined matrix
    models += [CalibrationModel(zero=zero, ridge=_RIDGE)] if recorded_loads.signal.shape[1] <= len(LOADS) else []
    models.append(plain)
    if noisy_loads:
        models += [replace(plain, direction="direct"), replace(plain, estimator="errors in both")]
    if recorded_loads.covariate_names:
        models += [replace(plain, drift=True), replace(plain, drift=True, gain=True)]
    models += [replace(plain, powers="squares"), CalibrationModel(zero=zero, powers="squares")]
    return list(dict.fromkeys([*models, CalibrationModel(zero=zero, powers="products")]))


def by_cases(recorded_loads: RecordedLoads, rows: Mask) -> tuple[LoadTable, str]:
    """Return the table grouped into the largest load cases that can be held out, and the kind of group.

    In order: runs; one sign of the load in a run; all readings of one load.
    """
    steps = recorded_loads.steps
    sign = np.sign(steps.load[np.arange(len(steps.run)), np.abs(steps.load).argmax(axis=1)]).astype(np.int64)
    runs = _named_runs(recorded_loads)
    halves = np.array([f"{run}, {_SIGNS[side]}" for run, side in zip(runs, sign, strict=True)])
    table = recorded_loads.table(rows, runs)
    _check(table)
    forward = CalibrationModel("weighted", "forward", zero="none" if recorded_loads.tared else "common")
    loads = np.unique(steps.load, axis=0, return_inverse=True)[1].ravel()
    for cases, words in ((runs, WHOLE_RUNS), (halves, HALF_RUNS)):
        try:
            hold_out(recorded_loads.table(rows, cases), forward)
        except UndeterminedCalibrationError:
            continue
        return recorded_loads.table(rows, cases), words
    return recorded_loads.table(rows, np.array([f"load {number}" for number in loads])), ONE_LOADS


def _named_runs(recorded_loads: RecordedLoads) -> NDArray:
    """Return the run (B,) of every step by name; several runs together if there are very many."""
    steps, met = recorded_loads.steps, np.unique(recorded_loads.steps.run)
    if len(met) <= _MOST_CASES:
        return np.array([f"run {steps.runs[number]}" for number in steps.run])
    group = np.searchsorted(met, steps.run) % _MOST_CASES
    return np.array([f"run {steps.runs[met[number]]} and others" for number in group])


def _check(table: LoadTable) -> None:
    """Raise UndeterminedCalibrationError, naming missing data, unless signals and loads determine a wrench. With
    more channels than components, as many of them as components must be independent."""
    channels, components = table.signals.shape[1], table.loads.shape[1]
    check_loads(table.loads, table.load_names)
    if channels < components:
        raise UndeterminedCalibrationError(
            f"found {channels} signal channels, expected {components} at least, one for each component of the wrench"
        )
    try:
        check_signals(table.signals, table.signal_cov, table.signal_names)
    except UndeterminedCalibrationError:
        noise = np.sqrt(np.diag(table.signal_cov)) if table.signal_cov is not None else np.ones(channels)
        strength = np.linalg.svd(table.signals / noise, compute_uv=False)
        if channels == components or strength[components - 1] <= _OVER_NOISE * np.sqrt(len(table.signals)):
            raise


def errors_by_run(recorded_loads: RecordedLoads, fitted: SensorCalibrations) -> Array:
    """Return the rms error (R, W) of every run that the chosen calibration was not fitted to, N and N m.

    These are the verification runs; without any, those of the calibration, each step by a fit without its case. Errors
    of one run share its zero, its mounting and often the direction of its load, so that a run counts once.
    """
    rows = recorded_loads.steps.held_out
    if rows.any():
        table = recorded_loads.table(rows, recorded_loads.steps.run)
        errors = predicted_loads(fitted.chosen, table).value - table.loads
    else:
        rows, errors = ~rows, fitted.choice.chosen.errors
    run = recorded_loads.steps.run[rows]
    return np.array([np.sqrt(np.mean(errors[run == number] ** 2, axis=0)) for number in np.unique(run)])


def _verified(recorded_loads: RecordedLoads, fit: Calibration) -> Array:
    """Return the root mean square error (W,) of the loads of verification runs."""
    rows = recorded_loads.steps.held_out
    if not rows.any():
        return np.full(recorded_loads.steps.load.shape[1], np.nan)
    table = recorded_loads.table(rows, recorded_loads.steps.run)
    return np.sqrt(np.mean((predicted_loads(fit, table).value - table.loads) ** 2, axis=0))
