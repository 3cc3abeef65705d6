"""Loads in one file and signals in another, for `truing init`: two tables of one bench, joined row by row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from truing.arrays import Array
from truing.formats.guess import MappingKeys, OtherWay
from truing.formats.named_loads import channel_mapping, channels_without_loads
from truing.formats.raw_tables import WRENCH
from truing.formats.units import bare_and_unit
from truing.pipeline.init_preview import batches
from truing.schemas.faults import CampaignFaults

if TYPE_CHECKING:
    from truing.formats.guess import Guess
    from truing.pipeline.init_entries import RawGroup

_File = tuple["RawGroup", "Guess"]
_STEPS = {"step", "load step", "loadstep", "schritt", "laststufe", "stufe", "no", "no.", "nr", "nr.", "index"}
_TOGETHER = 0.8  # share of the steps of either file that the other has
_QUESTION = "Rows of these loads belong to those of {}: in the same order, by their step, or by time"
_TAKEN = {
    "rows": "rows of loads are taken to belong to those of {} in the same order: {} rows in both",
    "step": "rows of loads are joined to those of {} by their step: {} rows have one",
    "time": "rows of loads are joined to those of {} by the nearest time, as if their clocks agreed ({} rows)",
}
_DIFFERENT = "channels of a sensor; {} holds loads, but {} rows and not {}, and no step or time in both relates them"


@dataclass(frozen=True)
class _Table:
    """A file of loads or of channels: its guess, the raw name of its steps if any, its steps and number of rows."""

    guess: Guess
    step: str | None
    steps: Array
    rows: int

    @property
    def has_time(self) -> bool:
        """True if a column holds times."""
        return "time_s" in self.guess.mapping.get("columns", {})


def with_loads_apart(folder: Path, files: Sequence[_File]) -> list[_File]:
    """Return the files with [files.loads] and [files.signals], if one alone holds loads and one alone channels.

    Their rows are joined by their steps, else by their order if they have equal numbers, else by time; a question says
    so. Where none is possible, the channels stay unread, with the reason.
    """
    of_loads = [n for n, (group, guess) in enumerate(files) if group.count == 1 and _holds_loads_alone(_applied(guess))]
    of_channels = [n for n, (group, guess) in enumerate(files) if group.count == 1 and _holds_channels_alone(guess)]
    if len(of_loads) != 1 or len(of_channels) != 1:
        return list(files)
    (first,), (second,) = of_loads, of_channels
    keys, doubts = channel_mapping(files[second][1].columns)
    channels = _with_keys(files[second][1], keys, doubts)
    of_files = files[first][0], _applied(files[first][1])
    loads, signals = _table(folder, *of_files), _table(folder, files[second][0], channels)
    result = list(files)
    if loads is None or signals is None:
        return result
    name = files[second][0].glob
    ways = {way: count for way in ("step", "rows", "time") if (count := _matching(way, loads, signals))}
    if not ways:
        note = _DIFFERENT.format(files[first][0].glob, loads.rows, signals.rows)
        result[second] = files[second][0], replace(files[second][1], notes=(note,))
        return result
    way, *more = ways
    doubt = _TAKEN[way].format(name, ways[way])
    of_loads_file, of_signals_file = _joined(way, loads, signals)
    others = tuple(
        OtherWay("join", _QUESTION.format(name), way, other, _joined(other, loads, signals)[0], doubt)
        for other in more[:1]
    )
    of_loads_file = replace(of_loads_file, ways=others, doubts=() if others else (doubt,))
    result[first] = files[first][0], of_loads_file
    result[second] = files[second][0], of_signals_file
    return result


def _applied(guess: Guess) -> Guess:
    """Return the guess for loads that are applied, where they could also be what a sensor shows."""
    return next((way.guess for way in guess.ways if way.key == "loads" and way.other == "applied"), guess)


def _holds_loads_alone(guess: Guess) -> bool:
    columns = guess.mapping.get("columns", {})
    named = {*columns, *guess.columns}
    is_load = any(name in named for name in WRENCH)
    return guess.table == "signals" and not guess.known and is_load and not _has_signals(named)


def _has_signals(named: set[str]) -> bool:
    return any(name.startswith(("v1_mv", "shown_")) for name in named)


def _holds_channels_alone(guess: Guess) -> bool:
    is_in_words = "v1_mv" in guess.mapping.get("units", {})  # the unit of the channels
    is_of_channels = is_in_words or bool(channels_without_loads(guess.columns))
    return guess.table is None and not guess.known and is_of_channels


def _with_keys(guess: Guess, keys: MappingKeys, doubts: tuple[str, ...]) -> Guess:
    """Return the guess for a file of channels as a table of signals."""
    columns = {**guess.mapping.get("columns", {}), **keys["columns"]}
    mapping = {**guess.mapping, **keys, "columns": columns, "number_rows": {"step": 1}, "constants": {"run": "1"}}
    return replace(
        guess,
        mapping=mapping,
        table="signals",
        notes=("channels of a sensor; their loads are in another file",),
        doubts=doubts,
    )


def _table(folder: Path, group: RawGroup, guess: Guess) -> _Table | None:
    """Return the rows of a file; None if it cannot be read."""
    step = next((name for name in guess.columns if bare_and_unit(name)[0].strip().casefold() in _STEPS), None)
    mapping = guess.mapping if step is None else _by_step(guess.mapping, step)
    for keys in (mapping, guess.mapping):
        try:
            read = [
                (batch.rows, batch.columns["step"].to_pylist())
                for batch in batches(folder, group.example, "signals", "interferometer", keys)
            ]
        except (CampaignFaults, KeyError):
            step = None
            continue
        steps = np.array([value for _, steps_of_file in read for value in steps_of_file], dtype=np.float64)
        is_key = step is not None and np.isfinite(steps).all() and len(np.unique(steps)) == len(steps)
        return _Table(guess, step if is_key else None, steps, sum(rows for rows, _ in read))
    return None


def _by_step(mapping: MappingKeys, step: str) -> MappingKeys:
    """Return the keys of a file with its own column of steps, in place of numbers of rows."""
    other_keys = {key: value for key, value in mapping.items() if key != "number_rows"}
    return {**other_keys, "columns": {"step": step, **mapping.get("columns", {})}}


def _matching(way: str, loads: _Table, signals: _Table) -> int:
    """Return the number of rows of signals that would have loads; 0 if rows cannot be joined this way."""
    if way == "rows":
        return signals.rows if loads.rows == signals.rows else 0
    if way == "step":
        if loads.step is None or signals.step is None:
            return 0
        both = len(np.intersect1d(loads.steps, signals.steps))
        return both if both >= _TOGETHER * max(loads.rows, signals.rows) else 0
    return signals.rows if loads.has_time and signals.has_time else 0


def _joined(way: str, loads: _Table, signals: _Table) -> tuple[Guess, Guess]:
    """Return the guesses for loads and signals that are joined in one way."""
    keys = {key: value for key, value in loads.guess.mapping.items() if key not in ("number_rows", "constants")}
    signal_guess = signals.guess
    if signals.step is not None:  # the numbers of the instrument, whatever joins the rows
        signal_guess = replace(signal_guess, mapping=_by_step(signal_guess.mapping, signals.step))
    if way == "step" and loads.step is not None:
        keys = {**keys, "columns": {"step": loads.step, **keys["columns"]}}
    note = "loads of the signals in another file"
    return replace(loads.guess, mapping={**keys, "joined_by": way}, table="loads", notes=(note,), ways=()), signal_guess
