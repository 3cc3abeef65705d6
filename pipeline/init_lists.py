"""Lists of numbered places next to a log of readings, for `truing init`: each place is one target in another pose."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from truing.formats.guess import MappingKeys, OtherWay
from truing.formats.presets import target_column
from truing.pipeline.init_preview import first_rows
from truing.pipeline.init_questions import NUMBER_OF_POSE, PLACEHOLDER, is_body_open, of_one_target
from truing.pipeline.init_robot import last_link
from truing.pipeline.init_survey import rows_of, rows_of_files
from truing.schemas.faults import CampaignFaults

if TYPE_CHECKING:
    from truing.formats.guess import Guess
    from truing.pipeline.init_entries import RawGroup
    from truing.pipeline.init_robot import Robot

_NUMBERED = re.compile(r"(?P<stem>.*?)[\s_.#-]*(?P<number>\d+)")
_FEWEST, _MOST_ROWS = 5, 100_000
_PLACE = "place"  # the part of a longer name that numbers it
_COVERED = 0.8  # share of the logged poses that have a place
_File = tuple["RawGroup", "Guess"]


def with_numbered_poses(folder: Path, files: Sequence[_File], robot: Robot | None) -> list[_File]:
    """Read lists such as TCP001, TCP002, ... as poses of one target, if a log of readings has as many poses."""
    logs = [(group, guess) for group, guess in files if guess.table == "configurations"]
    lists = [guess for _, guess in files if guess.table in ("points", "targets")]
    if len(logs) != 1 or len(lists) != 1 or any(guess.table == "poses" for _, guess in files):
        return list(files)  # next to points, a numbered list is a survey
    log = _log(folder, *logs[0])
    body = _moved_body(logs[0][1], robot)
    return [(group, _read_as_poses(folder, group, guess, log, body)) for group, guess in files]


def with_poses_in_order(folder: Path, files: Sequence[_File]) -> list[_File]:
    """Number the measured poses of one body as the rows of a log of as many, whose rows are counted.

    Numbers of an instrument, such as those of its frames, name no row of the log.
    """
    logs = [one for one in files if one[1].table == "configurations"]
    log = _log(folder, *logs[0]) if len(logs) == 1 else _Log()
    if not log.is_counted:
        return list(files)
    return [
        (group, _counted_as(log, folder, group, guess) if guess.table == "poses" else guess) for group, guess in files
    ]


def _counted_as(log: _Log, folder: Path, group: RawGroup, guess: Guess) -> Guess:
    raw = guess.mapping.get("columns", {}).get("pose", "pose")
    numbers = _log(folder, group, guess, table="poses").poses
    if len(set(numbers)) < len(numbers) or len(numbers) != len(log.poses) or set(numbers) == set(log.poses):
        return guess
    columns = {key: name for key, name in guess.mapping["columns"].items() if key != "pose"}
    doubt = f"poses are assumed to be in the order of the log, whose rows have no number; {raw} is not read"
    keys = {"columns": columns, "number_rows": {"pose": 1}}
    return replace(guess, mapping={**guess.mapping, **keys}, doubts=(*guess.doubts, doubt))


@dataclass(frozen=True)
class _Log:
    """Poses of a log, and whether they are the numbers of its rows."""

    poses: tuple[str, ...] = ()
    is_counted: bool = False


def _log(folder: Path, group: RawGroup, guess: Guess, table: str = "configurations") -> _Log:
    try:
        batch = first_rows(folder, group.example, table, "photogrammetry", guess.mapping)
    except CampaignFaults:
        return _Log()
    if batch is None or group.count > 1:
        return _Log()
    return _Log(tuple(map(str, batch.columns["pose"].to_pylist())), "pose" in guess.mapping.get("number_rows", {}))


def _moved_body(log: Guess, robot: Robot | None) -> str:
    """The body that a log moves: the tip of a robot; a placeholder if it is not known."""
    return robot.tip if robot is not None else last_link(None, [log]) or PLACEHOLDER


def _read_as_poses(folder: Path, group: RawGroup, guess: Guess, log: _Log, body: str) -> Guess:
    guess_of_all, guess = guess, _without_group(folder, group, guess)
    raw = guess.mapping.get("columns", {}).get("target") or target_column(guess.mapping.get("format", ""))
    if guess.table not in ("points", "targets") or guess.known or not is_body_open(guess) or raw is None:
        return guess_of_all
    if group.count > 1 and "(?P<pose>" in guess.mapping.get("from_name", ""):
        return _single_target(folder, group, guess_of_all, body)
    constants: dict[str, str | int] = {"pose": 1, "body": PLACEHOLDER}
    rows = rows_of_files(folder, group, replace(guess, table="points"), constants, most=_MOST_ROWS)
    numbers = [] if rows is None else _numbers(rows.targets)
    keys = _numbering(numbers, log, raw, guess)
    if len(numbers) < _FEWEST or keys is None:
        return guess_of_all
    stem = rows.targets[0] if rows is not None else ""
    doubt = f"places such as {stem} are assumed to be one target on {body} in as many poses"
    found = replace(guess, table="points", mapping={**of_one_target(guess, body), **keys})
    if body != PLACEHOLDER:  # the log has these poses, and moves this body
        return replace(found, doubts=(*guess.doubts, doubt), answered=guess.answered | {"body"})
    question = f"{stem}: its number is that of the pose, or part of the name of the target"
    way = OtherWay("numbers", question, "poses", "targets", guess_of_all, doubt)
    return replace(found, ways=(*guess.ways, way))


def _without_group(folder: Path, group: RawGroup, guess: Guess) -> Guess:
    """The guess without the group in names such as A::Calib::jp10, if all of them have the same: it is no body."""
    split = guess.mapping.get("split", {})
    grouped = {
        raw: text.replace("(?P<body>", "(?P<group>").replace("(?P<target>", f"(?P<{_PLACE}>")
        for raw, text in split.items()
    }
    if group.count > 1 or grouped == split:
        return guess
    rows = rows_of(folder, group, replace(guess, table="points"), {"pose": 1}, most=_MOST_ROWS)
    if rows is None or len(set(rows.bodies)) > 1:
        return guess
    columns = {key: raw for key, raw in guess.mapping["columns"].items() if key != "target"}
    return replace(guess, mapping={**guess.mapping, "split": grouped, "columns": {**columns, "target": _PLACE}})


def _numbers(names: Sequence[str]) -> list[int]:
    """The numbers of names with one stem, each once; empty for other names."""
    found = [_NUMBERED.fullmatch(name) for name in names]
    numbers = [int(match["number"]) for match in found if match is not None]
    stems = {match["stem"].casefold() for match in found if match is not None}
    return numbers if len(numbers) == len(names) == len(set(numbers)) and len(stems) == 1 else []


def _numbering(numbers: Sequence[int], log: _Log, raw: str | int, guess: Guess) -> MappingKeys | None:
    """Keys that give each place its pose: the number of its name, shifted if need be, or the number of its row.

    None if the log has other poses. A log whose rows are counted has no numbers of its own. A list from 0 on is
    shifted; one of the same length with other numbers is used in its order.
    """
    by_name: MappingKeys = {"split": {**guess.mapping.get("split", {}), str(raw): NUMBER_OF_POSE}}
    logged = {int(pose) for pose in log.poses if pose.isdecimal()}
    if not numbers or not logged:
        return None
    if not log.is_counted:
        both = len(logged.intersection(numbers))
        return by_name if both >= _COVERED * max(len(numbers), len(logged)) else None
    shift = min(logged) - min(numbers)
    is_within = max(numbers) + shift <= max(logged) and len(numbers) >= _COVERED * len(logged)
    if min(numbers) in (0, 1) and is_within:
        return by_name if shift == 0 else {**by_name, "offset": {"pose": shift}}
    return {"number_rows": {"pose": min(logged)}} if len(numbers) == len(logged) else None


def _single_target(folder: Path, group: RawGroup, guess: Guess, body: str) -> Guess:
    """The guess for files of one pose each, if they hold one place: it is on the body that the log moves."""
    rows = rows_of(folder, group, guess, {"body": PLACEHOLDER})
    if rows is None or len(rows.targets) != 1 or body == PLACEHOLDER:
        return guess
    doubt = f"the only place in each file is assumed to be one target on {body}"
    return replace(
        guess, mapping=of_one_target(guess, body), doubts=(*guess.doubts, doubt), answered=guess.answered | {"body"}
    )
