"""The simulated compliance as a file of the campaign: 6 x 6 numbers, SI, read and checked cell by cell."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.formats.discretion import discreet
from truing.formats.faultlog import FaultLog
from truing.formats.source import CampaignFiles, RawFile
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import Fault
from truing.schemas.settings_text import read_settings_text

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]

_RESPONSES = ("dx", "dy", "dz", "rx", "ry", "rz")
_LOADS = ("fx", "fy", "fz", "mx", "my", "mz")
_TYPED = 1e-3  # of the roots of the diagonal: matrices as they are typed are symmetric to that


def read_compliance(source: CampaignFiles, log: FaultLog) -> pa.Table | None:
    """The compliance of mechanism.compliance_file as a long table; None where there is none."""
    file = source.compliance
    if file is None:
        return None
    try:
        lines = read_settings_text(file.path).splitlines()
    except (OSError, ValueError):
        log.add(Fault("campaign.toml", "an existing text file", column="mechanism.compliance_file", value=file.name))
        return None
    matrix = _matrix(file, lines, log, source.is_outside(file))
    return None if matrix is None else _long(matrix)


def _matrix(file: RawFile, lines: list[str], log: FaultLog, is_outside: bool) -> Array | None:
    """The numbers (6, 6); None where a fault was noted. A line of the six loads' names may head them."""
    rows = [(number, _cells(line)) for number, line in enumerate(lines, 1) if line.strip() and line.lstrip()[0] != "#"]
    if rows and [cell.casefold()[:2] for cell in rows[0][1]] == list(_LOADS):
        rows = rows[1:]
    if len(rows) != 6:
        log.add(Fault(file.name, "six rows: dx dy dz rx ry rz", value=f"{len(rows)} rows"))
        return None
    matrix = np.full((6, 6), np.nan)
    clean = True
    for i, (number, cells) in enumerate(rows):
        if len(cells) != 6:
            log.add(Fault(file.name, "six numbers: fx fy fz mx my mz", row=number, value=f"{len(cells)} cells"))
            clean = False
            continue
        for j, cell in enumerate(cells):
            matrix[i, j] = _number(cell)
            if not np.isfinite(matrix[i, j]):
                shown = discreet(cell) if is_outside else cell
                log.add(Fault(file.name, "a finite number", row=number, column=_LOADS[j], value=shown))
                clean = False
    if clean:
        clean = _is_symmetric(file, matrix, [number for number, _ in rows], log)
    return matrix if clean else None


def _cells(line: str) -> list[str]:
    separator = next((mark for mark in (";", ",", "\t") if mark in line), None)
    return [cell.strip() for cell in (line.split(separator) if separator else re.split(r"\s+", line.strip()))]


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return float("nan")


def _is_symmetric(file: RawFile, matrix: Array, rows: list[int], log: FaultLog) -> bool:
    """Whether every entry is that across the diagonal; the worst one is named where not."""
    size = np.sqrt(np.abs(np.diag(matrix)))
    size = np.where(size > 0.0, size, 1.0)
    apart = np.abs(matrix - matrix.T) / np.outer(size, size)
    i, j = np.unravel_index(int(np.argmax(apart)), (6, 6))
    if apart[i, j] <= _TYPED:
        return True
    said = f"{matrix[j, i]:g}, as in row {rows[j]}, column {_LOADS[i]}: a compliance is symmetric"
    log.add(Fault(file.name, said, row=rows[i], column=_LOADS[j], value=f"{matrix[i, j]:g}"))
    return False


def _long(matrix: Array) -> pa.Table:
    import pyarrow as pa

    columns = {
        "response": [response for response in _RESPONSES for _ in _LOADS],
        "load": list(_LOADS) * 6,
        "coefficient": matrix.ravel(),
        "unit": [_unit(response, load) for response in _RESPONSES for load in _LOADS],
    }
    return pa.table(columns, schema=ARTIFACTS["given_compliance"].arrow_schema())


def _unit(response: str, load: str) -> str:
    return f"{'m' if response.startswith('d') else 'rad'}/{'N' if load.startswith('f') else '(N m)'}"
