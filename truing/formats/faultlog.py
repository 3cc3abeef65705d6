"""Log of faults in raw files: every kind of fault, the first few cases of each, and the number of others.

A path may lead out of the campaign's folder, to files that must not be shown: messages about them contain only numbers.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pyarrow as pa

from truing.arrays import Index, Mask
from truing.schemas.faults import CampaignFaults, Fault

MOST_LISTED = 3
"""Largest number of faults of one kind that are listed one by one."""
Records = Index
_NUMBER = re.compile(r"[-+\d.,' ]{0,30}([eE][-+]?\d{1,3})?|[-+]?(nan|inf)", re.IGNORECASE)
_COUNT = re.compile(r"\d{1,18} (bytes|cells|columns|files|frames|labels|lines|numbers|points|rows|vertices)")
_HIDDEN = "text that is not shown, as the file lies outside the campaign's folder"


@dataclass(frozen=True)
class CellFaults:
    """One kind of fault in one column of one file: the first records (from 0) with their values, and the total
    number."""

    expected: str
    column: str | None
    cells: tuple[tuple[int, str | None], ...]
    count: int

    @classmethod
    def where(
        cls, mask: Mask, records: Records, values: pa.Array | None, column: str | None, expected: str
    ) -> CellFaults:
        """Return the faults at the rows of a mask; ``values``: content of these cells."""
        rows = np.flatnonzero(mask)
        cells = tuple((int(records[row]), _cell_text(values, int(row))) for row in rows[:MOST_LISTED])
        return cls(expected, column, cells, len(rows))

    def changed(self, change: Callable[[int, str | None], tuple[int, str | None]]) -> CellFaults:
        """Return the same faults with changed records or values of their cells."""
        return replace(self, cells=tuple(change(*cell) for cell in self.cells))


def _cell_text(values: pa.Array | None, row: int) -> str | None:
    if values is None:
        return None
    value = values[row].as_py()
    return "" if value is None else str(value)[:80]


@dataclass
class _Kind:
    first: list[tuple[int, Fault]] = field(default_factory=list)
    count: int = 0


class FaultLog:
    """All faults of a campaign's files; records are converted to lines only when faults are shown."""

    def __init__(self) -> None:
        self._plain: dict[tuple[str, str | None, str], list[Fault]] = {}
        self._cells: dict[tuple[str, str | None, str], _Kind] = {}
        self._lacking: dict[tuple[str, str], dict[str, None]] = {}
        self._locate: dict[str, Callable[[Sequence[int]], Sequence[int]]] = {}

    def __bool__(self) -> bool:
        return bool(self._plain or self._cells or self._lacking)

    def absorb(self, other: FaultLog) -> None:
        """Add the faults of another log about other files."""
        self._plain.update(other._plain)
        self._cells.update(other._cells)
        for key, files in other._lacking.items():
            self._lacking.setdefault(key, {}).update(files)
        self._locate.update(other._locate)

    def add(self, fault: Fault) -> None:
        """Add a fault without row, or with a known row; duplicates are ignored."""
        same_kind = self._plain.setdefault((fault.file, fault.column, fault.expected), [])
        if fault not in same_kind:
            same_kind.append(fault)

    def add_missing(self, key: str, what: str, file: str) -> None:
        """Report a value that neither the rows of a file nor ``key`` of campaign.toml give; once for all files."""
        self._lacking.setdefault((key, what), {})[file] = None

    def cells(self, file: str, faults: CellFaults, locate: Callable[[Sequence[int]], Sequence[int]]) -> None:
        """Add faults in the records of a file; ``locate`` converts records to the line numbers of an editor."""
        if not faults.count:
            return
        kind = self._cells.setdefault((file, faults.column, faults.expected), _Kind())
        kind.count += faults.count
        self._locate[file] = locate
        for record, value in faults.cells[: MOST_LISTED - len(kind.first)]:
            kind.first.append((record, Fault(file, faults.expected, column=faults.column, value=value)))

    def faults(self) -> tuple[Fault, ...]:
        """Return all faults, by file and kind, limited with a count."""
        plain = [fault for faults in self._plain.values() for fault in _with_count_of_rest(faults, len(faults))]
        plain += [_missing_value_fault(key, what, list(files)) for (key, what), files in self._lacking.items()]
        return (*plain, *(fault for file in self._locate for fault in self._of_file(file)))

    def _of_file(self, file: str) -> list[Fault]:
        kinds = [kind for (name, _, _), kind in self._cells.items() if name == file]
        records = sorted({record for kind in kinds for record, _ in kind.first})
        row = dict(zip(records, self._locate[file](records), strict=False))  # fewer if the file has changed since
        return [
            fault
            for kind in kinds
            for fault in _with_count_of_rest([replace(f, row=row.get(record)) for record, f in kind.first], kind.count)
        ]

    def raise_faults(self) -> None:
        """Raise CampaignFaults if there is any fault."""
        if self:
            raise CampaignFaults(self.faults())


def _missing_value_fault(key: str, what: str, files: list[str]) -> Fault:
    further_files = len(files) - 1
    more = (
        f", nor {'does another file' if further_files == 1 else f'do {further_files} other files'}"
        if further_files
        else ""
    )
    return Fault("campaign.toml", f"{what}, which {files[0]} does not give in every row{more}", column=key)


def _with_count_of_rest(faults: list[Fault], count: int) -> list[Fault]:
    shown = faults[:MOST_LISTED]
    if count > len(shown):
        shown[-1] = replace(shown[-1], more=count - len(shown))
    return shown


def shareable_value(value: str | None) -> str | None:
    """Return a value from a file outside the campaign's folder in a form that may be shown."""
    if value is None or _NUMBER.fullmatch(value) or _COUNT.fullmatch(value):
        return value
    return _HIDDEN


def discreet_cells(faults: CellFaults) -> CellFaults:
    """Return faults of cells without their text."""
    return faults.changed(lambda record, value: (record, shareable_value(value)))
