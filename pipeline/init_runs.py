"""Files of several runs that each number their poses from 1, for `truing init`: later runs get an offset."""

from __future__ import annotations

import glob
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from truing.pipeline.init_preview import named_cells

if TYPE_CHECKING:
    from truing.formats.guess import Guess
    from truing.pipeline.init_entries import RawGroup

    _File = tuple["RawGroup", Guess]

_KEYS = {"configurations": ("pose",), "poses": ("pose", "body"), "points": ("pose", "body", "target")}
_MOST_RUNS, _MOST_ROWS = 40, 200_000


@dataclass(frozen=True)
class _RunFile:
    """One file of a group: its name, the keys of its rows, and its poses, which are whole numbers."""

    name: str
    rows: frozenset[tuple[str, ...]]
    poses: frozenset[int]


def with_runs_apart(folder: Path, files: Sequence[_File]) -> tuple[list[_File], list[str]]:
    """Return the files, each run with an offset of its own where files repeat the poses of others; and what was seen.

    Only whole numbers are moved. A single log has to hold the poses that result; otherwise the files may be repeats of
    its poses, and stay as they are.
    """
    read = [_runs(folder, group, guess) for group, guess in files]
    repeated = [runs is not None and _repeats(runs) for runs in read]
    runs_of = [runs for runs, is_repeated in zip(read, repeated, strict=True) if is_repeated and runs is not None]
    if not runs_of:
        return list(files), []
    globs = ", ".join(group.glob for (group, _), is_repeated in zip(files, repeated, strict=True) if is_repeated)
    offsets = _offsets(runs_of)
    logged = _logged(folder, files, repeated)
    if offsets is None or (logged is not None and not _within(runs_of, offsets, logged)):
        why = "not as many in each" if offsets is None else "the log has no poses behind those of the first file"
        seen = f"{globs}: files repeat the same poses, {why}: repeated measurements, or runs? "
        return list(files), [f"{seen}If they are runs, give each file an entry with an offset of its poses"]
    last = ", ".join(f"+{offset}" for offset in offsets[1:])
    seen = f"{globs}: each file numbers its poses from the same one on; taken as runs with further poses ({last}). "
    seen += "If files repeat the same poses, remove offset and keep one"
    result: list[_File] = []
    for (group, guess), runs, is_repeated in zip(files, read, repeated, strict=True):
        if not is_repeated or runs is None:
            result.append((group, guess))
            continue
        result += [_of_run(group, guess, run, offset) for run, offset in zip(runs, offsets, strict=True)]
    return result, [seen]


def _of_run(group: RawGroup, guess: Guess, run: _RunFile, offset: int) -> _File:
    """Return the entry of a single file, with what its poses lack."""
    example = group.example.parent / run.name
    path = (Path(group.glob).parent / glob.escape(run.name)).as_posix()
    own = replace(group, glob=path, example=example, count=1, names=(run.name,), path=path)
    if not offset:
        return own, guess
    doubt = f"a further run: {offset} is added to its poses, which files before it have too"
    offsets = {**guess.mapping.get("offset", {}), "pose": offset}
    return own, replace(guess, mapping={**guess.mapping, "offset": offsets}, doubts=(*guess.doubts, doubt))


def _runs(folder: Path, group: RawGroup, guess: Guess) -> list[_RunFile] | None:
    """Return the files of a group in natural order; None where their poses are no whole numbers of each file."""
    keys = guess.mapping
    if guess.table not in _KEYS or not 2 <= group.count <= _MOST_RUNS or guess.known:
        return None
    if "(?P<pose>" in str(keys.get("from_name", "")) or any("pose" in keys.get(key, {}) for key in _FIXED):
        return None
    runs = [_run(folder, group.example.parent / name, guess) for name in sorted(group.names, key=_natural)]
    return None if any(run is None for run in runs) else [run for run in runs if run is not None]


_FIXED = ("join", "constants", "rename", "offset")


def _run(folder: Path, path: Path, guess: Guess) -> _RunFile | None:
    table = str(guess.table)
    rows = named_cells(folder, path, table, "photogrammetry", guess.mapping, _KEYS[table], _MOST_ROWS)
    if not rows:
        return None
    poses = {row[0] for row in rows}
    if not all(re.fullmatch(r"\d+", pose) for pose in poses):
        return None
    return _RunFile(path.name, frozenset(rows), frozenset(map(int, poses)))


def _repeats(runs: Sequence[_RunFile]) -> bool:
    """True if every file repeats rows of the first one: its poses, with the same bodies and targets."""
    first = runs[0]
    return all(run.rows & first.rows and min(run.poses) == min(first.poses) for run in runs[1:])


def _offsets(runs_of: Sequence[Sequence[_RunFile]]) -> list[int] | None:
    """Return the offset of each run, the same for all tables; None where these have different numbers of files."""
    if len({len(runs) for runs in runs_of}) > 1:
        return None
    offsets = [0]
    for files in zip(*runs_of, strict=True):
        poses = set[int]().union(*(run.poses for run in files))
        offsets.append(offsets[-1] + max(poses) - min(poses) + 1)
    return offsets[:-1]


def _logged(folder: Path, files: Sequence[_File], repeated: Sequence[bool]) -> set[int] | None:
    """Return the poses of a log that repeats none; None without such a log."""
    logs = [
        _run(folder, group.example, guess)
        for (group, guess), is_repeated in zip(files, repeated, strict=True)
        if guess.table == "configurations" and not is_repeated and not guess.known
    ]
    return None if not logs else set[int]().union(*(log.poses for log in logs if log is not None))


def _within(runs_of: Sequence[Sequence[_RunFile]], offsets: Sequence[int], logged: set[int]) -> bool:
    moved = {pose + offset for runs in runs_of for run, offset in zip(runs, offsets, strict=True) for pose in run.poses}
    return moved <= logged


def _natural(name: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (0, part) for part in re.split(r"(\d+)", name)]
