"""Reports of inspection programs with a row for each coordinate of a point: PolyWorks, Calypso, PC-DMIS and others.

A table names the axis of a row in one of its cells, and the measured value in a column of its own; the name of the
point may stand in its first row alone. PC-DMIS writes a block for each point, with the name above it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from truing.formats.heading import unit_in_words
from truing.formats.raw import RawBatch, Unusable, Wanted, one_batch
from truing.formats.text import utf8_chunks
from truing.formats.units import bare_and_unit, known_unit
from truing.schemas.mapping import FileMapping

COLUMNS = ("part", "name", "x", "y", "z")
_LARGEST = 1 << 27
_SEPARATORS = ("\t", ";", "|", ",")
_AXIS = re.compile(r"(?P<axis>[xyz])[\s_-]?(value|wert|coord(inate)?|koord(inate)?|pos(ition)?)?", re.IGNORECASE)
_MEASURED = re.compile(
    r"meas(ured)?([ _]?value)?|act(ual)?([ _]?value)?|ist(wert)?|mess(wert)?|gemessen|mesur(é|e)", re.IGNORECASE
)
_FEATURE = re.compile(r"feature[ _]?(id|name)?|element|merkmal|(object|objekt)([ _]?name)?", re.IGNORECASE)
_NAME = re.compile(r"name|point|punkt|label|id|characteristic|dim(ension)?", re.IGNORECASE)
_PART = re.compile(
    r"part[ _]?(nb|no|nr|number|id)|piece([ _]?(no|number|name))?|teil(e?nr|nummer)?|serial", re.IGNORECASE
)
_UNIT = re.compile(r"units?|einheit", re.IGNORECASE)
_OF_AXIS = re.compile(r"[XYZ][\s_-]*(value|wert|coord(inate)?|koord(inate)?)?[\s_.-]+|[\s_.-]+[XYZ]$", re.IGNORECASE)
_BLOCK = re.compile(r"\s*DIM\s+\S+\s*=\s*(?:LOCATION|POSITION)\s+OF\s+\w+\s+(?P<name>\S+)\s+UNITS\s*=\s*(?P<unit>\w+)")
_BLOCK_HEAD = re.compile(r"\s*AX\s+.*\bMEAS\b")
_FEWEST_POINTS = 2


@dataclass(frozen=True)
class InspectedPoints:
    """Points of a report: part, name and coordinates as written (empty if missing), the line of each, and the unit."""

    rows: tuple[tuple[str, str, str, str, str], ...]
    lines: tuple[int, ...]
    unit: str | None


def read_inspection(path: Path, wanted: Wanted, entry: FileMapping) -> Iterator[RawBatch]:
    """Yield one row per point: part, name, x, y, z; a coordinate that no row states is empty.

    Raises Unusable if the file is no such report.
    """
    if path.stat().st_size > _LARGEST:
        raise Unusable(f"text of at most {_LARGEST >> 20} MB")
    with path.open("rb") as stream:
        text = b"".join(utf8_chunks(stream, entry.encoding)).decode()
    points = inspected_points(text.splitlines())
    if points is None:
        raise Unusable("a row for each coordinate: its axis X, Y or Z in one column, the measured value in another")
    columns = dict(zip(COLUMNS, map(list, zip(*points.rows, strict=True)), strict=True))
    yield from one_batch(columns, wanted, points.unit, points.lines)


def inspected_points(lines: Sequence[str]) -> InspectedPoints | None:
    """Return the points of a report's lines; None if it is none."""
    return _points_of_blocks(lines) or _points_of_table(lines)


