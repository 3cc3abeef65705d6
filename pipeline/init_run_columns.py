"""Runs of one file of positioning for `truing init`: a column such as the date tells apart approaches that repeat."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from truing.pipeline.init_preview import named_cells

if TYPE_CHECKING:
    from truing.formats.guess import Guess, MappingKeys
    from truing.pipeline.init_entries import RawGroup

    _File = tuple["RawGroup", Guess]

_KEYS = ("run", "target_mm", "direction", "cycle")
_MOST_RUNS, _MOST_ROWS = 40, 200_000


def with_run_columns(folder: Path, files: Sequence[_File]) -> list[_File]:
    """Take the runs of positioning from a column, if cycles repeat in the file and no longer do within each value."""
    return [(group, _with_column(folder, group, guess)) for group, guess in files]


def _with_column(folder: Path, group: RawGroup, guess: Guess) -> Guess:
    constants = guess.mapping.get("constants", {})
    if guess.table != "positioning" or "run" not in constants or group.count > 1 or guess.known:
        return guess
    if _runs_apart(folder, group.example, guess.mapping) is not False:
        return guess
    used = set(map(str, guess.mapping["columns"].values()))
    for name in guess.columns:
        keys = _taken_from(guess.mapping, name)
        if name not in used and _runs_apart(folder, group.example, keys):
            note = f"{name} is taken for run: cycles of a target repeat in the file, and do not within one {name}"
            doubt = f"the values of {name} are assumed to be runs"
            return replace(guess, mapping=keys, notes=(*guess.notes, note), doubts=(*guess.doubts, doubt))
    return guess


def _taken_from(mapping: MappingKeys, name: str) -> MappingKeys:
    """Keys that take the run from a column in place of a constant."""
    constants = {key: value for key, value in mapping["constants"].items() if key != "run"}
    others = {key: value for key, value in mapping.items() if key != "constants"}
    keys = {**others, "columns": {"run": name, **mapping["columns"]}}
    return {**keys, "constants": constants} if constants else keys


def _runs_apart(folder: Path, path: Path, mapping: MappingKeys) -> bool | None:
    """True if every run, target, direction and cycle is there once, in a few runs; None if the file is not read."""
    rows = named_cells(folder, path, "positioning", "interferometer", mapping, _KEYS, _MOST_ROWS)
    if not rows:
        return None
    is_few = len({row[0] for row in rows}) <= _MOST_RUNS
    return is_few and len(set(rows)) == len(rows)
