"""Bodies of a machine on legs whose names are in the rows of a file, such as BASE and PLATE, for `truing init`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from truing.pipeline.init_machine import body_of_legs, columns_of
from truing.pipeline.init_survey import rows_of_files

if TYPE_CHECKING:
    from truing.formats.guess import Guess
    from truing.pipeline.init_entries import RawGroup

    _File = tuple["RawGroup", Guess]

_BODIES = {"base", "platform"}
_MOST_ROWS = 20_000


def with_renamed_bodies(folder: Path, files: Sequence[_File]) -> list[_File]:
    """Rename two bodies of points to base and platform next to readings of legs, if their words say which is which."""
    has_legs = any("rho1_mm" in columns_of(guess) or "legs" in guess.machine for _, guess in files)
    return [(group, _renamed(folder, group, guess) if has_legs else guess) for group, guess in files]


def _renamed(folder: Path, group: RawGroup, guess: Guess) -> Guess:
    if guess.table not in ("points", "targets") or guess.known or "body" in guess.mapping.get("constants", {}):
        return guess
    rows = rows_of_files(folder, group, guess, {"pose": 1}, most=_MOST_ROWS)
    named = {} if rows is None else {body: body_of_legs(body) for body in dict.fromkeys(rows.bodies)}
    if set(named) == _BODIES or len(named) != len(_BODIES) or set(named.values()) != _BODIES:
        return guess
    renames = guess.mapping.get("rename", {})
    words = {re.escape(raw): body for raw, body in named.items()}
    doubt = ", ".join(f"{raw} is taken for {body}" for raw, body in named.items())
    keys = {**guess.mapping, "rename": {**renames, "body": {**renames.get("body", {}), **words}}}
    return replace(guess, mapping=keys, doubts=(*guess.doubts, doubt))
