"""Which calibrations of a sensor contend, which load cases are left out to judge them, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.recorded_steps import LOADS
from truing.estimation.sensor.calibrate import fit_calibration
from truing.estimation.sensor.calibration import Calibration, CalibrationModel, Zero
from truing.estimation.sensor.calibration_matrix import MatrixEstimate, calibration_matrix
from truing.estimation.sensor.determined import UndeterminedCalibrationError, check_loads, check_signals
from truing.estimation.sensor.held_out_loads import (
    CalibrationChoice,
    choose_calibration,
    covariance_by_case,
    hold_out,
    predicted_loads,
)
from truing.estimation.sensor.load_table import LoadTable
from truing.estimation.sensor.recorded_signals import Recorded

Array = NDArray[np.float64]

AS_PRINTED = CalibrationModel()
_RIDGE = 1.0
_MOST_CASES = 48  # more runs are left out some at a time
_OVER_NOISE = 2.0  # strength of a combination of signals over that of its noise, below which it is no signal
_SIGNS = {-1: "negative", 0: "unloaded", 1: "positive"}
# What is left out as a whole: the first of these without which no direction of loading is missing.
WHOLE_RUNS, HALF_RUNS = "whole runs", "either sign of the load in a run"
ONE_LOADS = "one load after the other"


@dataclass(frozen=True)
class SensorCalibrations:
    """Every calibration that the loads determine, the chosen one, and what the held-out loads say of them.

    ``left_out``: what was left out as a whole, in words. matrices: G_B of each contender, its sigma by the fit;
    by_case: that of the chosen one by leaving load cases out; as_written: what it is by the loads as they were written
    down, where the diagnosis has others. verification (W,): rms error of the chosen one in runs
    that nothing was fitted to, NaN without any.
    """

    table: LoadTable
    choice: CalibrationChoice
    left_out: str
    matrices: tuple[MatrixEstimate, ...]
    by_case: MatrixEstimate
    as_written: MatrixEstimate | None
    verification: Array

    @property
    def chosen(self) -> Calibration:
        """The fit of the chosen model to all calibration runs."""
        return self.choice.chosen.fit

    @property
    def matrix(self) -> MatrixEstimate:
        """Its G_B."""
        return self.matrices[self.choice.choice.chosen]


def calibrations(found: Recorded) -> SensorCalibrations:
    """Fit and judge every contender; raises UndeterminedCalibrationError, naming what is missing."""
    rows = ~found.steps.held_out
    table, words = by_cases(found, rows)
    choice = choose_calibration(table, contenders(found))
    matrices = tuple(calibration_matrix(one.fit, table.signal_cov) for one in choice.contenders)
    by_case = covariance_by_case(table, choice.chosen.fit.model)
    as_written = _as_written(found, table, choice.chosen.fit.model)
    return SensorCalibrations(table, choice, words, matrices, by_case, as_written, _verified(found, choice.chosen.fit))


def _as_written(found: Recorded, table: LoadTable, model: CalibrationModel) -> MatrixEstimate | None:
    if not found.causes:
        return None
    written = replace(table, loads=found.steps.load[~found.steps.held_out])
    return calibration_matrix(fit_calibration(written, model), table.signal_cov)


def contenders(found: Recorded) -> list[CalibrationModel]:
    """The printed formula, estimators that know of noise, and terms that held-out loads have to earn."""
    zero: Zero = "none" if found.tared else "common"
    noisy_loads = bool((found.load_sigma > 0.0).all())
    plain = CalibrationModel("weighted", "forward", zero=zero)
    models = [AS_PRINTED, CalibrationModel(zero=zero)]
    # a prior on channels that repeat one another predicts loads well, and leaves the matrix itself to noise
    models += [CalibrationModel(zero=zero, ridge=_RIDGE)] if found.signal.shape[1] <= len(LOADS) else []
    models.append(plain)
    if noisy_loads:
        models += [replace(plain, direction="direct"), replace(plain, estimator="errors in both")]
    if found.covariate_names:
        models += [replace(plain, drift=True), replace(plain, drift=True, gain=True)]
    models += [replace(plain, powers="squares"), CalibrationModel(zero=zero, powers="squares")]
    return list(dict.fromkeys([*models, CalibrationModel(zero=zero, powers="products")]))


def by_cases(found: Recorded, rows: NDArray[np.bool_]) -> tuple[LoadTable, str]:
    """The table with the largest load cases that can be left out: runs, else either sign of the load in a run, else
    all readings of one load."""
    steps = found.steps
    sign = np.sign(steps.load[np.arange(len(steps.run)), np.abs(steps.load).argmax(axis=1)]).astype(np.int64)
    runs = _named_runs(found)
    halves = np.array([f"{run}, {_SIGNS[way]}" for run, way in zip(runs, sign, strict=True)])
    table = found.table(rows, runs)
    _check(table)
    forward = CalibrationModel("weighted", "forward", zero="none" if found.tared else "common")
    loads = np.unique(steps.load, axis=0, return_inverse=True)[1].ravel()
    for cases, words in ((runs, WHOLE_RUNS), (halves, HALF_RUNS)):
        try:
            hold_out(found.table(rows, cases), forward)
        except UndeterminedCalibrationError:
            continue
        return found.table(rows, cases), words
    return found.table(rows, np.array([f"load {number}" for number in loads])), ONE_LOADS


def _named_runs(found: Recorded) -> NDArray:
    """The run (B,) of every step by name; where there are very many of them, some runs together."""
    steps, met = found.steps, np.unique(found.steps.run)
    if len(met) <= _MOST_CASES:
        return np.array([f"run {steps.runs[number]}" for number in steps.run])
    group = np.searchsorted(met, steps.run) % _MOST_CASES
    return np.array([f"run {steps.runs[met[number]]} and others" for number in group])


def _check(table: LoadTable) -> None:
    """Raise UndeterminedCalibrationError, naming what is missing, unless signals and loads determine a wrench.

    More channels than components repeat one another; then as many as there are components have to be independent.
    """
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


def _verified(found: Recorded, fit: Calibration) -> Array:
    """Root mean square error (W,) of the loads of verification runs."""
    rows = found.steps.held_out
    if not rows.any():
        return np.full(found.steps.load.shape[1], np.nan)
    table = found.table(rows, found.steps.run)
    return np.sqrt(np.mean((predicted_loads(fit, table).value - table.loads) ** 2, axis=0))
