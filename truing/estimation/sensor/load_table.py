"""Table of calibration loads: applied loads, signals relative to the zeros of runs, and the uncertainties of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Mask
from truing.estimation.interferometry.recorded_steps import LOADS, RecordedSteps

_UNLIKELY = 1e-3  # p-value of differences between zeros of runs, below which they are real

# Power of a signal combination relative to its noise, below which it counts as noise; and sigmas of the scatter of
# this noise in few rows.
_OVER_NOISE, _SIGMAS = 2.0, 6.0


@dataclass(frozen=True)
class LoadTable:
    """N rows of W applied loads (N, N m), C signals and K covariates minus their reference (such as T - T_ref, K).

    case (N,): load case or run of each row, held out as a whole. signal_cov (C, C), load_cov (W, W) or (N, W, W): error
    covariances of one row, None if not declared. zeros (N,): number of the run whose mean unloaded signals were
    subtracted from each row, and zero_share (N,): standard deviation of this mean over that of one signal, 0 for the
    unloaded rows themselves; None if nothing was subtracted.
    """

    signals: NDArray
    loads: NDArray
    case: NDArray
    covariates: NDArray = field(default_factory=lambda: np.empty((0, 0)))
    signal_cov: NDArray | None = None
    load_cov: NDArray | None = None
    signal_names: tuple[str, ...] = ()
    load_names: tuple[str, ...] = ()
    covariate_names: tuple[str, ...] = ()
    zeros: NDArray | None = None
    zero_share: NDArray | None = None

    def named(
        self,
        signals: Sequence[str] | None = None,
        loads: Sequence[str] | None = None,
        covariates: Sequence[str] | None = None,
    ) -> LoadTable:
        """Return the table with other names of its columns; None keeps those that it has.

        Raises ValueError for a wrong number of names, and for duplicate ones.
        """
        return replace(
            self,
            signal_names=_names(signals, self.signal_names, "signal"),
            load_names=_names(loads, self.load_names, "load"),
            covariate_names=_names(covariates, self.covariate_names, "covariate"),
        )

    @property
    def cases(self) -> NDArray:
        """Names of the load cases, sorted."""
        return np.unique(self.case)

    def rows(self, which: NDArray) -> LoadTable:
        """Return some rows, by mask or index."""
        cov = self.load_cov
        return replace(
            self,
            signals=self.signals[which],
            loads=self.loads[which],
            case=self.case[which],
            covariates=self.covariates[which],
            load_cov=cov[which] if cov is not None and cov.ndim == 3 else cov,
            zeros=None if self.zeros is None else self.zeros[which],
            zero_share=None if self.zero_share is None else self.zero_share[which],
        )


def load_table(
    signals: NDArray,
    loads: NDArray,
    case: NDArray | None = None,
    *,
    covariates: NDArray | None = None,
    signal_cov: NDArray | None = None,
    load_cov: NDArray | None = None,
) -> LoadTable:
    """Return a checked table; by default every row is its own case.

    Signals are called v1, v2, ..., loads fx to mz, covariates z1, z2, ...; `LoadTable.named` gives other names. Raises
    ValueError for shapes that do not agree, and for missing values, by row.
    """
    v, f = _matrix(signals, "signals"), _matrix(loads, "loads")
    z = np.empty((len(v), 0)) if covariates is None else _matrix(covariates, "covariates")
    cases = np.arange(len(v)) if case is None else np.asarray(case)
    if not len(v) == len(f) == len(z) == len(cases):
        raise ValueError(
            f"found {len(v)} rows of signals, {len(f)} of loads, {len(z)} of covariates, {len(cases)} cases"
        )
    return LoadTable(
        v,
        f,
        cases,
        z,
        _covariance(signal_cov, v.shape[1], len(v), "signal_cov"),
        _covariance(load_cov, f.shape[1], len(v), "load_cov"),
        tuple(f"v{i + 1}" for i in range(v.shape[1])),
        LOADS[: f.shape[1]],
        tuple(f"z{i + 1}" for i in range(z.shape[1])),
    )


def _matrix(values: NDArray, what: str) -> NDArray:
    array = np.asarray(values, float)
    if array.ndim != 2:
        raise ValueError(f"{what}: found shape {array.shape}, expected rows and columns")
    missing = np.flatnonzero(~np.isfinite(array).all(1))
    if len(missing):
        rows = ", ".join(str(i) for i in missing[:10]) + (", .." if len(missing) > 10 else "")
        raise ValueError(f"{what}: found no value in {len(missing)} rows (from 0: {rows}), expected numbers")
    return array


def _covariance(cov: NDArray | None, size: int, rows: int, what: str) -> NDArray | None:
    if cov is None:
        return None
    array = np.asarray(cov, float)
    if array.shape not in ((size, size), (rows, size, size)) or (array.ndim == 3 and what == "signal_cov"):
        raise ValueError(f"{what}: found shape {array.shape}, expected ({size}, {size})")
    return array


def _names(names: Sequence[str] | None, default: tuple[str, ...], what: str) -> tuple[str, ...]:
    channel_names = tuple(default if names is None else names)
    if len(channel_names) != len(default):
        raise ValueError(f"found {len(channel_names)} {what} names, expected {len(default)}")
    twice = [name for name in dict.fromkeys(channel_names) if channel_names.count(name) > 1]
    if twice:
        raise ValueError(f"found {what} {twice[0]!r} twice, expected different names")
    return channel_names


@dataclass(frozen=True)
class GrossSignal:
    """Gross error of a signal at one step of a run: its deviation from a smooth curve of the run, in sigmas."""

    run: int | str
    step: int
    signal: str
    deviation: float


@dataclass(frozen=True)
class KeptSignal(GrossSignal):
    """Signal that looks like a gross error, and is an effect of loads or runs: what it follows, and the p-value.

    is_predicted: nonlinear terms of the loads predict it; else other signals of its channel deviate alike there.
    """

    follows: str
    is_predicted: bool
    p_value: float


@dataclass(frozen=True)
class RecordedLoads:
    """Steps with signals, for calibration and for verification.

    steps (B,), signal (B, C) mV, relative to each run's unloaded readings if ``tared``; sigma (C,) mV, declared or
    estimated; covariate (B, K). load (B, 6): as recorded, or corrected by the diagnosed ``causes`` (in words); moved
    (B,): steps corrected by these. left_out: signals with a gross error, whose steps are left out; kept: signals that
    look like one and are an effect; excluded: steps that a person excluded at least partly.
    """

    steps: RecordedSteps
    load: Array
    causes: tuple[str, ...]
    moved: NDArray[np.bool_]
    signal: Array
    sigma: Array
    load_sigma: Array
    covariate: Array
    covariate_names: tuple[str, ...]
    tared: bool
    left_out: tuple[GrossSignal, ...]
    kept: tuple[KeptSignal, ...]
    excluded: int

    @property
    def steps_left_out(self) -> int:
        """Number of steps with a gross error in a signal."""
        return len({(one.run, one.step) for one in self.left_out})

    def table(self, rows: Mask, case: NDArray) -> LoadTable:
        """Return some steps as a table of calibration loads, with the case of every step (B,)."""
        table = load_table(
            self.signal[rows],
            self.load[rows],
            case[rows],
            covariates=self.covariate[rows],
            signal_cov=np.diag(self.sigma**2),
            load_cov=np.diag(self.load_sigma**2),
        )
        table = table.named(self.steps.signals, LOADS, self.covariate_names)
        if not self.tared:
            return table
        unloaded = (self.steps.load == 0.0).all(axis=1)
        count = np.bincount(self.steps.run[unloaded], minlength=len(self.steps.runs))[self.steps.run]
        share = np.where(unloaded, 0.0, 1.0 / np.sqrt(np.maximum(count, 1)))
        return replace(table, zeros=self.steps.run[rows], zero_share=share[rows])


def zeros_of_runs(
    steps: RecordedSteps, signal: Array, sigma: Array, covariate: Array, good: Mask
) -> tuple[Array, bool]:
    """Return the mean unloaded signal (R, C) of each run, and whether runs differ in it beyond noise and temperature.

    If a run has no unloaded reading, no zero is subtracted from any run.
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


def least_signal(rows: int) -> float:
    """Return the least length, in sigmas, of a signal combination over some rows that is more than noise."""
    return float(np.sqrt(rows * max(_OVER_NOISE, 1.0 + _SIGMAS * np.sqrt(2.0 / rows))))
