"""Output of every reader: the columns of a raw file as recorded, in batches."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index
from truing.formats.faultlog import CellFaults, Records

Kind = Literal["number", "seconds", "identifier", "text"]
"""Requested type of a raw column: float64 if all its cells are plain numbers (``seconds``: or moments), int64 if all
are integers, or as text."""
Wanted = Callable[[tuple[str, ...], str | None], Mapping[int, Kind] | None]
"""Given the names of a file's columns, and the unit of its coordinates where the file states one: which positions to
read, and as what; None where the file is of no use."""
_LARGEST = 2.0**53


@dataclass(frozen=True)
class RawBatch:
    """Some records of a raw file: columns by position (from 0; by name after reshaping), the record of each row,
    faults."""

    columns: Mapping[Any, pa.Array]
    records: Records
    faults: tuple[CellFaults, ...] = ()

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.records)


class Unusable(Exception):
    """A raw file that cannot be read at all, with the expectation, its row, value and column."""

    def __init__(
        self, expected: str, row: int | None = None, value: str | None = None, column: str | None = None
    ) -> None:
        self.expected, self.row, self.value, self.column = expected, row, value, column
        super().__init__(expected)


def finite_numbers(text: str, expected: str, row: int, count: int | None = None) -> Array:
    """Return the finite numbers (N,) of a line of text, N equal to ``count`` if given; raises Unusable otherwise."""
    try:
        values = np.array(text.split(), dtype=np.float64)
    except ValueError:
        raise Unusable(expected, row=row, value=text[:80]) from None
    if count is not None and len(values) != count:
        raise Unusable(expected, row=row, value=text[:80])
    if not np.isfinite(values).all():
        raise Unusable(f"{expected}, all of them finite", row=row, value=text[:80])
    return values


def consecutive(first: int, count: int) -> Records:
    """Return the numbers of ``count`` records starting with ``first``."""
    return np.arange(first, first + count, dtype=np.int64)


def one_batch(
    columns: Mapping[str, Sequence[Any] | Any],
    wanted: Wanted,
    unit: str | None = None,
    lines: Sequence[int] | None = None,
) -> Iterator[RawBatch]:
    """Yield the requested columns of a file, all of equal length.

    ``unit``: of its coordinates; ``lines``: line of each row in a text, from 1. Raises Unusable without rows.
    """
    rows = len(next(iter(columns.values())))
    if not rows:
        raise Unusable("at least one row of this table; the file holds none")
    kinds = wanted(tuple(columns), unit)
    if kinds is None:
        return
    records = consecutive(0, rows) if lines is None else np.asarray(lines, dtype=np.int64) - 1
    values = list(columns.values())
    yield RawBatch({position: pa.array(values[position]) for position in kinds}, records)


def integer_columns(values: Array, what: str, rows: Sequence[int] | None = None) -> Index:
    """Return numbers of points, images, cameras and pixels as integers; ``rows``: line of each in a text, from 1.

    Raises Unusable at the first value that is no integer.
    """
    not_whole = np.flatnonzero(~((values == np.floor(values)) & (np.abs(values) < _LARGEST)))
    if len(not_whole):
        row = None if rows is None else int(rows[not_whole[0]])
        raise Unusable(f"whole numbers of {what}", row=row, value=f"{values[not_whole[0]]:g}")
    return values.astype(np.int64)
