"""Signals of a calibration beside their loads, counted from the zeros of runs where these differ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.recorded_steps import LOADS, RecordedSteps
from truing.estimation.sensor.load_table import LoadTable, load_table

Array = NDArray[np.float64]
_UNLIKELY = 1e-3  # of zeros that differ so much from run to run by noise alone


@dataclass(frozen=True)
class Recorded:
    """Steps with signals: those that calibrate, and those that verify.

    steps (B,), signal (B, C) mV, counted from each run's unloaded readings where ``tared``; sigma (C,) mV, declared or
    found; covariate (B, K). load (B, 6): as written down, or as it acts by the diagnosis' ``causes``, in words.
    left_out: steps with a gross error in a signal; excluded: those of which a person left one out; put_right: those
    whose loads were exchanged.
    """

    steps: RecordedSteps
    load: Array
    causes: tuple[str, ...]
    signal: Array
    sigma: Array
    load_sigma: Array
    covariate: Array
    covariate_names: tuple[str, ...]
    tared: bool
    left_out: int
    excluded: int
    put_right: int

    def table(self, rows: NDArray[np.bool_], case: NDArray) -> LoadTable:
        """Some steps as a table of calibration loads, with the case of every step (B,)."""
        return load_table(
            self.signal[rows],
            self.load[rows],
            case[rows],
            covariates=self.covariate[rows],
            signal_cov=np.diag(self.sigma**2),
            load_cov=np.diag(self.load_sigma**2),
            signal_names=self.steps.signals,
            load_names=LOADS,
            covariate_names=self.covariate_names,
        )


def zeros_of_runs(
    steps: RecordedSteps, signal: Array, sigma: Array, covariate: Array, good: NDArray[np.bool_]
) -> tuple[Array, bool]:
    """Mean unloaded signal (R, C) of every run, and whether runs differ in it by more than noise and temperature do.

    A run without unloaded reading has no zero to count from: then none is taken out of any.
    """
    from scipy.special import chdtrc

    unloaded = (steps.load == 0.0).all(axis=1) & good
    member = (steps.run[unloaded, None] == np.arange(len(steps.runs))).astype(float)
    count = member.sum(0)
    met = np.isin(np.arange(len(steps.runs)), steps.run)
    if (count[met] == 0.0).any() or met.sum() < 2:
        return np.zeros((len(steps.runs), signal.shape[1])), False
    share = member / np.maximum(count, 1.0)
    mean = share.T @ signal[unloaded]
    explained = np.column_stack([np.ones(len(count)), share.T @ covariate[unloaded]]) * np.sqrt(count)[:, None]
    weighed = mean * np.sqrt(count)[:, None]
    by_those, _, rank, _ = np.linalg.lstsq(explained, weighed, rcond=None)
    squares = float(np.sum(((weighed - explained @ by_those) / sigma) ** 2))
    freedom = (int(met.sum()) - int(rank)) * signal.shape[1]
    return mean, freedom > 0 and bool(chdtrc(freedom, squares) < _UNLIKELY)
