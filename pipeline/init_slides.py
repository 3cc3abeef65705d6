"""Positions of linear axes in a log next to measured points, for `truing init`: a gantry moves points as its axes."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from truing.arrays import Array
from truing.formats.guess import MappingKeys
from truing.formats.units import bare_and_unit
from truing.pipeline.init_preview import first_rows
from truing.pipeline.init_survey import rows_of
from truing.schemas.faults import CampaignFaults

if TYPE_CHECKING:
    from truing.formats.guess import Guess
    from truing.pipeline.init_entries import RawGroup

_File = tuple["RawGroup", "Guess"]
_AXES = "xyz"
_WORDS = r"(?:ist|act(?:ual)?|pos(?:ition)?|mcs|mks|axis|achse|scale|encoder|machine|istwert|istpos(?:ition)?)"
_AXIS = re.compile(rf"(?P<first>[xyz])(?:[\s_.\-]*{_WORDS})+|(?:{_WORDS}[\s_.\-]*)+(?P<last>[xyz])", re.IGNORECASE)
_NUMBER = re.compile(r"nc|block|line|row|satz|nr|no|#|pose?|index|i", re.IGNORECASE)
_NUMBERED = r"\D*(?P<pose>\d+)\D*"
_FEWEST, _MOST_ROWS = 6, 20_000
_RIGID = 0.02  # change of distances between stops, of their size: points that move as the axes change less


def with_slides(folder: Path, files: Sequence[_File]) -> list[_File]:
    """Read a log of positions of three linear axes as configurations, if a file of points moves as these axes do."""
    tables = [guess.table for _, guess in files]
    logs = [n for n, (group, guess) in enumerate(files) if group.count == 1 and _columns_of_axes(guess)]
    lists = [n for n, table in enumerate(tables) if table in ("points", "targets") and n not in logs]
    if len(logs) != 1 or len(lists) != 1 or {"configurations", "poses"} & set(tables):
        return list(files)
    (log,), (measured,) = logs, lists
    read = _log(files[log][1])
    positions = _positions(folder, files[log][0], read)
    if positions is None or not _moves_as(folder, files[measured], positions):
        return list(files)
    result = list(files)
    result[log] = files[log][0], read
    return result


def _columns_of_axes(guess: Guess) -> dict[str, str]:
    """Raw names of the positions of x, y and z; empty unless each has one, in a unit of length or none."""
    found: dict[str, str] = {}
    for name in guess.columns:
        bare, unit = bare_and_unit(name)
        match = _AXIS.fullmatch(bare.strip())
        if match is not None and unit in (None, "mm", "um", "m", "in"):
            found.setdefault((match["first"] or match["last"]).casefold(), name)
    return found if guess.table in (None, "points", "targets") and set(found) == set(_AXES) else {}


def _log(guess: Guess) -> Guess:
    named = _columns_of_axes(guess)
    columns: MappingKeys = {f"{axis}_mm": named[axis] for axis in _AXES}
    units = {column: unit for column, raw in columns.items() if (unit := bare_and_unit(raw)[1]) not in (None, "mm")}
    number = next((name for name in guess.columns if _NUMBER.fullmatch(bare_and_unit(name)[0].strip(" ."))), None)
    kept = {key: value for key, value in guess.mapping.items() if key not in ("columns", "units", "unit", "constants")}
    keys: MappingKeys = {"columns": columns, **({"units": units} if units else {})}
    keys |= {"number_rows": {"pose": 1}} if number is None else {"split": {number: _NUMBERED}}
    screws = [
        {"axis": [float(axis == component) for component in _AXES], "point_mm": [0.0, 0.0, 0.0], "kind": "prismatic"}
        for axis in _AXES
    ]
    machine = {"type": "chain", "joints": list(_AXES), "screws": screws}
    note = f"positions of three linear axes: {', '.join(columns.values())}"
    return replace(guess, mapping={**kept, **keys}, table="configurations", notes=(note,), machine=machine, ways=())


def _positions(folder: Path, group: RawGroup, guess: Guess) -> Array | None:
    """Positions (N, 3) of the axes, mm; None if the log cannot be read."""
    try:
        batch = first_rows(folder, group.example, "configurations", "photogrammetry", guess.mapping)
    except CampaignFaults:
        return None
    columns = [] if batch is None else [batch.columns.get(f"{axis}_mm") for axis in _AXES]
    if not columns or any(column is None for column in columns):
        return None
    return np.column_stack([np.array(column.to_pylist(), float) for column in columns if column is not None])


def _moves_as(folder: Path, file: _File, positions: Array) -> bool:
    """True if distances between the measured stops are those between the positions of the axes, file by file."""
    group, guess = file
    examples = [group.example.parent / name for name in group.names] or [group.example]
    constants: dict[str, str | int] = {"pose": 1, "body": "body", "target": "1"}
    points = replace(guess, table="points")
    read = [rows_of(folder, replace(group, example=one), points, constants, most=_MOST_ROWS) for one in examples]
    found = [rows.places for rows in read if rows is not None]
    if len(found) < len(read) or sum(map(len, found)) != len(positions) or min(map(len, found)) < _FEWEST:
        return False
    first = 0
    for places in found:
        positions_of_file = positions[first : first + len(places)]
        first += len(places)
        change = np.linalg.norm(np.diff(places, axis=0), axis=1) - np.linalg.norm(
            np.diff(positions_of_file, axis=0), axis=1
        )
        size = float(np.sqrt(np.mean(np.sum(np.diff(positions_of_file, axis=0) ** 2, axis=1))))
        if not size or float(np.sqrt(np.mean(change**2))) > _RIGID * size:
            return False
    return True
