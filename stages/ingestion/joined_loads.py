"""Loads of one instrument next to signals of another: rows joined by their order, by run and step, or by time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index
from truing.formats.faultlog import FaultLog
from truing.formats.row_collection import CollectedRows, collect_rows
from truing.formats.shapes import LOADS_APART, WRENCH
from truing.formats.source import CampaignFiles
from truing.report.numbers import count_text, quantity
from truing.schemas.faults import Fault
from truing.stages.common.rows import Rows
from truing.stages.common.table_arrays import check_unique_keys, numbers, texts, without_rows

_LOADS = (*WRENCH, "load_axis", "load")
_TAKEN = (*_LOADS, "role")
_KEYS = 'joined_by = "step" or "time"'
_WAYS = f'joined_by = "rows", or a key: {_KEYS}'
_HALF = 0.5  # of the usual time between two rows of loads: a signal farther from each belongs to none
_WORDS = {"rows": "by their order", "step": "by run and step", "time": "by the nearest time"}


def with_joined_loads(
    signals: CollectedRows | None, source: CampaignFiles, log: FaultLog
) -> tuple[CollectedRows | None, pa.Table | None]:
    """Return the signals with the loads of [files.loads], and one row on how they were joined; None without such loads.

    Signals without a row of loads are left out and counted. Nothing is joined unless the mapping declares it.
    """
    loads = collect_rows(source, LOADS_APART, log, "run")
    if loads is None:
        return signals, None
    (way, *others) = {entry.joined_by for entry in source.entries(LOADS_APART.name)}
    if signals is None:
        log.add(Fault(loads.first_file, "signals of the same load steps: [files.signals]"))
        return None, None
    if both := [name for name in _LOADS if name in signals.table.column_names]:
        log.add(Fault(signals.first_file, "loads in one file: here, or in [files.loads]", value=", ".join(both)))
    if way is None or others:
        log.add(Fault("campaign.toml", f"how rows of loads belong to those of signals: {_WAYS}", column="files.loads"))
    if log:
        return None, None
    return _joined(signals, loads, way or "", source, log)


def _joined(
    signals: CollectedRows, loads: CollectedRows, way: str, source: CampaignFiles, log: FaultLog
) -> tuple[CollectedRows | None, pa.Table | None]:
    table = Rows("loads_joined")
    about: dict[str, float] = {}
    if way == "rows":
        place = _by_order(signals, loads, log)
    elif way == "step":
        place = _by_step(signals, loads, log)
    else:
        place, about = _by_time(signals, loads, source, log)
    if not log and (place < 0).all():
        log.add(Fault(loads.first_file, f"rows that belong to those of {signals.first_file}", column=_key(way)))
    if log:
        return None, None
    found = {"signal_rows": len(place), "load_rows": len(loads.table), "rows_matched": int((place >= 0).sum())}
    table.add(joined_by=way, **found, **about)
    return _with_loads(signals, loads, place), table.table()


def _with_loads(signals: CollectedRows, loads: CollectedRows, place: Index) -> CollectedRows:
    kept = without_rows(signals, place < 0, "signals without a row of loads")
    table = kept.table
    for name in (name for name in _TAKEN if name in loads.table.column_names):
        if name in table.column_names:
            table = table.drop_columns([name])
        table = table.append_column(name, loads.table.column(name).take(pa.array(place[place >= 0])))
    return replace(kept, table=table.combine_chunks())


def _by_order(signals: CollectedRows, loads: CollectedRows, log: FaultLog) -> Index:
    """Return for each signal row (N,) the same row of the loads; a fault if their numbers differ."""
    rows, other = len(signals.table), len(loads.table)
    if rows != other:
        expected = f"{count_text(rows, 'row')}, as in {signals.first_file}; else a key: {_KEYS}"
        log.add(Fault(loads.first_file, expected, value=count_text(other, "row")))
    return np.arange(rows)


def _by_step(signals: CollectedRows, loads: CollectedRows, log: FaultLog) -> Index:
    """Return for each signal row (N,) the row of loads with its step, and its run if the loads have runs; -1: none."""
    if "step" not in loads.table.column_names:
        log.add(Fault(loads.first_file, "a column step, to join rows by it", column="step"))
        return np.full(len(signals.table), -1)
    key = ("run", "step") if "run" in loads.table.column_names else ("step",)
    check_unique_keys(loads, log, *key, cure="each load once")
    known = {one: row for row, one in enumerate(_keys(loads, key))}
    return np.array([known.get(one, -1) for one in _keys(signals, key)], dtype=np.int64)


def _keys(rows: CollectedRows, key: tuple[str, ...]) -> list[tuple[str, ...]]:
    return list(zip(*(map(str, texts(rows, name)) for name in key), strict=True))


def _by_time(
    signals: CollectedRows, loads: CollectedRows, source: CampaignFiles, log: FaultLog
) -> tuple[Index, dict[str, float]]:
    """Return for each signal row (N,) the row of loads nearest in time, -1 for none within half the usual time between
    rows of loads; and the time by which the clocks may differ without another choice."""
    unmatched = np.full(len(signals.table), -1)
    for rows in (signals, loads):
        if "time_s" not in rows.table.column_names or not np.isfinite(numbers(rows, "time_s")).all():
            log.add(Fault(rows.first_file, "a time in every row, to join rows by it", column="time_s"))
    kinds = [{_kind(entry.time_format) for entry in source.entries(name)} for name in ("signals", LOADS_APART.name)]
    if kinds[0] != kinds[1]:
        kind = "times of one kind in both files: dates with a zone, dates without, or seconds"
        log.add(Fault(loads.first_file, kind, column="time_s"))
    if log:
        return unmatched, {}
    time, other = numbers(signals, "time_s"), numbers(loads, "time_s")
    order = np.argsort(other, kind="stable")
    sorted_times = other[order]
    between = np.diff(sorted_times)
    if not len(between) or not (between > 0.0).all():
        log.add(Fault(loads.first_file, "at least two rows, each at a time of its own", column="time_s"))
        return unmatched, {}
    middles = sorted_times[:-1] + 0.5 * between
    nearest = np.searchsorted(middles, time)
    apart = np.abs(time - sorted_times[nearest])
    is_near = apart <= _HALF * float(np.median(between))
    place = np.where(is_near, order[nearest], -1)
    return place, _clocks(time[is_near], middles, nearest[is_near], apart[is_near])


def _kind(time_format: str | None) -> str:
    """Return the kind of the times: "seconds", "dated" without a time zone, or "zoned"."""
    return "seconds" if time_format is None else "zoned" if "%z" in time_format else "dated"


def _clocks(time: Array, middles: Array, nearest: Index, apart: Array) -> dict[str, float]:
    """Return the largest difference of joined times, and the motions of the loads' clock that change no choice."""
    if not len(time):
        return {}
    edges = np.concatenate([[-np.inf], middles, [np.inf]])
    later, earlier = float((time - edges[nearest]).min()), float((edges[nearest + 1] - time).min())
    own = {"largest_apart_s": float(apart.max()), "later_s": later, "earlier_s": earlier}
    return {name: value for name, value in own.items() if np.isfinite(value)}


def _key(way: str) -> str | None:
    return {"step": "step", "time": "time_s"}.get(way)


def words_on_join(joined: pa.Table) -> str:
    """Return the numbers of joined rows of signals and loads, and the key by which they were joined."""
    (row,) = joined.to_pylist()
    text = f"loads of {row['rows_matched']:,} of {count_text(row['signal_rows'], 'row')} of signals"
    text += f" ({count_text(row['load_rows'], 'row')} of loads), joined {_WORDS[row['joined_by']]}"
    if row.get("largest_apart_s") is not None:
        text += f", at most {quantity(row['largest_apart_s'], 's')} apart"
    return text
