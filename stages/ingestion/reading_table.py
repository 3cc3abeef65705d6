"""Readings of an interferometer, or six-component displacements, as the long table that all stages share."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from truing.formats.faultlog import FaultLog
from truing.formats.gather import Gathered, gather
from truing.formats.shapes import DISPLACEMENT, INTERFEROMETER, MOTION, QUADRATURE, WRENCH
from truing.formats.source import CampaignFiles
from truing.schemas.faults import Fault
from truing.stages.common.sigma_bounds import check_sigma
from truing.stages.common.small_tables import SmallTable
from truing.stages.ingestion.corrected_readings import Corrections, corrected
from truing.stages.ingestion.gathered_columns import declared_missing, numbered, numbers, texts, unit_factors
from truing.stages.ingestion.load_columns import check_one_load, six_loads, with_known_loads
from truing.stages.ingestion.load_steps import check_once, check_roles, check_times
from truing.stages.ingestion.quadrature_table import lengths
from truing.stages.ingestion.step_samples import averaged, without_transit
from truing.stages.ingestion.tables import as_artifact, since_first

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.interferometer import Interferometer

Array = NDArray[np.float64]

CHANNELS = ("dx", "dy", "dz", "rx", "ry", "rz")
UNITS = {channel: "um" if channel.startswith("d") else "arcsec" for channel in CHANNELS}
_UM_PER_MM, _ARCSEC_PER_RAD = 1e3, 180.0 * 3600.0 / np.pi
_FURTHEST = {"um": 1e6, "arcsec": _ARCSEC_PER_RAD}  # a loaded platform moves by less than a metre, and a radian
_SAMPLES = "; of several samples of a step, [interferometer] average_samples = true takes the mean"
_EMPTY = "a number in every row; an empty cell has to be declared by missing"


@dataclass(frozen=True)
class _Readings:
    """N readings: the row of the raw table that each stands in, its channel, value and sigma, um or arcsec."""

    row: NDArray[np.int64]
    channel: NDArray[np.object_]
    value: Array
    sigma: Array
    corrections: Corrections = field(default_factory=Corrections)


@dataclass
class ReadingTable(SmallTable):
    """Readings, what became of the raw signals of every channel where there were any, and what was corrected."""

    channels: pa.Table | None = None
    corrections: Corrections = field(default_factory=Corrections)


def read_readings(source: CampaignFiles, settings: Any, log: FaultLog) -> ReadingTable | None:
    """The readings of interferometer.csv, those that displacement.csv or raw signals amount to; None where there are
    none of them."""
    own, six = source.entries("interferometer"), source.entries("displacement")
    raw = source.entries("quadrature")
    if own and six:
        log.add(Fault(six[0].paths[0], "no displacement beside readings of an interferometer: it replaces them"))
    if raw and (own or six):
        log.add(Fault(raw[0].paths[0], "no raw signals beside the readings that they become"))
    if six:
        _check_whole(settings.interferometer, log)
    shape = QUADRATURE if raw else INTERFEROMETER if own else DISPLACEMENT
    found, channels = gather(source, shape, log, "run"), None
    if found is None:
        return None
    if raw:
        made = lengths(found, settings.interferometer, log)
        if made is None:
            return None
        own, found, channels = raw, made.readings, made.channels
    elif own and settings.interferometer.average_samples and not log:
        found = averaged(found, log)
        if log:
            return None
    table = reading_table(found, settings, log, by_channel=bool(own))
    if table is None:
        return None
    if any(entry.time_format for entry in source.entries(shape.name)):
        table.table = since_first(table.table)
    return replace(table, channels=channels)


def _check_whole(optics: Interferometer, log: FaultLog) -> None:
    """Six components come as whole displacements: nothing of beams and frame is left to correct."""
    growing = any(getattr(optics.material, name) for name in CHANNELS[:3])
    for name, said in (("beams", not optics.beams.are_plain), ("material", growing)):
        if said:
            expected = "readings of an interferometer to correct: the six components of displacement.csv are corrected"
            log.add(Fault("campaign.toml", expected, column=f"interferometer.{name}"))


def reading_table(found: Gathered, settings: Any, log: FaultLog, *, by_channel: bool) -> ReadingTable | None:
    """The readings of a gathered table, a row per step and channel or a row per step; None where faults were noted."""
    found = with_known_loads(without_transit(found))
    key = ("run", "step", "channel") if by_channel else ("run", "step")
    check_once(found, log, *key, cure=_SAMPLES if by_channel else "")
    check_times(found, log)
    check_roles(found, log)
    loads = six_loads(found, settings.loading, log)
    check_one_load(found, numbered(found, "run", "step"), loads, log)
    readings = (_of_interferometer if by_channel else _of_displacement)(found, settings, log)
    left_out = dict(found.left_out)
    if gone := len(found.table) - len(np.unique(readings.row)):
        left_out[(found.first_file, "rows without any reading")] = gone
    if log:
        return None
    table = as_artifact("readings", _table(found, loads, readings))
    return ReadingTable(table, left_out, corrections=readings.corrections)


def _of_interferometer(found: Gathered, settings: Any, log: FaultLog) -> _Readings:
    channel, given = texts(found, "channel"), numbers(found, "reading")
    there = ~np.isnan(given)
    empty = np.asarray(found.table.column("reading").is_null())
    found.fault(log, empty & ~declared_missing(found), "reading", _EMPTY)
    value = given * unit_factors(found, "reading", "channel", UNITS, log)
    for name, unit in UNITS.items():
        found.fault(log, (channel == name) & (np.abs(value) > _FURTHEST[unit]), "reading", _size_expected(unit))
    value, corrections = corrected(found, value, settings.interferometer, log)
    declared = _declared(settings.noise)
    sigma = np.array([declared[UNITS.get(name, "um")] for name in channel], dtype=float)
    if "sigma" in found.table.column_names:
        own = numbers(found, "sigma") * unit_factors(found, "sigma", "channel", UNITS, log)
        for name, unit in UNITS.items():
            check_sigma(found, np.where(channel == name, own, np.nan), "sigma", unit, log)
        sigma = np.where(np.isnan(own), sigma, own)
    return _Readings(np.flatnonzero(there), channel[there], value[there], sigma[there], corrections)


def _declared(noise: Any) -> dict[str, float]:
    """One sigma of a reading, um and arcsec; NaN where none is declared."""
    return {"um": _or_nan(noise.linear_um), "arcsec": _or_nan(noise.angular_arcsec)}


def _or_nan(value: float | None) -> float:
    return np.nan if value is None else float(value)


def _of_displacement(found: Gathered, settings: Any, log: FaultLog) -> _Readings:
    """A component without a column, or without a value, was not measured."""
    given = [k for k, name in enumerate(MOTION) if name in found.table.column_names]
    if not given:
        log.add(Fault(found.first_file, f"at least one of the columns {', '.join(MOTION)}"))
    factor = {"um": _UM_PER_MM, "arcsec": _ARCSEC_PER_RAD}
    noise = settings.noise
    own = {"um": noise.displacement_mm, "arcsec": noise.rotation_rad}
    of_readings = _declared(noise)
    declared = {u: of_readings[u] / factor[u] if sigma is None else float(sigma) for u, sigma in own.items()}
    units = [UNITS[CHANNELS[k]] for k in given]
    value = np.full((len(found.table), len(given)), np.nan)
    for column, k in enumerate(given):
        unit = units[column]
        value[:, column] = numbers(found, MOTION[k]) * factor[unit]
        found.fault(log, np.abs(value[:, column]) > _FURTHEST[unit], MOTION[k], _size_expected(unit))
    row, at = np.nonzero(~np.isnan(value))
    sigma = np.array([declared[unit] * factor[unit] for unit in units])
    return _Readings(row, np.array(CHANNELS, object)[np.array(given, int)[at]], value[row, at], sigma[at])


def _size_expected(unit: str) -> str:
    return "less than a metre; is the unit right?" if unit == "um" else "less than a radian; is the unit right?"


def _table(found: Gathered, loads: Array, readings: _Readings) -> pa.Table:
    """The long table, ordered by run as they come, step and channel."""
    import pyarrow as pa

    run, step = numbered(found, "run")[readings.row], numbers(found, "step")[readings.row]
    channel = np.array([CHANNELS.index(name) for name in readings.channel], dtype=np.int64)
    order = np.lexsort((channel, step, run))
    row = readings.row[order]
    own = {"load_axis", "load", "reading", "channel", "sigma", *MOTION, *WRENCH}
    table = found.table.select([name for name in found.table.column_names if name not in own]).take(pa.array(row))
    for k, name in enumerate(WRENCH):
        table = table.append_column(name, pa.array(loads[row, k]))
    names = readings.channel[order]
    table = table.append_column("channel", pa.array(names.tolist(), pa.string()))
    table = table.append_column("reading", pa.array(readings.value[order]))
    table = table.append_column("unit", pa.array([UNITS[name] for name in names], pa.string()))
    return table.append_column("sigma", pa.array(readings.sigma[order], from_pandas=True))
