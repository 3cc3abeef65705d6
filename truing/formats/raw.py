"""What every reader yields: the columns of a raw file as they stand there, a batch at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from truing.formats.faultlog import CellFaults, Records

if TYPE_CHECKING:
    import pyarrow as pa

Kind = Literal["number", "seconds", "identifier", "text"]
"""How a raw column is wanted: float64 if all its cells are plain numbers (``seconds``: or moments), int64 if all are
integers, or as text."""

Wanted = Callable[[tuple[str, ...], str | None], Mapping[int, Kind] | None]
"""Given the names of a file's columns, and the unit of its coordinates where the file states one: which positions to
read, and as what; None where the file is of no use."""


@dataclass(frozen=True)
class RawBatch:
    """Some records of a raw file: columns by position (from 0; by name where reshaping made them), the record
    that each row stands in, what is wrong."""

    columns: Mapping[Any, pa.Array]
    records: Records
    faults: tuple[CellFaults, ...] = ()

    @property
    def rows(self) -> int:
        """How many rows."""
        return len(self.records)


class Unusable(Exception):
    """A raw file that cannot be read at all: what was expected of it, and where."""

    def __init__(
        self, expected: str, row: int | None = None, value: str | None = None, column: str | None = None
    ) -> None:
        self.expected, self.row, self.value, self.column = expected, row, value, column
        super().__init__(expected)


def consecutive(first: int, count: int) -> Records:
    """The numbers of ``count`` records from ``first`` on."""
    return np.arange(first, first + count, dtype=np.int64)
