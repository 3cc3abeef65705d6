"""Leica's GSI with 8 and 16 characters: coordinates of points, each in the unit of its word.

A line is a block of words: two digits for the quantity (11 point, 81 82 83 east north height); four characters of which
the last is the unit, a sign, 8 or 16 characters of data. A block with words of 16 characters begins with an asterisk.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from truing.formats.raw import RawBatch, Unusable, Wanted, one_batch

_LARGEST = 1 << 27
_WORD = re.compile(r"(\d\d)(....)([+-])(\S+)")
_AXES = {"81": "x", "82": "y", "83": "z"}
_FOOT = 304.8
# last character before the sign: step of the last digit, mm
_STEP_MM = {"0": 1.0, "1": 1e-3 * _FOOT, "6": 0.1, "7": 1e-4 * _FOOT, "8": 0.01}


def read_gsi(path: Path, wanted: Wanted) -> Iterator[RawBatch]:
    """Yield one row per block that begins with a point: its name, x y z in mm, null if missing.

    Raises Unusable if a line is no block, or a unit is no length.
    """
    with path.open("rb") as stream:
        content = stream.read(_LARGEST + 1)
    if len(content) > _LARGEST or b"\0" in content:
        raise Unusable(f"text of at most {_LARGEST >> 20} MB, a block of words in every line")
    rows: list[dict[str, str | float | None]] = []
    lines: list[int] = []
    for number, line in enumerate(content.decode("latin-1").splitlines(), start=1):
        if not line.strip():
            continue
        words = _words(number, line.strip())
        if words[0][0] == "11":
            rows.append(_point(number, words))
            lines.append(number)
    yield from one_batch({name: [row[name] for row in rows] for name in ("target", "x", "y", "z")}, wanted, "mm", lines)


def _words(number: int, line: str) -> list[tuple[str, str, str, str]]:
    """Return index, information, sign and data of each word."""
    length = 16 if line.startswith("*") else 8
    words_of_line = [_WORD.fullmatch(word) for word in line.lstrip("*").split()]
    if not words_of_line or any(word is None or len(word[4]) != length for word in words_of_line):
        raise Unusable(f"words of GSI-{length}: index, unit, sign, {length} characters", row=number, value=line[:80])
    return [(word[1], word[2], word[3], word[4]) for word in words_of_line if word is not None]


def _point(number: int, words: list[tuple[str, str, str, str]]) -> dict[str, str | float | None]:
    row: dict[str, str | float | None] = {"target": words[0][3].lstrip("0") or "0", "x": None, "y": None, "z": None}
    for index, information, sign, data in words[1:]:
        if index not in _AXES:
            continue
        step = _STEP_MM.get(information[-1])
        if step is None or not data.isdecimal():
            expected = f"digits, and a unit of {', '.join(_STEP_MM)} (m or ft, and how small the last digit is)"
            raise Unusable(expected, row=number, column=index, value=f"{index}{information}{sign}{data}")
        row[_AXES[index]] = (-step if sign == "-" else step) * int(data)
    return row
