"""Input of a sensor calibration: clean signals with their loads, tared if runs have separate zeros."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.arrays import Array
from truing.estimation.interferometry.recorded_steps import RecordedSteps
from truing.estimation.interferometry.run_curves import run_curves
from truing.estimation.interferometry.shared_inputs import SharedInput
from truing.estimation.sensor.load_table import GrossSignal, KeptSignal, RecordedLoads, zeros_of_runs
from truing.simulation.bench.causes.rows_exchanged import RowsExchanged, with_corrected_loads
from truing.stages.common.applied_findings import applied_findings
from truing.stages.common.manual_decisions import manual_decisions, without_excluded
from truing.stages.common.reading_arrays import LOAD_COLUMNS, load_steps

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign


MV = 1e-3
TEMPERATURES = ("material_temperature_c", "air_temperature_c")


def recorded(tables: Mapping[str, pa.Table], settings: Campaign) -> RecordedLoads:
    """Signals of a campaign with the loads as recorded, or as changed by the applied findings.

    Raises ValueError if no step has a reading of every channel.
    """
    findings = applied_findings(tables)
    return _recorded(tables, settings, findings.text if findings.is_main else None)


def recorded_with_other_loads(tables: Mapping[str, pa.Table], settings: Campaign) -> RecordedLoads | None:
    """The same signals with the alternative loads; None if no finding changes a load."""
    findings = applied_findings(tables)
    with_findings = _recorded(tables, settings, findings.text)
    if not with_findings.causes:
        return None
    return _recorded(tables, settings, None) if findings.is_main else with_findings


def recorded_elsewhere(
    tables: Mapping[str, pa.Table], settings: Campaign, model: str | None, tared: bool
) -> RecordedLoads:
    """Signals of another campaign of the same sensor; model: persistent effects that change its loads, if any.

    tared: whether signals count from each run's unloaded readings. Raises ValueError as `recorded`.
    """
    return _recorded(tables, settings, model, elsewhere=True, tared=tared)


def _recorded(
    tables: Mapping[str, pa.Table],
    settings: Campaign,
    model: str | None,
    *,
    elsewhere: bool = False,
    tared: bool | None = None,
) -> RecordedLoads:
    """Signals with the loads as recorded; with the text of a model, also with the loads by its effects."""
    steps = load_steps({name: tables[name] for name in ("signals", "readings") if name in tables})
    steps, out = without_excluded(steps, settings)
    steps = steps.subset(np.isfinite(steps.signal).all(axis=1) & (steps.signal.shape[1] > 0))
    if not len(steps.run):
        raise ValueError("no load step has a reading of every signal channel")
    exchanged = () if elsewhere else _exchanged(model, steps)
    plain, steps = steps.load, with_corrected_loads(steps, exchanged)
    signal = steps.signal / MV
    declared = settings.noise.signal_mv
    declared_range = np.full(signal.shape, np.nan if declared is None else declared)
    curves = run_curves(steps.load, steps.time_s, steps.run, signal, declared_range)
    by_person = manual_decisions(steps, settings.keep, "kept").signals
    is_rejected = curves.rejected & ~by_person
    is_accepted = np.asarray(~is_rejected.any(axis=1))
    sigma = np.full(signal.shape[1], declared) if declared is not None else np.nanmedian(curves.sigma, axis=0)
    covariate, names = _covariates(steps, settings.mechanism.reference_temperature_c)
    zero, apart = zeros_of_runs(steps, signal, sigma, covariate, is_accepted)
    apart = apart if tared is None else tared
    subset = steps.subset(is_accepted)
    noise = settings.noise
    load, causes = _acting(model, subset)
    return RecordedLoads(
        subset,
        load,
        (*dict.fromkeys(f"{cause.id} of {cause.subject}" for cause in exchanged), *causes),
        (load != plain[is_accepted]).any(axis=1),
        (signal - zero[steps.run] if apart else signal)[is_accepted],
        sigma,
        np.repeat([noise.load_n, noise.load_nm], 3),
        covariate[is_accepted],
        names,
        apart,
        tuple(
            GrossSignal(
                steps.runs[steps.run[b]],
                int(steps.step[b]),
                steps.signals[k],
                float(curves.residual[b, k] / curves.sigma[b, k]),
            )
            for b, k in np.argwhere(is_rejected)
        ),
        tuple(kept for shared in curves.shared for kept in _kept_signals(steps, shared)),
        int(out.signals.any(axis=1).sum()),
    )


def _kept_signals(steps: RecordedSteps, shared: SharedInput) -> Iterator[KeptSignal]:
    """Yield the signals of one effect that look like gross errors."""
    follows = shared.follows if shared.run is None else f"run {steps.runs[shared.run]}"
    for row, deviation in zip(shared.rows.tolist(), shared.deviation.tolist(), strict=True):
        where = steps.runs[steps.run[row]], int(steps.step[row]), steps.signals[shared.channel]
        yield KeptSignal(*where, deviation, follows, shared.is_predicted, shared.p_value)


def _exchanged(model: str | None, steps: RecordedSteps) -> tuple[RowsExchanged, ...]:
    """Exchanges of loads in an extended model, for existing rows."""
    from truing.simulation.bench.extended_model import read_sensor

    names = set(zip([steps.runs[run] for run in steps.run], steps.step.tolist(), strict=True))
    causes = () if model is None else read_sensor(model).causes
    return tuple(cause for cause in causes if isinstance(cause, RowsExchanged) and names.issuperset(cause.rows))


def _acting(model: str | None, steps: RecordedSteps) -> tuple[Array, tuple[str, ...]]:
    """Wrenches (B, 6) that act by an extended model, and the causes that make them differ from the recorded ones."""
    from truing.simulation.bench.extended_model import acting_wrenches, drives, read_sensor
    from truing.simulation.bench.known_readings import ReadingConditions

    if model is None:
        return steps.load, ()
    extended = read_sensor(model)
    causes = tuple(f"{cause.id} of {cause.subject or 'all loads'}" for cause in drives(extended))
    if not causes:
        return steps.load, ()
    known = {name: values for name, values in steps.covariates.items() if np.isfinite(values).all()}
    runs = np.array(steps.runs)[steps.run]
    conditions = ReadingConditions(runs, steps.step, steps.time_s, steps.load, known)
    return acting_wrenches(extended, conditions), causes


def _covariates(steps: RecordedSteps, reference_c: float) -> tuple[Array, tuple[str, ...]]:
    """Temperature minus its reference (B, 1), if recorded and varying."""
    for name in TEMPERATURES:
        values = steps.covariates.get(name)
        if values is not None and np.isfinite(values).all() and np.ptp(values) > 0.0:
            return (values - reference_c)[:, None], (name.removesuffix("_c"),)
    return np.empty((len(steps.run), 0)), ()


def ranges_of(settings: Campaign, recorded_loads: RecordedLoads) -> np.ndarray:
    """Range (6,) of every axis by [loading], else its largest load; NaN if never loaded."""
    largest = np.abs(recorded_loads.steps.load).max(axis=0)
    stated = [getattr(settings.loading, name) for name in LOAD_COLUMNS]
    return np.array(
        [
            stated_range or (largest_reading if largest_reading > 0.0 else np.nan)
            for stated_range, largest_reading in zip(stated, largest, strict=True)
        ]
    )
