"""Proposals for tables with columns of angles in degrees, minutes and seconds."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from truing.formats.guess import Guess
from truing.formats.sexagesimal import UNIT, degrees_of, is_marked_angle
from truing.formats.units import bare_and_unit

_LEAST = 0.8  # share of the cells of a column that are such angles
_DIGITS = 9  # of a degree: 4 microseconds of arc


def with_angles(records: list[list[str]], sniff: Callable[[list[list[str]]], Guess]) -> Guess:
    """Return the proposal for records, whose sexagesimal angles it sees in decimal degrees under heads with that
    unit."""
    columns = [list(column) for column in zip(*records, strict=True)]
    raw_names: dict[str, str] = {}
    for column in filter(_holds_angles, columns):
        column[1:] = map(_decimal, column[1:])
        if degrees_of(column[0]) is None:
            head = head_of_angles(column[0])
            raw_names[head], column[0] = column[0], head
    if not raw_names:
        return sniff(records)
    guess = with_raw_names(sniff([list(record) for record in zip(*columns, strict=True)]), raw_names)
    units = dict.fromkeys(raw_names.values(), UNIT)
    return guess if guess.table is not None else replace(guess, mapping={**guess.mapping, "units": units})


def head_of_angles(raw: str) -> str:
    """Return the name of a column with the unit of sexagesimal angles, as proposals read it."""
    return f"{bare_and_unit(raw)[0]} [{UNIT}]"


def _holds_angles(column: Sequence[str]) -> bool:
    cells = [cell for cell in column if cell.strip()]
    return bool(cells) and sum(map(is_marked_angle, cells)) >= _LEAST * len(cells)


def _decimal(cell: str) -> str:
    """Return a cell with decimal degrees, with the decimal mark of its seconds; other cells as they are."""
    angle = degrees_of(cell)
    text = cell if angle is None else f"{angle:.{_DIGITS}f}"
    return text.replace(".", ",") if angle is not None and "," in cell else text


def with_raw_names(guess: Guess, raw_names: Mapping[str, str]) -> Guess:
    """Return a proposal, in each of its ways, with the file's own names."""
    words = {**raw_names, **{_as_pattern(head): _as_pattern(raw) for head, raw in raw_names.items()}}
    return replace(
        guess,
        mapping=_renamed(guess.mapping, words),
        columns=tuple(raw_names.get(name, name) for name in guess.columns),
        doubts=tuple(_in_words(doubt, raw_names) for doubt in guess.doubts),
        other_tables=tuple(with_raw_names(one, raw_names) for one in guess.other_tables),
        ways=tuple(
            replace(
                way,
                text=_in_words(way.text, raw_names),
                doubt=_in_words(way.doubt, raw_names),
                guess=with_raw_names(way.guess, raw_names),
            )
            for way in guess.ways
        ),
    )


def _as_pattern(name: str) -> str:
    return re.escape(name).replace("\\ ", " ")


def _renamed(value: Any, words: Mapping[str, str]) -> Any:
    if isinstance(value, dict):
        return {key: _renamed(one, words) for key, one in value.items()}
    if isinstance(value, list):
        return [_renamed(one, words) for one in value]
    return _in_words(value, words) if isinstance(value, str) else value


def _in_words(text: str, words: Mapping[str, str]) -> str:
    for head, raw in words.items():
        text = text.replace(head, raw)
    return text
