"""Files of points that are parts of one list, for `truing init`: no target is in two of them, so they are no poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from truing.pipeline.init_questions import PLACEHOLDER, is_body_open
from truing.pipeline.init_survey import rows_of, rows_of_files

if TYPE_CHECKING:
    from truing.formats.guess import Guess
    from truing.pipeline.init_entries import RawGroup

_File = tuple["RawGroup", "Guess"]
_FEWEST, _MOST_ROWS = 2, 20_000  # targets in each file
_FEWEST_OF_STATION, _MOST_POSES = 6, 400  # poses that are to tell where the instrument stood; poses named in a mapping


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


def with_stations(folder: Path, files: Sequence[_File]) -> list[_File]:
    """Give the poses of each file of one list a series of their own: the instrument may have moved between files."""
    logs = [n for n, (group, guess) in enumerate(files) if guess.table == "configurations" and group.count == 1]
    lists = [(group, guess) for group, guess in files if guess.table == "points" and group.count > 1]
    if len(logs) != 1 or len(lists) != 1 or "target" not in lists[0][1].mapping.get("constants", {}):
        return list(files)
    group, guess = lists[0]
    keys = files[logs[0]][1].mapping
    examples = [group.example.parent / name for name in group.names]
    read = [rows_of(folder, replace(group, example=one), guess, {}, most=_MOST_ROWS) for one in examples]
    poses = [set(rows.poses) for rows in read if rows is not None]
    count = sum(map(len, poses))
    is_apart = len(poses) == len(read) and count == len(set().union(*poses)) <= _MOST_POSES
    if not is_apart or "series" in keys.get("columns", {}) or min(map(len, poses)) < _FEWEST_OF_STATION:
        return list(files)
    renames = {"|".join(sorted(own, key=_natural)): str(number) for number, own in enumerate(poses, 1)}
    mapping = {**keys, "columns": {**keys.get("columns", {}), "series": "pose"}}
    mapping["rename"] = {**keys.get("rename", {}), "series": renames}
    doubt = f"poses of each file {group.glob} are assumed to have a frame of their own; if the instrument stood still, "
    doubt += 'write [measurement] frame = "campaign"'
    log = replace(files[logs[0]][1], mapping=mapping, doubts=(*files[logs[0]][1].doubts, doubt))
    return [(own, log if n == logs[0] else one) for n, (own, one) in enumerate(files)]


def _natural(name: str) -> tuple[int, str]:
    return (int(name) if name.isdecimal() else 0, name)
