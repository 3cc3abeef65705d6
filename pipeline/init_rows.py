"""Files whose rows may belong together, for `truing init`: as many rows in each, but no table that holds both."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from truing.formats.compression import DAMAGED, open_plain

if TYPE_CHECKING:
    from truing.formats.guess import Guess
    from truing.pipeline.init_entries import RawGroup

_FEWEST = 5
_MOST_BYTES = 1 << 22


def rows_side_by_side(folder: Path, files: Sequence[tuple[RawGroup, Guess]]) -> list[str]:
    """Return sentences on files that are not recognised, and have as many rows of a table as another file."""
    rows = {group.glob: _rows(group, guess) for group, guess in files if group.count == 1 and guess.columns}
    unread = [group.glob for group, guess in files if group.glob in rows and guess.table is None and not guess.known]
    told: set[str] = set()
    sentences = []
    for name in unread:
        alike = [other for other, count in rows.items() if other != name and count == rows[name] >= _FEWEST]
        if alike and not {name, *alike} & told:
            told |= {name, *alike}
            sentences.append(
                f"{name} and {alike[0]} have {rows[name]} rows each: if these belong together, put the columns of both "
                f"into one file, and call truing init again"
            )
    return sentences


def _rows(group: RawGroup, guess: Guess) -> int:
    """Lines of a file from its first row of data on that have as many cells as its table; 0 if it cannot be read."""
    from truing.formats.delimited import split_record

    separator = {"tab": "\t", "blank": " "}.get(guess.mapping.get("separator", ","), guess.mapping.get("separator", ","))
    try:
        with open_plain(group.example) as stream:
            text = stream.read(_MOST_BYTES).decode(guess.mapping.get("encoding", "utf-8-sig"), errors="replace")
    except (*DAMAGED, OSError):
        return 0
    lines = text.splitlines()[guess.mapping.get("skip_lines", 0) :]
    records = [split_record(line.encode(), separator, '"') for line in lines if line.strip()]
    has_header = guess.mapping.get("header", True)
    return sum(len(record) == len(guess.columns) for record in records) - int(has_header)
