"""Sheets of Excel workbooks (.xlsx, .xlsm), row by row; formulas are not computed, and no macro is run."""

from __future__ import annotations

import fnmatch
import re
import warnings
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import date, datetime, time, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.formats.compression import FREE, LARGEST_RATIO
from truing.formats.dictionaries import as_dictionary, strings
from truing.formats.faultlog import CellFaults
from truing.formats.raw import Kind, RawBatch, Unusable, Wanted
from truing.schemas.faults import first_line
from truing.schemas.mapping import FileMapping
from truing.schemas.memory import raise_shortage

if TYPE_CHECKING:
    from openpyxl.workbook import Workbook

Cell = str | int | float | bool | datetime | date | time | timedelta | None
Row = list[Cell]

_ROWS = 1 << 14  # per batch
_MOST_ROWS, _MOST_COLUMNS = 1_048_576, 16_384  # limits of a sheet in the format
_MOST_MERGED = 200_000
_CHUNK = 1 << 20
_FORMULA = re.compile(rb"<f[ />]")
_MERGED = re.compile(rb'<mergeCell ref="([A-Z]{1,3})(\d{1,7}):([A-Z]{1,3})(\d{1,7})"')
_UNCOMPUTED = (
    "a value: the workbook holds a formula without its result; open it in a spreadsheet program and save it there"
)


@dataclass(frozen=True)
class _Record:
    """One row of a sheet that is not empty: its number from 1, cells, and columns whose formula has no result."""

    row: int
    cells: Row
    uncomputed: tuple[int, ...] = ()


def read_workbook(path: Path, wanted: Wanted, entry: FileMapping) -> Iterator[RawBatch]:
    """Yield the records below the header of a sheet; raises Unusable if the workbook or sheet cannot be read."""
    with _opened(path) as book:
        records = _records(path, book, sheet_of(book, entry), entry)
        first = next(records, None)
        if first is None:
            raise Unusable("a sheet that holds anything")
        names = _names(first.cells, entry)
        kinds = wanted(names, None)
        if kinds is None:
            return
        done = 0
        pending = [] if entry.header is not False else [first]
        for record in records:
            if len(pending) == _ROWS:
                yield _batch(pending, kinds, names, done, entry.decimal)
                done, pending = done + len(pending), []
            pending.append(record)
        if not done and not pending:
            raise Unusable("at least one row below the header")
        yield _batch(pending, kinds, names, done, entry.decimal)


def sheet_name(path: Path, entry: FileMapping) -> str:
    """Return the name of the sheet that a mapping reads; raises Unusable if there is no such sheet."""
    with _opened(path) as book:
        return sheet_of(book, entry)


def sheets_like(path: Path, pattern: str) -> list[str]:
    """Return the visible sheets whose names match a glob, in their order; raises Unusable if none does."""
    with _opened(path) as book:
        visible = _visible(book)
    names = [name for name in visible if fnmatch.fnmatchcase(name, pattern)]
    if not names:
        raise Unusable(f"a name like that of one of its sheets: {_listed(visible)}", column="sheet", value=pattern)
    return names


def rows_of_records(path: Path, entry: FileMapping, records: Sequence[int]) -> list[int]:
    """Return the rows of the sheet, from 1, of records (from 0, ascending); reads the sheet again."""
    wanted, records_rows = set(records), []
    with _opened(path) as book:
        rows = _records(path, book, sheet_of(book, entry), entry)
        if entry.header is not False:
            next(rows, None)
        for number, record in enumerate(rows):
            if number in wanted:
                records_rows.append(record.row)
            if len(records_rows) == len(wanted):
                break
    return records_rows


def first_rows(path: Path, count: int) -> dict[str, list[tuple[int, Row]]]:
    """Return the first non-empty rows of every visible sheet that has any, with their numbers from 1."""
    rows_of_sheets: dict[str, list[tuple[int, Row]]] = {}
    with _opened(path) as book:
        for name in _visible(book):
            rows: list[tuple[int, Row]] = []
            for record in _records(path, book, name, FileMapping(path=path.name)):
                rows.append((record.row, record.cells))
                if len(rows) == count:
                    break
            if rows:
                rows_of_sheets[name] = rows
    return rows_of_sheets


