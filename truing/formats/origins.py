"""Origins of a table's column: a column of the file, a constant, a row count, a part or a join of other columns."""

from __future__ import annotations

import math
import string
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from truing.formats.faultlog import Records
from truing.formats.patterns import BoundedPattern
from truing.formats.raw import Kind, RawBatch, Unusable, Wanted
from truing.schemas.mapping import FileMapping

_ROW_PER_POSE = ("poses", "configurations")
_WIDEST = {"text": 2, "identifier": 1, "seconds": 0, "number": 0}


@dataclass(frozen=True)
class RowNumber:
    """Number of the record in its file, with parameters for records that share a number or a count that restarts."""

    first: int
    rows_per_number: int = 1
    rows_per_count: int | None = None

    def of(self, records: Records) -> Records:
        """Return the number of each record (N,), counted from 0."""
        if self.rows_per_count is not None:
            records = records % self.rows_per_count
        return records // self.rows_per_number + self.first


def is_side_by_side(entry: FileMapping, table: str) -> bool:
    """True if several rows of a file form one row of a table with one row per pose."""
    return entry.rows_per_pose is not None and table in _ROW_PER_POSE


class RowCount:
    """Rows of one file between reader and table: ``side_by_side`` of them form a record."""

    def __init__(self, entry: FileMapping, side_by_side: int) -> None:
        groups = [*entry.rows_per_group.values(), *filter(None, [entry.rows_per_pose])]
        self._whole = math.lcm(*groups) if groups else 1
        self._per = side_by_side
        self._names = entry.names
        self._width = 0
        self._kinds: Mapping[int, Kind] = {}

    def hint(self, asked: Wanted) -> Wanted:
        """Return the request for the reader if the mapping refers to columns of joined rows."""
        if self._per == 1:
            return asked

        def of_rows(names: tuple[str, ...], unit: str | None) -> Mapping[int, Kind] | None:
            self._width = len(names)
            laid = side_by_side_names(len(names), self._per)
            if len(names) < len(self._names) <= len(laid):  # names of the complete record, not of one row
                laid = (*self._names, *laid[len(self._names) :])
            kinds = asked(laid, unit)
            if kinds is None:
                return None
            self._kinds = kinds
            kind_of_place: dict[int, Kind] = {}
            for index, kind in kinds.items():
                known = kind_of_place.setdefault(index % len(names), kind)
                kind_of_place[index % len(names)] = max(known, kind, key=lambda kind_of_cell: _WIDEST[kind_of_cell])
            return kind_of_place

        return of_rows

    def through(self, batches: Iterator[RawBatch]) -> Iterator[RawBatch]:
        """Yield the joined batches; raises Unusable at the end if the last group of rows is incomplete."""
        rows = 0
        pending: RawBatch | None = None
        for batch in batches:
            rows = max([rows, *(_implied_rows(batch))])
            if self._per == 1:
                yield batch
                continue
            pending, complete_rows = self._split_last_record(
                batch if pending is None else _joined_batches(pending, batch)
            )
            yield complete_rows
        if rows % self._whole:
            raise Unusable(f"a multiple of {self._whole} rows, as they belong together", value=f"{rows} rows")

    def _split_last_record(self, batch: RawBatch) -> tuple[RawBatch, RawBatch]:
        """Return the rows of the last record, which may be incomplete, and the records before it."""
        group = batch.records // self._per
        before = group < (group[-1] if len(group) else 0)
        if len(group) and batch.records[-1] % self._per == self._per - 1:
            before[:] = True
        last_record = RawBatch(
            {index: values.filter(~before) for index, values in batch.columns.items()}, batch.records[~before]
        )
        return last_record, self._rows_joined_to_records(batch, before)

    def _rows_joined_to_records(self, batch: RawBatch, chosen: np.ndarray) -> RawBatch:
        groups, counts = np.unique(batch.records[chosen] // self._per, return_counts=True)
        complete_groups = groups[counts == self._per]  # incomplete groups had a faulty row, which is reported
        rows = np.flatnonzero(chosen & np.isin(batch.records // self._per, complete_groups)).reshape(-1, self._per)
        columns = {
            index: batch.columns[index % self._width].take(rows[:, index // self._width]) for index in self._kinds
        }
        faults = tuple(fault.changed(lambda row, value: (row // self._per, value)) for fault in batch.faults)
        return RawBatch(columns, complete_groups, faults)


def side_by_side_names(width: int, rows: int) -> tuple[str, ...]:
    """Return names of the columns of joined rows: m00, m01, ... for the matrix of a pose, else positions."""
    if width == 4 and rows in (3, 4):
        return tuple(f"m{row}{column}" for row in range(rows) for column in range(width))
    return tuple(str(index + 1) for index in range(width * rows))


def _implied_rows(batch: RawBatch) -> Iterator[int]:
    """Yield the number of rows that a batch implies."""
    if len(batch.records):
        yield int(batch.records[-1]) + 1
    yield from (row + 1 for fault in batch.faults for row, _ in fault.cells)


def _joined_batches(first: RawBatch, second: RawBatch) -> RawBatch:
    """Return two batches as one; a column that is numeric in only one of them becomes text."""
    columns = {index: _concatenated(values, second.columns[index]) for index, values in first.columns.items()}
    records = np.concatenate([first.records, second.records])
    return RawBatch(columns or second.columns, records, second.faults)


def _concatenated(first: pa.Array, second: pa.Array) -> pa.Array:
    if first.type == second.type and not pa.types.is_dictionary(first.type):
        return pa.concat_arrays([first, second])
    texts = pa.concat_arrays([first.cast(pa.string()), second.cast(pa.string())])
    return (
        texts.dictionary_encode()
        if any(pa.types.is_dictionary(texts_of_column.type) for texts_of_column in (first, second))
        else texts
    )


@dataclass(frozen=True)
class Constant:
    """The same value in every row."""

    value: str | int | float


@dataclass(frozen=True)
class RawColumn:
    """A column of the file, by position."""

    position: int


@dataclass(frozen=True)
class PatternGroup:
    """A named group of a regular expression that another column's whole value matches."""

    column: str
    pattern: BoundedPattern[str]
    name: str


@dataclass(frozen=True)
class Joined:
    """A template of other columns."""

    template: str
    columns: tuple[str, ...]


@dataclass(frozen=True)
class Spread:
    """A column from the conversion of wide rows to long ones: target (and other names of the template), or a
    coordinate."""

    name: str


Origin = Constant | RawColumn | PatternGroup | RowNumber | Joined | Spread


def made_of(origin: Origin | None) -> tuple[str, ...]:
    """Raw columns that are joined or searched for this value; none if it is read as it stands."""
    if isinstance(origin, PatternGroup):
        return (origin.column,)
    return origin.columns if isinstance(origin, Joined) else ()


def template_fields(template: str) -> tuple[str, ...]:
    """Return the names in a template's braces."""
    return tuple(name for _, name, _, _ in string.Formatter().parse(template) if name)


def joined_by(template: str, values: Sequence[str]) -> str:
    """Return a template filled with values, in the order of its names; plain text, without format expressions."""
    left = iter(values)
    parts = string.Formatter().parse(template)
    return "".join(text if name is None else f"{text}{next(left):{form}}" for text, name, form, _ in parts)
