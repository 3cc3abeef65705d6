"""A table in memory: its columns, and the file and record of every row."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa

from truing.arrays import Mask
from truing.formats.evaluation import TableBatch
from truing.formats.faultlog import CellFaults, FaultLog, Records
from truing.formats.raw_tables import RawTable
from truing.formats.read import FileRows, read_table
from truing.formats.source import CampaignFiles
from truing.schemas.covariates import marked


@dataclass
class CollectedRows:
    """Rows of a table in the order of input; ``left_out``: counts by (file, reason).

    ``faulty``: by column, rows (N,) whose cell was faulty when read; columns without any are absent.
    """

    table: pa.Table
    parts: list[tuple[FileRows, Records]]
    left_out: Counter[tuple[str, str]] = field(default_factory=Counter)
    faulty: dict[str, Mask] = field(default_factory=dict)

    @property
    def first_file(self) -> str:
        """Name of the first of the files."""
        return self.parts[0][0].raw.name

    def _origin(self, row: int) -> tuple[FileRows, int]:
        for file, records in self.parts:
            if row < len(records):
                return file, int(records[row])
            row -= len(records)
        raise IndexError(row)

    def without_faults(self, *columns: str) -> Mask:
        """Return the mask of rows (N,) without faults in these cells when read, which can be compared with others."""
        determined = [self.faulty[name] for name in columns if name in self.faulty]
        return ~np.logical_or.reduce(determined) if determined else np.ones(len(self.table), dtype=bool)

    def fault(self, log: FaultLog, wrong: Mask, column: str, expected: str) -> None:
        """Report a fault in every row of a mask, except for cells that were faulty when read: one fault per cell."""
        values = self.table.column(column).combine_chunks() if column in self.table.column_names else None
        for row in np.flatnonzero(wrong & self.without_faults(column)):
            file, record = self._origin(int(row))
            value = None if values is None else values[int(row)].as_py()
            cell = (record, None if values is None else "" if value is None else str(value))
            log.cells(file.raw.name, CellFaults(expected, column, (cell,), 1), file.locate)


def collect_rows(
    source: CampaignFiles, shape: RawTable, log: FaultLog, identifier: str | None = None
) -> CollectedRows | None:
    """Return a whole table, with its ``identifier`` column as int64 if all values are integers, else as text.

    None if the campaign has no such table, or if it cannot be read at all (which is then reported).
    """
    if not source.entries(shape.name):
        return None
    batches, rows_collected = _read(source, shape, as_text=False)
    named = [batch.columns[identifier] for _, batch in batches if identifier in batch.columns]
    if any(pa.types.is_dictionary(column.type) for column in named):
        batches, rows_collected = _read(source, shape, as_text=True)
    log.absorb(rows_collected)
    if not batches:
        return None
    left_out: Counter[tuple[str, str]] = Counter()
    for file, batch in batches:
        left_out.update({(file.raw.name, reason): count for reason, count in batch.left_out.items()})
    parts = [(file, batch.records) for file, batch in batches]
    tables = [batch for _, batch in batches]
    table = _concatenated(tables)
    name_of_column = {name: marked(name) if shape.is_set_apart(name) else name for name in table.column_names}
    return CollectedRows(
        table.rename_columns(list(name_of_column.values())), parts, left_out, _faulty(tables, name_of_column)
    )


def _faulty(batches: list[TableBatch], new_names: Mapping[str, str]) -> dict[str, Mask]:
    names = {name for batch in batches for name in batch.faulty}
    return {
        new_names.get(name, name): np.concatenate([b.faulty.get(name, np.zeros(b.rows, dtype=bool)) for b in batches])
        for name in names
    }


def _read(
    source: CampaignFiles, shape: RawTable, *, as_text: bool
) -> tuple[list[tuple[FileRows, TableBatch]], FaultLog]:
    log = FaultLog()
    return list(read_table(source, shape, log, poses_as_text=as_text)), log


def _concatenated(batches: list[TableBatch]) -> pa.Table:
    tables = []
    for batch in batches:
        columns = {
            name: values.cast(pa.string()) if pa.types.is_dictionary(values.type) else values
            for name, values in batch.columns.items()
        }
        tables.append(pa.table(columns))
    return pa.concat_tables(tables, promote_options="default").combine_chunks()
