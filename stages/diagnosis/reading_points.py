"""From a run's tables to what the diagnosis compares where loads are applied: readings and signals of load steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.load_run import zeros_of_runs
from truing.estimation.interferometry.recorded_steps import CHANNELS, LOADS, READING_SI, RecordedSteps
from truing.inference.observations import Epochs, Frames, Observations
from truing.simulation.bench.causes.rows_exchanged import RowsExchanged, exchanged_rows
from truing.simulation.bench.known_readings import KnownReadings, ReadingConditions, SignalGains, Zeros, zeros_of
from truing.simulation.bench.model import ReadingModel
from truing.simulation.bench.six_upur.influence import influence_matrix
from truing.simulation.bench.six_upur.uncertain_sensor import UncertainSensor
from truing.stages.common.declared_optics import declared_optics
from truing.stages.common.overruled import decided, excluded_words, without_excluded
from truing.stages.common.reading_arrays import load_steps
from truing.stages.diagnosis.mechanism_points import Gathered
from truing.stages.diagnosis.shown import Channels
from truing.stages.diagnosis.signal_knowledge import scatter_of_signals, simulated_sensor, told_by_readings

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign

Array = NDArray[np.float64]

_FEWEST_STEPS = 6
_MILLIVOLT = 1e-3
_MOST_LACKING = 0.1  # of a column, that neighbours in time tell
# How far a gain that nobody declared may lie from the first guess at it.
_WIDE = 10.0


def reading_model(tables: Mapping[str, pa.Table], settings: Campaign) -> ReadingModel:
    """Return the plain simulation at all load steps; raises ValueError, saying why, where there is none."""
    steps = load_steps(tables)
    sensor = simulated_sensor(tables, settings, steps)
    sigma, _ = _noise(steps, settings, ())
    points, seen = _points(steps, sigma)
    told = seen.any(1) & np.isfinite(steps.time_s)
    return ReadingModel(_known(sensor, steps, points, seen, sigma, told, settings), _conditions(steps, told))


def gather_readings(tables: Mapping[str, pa.Table], settings: Campaign) -> Gathered:
    """Return what the diagnosis compares; raises ValueError, saying why, where the campaign does not hold it."""
    steps, out = without_excluded(load_steps(tables), settings)
    sensor = simulated_sensor(tables, settings, steps)
    exchanged = told_by_readings(exchanged_rows(steps, ~steps.held_out), steps, sensor)
    sigma, words = _noise(steps, settings, exchanged)
    words += [said for said in (excluded_words(out),) if said]
    points, seen = _points(steps, sigma)
    kept = decided(steps, settings.keep, "kept").chosen
    # the load of a step that was left out was applied all the same
    told = (seen | out.chosen).any(1) & np.isfinite(steps.time_s)
    fitted, held = told & ~steps.held_out, told & steps.held_out
    if why := _why_too_little(steps, fitted, settings):
        raise ValueError(why)
    model = ReadingModel(_known(sensor, steps, points, seen, sigma, fitted, settings), _conditions(steps, fitted))
    units = (*(("um",) * 3), *(("arcsec",) * 3), *(("mV",) * steps.signal.shape[1]))
    return Gathered(
        model,
        replace(_poses(steps, points, seen, sigma, fitted), kept=kept[fitted]),
        replace(_poses(steps, points, seen, sigma, held), kept=kept[held]) if held.any() else None,
        "; ".join(words),
        None,
        exchanged,
        shown=Channels(
            units,
            np.concatenate([READING_SI, np.full(steps.signal.shape[1], _MILLIVOLT)]),
            np.arange(len(units)) >= len(CHANNELS),
        ),
    )


def why_no_diagnosis_of_readings(tables: Mapping[str, pa.Table], settings: Campaign) -> str:
    """Why readings and signals cannot be held against a simulation, told without a fit; empty where they can."""
    steps, out = without_excluded(load_steps(tables), settings)
    try:
        simulated_sensor(tables, settings, steps)
    except ValueError as why:
        return str(why)
    if unknown := _without_noise(steps):
        return unknown
    moved = np.isfinite(steps.reading)
    signal = np.isfinite(steps.signal) & (settings.noise.signal_mv is not None or not moved.any())
    told = (np.concatenate([moved, signal], 1) | out.chosen).any(1) & np.isfinite(steps.time_s)
    return _why_too_little(steps, told & ~steps.held_out, settings)


def _without_noise(steps: RecordedSteps) -> str:
    declared = np.where(np.isfinite(steps.reading), steps.sigma, 1.0)
    unknown = [CHANNELS[k] for k in np.flatnonzero(~np.isfinite(declared).all(0))]
    return f"needs the noise of {', '.join(unknown)}: noise.linear_um, noise.angular_arcsec" if unknown else ""


def _why_too_little(steps: RecordedSteps, fitted: NDArray[np.bool_], settings: Campaign) -> str:
    """Why so many steps, with such loads, tell nothing; empty where they do."""
    if fitted.sum() < _FEWEST_STEPS:
        return f"needs at least {_FEWEST_STEPS} load steps with readings, found {int(fitted.sum())}"
    if not (settings.signals.zero_mv is not None and steps.signal.size) and not _loads_change(steps, fitted):
        tared = "or signals tared before each run: [signals] zero_mv"
        return f"needs loads that change within a run, whose zero is free, {tared}"
    return ""


def _loads_change(steps: RecordedSteps, rows: NDArray[np.bool_]) -> bool:
    """Whether any run has steps of different loads."""
    first = {run: np.flatnonzero(steps.run == run)[0] for run in np.unique(steps.run)}
    return bool(np.any(steps.load[rows] != steps.load[[first[run] for run in steps.run[rows]]]))


def _noise(steps: RecordedSteps, settings: Campaign, exchanged: tuple[RowsExchanged, ...]) -> tuple[Array, list[str]]:
    """One standard deviation (B, K) of every channel, m, rad, V; NaN for signals whose noise is not declared.

    Where there is nothing but signals, that is taken from their scatter.
    """
    declared = np.where(np.isfinite(steps.reading), steps.sigma, 1.0)
    if why := _without_noise(steps):
        raise ValueError(why)
    signal = settings.noise.signal_mv
    own = np.full(steps.signal.shape, np.nan if signal is None else signal * _MILLIVOLT)
    if signal is None and not np.isfinite(steps.reading).any():
        scatter = scatter_of_signals(steps, ~steps.held_out, exchanged)
        return np.concatenate([declared, np.broadcast_to(scatter, own.shape)], 1), []
    words = ["signals, whose noise is not declared"] if signal is None and steps.signal.size else []
    return np.concatenate([declared, own], 1), words


def _points(steps: RecordedSteps, sigma: Array) -> tuple[Array, NDArray[np.bool_]]:
    values = np.concatenate([steps.reading, steps.signal], 1)
    seen = np.isfinite(values) & np.isfinite(sigma)
    return np.where(seen, values, 0.0), seen


def _known(
    sensor: UncertainSensor,
    steps: RecordedSteps,
    points: Array,
    seen: NDArray[np.bool_],
    sigma: Array,
    fitted: NDArray[np.bool_],
    settings: Campaign,
) -> KnownReadings:
    typical = np.array(
        [np.median(own[there]) if there.any() else 1.0 for own, there in zip(sigma.T, seen.T, strict=True)]
    )
    noise = settings.noise
    return KnownReadings(
        sensor,
        (*CHANNELS, *steps.signals),
        typical,
        largest_loads(steps, settings),
        np.array([noise.load_n] * 3 + [noise.load_nm] * 3),
        _zeros(steps, seen, fitted, typical, settings.signals.zero_mv),
        _gains(sensor, steps, seen[:, len(CHANNELS) :] & fitted[:, None], settings),
        settings.interferometer.wavelength_nm * 1e-9,
        settings.mechanism.reference_temperature_c,
        declared_optics(settings.interferometer),
    )


def largest_loads(steps: RecordedSteps, settings: Campaign) -> Array:
    """The largest load (6,) of each axis, N and N m: that of [loading], else the largest applied; 1 where none was."""
    declared = [getattr(settings.loading, name) for name in ("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm")]
    applied = np.abs(steps.load).max(0)
    return np.array([given or (found if found > 0.0 else 1.0) for given, found in zip(declared, applied, strict=True)])


def _zeros(
    steps: RecordedSteps, seen: NDArray[np.bool_], fitted: NDArray[np.bool_], typical: Array, tared_mv: float | None
) -> Zeros:
    """The zeros of runs, as uncertain as their starts show; those of signals are free, unless each run was tared."""
    found = zeros_of(_labels(steps)[fitted], seen[fitted], typical, signals=steps.signal.shape[1])
    noise = typical[: len(CHANNELS)]
    spread = zeros_of_runs(steps, steps.reading, noise).spread(noise)
    place = {label: number for number, label in enumerate(np.array(steps.runs).tolist())}
    own = np.flatnonzero(found.channel < len(CHANNELS))
    sigma = found.sigma.copy()
    sigma[own] = spread[[place[label] for label in found.run[own].tolist()], found.channel[own]]
    found = replace(found, sigma=sigma)
    if tared_mv is None:
        return found
    signal = found.channel >= len(CHANNELS)
    return replace(found, sigma=np.where(signal, tared_mv * _MILLIVOLT, found.sigma), known=found.known | signal)


def _gains(sensor: UncertainSensor, steps: RecordedSteps, seen: NDArray[np.bool_], settings: Campaign) -> SignalGains:
    """What is known of the signals' gains: by leg where there is a channel for each, else by load."""
    count = seen.shape[1]
    if not seen.any():
        return SignalGains.none() if not count else SignalGains(np.zeros((count, 6)), np.ones((count, 6)), False)
    if sensor.joints is None or count != len(LOADS):
        rows = np.stack([_slopes(steps.load, steps.signal[:, j], steps.run, seen[:, j]) for j in range(count)])
        return SignalGains(rows, _wide(rows, axis=1), False)
    declared, tolerance = settings.signals.sensitivity_mv_per_n, settings.signals.sensitivity_tolerance
    if declared is not None:
        gains = np.broadcast_to(np.asarray(declared, float) * _MILLIVOLT, (count,)).copy()
        return SignalGains(gains, np.abs(gains) * max(tolerance or 0.0, 1e-6), True)
    columns = np.linalg.solve(influence_matrix(sensor.joints), steps.load.T).T[..., None]
    own = [_slopes(columns[:, j], steps.signal[:, j], steps.run, seen[:, j])[0] for j in range(count)]
    gains = np.array(own)
    return SignalGains(gains, _wide(gains), False)


