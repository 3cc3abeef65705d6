"""Tables below a heading of keys and values: LabVIEW's measurement files and recordings of TwinCAT Scope."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from truing.formats.delimited import guess_separator, split_record

_LABVIEW = "LabVIEW Measurement"
_END_OF_HEADER = "***End_of_Header***"
_UNITS_OF_LABVIEW, _DIMENSION = "Y_Unit_Label", "X_Dimension"
_NUMBER = re.compile(r"[-+]?[\d.,]+(?:[eE][-+]?\d+)?")
_NAME_KEYS = ("name", "symbolname")
_UNIT_KEYS = ("unit", "y_unit")
_TIME = "time{} [ms]"  # TwinCAT counts milliseconds from the start of the recording
NUMBERS_ALONE = r"\s*[-+.\d]"  # a record of data; TwinCAT may end a file by the word EOF

Numbered = Sequence[tuple[int, str]]


@dataclass(frozen=True)
class HeadedTable:
    """Lines of data with their numbers from 0, and a name with unit for each column.

    repeated: names of columns that repeat the time of the first channel.
    """

    lines: list[tuple[int, str]]
    names: tuple[str, ...]
    repeated: tuple[str, ...] = ()


def headed_table(lines: Numbered) -> HeadedTable | None:
    """Return the table below a heading of keys and values; None for any other file.

    lines: those of the file's first part that are not empty, with their numbers from 0.
    """
    return _labview(lines) or _twincat(lines)


def _labview(lines: Numbered) -> HeadedTable | None:
    """Return the first segment of a LabVIEW measurement file (National Instruments, specification of .lvm)."""
    if not lines or not lines[0][1].startswith(_LABVIEW):
        return None
    ends = [row for row, (_, line) in enumerate(lines) if line.startswith(_END_OF_HEADER)]
    start = max(ends[:2], default=len(lines))  # the file's header ends, then that of the first segment
    if start + 2 >= len(lines):
        return None
    separator = guess_separator([line for _, line in lines[start + 2 :]], '"')
    heads = {cells[0]: cells for _, line in lines[:start] if (cells := _cells(line, separator))}
    names = _cells(lines[start + 1][1], separator)
    width = len(_cells(lines[start + 2][1], separator))
    units = [*heads.get(_UNITS_OF_LABVIEW, [""])[1:], *[""] * width]
    channels = [_with_unit(name, unit) for name, unit in zip(names[1:width], units, strict=False)]
    first = "time [s]" if heads.get(_DIMENSION, [])[1:2] == ["Time"] else names[0]
    return HeadedTable(list(lines[start + 2 :]), (first, *channels)) if len(channels) == width - 1 else None


def _twincat(lines: Numbered) -> HeadedTable | None:
    """Return a recording with pairs of columns, time and value; above each pair stand pairs of key and value."""
    separator = guess_separator([line for _, line in lines[len(lines) // 2 :]], '"')
    rows = [_cells(line, separator) for _, line in lines]
    first = next((index for index, row in enumerate(rows) if len(row) > 1 and all(map(_is_number, row))), None)
    if first is None or len(rows[first]) % 2:
        return None
    width = len(rows[first])
    pairs = {
        row[0].casefold(): row[1::2]
        for row in rows[:first]
        if len(row) == width and len(set(row[::2])) == 1 and not _is_number(row[0])
    }
    names = next((pairs[key] for key in _NAME_KEYS if key in pairs), [])
    if "sampletime[ms]" not in pairs or not all(names) or len({*names}) < width // 2:
        return None
    units = next((pairs[key] for key in _UNIT_KEYS if key in pairs), [""] * len(names))
    values = [_with_unit(name, unit) for name, unit in zip(names, units, strict=True)]
    times = [_TIME.format("" if number == 1 else f" {number}") for number in range(1, len(values) + 1)]
    named = tuple(name for pair in zip(times, values, strict=True) for name in pair)
    return HeadedTable(list(lines[first:]), named, tuple(times[1:]))


def _cells(line: str, separator: str) -> list[str]:
    return split_record(line.encode(), separator, '"')


def _is_number(cell: str) -> bool:
    return _NUMBER.fullmatch(cell.strip()) is not None


def _with_unit(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit.strip() else name
