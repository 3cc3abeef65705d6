"""Poses as commanded next to measured ones, for `truing init`: what a controller asked for is no measurement."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from truing.formats.guess import Guess
    from truing.pipeline.init_entries import RawGroup

_File = tuple["RawGroup", "Guess"]
_COMMANDED = re.compile(
    r"(?<![^\W\d_])(soll(werte?|posen?)?|cmds?|command(s|ed)?|nominals?|desired|programmed|planned|setpoints?"
    r"|theoretical|consignes?|reference[ _-]?poses?)(?![^\W\d_])",
    re.IGNORECASE,
)
_MEASURED = ("poses", "points")
_NOTE = (
    "poses as commanded ({word}), next to measured ones: not read. truing predicts measured poses from readings of "
    "joints: export the joints of each pose"
)


def without_commanded_poses(files: Sequence[_File]) -> list[_File]:
    """Leave out lists of poses that their file's name calls commanded, if another file has measured poses or points."""
    words = [_word(group) if guess.table == "poses" and not guess.known else "" for group, guess in files]
    is_measured = any(guess.table in _MEASURED and not word for (_, guess), word in zip(files, words, strict=True))
    return [
        (group, _not_read(guess, word) if word and is_measured else guess)
        for (group, guess), word in zip(files, words, strict=True)
    ]


def _not_read(guess: Guess, word: str) -> Guess:
    return replace(guess, table=None, known=True, mapping={}, notes=(_NOTE.format(word=word),), ways=(), doubts=())


def _word(group: RawGroup) -> str:
    """Return the word in a file's name that says commanded; empty without one."""
    match = _COMMANDED.search(Path(group.example).stem)
    return match[0] if match else ""
