"""Next steps for files that `truing init` does not read, or whose rows do not belong together."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from truing.formats.compression import DAMAGED, open_plain

if TYPE_CHECKING:
    from truing.formats.guess import Guess
    from truing.pipeline.init_entries import RawGroup

BY_HAND = "docs/own-files.md"
_WHAT_IS_READ = (
    "no page can be made without a table. truing reads points or poses of bodies, beside readings of joints or legs "
    "for a machine; positions of one axis (command and reading in the same row, or runs over targets); and loads "
    "beside signals of a force sensor. Instruments: docs/how-to/index.md"
)
_FEWEST = 5
_MOST_BYTES = 1 << 22


def next_steps(files: Sequence[tuple[RawGroup, Guess]]) -> list[str]:
    """Return sentences on what to do with files that are not recognised, or have another number of rows."""
    is_other = any(guess.table is None and not guess.known for _, guess in files)
    has_tables = any(guess.table is not None for _, guess in files)
    return [
        *_rows_side_by_side(files),
        *_rows_that_differ(files),
        *([f"files that are not recognised are read by entries written by hand: {BY_HAND}"] if is_other else []),
        *([] if has_tables else [_WHAT_IS_READ]),
    ]


def _rows_side_by_side(files: Sequence[tuple[RawGroup, Guess]]) -> list[str]:
    """Return sentences on files that are not recognised, and have as many rows of a table as another file."""
    rows = {group.glob: _rows(group, guess) for group, guess in files if group.count == 1 and guess.columns}
    unread = [group.glob for group, guess in files if group.glob in rows and guess.table is None and not guess.known]
    reported: set[str] = set()
    sentences = []
    for name in unread:
        alike = [other for other, count in rows.items() if other != name and count == rows[name] >= _FEWEST]
        if alike and not {name, *alike} & reported:
            reported |= {name, *alike}
            sentences.append(
                f"{name} and {alike[0]} have {rows[name]} rows each: if these belong together, put the columns of both "
                f"into one file, and call truing init again"
            )
    return sentences


def _rows_that_differ(files: Sequence[tuple[RawGroup, Guess]]) -> list[str]:
    """Return sentences on measured poses that are numbered as the rows of a log which has another number of rows."""
    counted = [
        (group, guess)
        for group, guess in files
        if group.count == 1 and "pose" in guess.mapping.get("number_rows", {}) and "format" not in guess.mapping
    ]
    logs = [one for one in counted if one[1].table == "configurations"]
    if len(logs) != 1 or not (rows := _rows(*logs[0])):
        return []
    rows_by_group = {group.glob: _rows(group, guess) for group, guess in counted if guess.table in ("poses", "points")}
    return [
        f"{name} has {count} rows, {logs[0][0].glob} has {rows}, and no column relates them: give both a column "
        f"pose, or times of clocks that differ by a constant"
        for name, count in rows_by_group.items()
        if count not in (0, rows)
    ]


def _rows(group: RawGroup, guess: Guess) -> int:
    return len(records_of(group.example, guess))


def records_of(path: Path, guess: Guess) -> list[list[str]]:
    """Return the rows of a text's table by a guess, as cells; empty if it cannot be read."""
    from truing.formats.delimited import guess_separator, split_record

    keys = guess.mapping
    try:
        with open_plain(path) as stream:
            text = stream.read(_MOST_BYTES).decode(keys.get("encoding", "utf-8-sig"), errors="replace")
    except (*DAMAGED, OSError, LookupError):
        return []
    lines = [line for line in text.splitlines()[keys.get("skip_lines", 0) :] if line.strip()]
    lines = [line for line in lines if "comment" not in keys or not line.lstrip().startswith(keys["comment"])]
    given = keys.get("separator") or guess_separator(lines[len(lines) // 3 :], '"')
    separator = {"tab": "\t", "blank": " "}.get(given, given)
    records = [split_record(line.encode(), separator, '"') for line in lines]
    complete = [record for record in records if len(record) == len(guess.columns)]
    return complete[int(keys.get("header", True)) :]
