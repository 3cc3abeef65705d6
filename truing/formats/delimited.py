"""Reader of delimited text in any dialect, parsed block by block on all cores."""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import IO

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv

from truing.formats.block_heads import BlockHeads
from truing.formats.faultlog import CellFaults
from truing.formats.numbers import Notation
from truing.formats.raw import Kind, RawBatch, Unusable, Wanted, consecutive
from truing.formats.text import Lines, record_blocks, skip_lines, split_lines, take_record, utf8_chunks
from truing.schemas.mapping import FileMapping
from truing.threads import in_order

_SEPARATORS = ("\t", ";", "|", ",")
_NUMBERS_SIDE_BY_SIDE = re.compile(r"\s*[-+\d.,eE]+(\s+[-+\d.,eE]+)+\s*")
COMPILED_FROM = 96 << 20  # bytes
_GROUPED = re.compile(Notation(",", " ").pattern + "|" + Notation(".", " ").pattern)


def read_delimited(stream: IO[bytes], entry: FileMapping, wanted: Wanted) -> Iterator[RawBatch]:
    """Yield the records of a text file; raises Unusable if it has none or cannot be split into records."""
    blocks = record_blocks(utf8_chunks(stream, entry.encoding), entry.quote.encode())
    whole = next(blocks, b"")
    first = skip_lines(whole, entry.skip_lines)
    separator = separator_of(entry, first)
    lines = Lines.of(entry, separator)
    added: tuple[str, ...] = ()
    if lines.heads is not None:
        heads = BlockHeads(lines.heads, separator, lines)
        blocks, added = heads.applied(chain([whole], blocks)), heads.names
        first = skip_lines(next(blocks, b""), entry.skip_lines)
    has_header = entry.header is not False
    heading, lines_below = take_record(first, lines.of_heading() if has_header else lines)
    if heading is None:
        raise Unusable("at least one record; there is none")
    names = column_names(heading, separator, entry)
    names = (*names[: len(names) - len(added)], *added)
    kinds = wanted(names, None)
    if kinds is None:
        return
    parser = _Parser(lines, separator, entry, len(names), kinds, _pays_compiled(stream, entry))
    done = 0
    for batch, count in in_order(parser.parse, chain(filter(None, [lines_below if has_header else first]), blocks)):
        if count:  # a block may consist of blank lines and comments
            yield _from_record(batch, done)
        done += count
    if done == 0:
        raise Unusable("at least one record below the header")


def _pays_compiled(stream: IO[bytes], entry: FileMapping) -> bool:
    """True for a file so large that the compiled parser saves more time than loading it takes."""
    if entry.missing or entry.thousands is not None:
        return False
    try:
        size = os.fstat(stream.fileno()).st_size
    except (OSError, AttributeError):  # text that is decompressed, or cut out of another file, has no number
        return False
    if size < COMPILED_FROM:
        return False
    from truing.compiled_code import can_cache

    return can_cache(Path(__file__).parent)  # compiling anew takes longer than it saves


def separator_of(entry: FileMapping, block: bytes) -> str:
    """Return the declared separator, or the one that splits the first records into equal numbers of clean fields."""
    if entry.separator is not None:
        return {"blank": " ", "tab": "\t"}.get(entry.separator, entry.separator)
    records = Lines.of(entry, "whitespace")
    head = [line for line in split_lines(block[: 1 << 16], entry.quote.encode())[:60] if records.is_record(line)]
    return guess_separator([line.decode(errors="replace").strip("\r\n") for line in head[:30]], entry.quote)


def guess_separator(lines: list[str], quote: str) -> str:
    """Return the separator of some lines; a comma if there is only one column.

    csv.Sniffer and clevercsv fail on exports of AICON and of trackers (tests/formats).
    """
    for separator in (*_SEPARATORS, "whitespace"):
        cut = [split_record(line.encode(), separator, quote) for line in lines]
        counts = [len(fields) for fields in cut]
        most = max(set(counts), key=counts.count, default=1)
        if most > 1 and counts.count(most) >= 0.8 * len(counts) and all(map(_is_clean, chain(*cut[1:]))):
            return separator
    return ","


def _is_clean(field: str) -> bool:
    return not _NUMBERS_SIDE_BY_SIDE.fullmatch(field) or _GROUPED.match(field.strip()) is not None


def split_record(record: bytes, separator: str, quote: str) -> list[str]:
    """Return the fields of one record, without surrounding blanks."""
    text = record.decode(errors="replace").strip("\r\n")
    if separator == "whitespace":
        return text.split()
    rows = csv.reader(
        io.StringIO(text, newline=""),
        delimiter=separator,
        quotechar=quote or None,
        quoting=csv.QUOTE_MINIMAL if quote else csv.QUOTE_NONE,
    )
    try:
        return [field.strip() for field in next(rows, [])]
    except csv.Error:  # a field longer than Python's reader accepts
        return [field.strip() for field in text.split(separator)]


def column_names(heading: bytes, separator: str, entry: FileMapping) -> tuple[str, ...]:
    """Return the names of the columns: of the header, else of the mapping, else their positions from 1."""
    fields = split_record(heading, separator, entry.quote)
    if entry.header is not False:
        return tuple(fields)
    positions = [str(position + 1) for position in range(len(fields))]
    return (*entry.names[: len(fields)], *positions[len(entry.names) :])


