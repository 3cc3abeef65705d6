"""Lines of a file with numbers that a key of [mechanism] names, such as a simulated matrix."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from truing.arrays import Array
from truing.formats.faultlog import FaultLog, shareable_value
from truing.formats.source import RawFile
from truing.schemas.faults import Fault
from truing.schemas.settings_text import read_settings_text

Line = tuple[int, list[str]]


def read_lines(file: RawFile, key: str, log: FaultLog) -> list[Line] | None:
    """Numbers and cells of the lines that are neither blank nor a comment; None where the file cannot be read."""
    try:
        lines = read_settings_text(file.path).splitlines()
    except (OSError, ValueError):
        log.add(Fault("campaign.toml", "an existing text file", column=f"mechanism.{key}", value=file.name))
        return None
    return [(number, _cells(line)) for number, line in enumerate(lines, 1) if line.strip() and line.lstrip()[0] != "#"]


def _cells(line: str) -> list[str]:
    separator = next((mark for mark in (";", ",", "\t") if mark in line), None)
    return [cell.strip() for cell in (line.split(separator) if separator else re.split(r"\s+", line.strip()))]


def number_of(cell: str) -> float:
    """The number in a cell; NaN where there is none."""
    try:
        return float(cell)
    except ValueError:
        return float("nan")


def numbers_of(
    file: RawFile, rows: Sequence[Line], columns: Sequence[str], expected: str, log: FaultLog, is_outside: bool
) -> Array:
    """The numbers (rows, columns); NaN where a fault was noted.

    expected: the cells of a row, in words; is_outside: the file lies outside the campaign's folder, so that a fault
    does not show its content.
    """
    matrix = np.full((len(rows), len(columns)), np.nan)
    for i, (row, cells) in enumerate(rows):
        if len(cells) != len(columns):
            log.add(Fault(file.name, expected, row=row, value=f"{len(cells)} cells"))
            continue
        for j, cell in enumerate(cells):
            matrix[i, j] = number_of(cell)
            if not np.isfinite(matrix[i, j]):
                shown = shareable_value(cell) if is_outside else cell
                log.add(Fault(file.name, "a finite number", row=row, column=columns[j], value=shown))
    return matrix
