"""Input of a force sensor's signals: one row per load step, with loads and time."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index
from truing.belonging.counted_times import times_from_order
from truing.formats.faultlog import FaultLog
from truing.formats.raw_tables import SHOWN_WRENCH, SIGNALS, WRENCH
from truing.formats.row_collection import CollectedRows, collect_rows
from truing.formats.source import CampaignFiles
from truing.schemas.columns import COLUMNS
from truing.schemas.faults import Fault
from truing.stages.common.table_arrays import SmallTable, numbered, numbers, texts
from truing.stages.ingestion.joined_loads import with_joined_loads
from truing.stages.ingestion.load_steps import (
    averaged_signals,
    check_same_loads,
    checked_steps,
)
from truing.stages.ingestion.tables import as_artifact, since_first

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import SensorMechanism

SIGNAL = re.compile(r"v\d+_mv")
_SINGULAR = 1e12  # condition number of the leg forces' influence, N and N m
_PER_N = 1.0  # mV per N of a leg, where no sensitivity is declared


def read_signals(
    source: CampaignFiles, settings: Campaign, readings: pa.Table | None, log: FaultLog
) -> tuple[SmallTable | None, pa.Table | None]:
    """Return the signals, and how loads of another file were joined to them; each None if the campaign has none.

    Steps that the readings contain take their time from these.
    """
    rows = collect_rows(source, SIGNALS, log, "run")
    rows, joined = with_joined_loads(rows, source, log)
    table = None if rows is None else signal_table(rows, settings, readings, log)
    if table is not None and any(entry.time_format for entry in source.entries("signals")):
        table.table = since_first(table.table)
    return table, joined


def signal_table(
    collected: CollectedRows, settings: Campaign, readings: pa.Table | None, log: FaultLog
) -> SmallTable | None:
    """Return the signals of an assembled table with one row per step; None after a fault."""
    if settings.signals.average_samples:
        collected = averaged_signals(collected, settings.loading, log)
        if log:
            return None
    collected, loads = checked_steps(collected, ("run", "step"), settings.loading, log)
    if any(name in collected.table.column_names for name in SHOWN_WRENCH):
        collected = with_leg_signals(collected, settings, log)
        if log:
            return None
    _check_channels(collected, settings.signals.sensitivity_mv_per_n, log)
    same = _same_step(collected, readings)
    if readings is not None:
        known = np.column_stack([readings.column(name).to_numpy() for name in WRENCH])
        check_same_loads(collected, loads, _where_known(known, same), log)
    if log:
        return None
    time = _times(collected, readings, same)
    used_columns = {"load_axis", "load", "time_s", *WRENCH}
    table = collected.table.select([name for name in collected.table.column_names if name not in used_columns])
    table = _with_numbers(table, {"time_s": time, **{name: loads[:, k] for k, name in enumerate(WRENCH)}})
    order = np.lexsort((numbers(collected, "step"), numbered(collected, "run")))
    return SmallTable(as_artifact("signals", table.take(order)), dict(collected.left_out))


def _with_numbers(table: pa.Table, columns: dict[str, Array]) -> pa.Table:
    for name, values in columns.items():
        table = table.append_column(name, pa.array(values))
    return table


def _check_channels(collected: CollectedRows, sensitivity: float | tuple[float, ...] | None, log: FaultLog) -> None:
    names = [name for name in collected.table.column_names if SIGNAL.fullmatch(name)]
    wanted = [f"v{number + 1}_mv" for number in range(max(len(names), 1))]
    if sorted(names) != sorted(wanted) or not all(COLUMNS["signal"].matches(name) for name in wanted):
        expected = "signals in columns v1_mv, v2_mv, .. without a gap, up to v8_mv"
        log.add(Fault(collected.first_file, expected, value=", ".join(names) or None))
    if isinstance(sensitivity, tuple) and names and len(sensitivity) != len(names):
        expected = f"one number, or one for each of the {len(names)} signals of {collected.first_file}"
        log.add(
            Fault("campaign.toml", expected, column="signals.sensitivity_mv_per_n", value=f"{len(sensitivity)} numbers")
        )


def _same_step(collected: CollectedRows, readings: pa.Table | None) -> Index:
    """Return for each row (N,) the first row of the readings with the same run and step; -1 if there is none."""
    if readings is None:
        return np.full(len(collected.table), -1)
    first_row: dict[tuple[str, object], int] = {}
    columns = (readings.column(name).to_pylist() for name in ("run", "step"))
    for row, (run, step) in enumerate(zip(*columns, strict=True)):
        first_row.setdefault((str(run), step), row)
    step_keys = zip(texts(collected, "run"), texts(collected, "step"), strict=True)
    return np.array([first_row.get((str(run), step), -1) for run, step in step_keys], dtype=np.int64)


def _where_known(values: Array, same: Index) -> Array:
    """Return values (M, ...) of the readings at rows (N,); NaN for row -1."""
    known = np.array(values[same], dtype=float)
    known[same < 0] = np.nan
    return known


def _times(collected: CollectedRows, readings: pa.Table | None, same: Index) -> Array:
    times = (
        numbers(collected, "time_s")
        if "time_s" in collected.table.column_names
        else np.full(len(collected.table), np.nan)
    )
    if readings is not None and len(readings):
        reading_times = _where_known(readings.column("time_s").to_numpy(), same)
        times = np.where(np.isnan(reading_times), times, reading_times)
    return times_from_order(numbered(collected, "run"), numbers(collected, "step"), times)


def with_leg_signals(collected: CollectedRows, settings: Campaign, log: FaultLog) -> CollectedRows:
    """Return the table with signals v1_mv .. v6_mv from a displayed wrench: its leg forces times the sensitivity."""
    names = collected.table.column_names
    signals = [name for name in names if COLUMNS["signal"].matches(name)]
    if signals or any(name not in names for name in SHOWN_WRENCH):
        expected = f"either the signals of the legs, or all of {', '.join(SHOWN_WRENCH)}"
        log.add(
            Fault(collected.first_file, expected, value=", ".join([*signals, *(n for n in SHOWN_WRENCH if n in names)]))
        )
    if settings.mechanism.type != "6-upur":
        expected = '[mechanism] type = "6-upur": the geometry of the legs turns the shown wrench into their forces'
        log.add(Fault("campaign.toml", expected, column="mechanism.type", value=settings.mechanism.type))
    if log:
        return collected
    from truing.simulation.bench.six_upur.influence import influence_matrix
    from truing.stages.common.sensor_elements import sensor_joints

    G = influence_matrix(sensor_joints(cast("SensorMechanism", settings.mechanism)))
    if np.linalg.cond(G) > _SINGULAR:
        log.add(Fault("campaign.toml", "legs that carry every load, not parallel ones", column="mechanism.legs"))
        return collected
    shown = np.column_stack([numbers(collected, name) for name in SHOWN_WRENCH])
    sensitivity = np.broadcast_to(settings.signals.sensitivity_mv_per_n or _PER_N, 6)
    reported = np.linalg.solve(G, shown.T).T * sensitivity
    table = collected.table.select([name for name in names if name not in SHOWN_WRENCH])
    for leg in range(6):
        table = table.append_column(f"v{leg + 1}_mv", pa.array(reported[:, leg]))
    return replace(collected, table=table)
