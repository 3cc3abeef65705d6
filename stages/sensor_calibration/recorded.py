"""What a calibration of a sensor begins with: clean signals beside loads, tared where runs have zeros of their own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stages.common.overruled import decided, without_excluded
from stages.common.reading_arrays import LOADS, RecordedSteps, load_steps
from stages.sensor.exchanged_rows import exchanged_rows, put_right
from truing.estimation.interferometry.run_curves import run_curves
from truing.estimation.sensor.load_table import LoadTable, load_table

if TYPE_CHECKING:
    import pyarrow as pa

    from schemas.campaign import Campaign

Array = NDArray[np.float64]

MV = 1e-3
_UNLIKELY = 1e-3  # of zeros that differ so much from run to run by noise alone
TEMPERATURES = ("material_temperature_c", "air_temperature_c")


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


def recorded(tables: Mapping[str, pa.Table], settings: Campaign) -> Recorded:
    """The signals of a campaign; raises ValueError where no step has a reading of every channel."""
    steps = load_steps({name: tables[name] for name in ("signals", "readings") if name in tables})
    steps, out = without_excluded(steps, settings)
    steps = steps.chosen(np.isfinite(steps.signal).all(axis=1) & (steps.signal.shape[1] > 0))
    if not len(steps.run):
        raise ValueError("no load step has a reading of every signal channel")
    exchanged = exchanged_rows(steps, ~steps.held_out)
    steps = put_right(steps, exchanged)
    signal = steps.signal / MV
    declared = settings.noise.signal_mv
    given = np.full(signal.shape, np.nan if declared is None else declared)
    curves = run_curves(steps.load, steps.time_s, steps.run, signal, given)
    by_person = decided(steps, settings.keep, "kept").signals
    good = np.asarray(~(curves.rejected & ~by_person).any(axis=1))
    sigma = np.full(signal.shape[1], declared) if declared is not None else np.nanmedian(curves.sigma, axis=0)
    covariate, names = _covariates(steps, settings.mechanism.reference_temperature_c)
    zero, apart = _zeros(steps, signal, sigma, covariate, good)
    kept = steps.chosen(good)
    noise = settings.noise
    load, causes = _acting(tables, kept)
    return Recorded(
        kept,
        load,
        causes,
        (signal - zero[steps.run] if apart else signal)[good],
        sigma,
        np.repeat([noise.load_n, noise.load_nm], 3),
        covariate[good],
        names,
        apart,
        int((~good).sum()),
        int(out.signals.any(axis=1).sum()),
        len({row for one in exchanged for row in one.rows}),
    )


def _zeros(
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


def _acting(tables: Mapping[str, pa.Table], steps: RecordedSteps) -> tuple[Array, tuple[str, ...]]:
    """The wrenches (B, 6) that act by the extended model, and its causes that make them differ from what is written."""
    from truing.simulation.bench.extended_sensor import acting_wrenches, drives
    from truing.simulation.bench.known_readings import ReadingConditions
    from truing.simulation.bench.sensor_text import read_sensor

    text = tables.get("model")
    if not isinstance(text, str):
        return steps.load, ()
    extended = read_sensor(text)
    causes = tuple(f"{cause.id} of {cause.subject or 'all loads'}" for cause in drives(extended))
    if not causes:
        return steps.load, ()
    known = {name: values for name, values in steps.covariates.items() if np.isfinite(values).all()}
    runs = np.array(steps.runs)[steps.run]
    conditions = ReadingConditions(runs, steps.step, steps.time_s, steps.load, known)
    return acting_wrenches(extended, conditions), causes


def _covariates(steps: RecordedSteps, reference_c: float) -> tuple[Array, tuple[str, ...]]:
    """The temperature less its reference (B, 1), where one was recorded and moved."""
    for name in TEMPERATURES:
        values = steps.covariates.get(name)
        if values is not None and np.isfinite(values).all() and np.ptp(values) > 0.0:
            return (values - reference_c)[:, None], (name.removesuffix("_c"),)
    return np.empty((len(steps.run), 0)), ()