def sheet_of(book: Workbook, entry: FileMapping) -> str:
    """Return the sheet named or counted from 1 by ``sheet``; by default the only visible one that is not empty."""
    names = [sheet.title for sheet in book.worksheets]
    if isinstance(entry.sheet, int):
        if not 1 <= entry.sheet <= len(names):
            raise Unusable(f"a sheet from 1 to {len(names)}: {_listed(names)}", column="sheet", value=str(entry.sheet))
        return names[entry.sheet - 1]
    if entry.sheet is not None:
        if entry.sheet not in names:
            raise Unusable(f"one of its sheets: {_listed(names)}", column="sheet", value=entry.sheet)
        return entry.sheet
    filled_sheets = [name for name in _visible(book) if _has_content(book, name)]
    if not filled_sheets:
        raise Unusable("a visible sheet that holds anything", value=_listed(names))
    if len(filled_sheets) > 1:
        raise Unusable(
            f"which sheet to read, as {len(filled_sheets)} hold something: sheet = {filled_sheets[0]!r}",
            value=_listed(filled_sheets),
        )
    return filled_sheets[0]


def _visible(book: Workbook) -> list[str]:
    return [sheet.title for sheet in book.worksheets if sheet.sheet_state == "visible"]


def _has_content(book: Workbook, name: str) -> bool:
    sheet = book[name]
    sheet.reset_dimensions()
    return any(cell is not None for row in sheet.iter_rows(max_row=_MOST_ROWS, values_only=True) for cell in row)


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:12])


