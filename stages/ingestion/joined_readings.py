"""Readings of an axis in another file than its commands: rows joined by their order, by pose or by time."""

from __future__ import annotations

import numpy as np

from truing.arrays import Index
from truing.formats.faultlog import FaultLog
from truing.formats.row_collection import CollectedRows, collect_rows
from truing.formats.shapes import MEASURED_APART
from truing.formats.source import CampaignFiles
from truing.report.numbers import count_text, quantity
from truing.schemas.faults import Fault
from truing.stages.ingestion.joined_rows import by_key, by_order, by_time, check_clocks, with_columns

_KEYS = 'joined_by = "pose" or "time"'
_WORDS = {"rows": "by their order", "pose": "by pose", "time": "by the nearest time"}
_KEY_COLUMNS = {"pose": "pose", "time": "time_s"}


def with_joined_readings(rows: CollectedRows, source: CampaignFiles, log: FaultLog) -> tuple[CollectedRows, str]:
    """Return the rows of an axis with the columns of [files.measured], and words on how they were joined; the rows as
    they are without such a table.

    Rows without a reading are left out and counted. By time, a row and a reading belong together if each is the nearest
    to the other.
    """
    readings = collect_rows(source, MEASURED_APART, log, "pose")
    if readings is None:
        return rows, ""
    (way, *others) = {entry.joined_by for entry in source.entries(MEASURED_APART.name)}
    taken = [name for name in readings.table.column_names if name not in ("pose", "time_s")]
    if both := [name for name in taken if name in rows.table.column_names]:
        expected = "columns in one file: here, or in [files.measured]"
        log.add(Fault(rows.first_file, expected, value=", ".join(both)))
    if way is None or others:
        expected = f'how its rows belong to those of configurations: joined_by = "rows", or a key: {_KEYS}'
        log.add(Fault("campaign.toml", expected, column="files.measured"))
    if log:
        return rows, ""
    place, apart = _places(rows, readings, way or "", source, log)
    if not log and (place < 0).all():
        expected = f"rows that belong to those of {rows.first_file}"
        log.add(Fault(readings.first_file, expected, column=_KEY_COLUMNS.get(way or "")))
    if log:
        return rows, ""
    words = f"readings of {int((place >= 0).sum()):,} of {count_text(len(place), 'row')} of commands"
    words += f" ({count_text(len(readings.table), 'row')} of readings), joined {_WORDS[way or '']}{apart}"
    return with_columns(rows, readings, place, taken, "commands without a reading"), words


def _places(
    rows: CollectedRows, readings: CollectedRows, way: str, source: CampaignFiles, log: FaultLog
) -> tuple[Index, str]:
    """Return the reading of each row (N,), -1 for none, and words on the largest difference of joined times."""
    if way == "rows":
        return by_order(rows, readings, _KEYS, log), ""
    if way == "pose":
        return by_key(rows, readings, ("pose",), "each pose once", log), ""
    check_clocks(rows, readings, source, ("configurations", MEASURED_APART.name), log)
    if log:
        return np.full(len(rows.table), -1), ""
    place, about = by_time(rows, readings, log)
    back, _ = by_time(readings, rows, log)
    if log:
        return place, ""
    is_mutual = (place >= 0) & (back[place] == np.arange(len(place)))
    apart = about.get("largest_apart_s")
    return np.where(is_mutual, place, -1), "" if apart is None else f", at most {quantity(apart, 's')} apart"