def _points_of_blocks(lines: Sequence[str]) -> InspectedPoints | None:
    """Return the points of blocks as PC-DMIS writes them."""
    values: list[tuple[int, str, str, str]] = []
    units: set[str | None] = set()
    name, point = "", None
    for number, line in enumerate(lines, start=1):
        if match := _BLOCK.match(line):
            name, point = match["name"].rstrip(","), None
            units.add(known_unit(match["unit"].lower()))
        elif _BLOCK_HEAD.match(line):
            point = line.split().index("MEAS")
        elif name and point is not None and re.match(r"\s*[XYZ]\s", line):
            cells = line.split()
            if len(cells) > point:
                values.append((number, name, cells[0].lower(), cells[point]))
    return _points(values, {name: "" for _, name, _, _ in values}, units.pop() if len(units) == 1 else None)


def _points_of_table(lines: Sequence[str]) -> InspectedPoints | None:
    """Return the points of a table with a row for each coordinate."""
    for separator in _SEPARATORS:
        cells = [[cell.strip().strip('"') for cell in line.split(separator)] for line in lines]
        head = next((i for i, row in enumerate(cells) if _first(row, _MEASURED) is not None and len(row) > 2), None)
        if (
            head is not None
            and (points_in_table := _points_of_rows(cells, head, unit_in_words(lines[:head]))) is not None
        ):
            return points_in_table
    return None


def _points_of_rows(cells: Sequence[Sequence[str]], head: int, unit: str | None) -> InspectedPoints | None:
    names, rows = (
        cells[head],
        [(i + 1, row) for i, row in enumerate(cells) if i > head and len(row) == len(cells[head])],
    )
    measured, axis = _first(names, _MEASURED), _axis_column([row for _, row in rows], len(names))
    named = _first(names, _FEATURE)
    named = _first(names, _NAME) if named is None else named
    if measured is None or axis is None or named is None:
        return None
    part, of_unit = _first(names, _PART), _first(names, _UNIT)
    values: list[tuple[int, str, str, str]] = []
    parts: dict[str, str] = {}
    units, prefix = {bare_and_unit(names[measured])[1]}, ""
    for number, row in rows:
        prefix = row[named] or prefix
        if (match := _AXIS.fullmatch(row[axis])) is None:
            continue
        bare = _OF_AXIS.sub("", prefix) or prefix if named != axis else prefix
        key = f"{row[part]}\0{bare}" if part is not None else bare
        parts[key] = row[part] if part is not None else ""
        values.append((number, key, match["axis"].lower(), row[measured]))
        units |= {known_unit(row[of_unit])} if of_unit is not None else set()
    stated = units - {None}
    return _points(values, parts, stated.pop() if len(stated) == 1 else unit)


def _axis_column(rows: Sequence[Sequence[str]], width: int) -> int | None:
    """Return the column whose cells name all three axes, one in each row that has a coordinate."""
    for index in range(width):
        axis_letters = [match["axis"].lower() for row in rows if (match := _AXIS.fullmatch(row[index]))]
        if set(axis_letters) == set("xyz") and 2 * len(axis_letters) >= len(rows):
            return index
    return None


def _first(names: Sequence[str], pattern: re.Pattern[str]) -> int | None:
    return next((i for i, name in enumerate(names) if pattern.fullmatch(bare_and_unit(name)[0])), None)


def _points(
    values: Sequence[tuple[int, str, str, str]], parts: dict[str, str], unit: str | None
) -> InspectedPoints | None:
    """Return points of line, name, axis and value; a second value of an axis begins another point of the same name."""
    rows: list[tuple[str, str, dict[str, str]]] = []
    lines: list[int] = []
    for number, key, axis, value in values:
        if not rows or rows[-1][0] != key or axis in rows[-1][2]:
            rows.append((key, parts[key], {}))
            lines.append(number)
        rows[-1][2][axis] = value
    complete = sum(len(coordinates) == len("xyz") for _, _, coordinates in rows)
    if complete < _FEWEST_POINTS or 2 * complete < len(rows):
        return None
    point_rows = tuple(
        (part, key.rpartition("\0")[2], coordinates.get("x", ""), coordinates.get("y", ""), coordinates.get("z", ""))
        for key, part, coordinates in rows
    )
    return InspectedPoints(point_rows, tuple(lines), unit)
