"""A list of measured places next to a longer log of a robot, for `truing init`: the rows of the log at the times of the
list are its poses, where the robot stands still."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from truing.arrays import Array, Index
from truing.formats.guess import MappingKeys
from truing.formats.units import conversion
from truing.pipeline.init_questions import PLACEHOLDER, is_body_open, of_one_target
from truing.pipeline.init_robot import last_link
from truing.pipeline.init_rows import records_of
from truing.pipeline.init_times import is_counted, times_of

if TYPE_CHECKING:
    from truing.formats.guess import Guess
    from truing.pipeline.init_entries import RawGroup
    from truing.pipeline.init_robot import Robot

_File = tuple["RawGroup", "Guess"]
_FEWEST, _MOST = 5, 400  # measured places; rows of the log that a mapping names
_QUARTER_H, _MOST_H = 0.25, 14.0  # zones of clocks
_STILL = 1e-3  # largest change of a joint between rows next to a place, of its range in the log


def with_log_at_times(folder: Path, files: Sequence[_File], robot: Robot | None) -> list[_File]:
    """Read of a log the rows at the times of measured places, in their order, if the robot stands still at each.

    Clocks may differ by quarters of an hour, as those of two zones do; one difference alone has to fit.
    """
    logs = [n for n, (group, guess) in enumerate(files) if is_counted(group, guess, "configurations")]
    lists = [n for n, (group, guess) in enumerate(files) if _is_list(group, guess)]
    if len(logs) != 1 or len(lists) != 1:
        return list(files)
    (log,), (places,) = logs, lists
    rows = _rows_of_places(files[log], files[places])
    if rows is None:
        return list(files)
    result = list(files)
    name = files[places][0].glob
    result[log] = files[log][0], _at_rows(files[log][1], rows, name)
    body = robot.tip if robot is not None else last_link(None, [files[log][1]]) or PLACEHOLDER
    guess = files[places][1]
    doubt = f"each row is assumed to be a pose of one target on {body}, at its time in {files[log][0].glob}"
    one = replace(guess, mapping={**of_one_target(guess, body), "number_rows": {"pose": 1}})
    answered = guess.answered if body == PLACEHOLDER else guess.answered | {"body"}
    result[places] = files[places][0], replace(one, table="points", doubts=(*guess.doubts, doubt), answered=answered)
    return result


def _is_list(group: RawGroup, guess: Guess) -> bool:
    named = {*guess.mapping.get("columns", {}), *guess.mapping.get("number_rows", {}), *guess.mapping.get("split", {})}
    is_bare = guess.table in ("points", "targets") and not guess.known and group.count == 1 and "format" not in named
    return is_bare and "pose" not in named and is_body_open(guess)


def _rows_of_places(log: _File, places: _File) -> Index | None:
    """Row of the log, from 0, at each measured place; None unless one difference of the clocks fits."""
    times, shots = times_of(*log), times_of(*places)
    if times is None or shots is None or not _FEWEST <= len(shots) <= min(_MOST, len(times) - 1):
        return None
    unit = log[1].mapping.get("units", {}).get("time_s", "s")
    times = times * conversion(unit, "s")[0]
    joints = _joints(*log)
    if joints is None or len(joints) != len(times) or np.any(np.diff(times) <= 0.0):
        return None
    zones = 3600.0 * np.arange(-_MOST_H, _MOST_H + _QUARTER_H, _QUARTER_H)
    found = [rows for late in zones if (rows := _rows_at_rest(times, shots - late, joints)) is not None]
    return found[0] if len(found) == 1 else None


def _rows_at_rest(times: Array, shots: Array, joints: Array) -> Index | None:
    """Row (M,) of times (N,) nearest to each shot, if joints (N, J) stand still there; else None."""
    if shots.min() < times[0] or shots.max() > times[-1]:
        return None
    rows = np.clip(np.searchsorted(times, shots), 1, len(times) - 2)
    rows = rows - (shots - times[rows - 1] < times[rows] - shots)
    rows = np.clip(rows, 1, len(times) - 2)
    change = np.abs(joints[rows + 1] - joints[rows - 1])
    is_still = bool(np.all(change <= _STILL * np.ptp(joints, axis=0)))
    return rows if is_still and len(set(rows.tolist())) == len(rows) else None


def _joints(group: RawGroup, guess: Guess) -> Array | None:
    """Readings (N, J) of the joints that a log gives; None where a cell is no number."""
    columns = guess.mapping.get("columns", {})
    raw = [name for column, name in columns.items() if column.endswith(("_rad", "_deg", "_mm"))]
    places = [guess.columns.index(name) for name in raw if name in guess.columns]
    try:
        return np.array([[float(row[place]) for place in places] for row in records_of(group.example, guess)])
    except ValueError:
        return None


def _at_rows(guess: Guess, rows: Index, places: str) -> Guess:
    """The log's guess with these rows alone, from 0, numbered in the order of the measured places."""
    first = int(guess.mapping["number_rows"]["pose"])
    numbers = [str(first + row) for row in rows.tolist()]
    keys: MappingKeys = {
        "columns": {**guess.mapping["columns"], "pose": "row"},
        "number_rows": {"row": first},
        "select": {"row": "|".join(numbers)},
        "ignore": "|".join(filter(None, (guess.mapping.get("ignore"), "row"))),
        "rename": {"pose": {row: str(k) for k, row in enumerate(numbers, 1) if row != str(k)}},
    }
    doubt = f"rows at the times of {places} are read, where the joints stand still: {len(numbers)} of the log"
    kept = tuple(one for one in guess.doubts if "number_rows" not in one)
    return replace(guess, mapping={**guess.mapping, **keys}, doubts=(*kept, doubt))
