"""Measured poses joined by time to a log with another number of rows, for `truing init`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from truing.arrays import Array, Index
from truing.formats.guess import MappingKeys
from truing.formats.probable_columns import columns_by_names
from truing.formats.times import time_format_of
from truing.pipeline.init_rows import records_of

if TYPE_CHECKING:
    from truing.formats.guess import Guess
    from truing.pipeline.init_entries import RawGroup

_File = tuple["RawGroup", "Guess"]
_FEWEST, _MOST = 5, 400  # rows of the log; rows named in a mapping
_NEAR = 0.25  # of the shortest time between rows of the log: farther from each, a measured pose belongs to none
_ANCHORS = 8  # rows from which differences of the clocks are tried


def with_poses_by_time(folder: Path, files: Sequence[_File]) -> list[_File]:
    """Number measured poses as the rows of a log with fewer rows, if times in both tell which belong together.

    The clocks may differ by a constant. Of several poses of one row the first is read.
    """
    logs = [n for n, (group, guess) in enumerate(files) if is_counted(group, guess, "configurations")]
    measured = [n for n, (group, guess) in enumerate(files) if is_counted(group, guess, "poses")]
    if len(logs) != 1 or len(measured) != 1:
        return list(files)
    (log,), (poses,) = logs, measured
    times, measured_times = times_of(*files[log]), times_of(*files[poses])
    if times is None or measured_times is None or not _FEWEST <= len(times) < len(measured_times) <= _MOST:
        return list(files)
    found = _joined(times, measured_times)
    if found is None:
        return list(files)
    row_of, apart = found
    result = list(files)
    result[poses] = files[poses][0], _numbered(files[poses][1], row_of, files[log][0].glob, apart)
    return result


def is_counted(group: RawGroup, guess: Guess, table: str) -> bool:
    """Return True for a single file of a table whose poses are counted by rows."""
    return guess.table == table and group.count == 1 and "pose" in guess.mapping.get("number_rows", {})


def times_of(group: RawGroup, guess: Guess) -> Array | None:
    """Times (N,) of the rows of a file, s; None without a column of times."""
    name = columns_by_names(guess.columns)[0].get("columns", {}).get("time_s")
    if name not in guess.columns:
        return None
    place = guess.columns.index(name)
    cells = [record[place] for record in records_of(group.example, guess)]
    form = time_format_of(cells)
    if form is None:
        return np.array(cells, float) if all(re.fullmatch(r"\d+(\.\d*)?", cell.strip()) for cell in cells) else None
    moments = [datetime.strptime(cell.strip(), form.form) for cell in cells]
    return np.array([(one if one.tzinfo else one.replace(tzinfo=UTC)).timestamp() for one in moments])


def _joined(times: Array, measured_times: Array) -> tuple[Index, float] | None:
    """Row of the log for each measured pose (M,), -1 for none, and by how much its clock is later, s.

    None unless one difference of the clocks alone gives each row a pose: rows at equal intervals leave it open.
    """
    near = _NEAR * float(np.diff(np.sort(times)).min())
    tried = (measured_times[: _ANCHORS + len(measured_times) - len(times), None] - times[:_ANCHORS]).ravel()
    rows = [_rows_at(times, measured_times - late, near) for late in tried]
    rows_with_all_times = [k for k, row in enumerate(rows) if len(set(row.tolist()) - {-1}) == len(times)]
    if not rows_with_all_times or np.ptp(tried[rows_with_all_times]) > 2.0 * near:
        return None
    first = min(rows_with_all_times, key=lambda k: abs(tried[k] - float(np.median(tried[rows_with_all_times]))))
    row_of = rows[first].copy()
    seen: set[int] = set()
    for number, row in enumerate(row_of.tolist()):
        if row in seen:
            row_of[number] = -1
        seen.add(row)
    return row_of, float(tried[first])


def _rows_at(times: Array, measured_times: Array, near: float) -> Index:
    nearest = np.abs(measured_times[:, None] - times).argmin(axis=1)
    return np.where(np.abs(measured_times - times[nearest]) <= near, nearest, -1)


def _numbered(guess: Guess, row_of: Index, log: str, late_s: float) -> Guess:
    """The guess whose rows have the numbers of the log's rows; other rows are left out."""
    first = int(guess.mapping["number_rows"]["pose"])
    kept = [(str(first + number), str(first + row)) for number, row in enumerate(row_of.tolist()) if row >= 0]
    out = [str(first + number) for number, row in enumerate(row_of.tolist()) if row < 0]
    keys: MappingKeys = {
        "columns": {**guess.mapping["columns"], "pose": "row"},
        "number_rows": {"row": first},
        "select": {"row": f"(?!({'|'.join(out)})$).*"},
        "rename": {"pose": {number: row for number, row in kept if number != row}},
    }
    doubt = (
        f"rows are joined to those of {log} by time (the clocks differ by {late_s:.3g} s): "
        f"{len(kept)} match; left out: {', '.join(out)}"
    )
    return replace(guess, mapping={**guess.mapping, **keys}, doubts=(*guess.doubts, doubt))
