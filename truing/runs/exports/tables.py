"""Export of all tables of a run: one CSV per table, or one Excel workbook with a list of contents."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from typing import Any

import pyarrow as pa
import pyarrow.csv
import xlsxwriter

from truing.runs.recorded_run import Run
from truing.schemas.artifacts import ARTIFACTS

ROWS_PER_SHEET = 1_000_000  # a sheet of Excel ends at 2**20
_SHEET_NAME = 31  # characters
_ALWAYS_THE_SAME = datetime(2000, 1, 1, tzinfo=UTC)  # no clock: equal tables give equal bytes
_CONTENTS = ("sheet", "artifact", "rows", "stage", "digest", "meaning")


def text_tables(run: Run) -> Iterator[tuple[str, bytes]]:
    """Yield a CSV per table, named as its Parquet file."""
    for name, path in run.files.items():
        sink = pa.BufferOutputStream()
        pa.csv.write_csv(run.table(name), sink, pa.csv.WriteOptions(quoting_style="needed"))
        yield f"{path.stem}.csv", bytes(sink.getvalue())


def workbook(run: Run) -> Iterator[tuple[str, bytes]]:
    """Yield the workbook; a table too long for one sheet continues in ``name (2)`` and so on."""
    made = io.BytesIO()
    # A text stays text: no content of a campaign's file may become a formula or a link.
    options = {"in_memory": True, "strings_to_formulas": False, "strings_to_urls": False}
    with xlsxwriter.Workbook(made, options) as book:
        book.set_properties({"title": run.campaign, "created": _ALWAYS_THE_SAME})
        head = book.add_format({"bold": True})
        parts = [(sheet, name, part) for name in run for sheet, part in _parts(name, run.table(name))]
        _contents(book, head, run, parts)
        for sheet, name, part in parts:
            _write_table(book.add_worksheet(sheet), head, part, run[name].attrs["units"])
    yield "tables.xlsx", made.getvalue()


def _parts(name: str, table: pa.Table) -> Iterator[tuple[str, pa.Table]]:
    for k in range(max(1, math.ceil(len(table) / ROWS_PER_SHEET))):
        ending = f" ({k + 1})" if k else ""
        yield name[: _SHEET_NAME - len(ending)] + ending, table.slice(k * ROWS_PER_SHEET, ROWS_PER_SHEET)


def _contents(book: xlsxwriter.Workbook, head: object, run: Run, parts: Sequence[tuple[str, str, pa.Table]]) -> None:
    sheet = book.add_worksheet("contents")
    sheet.write_row(0, 0, _CONTENTS, head)
    for row, (title, name, part) in enumerate(parts, start=1):
        origin = run.origin(name)
        facts = (title, name, len(part), origin["stage"], origin["digest"], ARTIFACTS[name].meaning)
        sheet.write_row(row, 0, facts)
    sheet.autofit()


def _write_table(sheet: Any, head: Any, table: pa.Table, units: dict[str, str]) -> None:
    """Write column names, units below them, then the rows; missing numbers stay empty."""
    sheet.write_row(0, 0, table.schema.names, head)
    sheet.write_row(1, 0, [units.get(name, "") for name in table.schema.names], head)
    for column, values in enumerate(table.columns):
        sheet.write_column(2, column, [_cell(value) for value in values.to_pylist()])
    sheet.freeze_panes(2, 0)


def _cell(value: object) -> object:
    return None if isinstance(value, float) and not math.isfinite(value) else value
