"""Readings of an interferometer from readings, raw signals or six-component displacements, as one long table."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import Array, Index
from truing.belonging.counted_times import times_from_order
from truing.estimation.interferometry.log_quality import saturated
from truing.estimation.interferometry.quadrature import (
    EllipseFit,
    corrected_phase,
    count_fringes,
    fit_ellipse,
    length_from_phase,
    phase_sigma,
    residual_radius,
    uncorrected_error,
)
from truing.estimation.interferometry.recorded_steps import CHANNELS
from truing.formats.faultlog import FaultLog
from truing.formats.raw_tables import DISPLACEMENT, INTERFEROMETER, MOTION, QUADRATURE, WRENCH
from truing.formats.row_collection import CollectedRows, collect_rows
from truing.formats.source import CampaignFiles
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.column import SIGMA_BOUNDS
from truing.schemas.faults import Fault
from truing.stages.common.table_arrays import (
    SmallTable,
    check_sigma,
    declared_missing,
    numbered,
    numbers,
    texts,
    unit_factors,
)
from truing.stages.ingestion.corrected_readings import Corrections, corrected
from truing.stages.ingestion.load_steps import (
    averaged,
    check_one_load,
    checked_steps,
)
from truing.stages.ingestion.tables import as_artifact, since_first

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.interferometer import Interferometer
    from truing.schemas.sections import Noise

LINEAR = ("dx", "dy", "dz")
_UM = 1e6  # per m
_TURN = np.linspace(0.0, 2.0 * np.pi, 360, endpoint=False)
_SIGNALS = (("signal_x", "signal_y"), ("phase_deg", "radius"))
UNITS = {channel: "um" if channel.startswith("d") else "arcsec" for channel in CHANNELS}
_UM_PER_MM, _ARCSEC_PER_RAD = 1e3, 180.0 * 3600.0 / np.pi
_FURTHEST = {"um": 1e6, "arcsec": _ARCSEC_PER_RAD}  # a loaded platform moves by less than a metre, and a radian
_SAMPLES = "; of several samples of a step, [interferometer] average_samples = true takes the mean"
_EMPTY = "a number in every row; an empty cell has to be declared by missing"


@dataclass(frozen=True)
class Lengths:
    """Readings from raw signals: one row per run, step and channel, and the ellipse of each channel."""

    readings: CollectedRows
    channels: pa.Table


def lengths(collected: CollectedRows, settings: Interferometer, log: FaultLog) -> Lengths | None:
    """Return vacuum lengths since the first step of each run, um; several samples of a step are averaged with their
    loads and times.

    One ellipse per channel serves all runs, fitted to samples within the converter's range. Fringes are counted from
    sample to sample within a run. None after a fault, which is reported.
    """
    signals = _signals(collected, settings.signal_step, log)
    channel = texts(collected, "channel")
    collected.fault(
        log, ~np.isin(channel, LINEAR), "channel", f"one of {', '.join(LINEAR)}: an angle takes two of them"
    )
    if log:
        return None
    run, step = numbered(collected, "run"), numbers(collected, "step")
    order = np.lexsort((np.arange(len(run)), step, run))  # samples of a step are in the order of their rows
    value, sigma = np.full((2, len(run)), np.nan)
    rows = []
    source = "column" if "sigma" in collected.table.column_names else "ellipse"
    for name in dict.fromkeys(channel):
        rows_of_channel = order[channel[order] == name]
        reported = _channel_lengths(signals[rows_of_channel], run[rows_of_channel], settings)
        value[rows_of_channel], sigma[rows_of_channel] = reported.length, reported.sigma
        rows.append({"channel": name, **reported.facts, "sigma_source": source})
        if not reported.fit.ok[0]:
            expected = f"signals of {name} that go round their ellipse: {reported.fit.status[0]}"
            log.add(Fault(collected.first_file, expected, column="signal_x"))
    if log:
        return None
    table = pa.Table.from_pylist(rows, schema=ARTIFACTS["quadrature"].arrow_schema(present=("sigma_source",)))
    readings = _by_step(collected, value, sigma, log)
    return None if log else Lengths(readings, table)


def _signals(collected: CollectedRows, step: float | None, log: FaultLog) -> Array:
    """Return signals (N, 2), given directly or as phase and radius; in whole converter steps if the step is known."""
    names_given = next(
        (names for names in _SIGNALS if all(name in collected.table.column_names for name in names)), None
    )
    if names_given is None:
        log.add(Fault(collected.first_file, "columns signal_x and signal_y, or phase_deg and radius"))
        return np.full((len(collected.table), 2), np.nan)
    first, second = (numbers(collected, name) for name in names_given)
    if names_given == _SIGNALS[1]:
        p = np.radians(first)
        first, second = second * np.cos(p), second * np.sin(p)
    signals = np.stack([first, second], -1)
    return signals if step is None else np.round(signals / step) * step


@dataclass(frozen=True)
class _ChannelLengths:
    """Results of one channel: ellipse, lengths (N,) in um since the first sample of each run, their sigma, and
    facts."""

    fit: EllipseFit
    length: Array
    sigma: Array
    facts: dict[str, object]


def _channel_lengths(signals: Array, run: Index, settings: Interferometer) -> _ChannelLengths:
    """Return the lengths of samples (N, 2) in time order, from runs (N,)."""
    cut = np.zeros(len(signals), dtype=bool)
    for side in (0, 1):
        cut[saturated(signals[:, side]).where] = True
    is_finite = np.asarray(np.isfinite(signals).all(-1))
    is_kept = is_finite & ~cut
    ellipse_fit, fit = fit_ellipse(signals), fit_ellipse(signals, is_kept[None])
    phase = corrected_phase(signals[None], fit.values)
    sigma = phase_sigma(fit, phase)[0]
    wavelength = 1e-9 * settings.wavelength_nm
    length, risk = np.full(len(signals), np.nan), 0.0
    for number in np.unique(run):
        rows_of_run = run == number
        count = count_fringes(phase[0, rows_of_run], sigma[rows_of_run])
        followed = length_from_phase(count.phase, wavelength, passes=settings.passes)
        length[rows_of_run] = _UM * (followed - followed[0])
        risk = max(risk, float(np.nan_to_num(count.risk).max()))
    per_rad = wavelength / settings.passes / (2.0 * np.pi)
    facts = {
        "samples": len(signals),
        **dict(zip(("x0", "y0", "amplitude_x", "amplitude_y", "lag_rad"), fit.values[0].tolist(), strict=True)),
        "radius_before": float(np.nanstd(np.linalg.norm(signals, axis=-1))),
        "radius_after": float(residual_radius(signals[None], ellipse_fit.values, is_finite[None])[0]),
        "radius_uncut": float(residual_radius(signals[None], fit.values, is_kept[None])[0]),
        "radius_mean": float(np.nanmean(np.linalg.norm(signals, axis=-1))),
        "cut_share": float(cut.mean()),
        "periodic_error_um": _UM * per_rad * float(np.abs(uncorrected_error(fit.values, _TURN)).max()),
        "miscount_risk": risk,
        "status": str(fit.status[0]),
    }
    return _ChannelLengths(fit, length, _UM * per_rad * sigma, facts)


def _by_step(collected: CollectedRows, value: Array, sigma: Array, log: FaultLog) -> CollectedRows:
    """Return one row per run, step and channel, with the mean reading of its samples and the sigma of one sample.

    Samples during a change of load only serve to count fringes. Readings are relative to the first step with a reading.
    """
    table = collected.table.append_column("reading", pa.array(value))
    if "sigma" not in table.column_names:
        table = table.append_column("sigma", pa.array(np.maximum(sigma, SIGMA_BOUNDS["um"][0])))
    made = averaged(replace(collected, table=table), log)
    reading = numbers(made, "reading")
    column = made.table.column_names.index("reading")
    table = made.table.set_column(column, "reading", pa.array(reading - reading[_first_of_run(made)]))
    made = replace(made, table=table)
    if "time_s" in table.column_names:
        return made
    _, once, at = np.unique(numbered(made, "run", "step"), return_index=True, return_inverse=True)
    run, step = numbered(made, "run")[once], numbers(made, "step")[once]
    time = times_from_order(run, step, np.full(len(once), np.nan))[at]
    return replace(made, table=table.append_column("time_s", pa.array(time)))


def _first_of_run(collected: CollectedRows) -> Index:
    """Return for each row (N,) the row of the first step with a reading, of the same run and channel."""
    pair = numbered(collected, "run", "channel")
    order = np.lexsort((numbers(collected, "step"), ~np.isfinite(numbers(collected, "reading")), pair))
    _, start = np.unique(pair[order], return_index=True)
    return np.asarray(order[start][pair])


@dataclass(frozen=True)
class _Readings:
    """N readings: row of the raw table, channel, value and sigma, um or arcsec."""

    row: Index
    channel: NDArray[np.object_]
    value: Array
    sigma: Array
    corrections: Corrections = field(default_factory=Corrections)


@dataclass
class ReadingTable(SmallTable):
    """Readings, results of the raw signals by channel if there are any, and the corrections made."""

    channels: pa.Table | None = None
    corrections: Corrections = field(default_factory=Corrections)


def read_readings(source: CampaignFiles, settings: Campaign, log: FaultLog) -> ReadingTable | None:
    """Return readings from interferometer.csv, displacement.csv or raw signals; None without any of these."""
    interferometer, six = source.entries("interferometer"), source.entries("displacement")
    raw = source.entries("quadrature")
    if interferometer and six:
        log.add(Fault(six[0].paths[0], "no displacement next to readings of an interferometer: it replaces them"))
    if raw and (interferometer or six):
        log.add(Fault(raw[0].paths[0], "no raw signals next to the readings that they become"))
    if six:
        _check_complete(settings.interferometer, log)
    shape = QUADRATURE if raw else INTERFEROMETER if interferometer else DISPLACEMENT
    rows, channels = collect_rows(source, shape, log, "run"), None
    if rows is None:
        return None
    if raw:
        made = lengths(rows, settings.interferometer, log)
        if made is None:
            return None
        interferometer, rows, channels = raw, made.readings, made.channels
    elif interferometer and settings.interferometer.average_samples and not log:
        rows = averaged(rows, log)
        if log:
            return None
    table = reading_table(rows, settings, log, by_channel=bool(interferometer))
    if table is None:
        return None
    if any(entry.time_format for entry in source.entries(shape.name)):
        table.table = since_first(table.table)
    return replace(table, channels=channels)


def _check_complete(optics: Interferometer, log: FaultLog) -> None:
    """Report declared beams or material: displacements in six components are corrected already."""
    growing = any(getattr(optics.material, name) for name in CHANNELS[:3])
    for name, is_stated in (("beams", not optics.beams.are_plain), ("material", growing)):
        if is_stated:
            expected = "readings of an interferometer to correct: the six components of displacement.csv are corrected"
            log.add(Fault("campaign.toml", expected, column=f"interferometer.{name}"))


def reading_table(
    collected: CollectedRows, settings: Campaign, log: FaultLog, *, by_channel: bool
) -> ReadingTable | None:
    """Return the readings of an assembled table with one row per step and channel, or per step; None after a fault."""
    key = ("run", "step", "channel") if by_channel else ("run", "step")
    collected, loads = checked_steps(collected, key, settings.loading, log, _SAMPLES if by_channel else "")
    check_one_load(collected, numbered(collected, "run", "step"), loads, log)
    readings = (_interferometer_readings if by_channel else _displacement_readings)(collected, settings, log)
    left_out = dict(collected.left_out)
    if missing_rows := len(collected.table) - len(np.unique(readings.row)):
        left_out[(collected.first_file, "rows without any reading")] = missing_rows
    if log:
        return None
    table = as_artifact("readings", _table(collected, loads, readings))
    return ReadingTable(table, left_out, corrections=readings.corrections)


def _interferometer_readings(collected: CollectedRows, settings: Campaign, log: FaultLog) -> _Readings:
    channel, readings = texts(collected, "channel"), numbers(collected, "reading")
    is_recorded = ~np.isnan(readings)
    empty = np.asarray(collected.table.column("reading").is_null())
    collected.fault(log, empty & ~declared_missing(collected), "reading", _EMPTY)
    value = readings * unit_factors(collected, "reading", "channel", UNITS, log)
    for name, unit in UNITS.items():
        collected.fault(log, (channel == name) & (np.abs(value) > _FURTHEST[unit]), "reading", _size_expected(unit))
    value, corrections = corrected(collected, value, settings.interferometer, log)
    declared = _declared_sigmas(settings.noise)
    sigma = np.array([declared[UNITS.get(name, "um")] for name in channel], dtype=float)
    if "sigma" in collected.table.column_names:
        sigmas = numbers(collected, "sigma") * unit_factors(collected, "sigma", "channel", UNITS, log)
        for name, unit in UNITS.items():
            check_sigma(collected, np.where(channel == name, sigmas, np.nan), "sigma", unit, log)
        sigma = np.where(np.isnan(sigmas), sigma, sigmas)
    return _Readings(
        np.flatnonzero(is_recorded), channel[is_recorded], value[is_recorded], sigma[is_recorded], corrections
    )


def _declared_sigmas(noise: Noise) -> dict[str, float]:
    """Return the declared sigma of a reading, um and arcsec; NaN if undeclared."""
    return {"um": _or_nan(noise.linear_um), "arcsec": _or_nan(noise.angular_arcsec)}


def _or_nan(value: float | None) -> float:
    return np.nan if value is None else float(value)


def _displacement_readings(collected: CollectedRows, settings: Campaign, log: FaultLog) -> _Readings:
    """Return readings from displacements; a component without a column or value was not measured."""
    components_given = [k for k, name in enumerate(MOTION) if name in collected.table.column_names]
    if not components_given:
        log.add(Fault(collected.first_file, f"at least one of the columns {', '.join(MOTION)}"))
    factor = {"um": _UM_PER_MM, "arcsec": _ARCSEC_PER_RAD}
    noise = settings.noise
    noise_of_unit = {"um": noise.displacement_mm, "arcsec": noise.rotation_rad}
    of_readings = _declared_sigmas(noise)
    declared = {u: of_readings[u] / factor[u] if sigma is None else float(sigma) for u, sigma in noise_of_unit.items()}
    units = [UNITS[CHANNELS[k]] for k in components_given]
    value = np.full((len(collected.table), len(components_given)), np.nan)
    for column, k in enumerate(components_given):
        unit = units[column]
        value[:, column] = numbers(collected, MOTION[k]) * factor[unit]
        collected.fault(log, np.abs(value[:, column]) > _FURTHEST[unit], MOTION[k], _size_expected(unit))
    row, at = np.nonzero(~np.isnan(value))
    sigma = np.array([declared[unit] * factor[unit] for unit in units])
    return _Readings(row, np.array(CHANNELS, object)[np.array(components_given, int)[at]], value[row, at], sigma[at])


def _size_expected(unit: str) -> str:
    return "less than a metre; is the unit right?" if unit == "um" else "less than a radian; is the unit right?"


def _table(collected: CollectedRows, loads: Array, readings: _Readings) -> pa.Table:
    """Return the long table, ordered by run as in the file, step and channel."""
    run, step = numbered(collected, "run")[readings.row], numbers(collected, "step")[readings.row]
    channel = np.array([CHANNELS.index(name) for name in readings.channel], dtype=np.int64)
    order = np.lexsort((channel, step, run))
    row = readings.row[order]
    used_columns = {"load_axis", "load", "reading", "channel", "sigma", *MOTION, *WRENCH}
    table = collected.table.select([name for name in collected.table.column_names if name not in used_columns]).take(
        row
    )
    for k, name in enumerate(WRENCH):
        table = table.append_column(name, pa.array(loads[row, k]))
    names = readings.channel[order]
    table = table.append_column("channel", pa.array(names.tolist(), pa.string()))
    table = table.append_column("reading", pa.array(readings.value[order]))
    table = table.append_column("unit", pa.array([UNITS[name] for name in names], pa.string()))
    return table.append_column("sigma", pa.array(readings.sigma[order], from_pandas=True))
