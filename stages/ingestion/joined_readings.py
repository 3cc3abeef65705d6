"""Readings of an axis that are in another file than its commands: rows joined by order, by pose or by time."""

from __future__ import annotations

import numpy as np

from truing.arrays import Index
from truing.formats.faultlog import FaultLog
from truing.formats.raw_tables import MEASURED_APART
from truing.formats.row_collection import CollectedRows, collect_rows
from truing.formats.source import CampaignFiles
from truing.report.numbers import count_text, quantity
from truing.schemas.faults import Fault
from truing.stages.ingestion.joined_rows import by_key, by_order, by_time, check_clocks, with_columns

_KEYS = 'joined_by = "pose" or "time"'
_WORDS = {"rows": "by their order", "pose": "by pose", "time": "by the nearest time"}
_KEY_COLUMNS = {"pose": "pose", "time": "time_s"}


def with_joined_readings(rows: CollectedRows, source: CampaignFiles, log: FaultLog) -> tuple[CollectedRows, str]:
    """Return the rows of an axis with the columns of [files.measured], and a phrase on how they were joined.

    Without such a table, rows stay as they are and the phrase is empty. Rows without a reading are left out and
    counted. By time, a row and a reading belong together if each is the nearest to the other.
    """
    readings = collect_rows(source, MEASURED_APART, log, "pose")
    if readings is None:
        return rows, ""
    (joined_by, *others) = {entry.joined_by for entry in source.entries(MEASURED_APART.name)}
    columns = [name for name in readings.table.column_names if name not in ("pose", "time_s")]
    if in_both := [name for name in columns if name in rows.table.column_names]:
        expected = "columns in one file: here, or in [files.measured]"
        log.add(Fault(rows.first_file, expected, value=", ".join(in_both)))
    if joined_by is None or others:
        expected = f'how its rows belong to those of configurations: joined_by = "rows", or a key: {_KEYS}'
        log.add(Fault("campaign.toml", expected, column="files.measured"))
    if log:
        return rows, ""
    reading_of_row, largest_apart = _places(rows, readings, joined_by or "", source, log)
    if not log and (reading_of_row < 0).all():
        expected = f"rows that belong to those of {rows.first_file}"
        log.add(Fault(readings.first_file, expected, column=_KEY_COLUMNS.get(joined_by or "")))
    if log:
        return rows, ""
    words = f"readings of {int((reading_of_row >= 0).sum()):,} of {count_text(len(reading_of_row), 'row')} of commands"
    words += f" ({count_text(len(readings.table), 'row')} of readings), joined {_WORDS[joined_by or '']}{largest_apart}"
    return with_columns(rows, readings, reading_of_row, columns, "commands without a reading"), words


def _places(
    rows: CollectedRows, readings: CollectedRows, joined_by: str, source: CampaignFiles, log: FaultLog
) -> tuple[Index, str]:
    """Return the index of the reading of each row (N,), -1 for none, and a phrase on the largest time difference."""
    if joined_by == "rows":
        return by_order(rows, readings, _KEYS, log), ""
    if joined_by == "pose":
        return by_key(rows, readings, ("pose",), "each pose once", log), ""
    check_clocks(rows, readings, source, ("configurations", MEASURED_APART.name), log)
    if log:
        return np.full(len(rows.table), -1), ""
    reading_of_row, about = by_time(rows, readings, log)
    row_of_reading, _ = by_time(readings, rows, log)
    if log:
        return reading_of_row, ""
    is_mutual = (reading_of_row >= 0) & (row_of_reading[reading_of_row] == np.arange(len(reading_of_row)))
    largest = about.get("largest_apart_s")
    phrase = "" if largest is None else f", at most {quantity(largest, 's')} apart"
    return np.where(is_mutual, reading_of_row, -1), phrase
