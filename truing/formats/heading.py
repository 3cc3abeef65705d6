"""Names of the columns of an unknown table: in one row, in several rows with units below, or in a comment."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from truing.formats.units import is_like_a_unit, known_unit

_MOST_ROWS = 8  # of a heading
_NUMBER = "#"
_NO_UNIT = {"", "-", "--", "[-]", "[]"}
_UNIT_LINE = re.compile(
    r"\b(?:units?|einheit(?:en)?|unités?)(?:\s+(?:are|in|is|of (?:measure(?:ment)?|length)))*"
    r"[\s:=;,]*[\"'\[(]?(?P<unit>[A-Za-zµμ]+)",
    re.IGNORECASE,
)
_UNIT_BEHIND_AXES = re.compile(  # one unit behind the names of all coordinates: X Y Z (mm)
    r"\bx\b[^()\[\]]*\by\b[^()\[\]]*\bz\b[^()\[\]]*[(\[](?P<unit>[^()\[\]]+)[)\]]\s*$", re.IGNORECASE
)
_SERIAL_NUMBER = re.compile(r"[\dA-Fa-f-]{8,}|\d+")
# Formats of dates and times below their column, as dd.mm.yyyy hh:mm:ss
_PATTERN_OF_TIME = re.compile(r"(?=.*[./:-])(?=.*(?:dd|tt|yy|jj|hh))[dtmyjhsf0\s./:,-]+", re.IGNORECASE)
Row = Sequence[str]


@dataclass(frozen=True)
class Heading:
    """Names of the columns, and the number of rows above the first row of data.

    ``is_row``: the row above the data alone holds the names; otherwise they are composed, or in a comment.
    """

    names: tuple[str, ...]
    rows: int
    is_row: bool = False


def heading_of(records: Sequence[Row], is_number: Callable[[str], bool], comments: Sequence[Row] = ()) -> Heading:
    """Return the names of records of equally many cells; positions from 1 if no row and no comment holds names."""
    rows = _rows_of_names(records, is_number)
    if rows > 1 and (names := _composed(records[:rows], is_number)) is not None:
        return Heading(names, rows)
    if rows:
        return Heading(tuple(records[0]), 1, is_row=True)
    if (named := _names_in_comment(len(records[0]), is_number, comments)) is not None:
        return Heading(named, 0)
    return Heading(tuple(str(number + 1) for number in range(len(records[0]))), 0)


def unit_in_words(lines: Sequence[str]) -> str | None:
    """Return the unit that lines such as ``Units: Inches`` state; None without one, or if they differ."""
    found = [match for line in lines if (match := _UNIT_LINE.search(line) or _UNIT_BEHIND_AXES.search(line))]
    units_found = {known_unit(match["unit"]) for match in found} - {None}
    return units_found.pop() if len(units_found) == 1 else None


def _rows_of_names(records: Sequence[Row], is_number: Callable[[str], bool]) -> int:
    """Return the number of rows before the first row of data: 0 if the first row holds numbers, and a row follows."""
    if len(records) < 2 or any(map(is_number, records[0])):
        return 0
    numbers = [sum(map(is_number, record)) for record in records]
    usual = max(
        Counter(numbers[len(numbers) // 2 :]).items(), key=lambda counted_number: (counted_number[1], counted_number[0])
    )[0]
    data = next((i for i, count in enumerate(numbers) if 0 < usual <= 2 * count and _is_data(records[i], is_number)), 1)
    return data if 1 <= data <= _MOST_ROWS and data < len(records) else 1


def _is_data(record: Row, is_number: Callable[[str], bool]) -> bool:
    """True unless all cells with numbers are serial numbers in a row whose other cells are empty or texts."""
    return not all(_SERIAL_NUMBER.fullmatch(cell.strip()) for cell in record if is_number(cell)) or is_number(record[0])


def _composed(rows: Sequence[Row], is_number: Callable[[str], bool]) -> tuple[str, ...] | None:
    """Return names composed from rows: units of the last row, and words of the others if needed to tell columns."""
    if any(any(map(is_number, row)) and not _is_serial(row) for row in rows):
        return None
    *above, last = [[cell.strip() for cell in row] for row in rows]
    units = last if _are_units(last) else None
    if units is None:
        above.append(last)
    if not above or (units is None and len(above) < 2):
        return None
    *others, base = above
    base = _with_units_of_cells(others[-1], base) if others and units is None else base
    group_rows = [_filled(row) for row in others if _names_groups(row)] if _repeats(base) else []
    is_ambiguous = [base.count(name) > 1 or not name for name in base]  # a name of its own needs no words above it
    group_rows = [
        row for row in group_rows if len({cell for cell, needed in zip(row, is_ambiguous, strict=True) if needed}) > 1
    ]
    names = [
        ".".join(dict.fromkeys(filter(None, cells))) if needed else cells[-1]
        for needed, cells in zip(is_ambiguous, zip(*group_rows, base, strict=True), strict=True)
    ]
    if units is not None:
        bare = [cell.strip("[]() ") for cell in units]
        names = [
            f"{name} [{unit}]" if name and unit not in _NO_UNIT and not _PATTERN_OF_TIME.fullmatch(unit) else name
            for name, unit in zip(names, bare, strict=True)
        ]
    named = [name for name in names if name]
    if len(set(named)) < len(named):
        return None
    return tuple(name or str(number) for number, name in enumerate(names, start=1))


def _with_units_of_cells(above: Sequence[str], base: Sequence[str]) -> list[str]:
    """Return names, in which a unit alone belongs to the word above it."""
    return [
        f"{word} [{cell.strip('[]() ')}]" if word and known_unit(cell.strip("[]() ")) is not None else cell
        for word, cell in zip(above, base, strict=True)
    ]


def _are_units(row: Sequence[str]) -> bool:
    cells = [cell for cell in row if cell not in _NO_UNIT and not _PATTERN_OF_TIME.fullmatch(cell)]
    known = sum(known_unit(cell.strip("[]() ")) is not None for cell in cells)
    return 2 * known > len(cells) and all(is_like_a_unit(cell) for cell in cells)


def _repeats(names: Sequence[str]) -> bool:
    named = [name for name in names if name]
    return len(set(named)) < len(named) or len(named) < len(names)


def _names_groups(row: Sequence[str]) -> bool:
    """True if a row names groups of columns: several words that are no serial numbers."""
    words = {cell for cell in row if cell}
    return len(words) > 1 and not _is_serial(row)


def _is_serial(row: Row) -> bool:
    """True if all cells are serial numbers, but for the word that says so."""
    cells = [cell.strip() for cell in row if cell.strip()]
    return all(_SERIAL_NUMBER.fullmatch(cell) for cell in (cells[1:] if cells and cells[0].upper() == "ID" else cells))


def _filled(row: Sequence[str]) -> list[str]:
    """Return a row whose empty cells hold the text before them, as merged cells are exported."""
    last_name, filled = "", []
    for cell in row:
        last_name = cell or last_name
        filled.append(last_name)
    return filled


def _with_units_behind(cells: Sequence[str]) -> list[str]:
    """Return cells in which a unit in brackets belongs to the name before it, as blanks part them."""
    joined: list[str] = []
    for cell in cells:
        if joined and cell.startswith(("[", "(")):
            joined[-1] += f" {cell}"
        else:
            joined.append(cell)
    return joined


def _names_in_comment(width: int, is_number: Callable[[str], bool], comments: Sequence[Row]) -> tuple[str, ...] | None:
    """Return the cells of the last comment that has a name for each column."""
    for cells in reversed(comments):
        named = [cell.strip() for cell in cells]
        if named:
            named[0] = named[0].lstrip("# ") or _NUMBER  # the mark of a comment was its name
        if len(named) == width + 1 and _UNIT_BEHIND_AXES.search(" ".join(named)):
            named = named[:width]
        elif len(named) > width:
            named = _with_units_behind(named)
        if len(named) == width and all(named) and len(set(named)) == width and not any(map(is_number, named)):
            return tuple(named)
    return None