@contextmanager
def _opened(path: Path, *, formulas: bool = False) -> Iterator[Workbook]:
    """Yield the workbook, read as a stream; raises Unusable if it is damaged or exceeds the allowed ratio."""
    try:
        import openpyxl
    except ModuleNotFoundError:
        raise Unusable("a sheet saved as CSV: workbooks need openpyxl, which is not installed") from None
    _check_size(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about charts and styles, which are not read
            book = openpyxl.load_workbook(path, read_only=True, data_only=not formulas, keep_links=False)
        try:
            yield book
        finally:
            book.close()
    except (Unusable, OSError, GeneratorExit):
        raise
    except Exception as error:  # openpyxl passes on any exception that a damaged part causes
        raise_shortage(error)
        raise Unusable("an undamaged Excel workbook (.xlsx)", value=first_line(error)[:80]) from None


def _check_size(path: Path) -> None:
    """Refuse an archive by its stated unpacked size; reading never exceeds that size."""
    try:
        with zipfile.ZipFile(path) as archive:
            unpacked = sum(part.file_size for part in archive.infolist())
            names = archive.namelist()
    except (zipfile.BadZipFile, NotImplementedError, ValueError):
        raise Unusable("an undamaged Excel workbook (.xlsx); an old one (.xls) has to be saved as .xlsx") from None
    if unpacked > max(FREE, LARGEST_RATIO * path.stat().st_size):
        raise Unusable(
            f"content of at most {LARGEST_RATIO} times the file's size; this one may be a decompression bomb"
        )
    if "xl/workbook.xml" not in names:
        raise Unusable("an Excel workbook (.xlsx); other spreadsheets have to be saved as such, or as CSV")


def _records(path: Path, book: Workbook, name: str, entry: FileMapping) -> Iterator[_Record]:
    """Yield the non-empty rows of a sheet, from ``skip_lines`` on; vertically merged cells are filled."""
    has_formulas, merged = _sheet_structure(path, book, name)
    if not has_formulas:
        rows = ((row, cells, ()) for row, cells in _rows(book, name))
        yield from _with_merged_cells(rows, merged, entry.skip_lines)
        return
    with _opened(path, formulas=True) as book_with_formulas:
        yield from _with_merged_cells(
            _with_formulas(_rows(book, name), _rows(book_with_formulas, name)), merged, entry.skip_lines
        )


def _rows(book: Workbook, name: str) -> Iterator[tuple[int, Row]]:
    sheet = book[name]
    sheet.reset_dimensions()  # the size stated in a file may be wrong
    for number, cells in enumerate(sheet.iter_rows(values_only=True), start=1):
        if number > _MOST_ROWS or len(cells) > _MOST_COLUMNS:
            raise Unusable(f"at most {_MOST_ROWS} rows and {_MOST_COLUMNS} columns", row=number)
        yield number, list(cells)


def _with_formulas(
    values: Iterator[tuple[int, Row]], formulas: Iterator[tuple[int, Row]]
) -> Iterator[tuple[int, Row, tuple[int, ...]]]:
    for (row, cells), (_, texts) in zip(values, formulas, strict=False):
        without = tuple(
            index
            for index, (cell, text) in enumerate(zip(cells, texts, strict=False))
            if cell is None and text is not None
        )
        yield row, cells, without


def _with_merged_cells(
    rows: Iterator[tuple[int, Row, tuple[int, ...]]], merged: dict[int, list[tuple[int, int]]], skip: int
) -> Iterator[_Record]:
    block_of_column: dict[int, tuple[int, Cell]] = {}  # column: last row of its block, and its common value
    for row, cells, uncomputed in rows:
        for column, (last, value) in list(block_of_column.items()):
            if row > last:
                del block_of_column[column]
            elif column < len(cells) and cells[column] is None:
                cells[column] = value
            elif column >= len(cells):
                cells += [None] * (column - len(cells)) + [value]
        for column, last in merged.get(row, ()):
            if column < len(cells):
                block_of_column[column] = last, cells[column]
        if row > skip and (uncomputed or any(cell is not None and cell != "" for cell in cells)):
            yield _Record(row, cells, uncomputed)


def _sheet_structure(path: Path, book: Workbook, name: str) -> tuple[bool, dict[int, list[tuple[int, int]]]]:
    """True if a sheet holds formulas, and its vertically merged cells: by first row, column and last row."""
    from openpyxl.utils import column_index_from_string

    has_formulas, unfinished, count = False, b"", 0
    merged: dict[int, list[tuple[int, int]]] = {}
    part = str(book[name]._worksheet_path).lstrip("/")
    with zipfile.ZipFile(path) as archive, archive.open(part) as stream:
        while chunk := stream.read(_CHUNK):
            text = unfinished + chunk
            has_formulas = has_formulas or _FORMULA.search(text) is not None
            for match in _MERGED.finditer(text):
                left, top, right, bottom = (group.decode() for group in match.groups())
                count += 1
                if left == right and count <= _MOST_MERGED:
                    block = column_index_from_string(left) - 1, int(bottom)
                    merged.setdefault(int(top), []).append(block)
            cut = text.rfind(b"<")
            unfinished = text[cut:] if cut >= 0 and len(text) - cut < 100 else b""
    return has_formulas, merged


def _names(heading: Row, entry: FileMapping) -> tuple[str, ...]:
    while heading and heading[-1] is None:
        heading = heading[:-1]
    if entry.header is not False:
        return tuple(" ".join(text_of(cell).split()) for cell in heading)
    positions = [str(position + 1) for position in range(len(heading))]
    return (*entry.names, *positions[len(entry.names) :])  # the last cells of the first row may be empty


def _batch(records: list[_Record], kinds: Mapping[int, Kind], names: tuple[str, ...], done: int, mark: str) -> RawBatch:
    """Return records from number ``done`` on; mark: decimal mark for texts of the sheet."""
    numbers = np.arange(done, done + len(records), dtype=np.int64)
    columns = {index: _column([_cell(r.cells, index) for r in records], kind, mark) for index, kind in kinds.items()}
    faults = []
    for index in kinds:
        mask = np.array([index in record.uncomputed for record in records], dtype=bool)
        if mask.any():
            faults.append(CellFaults.where(mask, numbers, None, names[index] or str(index + 1), _UNCOMPUTED))
    if faults:  # already reported: the cells are no second fault
        is_computed = np.array([not set(kinds) & set(record.uncomputed) for record in records], dtype=bool)
        columns = {index: column.filter(is_computed) for index, column in columns.items()}
        numbers = numbers[is_computed]
    return RawBatch(columns, numbers, tuple(faults))


def _cell(cells: Row, index: int) -> Cell:
    return cells[index] if index < len(cells) else None


def _column(cells: Row, kind: Kind, mark: str) -> pa.Array:
    """Return a column in the requested kind: numbers if all cells are numbers, else text as the sheet shows it."""
    wants_numbers = kind in ("number", "seconds")
    if wants_numbers and all(_is_number(cell) for cell in cells):
        return pa.array([float(cell) for cell in cells], pa.float64())  # type: ignore[arg-type]
    if kind == "seconds" and all(isinstance(cell, datetime) for cell in cells):
        return pa.array([_seconds(cell) for cell in cells], pa.float64())  # type: ignore[arg-type]
    if kind == "identifier" and all(_is_number(cell) and float(cell) == round(float(cell)) for cell in cells):  # type: ignore[arg-type]
        return pa.array([int(cell) for cell in cells], pa.int64())  # type: ignore[arg-type]
    texts = strings([text_of(cell, mark) for cell in cells])
    return texts if wants_numbers else as_dictionary(texts)


def _is_number(cell: Cell) -> bool:
    return isinstance(cell, int | float) and not isinstance(cell, bool) and abs(cell) < 2**63


def _seconds(moment: datetime) -> float:
    """Return seconds since 1970 of a date, which has no time zone in a workbook."""
    return (moment - datetime(1970, 1, 1)).total_seconds()


def text_of(cell: Cell, mark: str = ".") -> str:
    """Return the text of a cell; empty for an empty cell."""
    if cell is None:
        return ""
    if isinstance(cell, float) and cell == round(cell) and abs(cell) < 1e15:
        return str(int(cell))
    if isinstance(cell, datetime):
        return cell.isoformat(sep=" ")
    return repr(cell).replace(".", mark) if isinstance(cell, float) else str(cell).strip()
