"""Small damages of a good file, as hypothesis draws them: bytes, lines, cells and columns of text, Parquet columns."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from hypothesis import strategies as st

_CELL = re.compile(rb"[^,;\t\n\r\"'=\[\]{}#\s]+")
_ODD_BYTES = (b"\x00", b"\xff", b"\r", b"\n\n", b'"', b"'", b";", b"\t", b"\xef\xbb\xbf", b"\xff\xfe", b"#", b",,,")
_EXTREMES = (
    *("nan", "-inf", "1e308", "-1e-320", "1e999", "0", "-1", "-0.0", "9223372036854775807", "18446744073709551616"),
    *("9" * 40, "9" * 5000, "0x1F", "1_000", "1,5", "1 000", "NULL", "#REF!", "12 mm", "١٢", "−1", "1e", "--", "True"),
)
_TOML_VALUES = (
    *("nan", "-inf", "1e308", "0", "-1", "true", '""', "[]", "{}", "[[1.0], [2.0, 3.0]]", "1979-05-27", "07:32:00"),
    *('"\\u0000"', '"' + "x" * 5000 + "/y.csv" + '"', '"{"', '"{0.__class__}"', '"(?P<pose>"', '"../.."', '"**"'),
    *("9" * 5000, "0x" + "f" * 5000, "[" * 3000 + "]" * 3000, '{ a = { b = "c" } }', '["a", 1, []]'),
)
_NAMES = ("x_mm", "pose", "target", "body", "run", "", " ", "time_s", "sigma_x_mm", "cov_xy_mm2", "a\nb", "Δ" * 300)


@dataclass(frozen=True)
class Damage:
    """One damage: which kind, where in the file (two shares of its length), and which of its odd things it puts in."""

    kind: str
    at: float
    other: float
    odd: int

    def applied(self, content: bytes) -> bytes:
        """The content with the damage."""
        return _KINDS[self.kind](content, self)


_Change = Callable[[bytes, Damage], bytes]


def _span(content: bytes, damage: Damage) -> tuple[int, int]:
    start = int(damage.at * len(content))
    return start, min(len(content), start + 1 + int(damage.other**4 * len(content)))


def _delete(content: bytes, damage: Damage) -> bytes:
    start, stop = _span(content, damage)
    return content[:start] + content[stop:]


def _double(content: bytes, damage: Damage) -> bytes:
    start, stop = _span(content, damage)
    return content[:stop] + content[start:]


def _flip(content: bytes, damage: Damage) -> bytes:
    at = int(damage.at * len(content))
    return content[:at] + bytes([content[at] ^ (1 << damage.odd % 8)]) + content[at + 1 :] if content else b""


def _put_bytes(content: bytes, damage: Damage) -> bytes:
    at = int(damage.at * len(content))
    return content[:at] + _ODD_BYTES[damage.odd % len(_ODD_BYTES)] + content[at:]


def _cut(content: bytes, damage: Damage) -> bytes:
    return content[: int(damage.at * len(content))]


def _lines(change: Callable[[list[bytes], int, int], None]) -> _Change:
    def apply(content: bytes, damage: Damage) -> bytes:
        lines = content.splitlines(keepends=True)
        if lines:
            change(lines, int(damage.at * len(lines)), int(damage.other * len(lines)))
        return b"".join(lines)

    return apply


def _exchange(lines: list[bytes], i: int, j: int) -> None:
    lines[i], lines[j] = lines[j], lines[i]


def _cells(odd: tuple[str, ...]) -> _Change:
    """Another text for one cell of a line, any line equally likely, so that heads and keys get their share."""

    def apply(content: bytes, damage: Damage) -> bytes:
        lines = content.splitlines(keepends=True)
        if not lines:
            return content
        line = lines[at := int(damage.at * len(lines))]
        cells = list(_CELL.finditer(line))
        if cells:
            cell = cells[int(damage.other * len(cells))]
            text = odd[damage.odd % len(odd)].encode()
            lines[at] = line[: cell.start()] + text + line[cell.end() :]
        return b"".join(lines)

    return apply


def _column(content: bytes, damage: Damage) -> bytes:
    """The same odd cell in every row of a column; the first line is that of names."""
    rows = [line.split(b",") for line in content.split(b"\n")]
    at, text = int(damage.at * len(rows[0])), _EXTREMES[damage.odd % len(_EXTREMES)].encode()
    return b"\n".join(
        b",".join([*row[:at], text, *row[at + 1 :]]) if i else b",".join(row) for i, row in enumerate(rows)
    )


def _name(content: bytes, damage: Damage) -> bytes:
    head, end, rest = content.partition(b"\n")
    names = head.split(b",")
    names[int(damage.at * len(names))] = _NAMES[damage.odd % len(_NAMES)].encode()
    return b",".join(names) + end + rest


def _toml_value(content: bytes, damage: Damage) -> bytes:
    lines = content.splitlines(keepends=True)
    places = [i for i, line in enumerate(lines) if b" = " in line]
    if places:
        at = places[int(damage.at * len(places))]
        parts = re.split(rb"(?<= = )", lines[at])
        which = 1 + int(damage.other * (len(parts) - 1))
        stop = re.search(rb"(?=, \w+ = |[ ]?}|$)", parts[which])
        rest = parts[which][stop.start() :] if stop and damage.odd % 2 else b"\n"
        parts[which] = _TOML_VALUES[damage.odd // 2 % len(_TOML_VALUES)].encode() + rest
        lines[at] = b"".join(parts)
    return b"".join(lines)


_BYTES: dict[str, _Change] = {
    "delete": _delete,
    "double": _double,
    "flip": _flip,
    "put-bytes": _put_bytes,
    "cut": _cut,
}
_TEXT: dict[str, _Change] = {
    "delete-line": _lines(lambda lines, i, j: lines.__delitem__(i)),
    "double-line": _lines(lambda lines, i, j: lines.insert(j, lines[i])),
    "exchange-lines": _lines(_exchange),
    "cell": _cells(_EXTREMES),
}
_TABLE: dict[str, _Change] = {"column": _column, "name": _name}
_TOML: dict[str, _Change] = {"value": _toml_value, "toml-cell": _cells(_TOML_VALUES)}
_KINDS = {**_BYTES, **_TEXT, **_TABLE, **_TOML}


def damages(form: str) -> st.SearchStrategy[tuple[Damage, ...]]:
    """One to three damages of a file: ``csv``, ``toml`` or ``bytes`` (what is no text)."""
    kinds = {"csv": (*_BYTES, *_TEXT, *_TABLE), "toml": (*_BYTES, *_TEXT, *_TOML), "bytes": tuple(_BYTES)}[form]
    shares = st.integers(0, 9999).map(lambda n: n / 10000)
    one = st.builds(Damage, st.sampled_from(kinds), shares, shares, st.integers(0, 999))
    return st.lists(one, min_size=1, max_size=3).map(tuple)


def damaged(content: bytes, those: tuple[Damage, ...]) -> bytes:
    """A content with one damage after the other."""
    for damage in those:
        content = damage.applied(content)
    return content


# -- Parquet: whole files whose columns are of other types --------------------------------------------------


def _texts(column: pa.ChunkedArray) -> list[str]:
    return [str(value) for value in column.to_pylist()]


def _nested(column: pa.ChunkedArray) -> pa.Array:
    return pa.array([[value, value] for value in column.to_pylist()])


_TYPES: dict[str, Callable[[pa.ChunkedArray], Any]] = {
    "null": lambda column: pa.nulls(len(column)),
    "nulls": lambda column: pa.nulls(len(column), column.type),
    "some null": lambda column: pa.array([None, *column.to_pylist()[1:]], column.type),
    "text": lambda column: pa.array(_texts(column)),
    "large text": lambda column: pa.array(_texts(column), pa.large_string()),
    "text view": lambda column: pa.array(_texts(column), pa.string_view()),
    "bytes": lambda column: pa.array([text.encode() + b"\xff" for text in _texts(column)], pa.binary()),
    "dictionary": lambda column: pa.array(_texts(column)).dictionary_encode(),
    "dictionary of values": lambda column: column.combine_chunks().dictionary_encode(),
    "truth": lambda column: pa.array([n % 2 == 0 for n in range(len(column))]),
    "list": _nested,
    "struct": lambda column: pa.array([{"a": value} for value in column.to_pylist()]),
    "day": lambda column: pa.array(np.arange(len(column), dtype=np.int32), pa.date32()),
    "clock": lambda column: pa.array(np.arange(len(column)), pa.time64("ns")),
    "moment": lambda column: pa.array(np.arange(len(column)) * 10**9, pa.timestamp("ns", tz="Europe/Berlin")),
    "far moment": lambda column: pa.array(np.full(len(column), 2**62), pa.timestamp("s")),
    "span": lambda column: pa.array(np.arange(len(column)), pa.duration("us")),
    "decimal": lambda column: pa.array(np.arange(len(column))).cast(pa.decimal128(38, 3)),
    "long decimal": lambda column: pa.array([10**75] * len(column), pa.decimal256(76, 0)),
    "half": lambda column: pa.array(np.arange(len(column), dtype=np.float16)),
    "unsigned": lambda column: pa.array(np.full(len(column), 2**64 - 1, dtype=np.uint64)),
    "float": lambda column: pa.array(np.arange(len(column), dtype=np.float64) + 0.5),
    "nan": lambda column: pa.array(np.full(len(column), np.nan)),
    "extreme": lambda column: pa.array(np.full(len(column), -1.7e308)),
    "whole": lambda column: pa.array(np.full(len(column), -(2**63), dtype=np.int64)),
}


@dataclass(frozen=True)
class ColumnDamage:
    """A column of a Parquet table (by a share of their number) as another type, or under another name."""

    column: float
    kind: str
    name: str | None

    def applied(self, table: pa.Table) -> pa.Table:
        """The table with the damage."""
        at = int(self.column * table.num_columns)
        name = table.column_names[at] if self.name is None else self.name
        try:
            values = _TYPES[self.kind](table.column(at)) if self.kind else table.column(at)
        except (pa.ArrowException, OverflowError):
            return table  # a second damage of one column, of a type that the first made impossible
        return table.set_column(at, name, values)


def column_damages() -> st.SearchStrategy[tuple[ColumnDamage, ...]]:
    """One or two of them."""
    shares = st.integers(0, 999).map(lambda n: n / 1000)
    kinds = st.sampled_from(("", *_TYPES))
    one = st.builds(ColumnDamage, shares, kinds, st.one_of(st.none(), st.none(), st.sampled_from(_NAMES)))
    return st.lists(one, min_size=1, max_size=2).map(tuple)
