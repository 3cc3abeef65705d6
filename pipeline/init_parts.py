"""Files of points that are parts of one list, for `truing init`: no target is in two of them, so they are no poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from truing.pipeline.init_questions import PLACEHOLDER, is_body_open
from truing.pipeline.init_survey import rows_of_files

if TYPE_CHECKING:
    from truing.formats.guess import Guess
    from truing.pipeline.init_entries import RawGroup

_File = tuple["RawGroup", "Guess"]
_FEWEST, _MOST_ROWS = 2, 20_000  # targets in each file


def with_parts_of_one_list(folder: Path, files: Sequence[_File]) -> list[_File]:
    """Take the numbers in names of files as no poses, where no target is in two of these files."""
    return [(group, _as_parts(folder, group, guess)) for group, guess in files]


def _as_parts(folder: Path, group: RawGroup, guess: Guess) -> Guess:
    keys = guess.mapping
    is_named = "target" in {*guess.columns, *keys.get("columns", {})}
    if guess.table != "points" or group.count < 2 or not is_named or "(?P<pose>" not in keys.get("from_name", ""):
        return guess
    constants = {"body": PLACEHOLDER} if is_body_open(guess) else {}
    rows = rows_of_files(folder, group, guess, constants, most=_MOST_ROWS)
    if rows is None:
        return guess
    targets: dict[str, set[tuple[str, str]]] = {}
    for pose, body, target in zip(rows.poses, rows.bodies, rows.targets, strict=True):
        targets.setdefault(pose, set()).add((body, target))
    apart = len(set().union(*targets.values())) == len(rows.targets)
    if not apart or len(targets) < 2 or min(map(len, targets.values())) < _FEWEST:
        return guess
    mapping = {key: value for key, value in keys.items() if key != "from_name"}
    note = "no target is in two of these files: parts of one list, and no poses"
    return replace(guess, mapping=mapping, notes=(*guess.notes, note))