@dataclass(frozen=True)
class _Parser:
    lines: Lines
    separator: str
    entry: FileMapping
    width: int
    kinds: Mapping[int, Kind]
    is_compiled: bool

    def parse(self, block: bytes) -> tuple[RawBatch, int]:
        """Return one block's records, and their number, including those with too few or too many fields."""
        if self.entry.thousands is None:
            try:
                return self._typed(self.lines.records(block) if self.lines.may_pass_over(block) else block)
            except pa.ArrowInvalid:
                pass  # some cell has the wrong type: parse as text to find it
        return self._as_text(self.lines.records(block))

    def _typed(self, text: bytes) -> tuple[RawBatch, int]:
        if self.is_compiled and (plain := self._plain(text)) is not None:
            columns, rows = plain
            return RawBatch(columns, consecutive(0, rows)), rows
        number = pa.float64()
        types = {
            "number": number,
            "seconds": number,
            "identifier": pa.int64(),
            "text": pa.dictionary(pa.int32(), pa.string()),
        }
        table = self._read(text, types, None)
        if any(table[str(i)].null_count for i, kind in self.kinds.items() if kind != "text"):
            raise pa.ArrowInvalid("an empty cell may be one that means missing, or stand in a blank line")
        return self._batch(table, []), table.num_rows

    def _plain(self, text: bytes) -> tuple[dict[int, pa.Array], int] | None:
        from truing.formats.plain_text import plain_columns

        entry = self.entry
        if (
            len(self.separator.encode()) != 1
            or self.separator == entry.decimal
            or (entry.quote and entry.quote.encode() in text)
        ):
            return None
        return plain_columns(text, self.separator, entry.decimal, self.kinds, self.width)

    def _as_text(self, text: bytes) -> tuple[RawBatch, int]:
        if not text:
            return RawBatch({}, consecutive(0, 0)), 0
        _check_utf8(text, self.lines)
        ragged: list[tuple[int, str]] = []

        def collect(row: object) -> str:
            ragged.append((row.number - 1, f"{row.actual_columns} columns"))  # type: ignore[attr-defined]
            return "skip"

        texts = pa.dictionary(pa.int32(), pa.string())
        types = {"number": pa.string(), "seconds": pa.string(), "identifier": texts, "text": texts}
        table = self._read(text, types, collect)
        return self._batch(table, ragged), table.num_rows + len(ragged)

    def _read(self, text: bytes, types: Mapping[str, pa.DataType], on_ragged: Callable | None) -> pa.Table:
        separator, quote = self.separator, self.entry.quote
        if separator == "whitespace":
            separator, text = " ", _single_blanks(text)
        return pacsv.read_csv(
            pa.py_buffer(text),
            read_options=pacsv.ReadOptions(
                use_threads=False, block_size=len(text) + 1, column_names=[str(i) for i in range(self.width)]
            ),
            parse_options=pacsv.ParseOptions(
                delimiter=separator,
                quote_char=quote or False,
                newlines_in_values=bool(quote) and quote.encode() in text,
                invalid_row_handler=on_ragged,
            ),
            convert_options=pacsv.ConvertOptions(
                include_columns=[str(i) for i in self.kinds],
                column_types={str(i): types[kind] for i, kind in self.kinds.items()},
                decimal_point=self.entry.decimal,
                null_values=["", *self.entry.missing],
                strings_can_be_null=False,
            ),
        )

    def _batch(self, table: pa.Table, ragged: list[tuple[int, str]]) -> RawBatch:
        rows = consecutive(0, table.num_rows + len(ragged))
        records = np.delete(rows, [row for row, _ in ragged]) if ragged else rows
        columns = {i: _as_one_chunk(table[str(i)]) for i in self.kinds}
        if not ragged:
            return RawBatch(columns, records)
        fault = CellFaults(f"{self.width} columns in every row", None, tuple(ragged), len(ragged))
        return RawBatch(columns, records, (fault,))


def _as_one_chunk(column: pa.ChunkedArray) -> pa.Array:
    return column.chunk(0) if column.num_chunks == 1 else column.combine_chunks()


def _from_record(batch: RawBatch, first: int) -> RawBatch:
    faults = tuple(fault.changed(lambda record, value: (first + record, value)) for fault in batch.faults)
    return RawBatch(batch.columns, batch.records + first, faults)


def _single_blanks(text: bytes) -> bytes:
    text = text.translate(bytes.maketrans(b"\t\r", b"  "))
    while b"  " in text:
        text = text.replace(b"  ", b" ")
    return text.replace(b" \n", b"\n").replace(b"\n ", b"\n").strip(b" ")


def _check_utf8(text: bytes, lines: Lines) -> None:
    try:
        text.decode()
    except UnicodeDecodeError as error:
        raise Unusable(
            'text in UTF-8; exports of older programs are read with encoding = "cp1252"',
            value=split_lines(text[: error.end], lines.quote)[-1].decode(errors="replace")[-40:],
        ) from None
