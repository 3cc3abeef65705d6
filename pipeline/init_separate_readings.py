"""Commands of an axis in one file and readings of an instrument in another, for `truing init`: how their rows belong
together."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from truing.arrays import Array
from truing.formats.guess import Guess, MappingKeys, OtherWay
from truing.formats.named_bench import axis_rows
from truing.formats.proposed_angles import head_of_angles, with_raw_names
from truing.formats.sexagesimal import UNIT
from truing.formats.sniff_readings import proposal_of_axis
from truing.formats.units import bare_and_unit
from truing.pipeline.init_preview import batches
from truing.schemas.faults import CampaignFaults

if TYPE_CHECKING:
    from truing.pipeline.init_entries import RawGroup

_File = tuple["RawGroup", Guess]
_COUNTERS = {"pose", "pos", "pos.", "row", "point", "punkt", "step", "no", "no.", "nr", "nr.", "index", "#"}
_READ_AS = (
    *("encoding", "separator", "quote", "comment", "skip_lines", "keep_lines", "header", "names", "decimal"),
    *("thousands", "missing", "sheet", "time_format", "format"),
)
_RECORDED = ("measured", "deviation", "load", "motor")
_OF_EACH_ROW = ("time_s", "temperature_c")
_TOGETHER = 0.8  # share of the rows of the shorter file that the other has
_QUESTION = "Rows of this file belong to those of {}: in the same order, by their number, or by time"
_TAKEN = {
    "pose": "rows are joined to those of {} by their number: {} rows have one",
    "rows": "rows are taken to belong to those of {} in the same order: {} rows in both",
    "time": "rows are joined to those of {} by the nearest time, as if their clocks agreed ({} rows)",
}


@dataclass(frozen=True)
class _AxisFile:
    """A file as numbers: names of its columns, their values (N, W), the name of its count of rows if any, and times
    (N,), None without any."""

    names: tuple[str, ...]
    values: Array
    counter: str | None
    time: Array | None

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.values)

    @property
    def counts(self) -> Array:
        """Numbers of the rows (N,)."""
        return self.values[:, self.names.index(self.counter or "")]


def with_measured_apart(folder: Path, files: Sequence[_File]) -> list[_File]:
    """Return the files with [files.configurations] and [files.measured], if one alone holds commands of an axis and one
    alone what an instrument read there.

    Rows are joined by their numbers, else by their order if there are as many, else by time; a question says so. A
    column of times is read, whatever joins the rows.
    """
    tables = {n: table for n, file in enumerate(files) if (table := _table(folder, *file)) is not None}
    pairs = [
        (first, second, guesses)
        for first, second in itertools.permutations(tables, 2)
        if files[second][1].table is None
        and (guesses := _proposal(files[first], files[second], tables[first], tables[second])) is not None
    ]
    if len(pairs) != 1:
        return list(files)
    ((first, second, guesses),) = pairs
    result = list(files)
    for place, guess in zip((first, second), guesses, strict=True):
        result[place] = files[place][0], guess
    return result


def _table(folder: Path, group: RawGroup, guess: Guess) -> _AxisFile | None:
    """Return the numbers of a file that may be one of the two; None for other files."""
    if group.count != 1 or guess.known or guess.table not in (None, "configurations") or not guess.columns:
        return None
    time = guess.mapping.get("columns", {}).get("time_s")
    angles = {name: unit for name, unit in guess.mapping.get("units", {}).items() if unit == UNIT}
    columns = guess.mapping.get("columns", {})
    angles = {raw: UNIT for raw in (columns.get(name, name) for name in angles) if isinstance(raw, str)}
    keys: MappingKeys = {key: guess.mapping[key] for key in _READ_AS if key in guess.mapping}
    keys |= {"columns": {"time_s": time} if isinstance(time, str) else {}, "number_rows": {"pose": 1}}
    keys |= {"units": angles} if angles else {}
    try:
        read = list(batches(folder, group.example, "configurations", "photogrammetry", keys))
    except CampaignFaults:
        return None
    if not read:
        return None
    columns_read = {
        name: np.concatenate([np.asarray(batch.columns[name], dtype=float) for batch in read if name in batch.columns])
        for name in read[0].columns
        if name not in ("pose", "role", "repeat_of", "series")
    }
    times = columns_read.pop("time_s", None)
    names = tuple(head_of_angles(name) if name in angles else name for name in columns_read)
    if not names or len({len(values) for values in columns_read.values()}) > 1:
        return None
    values = np.column_stack(list(columns_read.values()))
    counters = [name for name, column in zip(names, values.T, strict=True) if _counts(name, column)]
    is_timed = times is not None and len(times) == len(values) and np.isfinite(times).all()
    return _AxisFile(names, values, next(iter(counters), None), times if is_timed else None)


def _counts(name: str, values: Array) -> bool:
    """True if a column numbers the rows of its file."""
    is_whole = np.isfinite(values).all() and np.array_equal(values, np.round(values))
    return name.strip().casefold() in _COUNTERS and bool(is_whole) and len(np.unique(values)) == len(values)


def _proposal(first: _File, second: _File, commands: _AxisFile, readings: _AxisFile) -> tuple[Guess, Guess] | None:
    """Return the guesses for a file of commands and one of readings; None if they are not, or cannot be joined."""
    if axis_rows(readings.names, readings.values) or set(commands.names) & _measured_columns(readings):
        return None
    measured_names = [name for name in readings.names if name in _measured_columns(readings)]
    names = (*commands.names, *measured_names)
    rows = min(commands.rows, readings.rows)
    shown = readings.values[:rows, [readings.names.index(name) for name in measured_names]]
    axes = axis_rows(names, np.column_stack([commands.values[:rows], shown]))
    ways = {way: n for way in _TAKEN if (n := _matching(way, commands, readings))}
    if not axes or not ways:
        return None
    meant = {key: raw for key, raw in first[1].mapping.get("columns", {}).items() if key in _OF_EACH_ROW}
    both = proposal_of_axis(axes, names, {}, meant)
    columns = both.mapping["columns"]
    is_command = any(key.startswith("command_") and raw in commands.names for key, raw in columns.items())
    read = {key: raw for key, raw in columns.items() if _raw_name(raw) in measured_names}
    if not is_command or not any(key.startswith(_RECORDED) for key in read):
        return None
    return _of_commands(first, both, commands, measured_names, next(iter(ways))), _of_readings(
        first, second, both, readings, ways
    )


def _measured_columns(table: _AxisFile) -> set[str]:
    """Return the columns of a table but the number of its rows."""
    return set(table.names) - {table.counter}


def _raw_name(source: object) -> object:
    return source["name"] if isinstance(source, dict) else source


def _matching(way: str, commands: _AxisFile, readings: _AxisFile) -> int:
    """Return the number of commands that would have a reading; 0 if rows cannot be joined this way."""
    fewer = min(commands.rows, readings.rows)
    if way == "rows":
        return fewer if commands.rows == readings.rows else 0
    if way == "pose":
        is_counted = commands.counter is not None and readings.counter is not None
        matches = len(np.intersect1d(commands.counts, readings.counts)) if is_counted else 0
    else:
        matches = 0 if commands.time is None or readings.time is None else _near(commands.time, readings.time)
    return matches if matches >= _TOGETHER * fewer else 0


def _near(time: Array, other: Array) -> int:
    """Return the number of times of the shorter list that lie within half a usual step of the longer one."""
    longer, shorter = (np.sort(times) for times in sorted((time, other), key=len, reverse=True))
    if len(longer) <= 1:
        return 0
    place = np.clip(np.searchsorted(longer, shorter), 1, len(longer) - 1)
    apart = np.minimum(np.abs(shorter - longer[place - 1]), np.abs(shorter - longer[place]))
    return int((apart <= 0.5 * np.median(np.diff(longer))).sum())


def _of_commands(file: _File, both: Guess, table: _AxisFile, readings: Sequence[str], way: str) -> Guess:
    """Return the guess for the file of commands, from that for both together."""
    columns = {key: raw for key, raw in both.mapping["columns"].items() if _raw_name(raw) not in readings}
    doubts = tuple(way.doubt for way in both.ways if way.key == "axis")
    keys = _keys(file, both, columns, table.counter if way == "pose" else None)
    keys |= {} if "pose" in keys["columns"] else {"number_rows": {"pose": 1}}
    note = "commands of an axis, whose readings are in another file"
    guess = Guess(keys, file[1].columns, "configurations", (note,), doubts=doubts)
    return with_raw_names(guess, _raw_names(table.names, file[1].columns))


def _of_readings(commands: _File, file: _File, both: Guess, table: _AxisFile, ways: dict[str, int]) -> Guess:
    """Return the guess for the file of readings, with the questions of their sign and of how they are joined."""
    own_columns = _measured_columns(table)

    def guess_of(both_guess: Guess, way: str) -> Guess:
        columns = {key: raw for key, raw in both_guess.mapping["columns"].items() if _raw_name(raw) in own_columns}
        time = file[1].mapping.get("columns", {}).get("time_s")
        columns = {**({"time_s": time} if time is not None else {}), **columns}
        keys = _keys(file, both_guess, columns, table.counter if way == "pose" else None) | {"joined_by": way}
        doubts = tuple(doubt for doubt in both_guess.doubts if any(str(raw) in doubt for raw in columns.values()))
        note = "readings of the axis, for the commands of another file"
        guess = Guess(keys, file[1].columns, "measured", (note,), doubts=doubts)
        return with_raw_names(guess, _raw_names(table.names, file[1].columns))

    name = commands[0].glob
    way, *others = ways
    doubt = _TAKEN[way].format(name, ways[way])

    def with_join(both_guess: Guess) -> Guess:
        guess = guess_of(both_guess, way)
        if not others:
            return replace(guess, doubts=(*guess.doubts, doubt))
        other = OtherWay("join", _QUESTION.format(name), way, others[0], guess_of(both_guess, others[0]), doubt)
        return replace(guess, ways=(other,))

    guess = with_join(both)
    signs = tuple(
        replace(sign_way, guess=with_join(sign_way.guess)) for sign_way in both.ways if sign_way.key == "sign"
    )
    return replace(guess, ways=(*signs, *guess.ways))


def _keys(file: _File, both: Guess, columns: MappingKeys, counter: str | None) -> MappingKeys:
    """Return keys of one of two files, of those for both together. counter: its number of rows, where it is read."""
    keys = {key: value for key, value in file[1].mapping.items() if key in _READ_AS and key != "time_format"}
    if "time_s" in columns and "time_format" in file[1].mapping:
        keys["time_format"] = file[1].mapping["time_format"]
    keys["columns"] = {**({} if counter is None else {"pose": counter}), **columns}
    units = {key: unit for key, unit in both.mapping.get("units", {}).items() if key in columns}
    keys |= {"units": units} if units else {}
    passed_over = re.compile(both.mapping.get("ignore", r"(?!)"))
    names = [name for name in file[1].columns if passed_over.fullmatch(name) and name != keys["columns"].get("pose")]
    return keys | ({"ignore": "|".join(re.escape(name).replace("\\ ", " ") for name in names)} if names else {})


def _raw_names(names: Sequence[str], raw: Sequence[str]) -> dict[str, str]:
    """Return raw names by the names of sexagesimal angles that proposals read."""
    return {head: name for name in raw if (head := head_of_angles(name)) in names and bare_and_unit(head)[1] == UNIT}
