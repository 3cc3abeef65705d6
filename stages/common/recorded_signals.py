"""What a calibration of a sensor begins with: clean signals beside loads, tared where runs have zeros of their own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.arrays import Array
from truing.estimation.interferometry.recorded_steps import RecordedSteps
from truing.estimation.interferometry.run_curves import run_curves
from truing.estimation.sensor.load_table import Recorded, zeros_of_runs
from truing.simulation.bench.causes.rows_exchanged import exchanged_rows, put_right
from truing.stages.common.overruled import decided, without_excluded
from truing.stages.common.reading_arrays import LOAD_COLUMNS, load_steps

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign


MV = 1e-3
TEMPERATURES = ("material_temperature_c", "air_temperature_c")


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
    zero, apart = zeros_of_runs(steps, signal, sigma, covariate, good)
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


def _acting(tables: Mapping[str, pa.Table], steps: RecordedSteps) -> tuple[Array, tuple[str, ...]]:
    """The wrenches (B, 6) that act by the extended model, and its causes that make them differ from what is written."""
    from truing.simulation.bench.extended_model import acting_wrenches, drives, read_sensor
    from truing.simulation.bench.known_readings import ReadingConditions

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


def ranges_of(settings: Campaign, found: Recorded) -> np.ndarray:
    """The range (6,) of every axis: as [loading] has it, else its largest load; NaN where it was never loaded."""
    largest = np.abs(found.steps.load).max(axis=0)
    stated = [getattr(settings.loading, name) for name in LOAD_COLUMNS]
    return np.array([one or (own if own > 0.0 else np.nan) for one, own in zip(stated, largest, strict=True)])
