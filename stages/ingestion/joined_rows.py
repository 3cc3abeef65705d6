"""Rows of two tables that belong together: in the same order, by a key, or by the nearest time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index
from truing.formats.faultlog import FaultLog
from truing.formats.row_collection import CollectedRows
from truing.formats.source import CampaignFiles
from truing.report.numbers import count_text
from truing.schemas.faults import Fault
from truing.stages.common.table_arrays import check_unique_keys, numbers, texts, without_rows

_HALF = 0.5  # of the usual time between two rows of the others: a row farther from each belongs to none


def by_order(rows: CollectedRows, others: CollectedRows, keys: str, log: FaultLog) -> Index:
    """Return for each row (N,) the same row of the others; a fault if their numbers differ. keys: settings that join
    rows by a key."""
    count, count_of_others = len(rows.table), len(others.table)
    if count != count_of_others:
        expected = f"{count_text(count, 'row')}, as in {rows.first_file}; else a key: {keys}"
        log.add(Fault(others.first_file, expected, value=count_text(count_of_others, "row")))
    return np.arange(count)


def by_key(rows: CollectedRows, others: CollectedRows, key: tuple[str, ...], cure: str, log: FaultLog) -> Index:
    """Return for each row (N,) the row of the others with the same key, which they have once; -1: none."""
    if (column := key[-1]) not in others.table.column_names:
        log.add(Fault(others.first_file, f"a column {column}, to join rows by it", column=column))
        return np.full(len(rows.table), -1)
    check_unique_keys(others, log, *key, cure=cure)
    known = {one: row for row, one in enumerate(_keys(others, key))}
    return np.array([known.get(one, -1) for one in _keys(rows, key)], dtype=np.int64)


def _keys(rows: CollectedRows, key: tuple[str, ...]) -> list[tuple[str, ...]]:
    return list(zip(*(map(str, texts(rows, name)) for name in key), strict=True))


def check_clocks(
    rows: CollectedRows, others: CollectedRows, source: CampaignFiles, tables: Sequence[str], log: FaultLog
) -> None:
    """Report rows without a time, and times of two kinds in the files of two tables."""
    for table in (rows, others):
        if "time_s" not in table.table.column_names or not np.isfinite(numbers(table, "time_s")).all():
            log.add(Fault(table.first_file, "a time in every row, to join rows by it", column="time_s"))
    kinds = [{_kind(entry.time_format) for entry in source.entries(name)} for name in tables]
    if kinds[0] != kinds[1]:
        kind = "times of one kind in both files: dates with a zone, dates without, or seconds"
        log.add(Fault(others.first_file, kind, column="time_s"))


def _kind(time_format: str | None) -> str:
    """Return the kind of the times: "seconds", "dated" without a time zone, or "zoned"."""
    return "seconds" if time_format is None else "zoned" if "%z" in time_format else "dated"


def by_time(rows: CollectedRows, others: CollectedRows, log: FaultLog) -> tuple[Index, dict[str, float]]:
    """Return for each row (N,) the row of the others nearest in time, -1 for none within half the usual time between
    them; and the time by which the clocks may differ without another choice."""
    time, time_of_others = numbers(rows, "time_s"), numbers(others, "time_s")
    order = np.argsort(time_of_others, kind="stable")
    sorted_times = time_of_others[order]
    between = np.diff(sorted_times)
    if not len(between) or not (between > 0.0).all():
        log.add(Fault(others.first_file, "at least two rows, each at a time of its own", column="time_s"))
        return np.full(len(time), -1), {}
    middles = sorted_times[:-1] + 0.5 * between
    nearest = np.searchsorted(middles, time)
    apart = np.abs(time - sorted_times[nearest])
    is_near = apart <= _HALF * float(np.median(between))
    place = np.where(is_near, order[nearest], -1)
    return place, _clocks(time[is_near], middles, nearest[is_near], apart[is_near])


def _clocks(time: Array, middles: Array, nearest: Index, apart: Array) -> dict[str, float]:
    """Return the largest difference of joined times, and the motions of the others' clock that change no choice."""
    if not len(time):
        return {}
    edges = np.concatenate([[-np.inf], middles, [np.inf]])
    later, earlier = float((time - edges[nearest]).min()), float((edges[nearest + 1] - time).min())
    clock_facts = {"largest_apart_s": float(apart.max()), "later_s": later, "earlier_s": earlier}
    return {name: value for name, value in clock_facts.items() if np.isfinite(value)}


def with_columns(
    rows: CollectedRows, others: CollectedRows, place: Index, names: Sequence[str], reason: str
) -> CollectedRows:
    """Return rows with columns of the others at these places (N,); rows without one (-1) are left out for a reason."""
    kept = without_rows(rows, place < 0, reason)
    table = kept.table
    for name in names:
        if name in table.column_names:
            table = table.drop_columns([name])
        table = table.append_column(name, others.table.column(name).take(pa.array(place[place >= 0])))
    return replace(kept, table=table.combine_chunks())