def _wide(values: Array, axis: int | None = None) -> Array:
    size = np.abs(values).max(axis=axis, keepdims=axis is not None)
    return np.broadcast_to(_WIDE * np.where(size > 0.0, size, 1.0), values.shape).copy()


def _slopes(columns: Array, values: Array, run: NDArray[np.int64], seen: NDArray[np.bool_]) -> Array:
    """Slopes (W,) of values (B,) along columns (B, W), each run with a zero of its own."""
    at = np.unique(run[seen], return_inverse=True)[1]
    zeros = np.eye(int(at.max()) + 1)[at] if seen.any() else np.zeros((0, 0))
    whole = np.hstack([columns[seen], zeros])
    return np.asarray(np.linalg.lstsq(whole, values[seen], rcond=None)[0][: columns.shape[1]])


def _conditions(steps: RecordedSteps, rows: NDArray[np.bool_]) -> ReadingConditions:
    own = steps.chosen(rows)
    between = {name: _between(values, own.time_s) for name, values in own.covariates.items()}
    known = {name: values for name, values in between.items() if np.isfinite(values).all()}
    span = (float(np.nanmin(steps.time_s)), float(np.nanmax(steps.time_s)))
    return ReadingConditions(_labels(own), own.step, own.time_s, own.load, known, span)


def _between(values: Array, time_s: Array) -> Array:
    """A column (B,) with what a few steps lack, as those do that left signals alone, from their neighbours in time."""
    lacks = ~np.isfinite(values)
    if lacks.mean() > _MOST_LACKING or not np.isfinite(time_s).all():
        return values
    order = np.argsort(time_s)
    order = order[~lacks[order]]
    return np.where(lacks, np.interp(time_s, time_s[order], values[order]), values)


def _labels(steps: RecordedSteps) -> NDArray:
    """The names of the runs (B,) of steps."""
    return np.array(steps.runs)[steps.run]


def _poses(
    steps: RecordedSteps, points: Array, seen: NDArray[np.bool_], sigma: Array, rows: NDArray[np.bool_]
) -> Epochs:
    covariance = np.where(np.isfinite(sigma), sigma, 1.0)[rows] ** 2
    measured = Observations(points[rows][..., None], covariance[..., None, None], seen[rows])
    return Epochs(measured, _conditions(steps, rows), Frames.of_numbers(int(rows.sum())))
