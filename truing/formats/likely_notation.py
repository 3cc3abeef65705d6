"""Notation in which the numbers of a file are probably written."""

from __future__ import annotations

import re

from truing.formats.numbers import Notation

COMMA_DECIMAL, COMMA_THOUSANDS = Notation(",", None), Notation(".", ",")
_OPEN_COMMA = re.compile(r"[-+]?[1-9]\d{0,2},\d{3}")
_NOTATIONS = (
    Notation(".", None),
    COMMA_DECIMAL,
    COMMA_THOUSANDS,
    Notation(",", "."),
    Notation(".", "'"),
    Notation(",", " "),
)


def ambiguous_comma(records: list[list[str]]) -> str | None:
    """Return a number whose comma may separate thousands as well; None if another cell decides."""
    commas = [cell for record in records[1:] or records for cell in record if "," in cell]
    return commas[0] if all(_OPEN_COMMA.fullmatch(cell.strip()) for cell in commas) else None


def likely_notation(records: list[list[str]]) -> Notation:
    """Return the notation that reads most cells; the simplest among equals."""
    cells = [cell for record in records for cell in record]
    return max(_NOTATIONS, key=lambda notation: sum(is_number(cell, notation) for cell in cells))


def is_number(cell: str, notation: Notation) -> bool:
    return re.match(notation.pattern, cell.strip()) is not None
