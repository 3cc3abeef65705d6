"""Malicious files, and files that fuzzing found to cause defects."""

from __future__ import annotations

import gzip
import io
import zipfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from tests.broken.spoiling import Broken, Spoil, appended, cell, replaced, toml, whole

_HEAD = b"pose,body,target,x_mm,y_mm,z_mm\n"


def _mapped(path: str, content: bytes | None = None, keys: str = "") -> Spoil:
    """The points in a file of another name (absent: the contract's), read by [files.points]."""

    def spoil(folder: Path) -> None:
        if content is not None:
            (folder / "points.csv").unlink()
            (folder / path).write_bytes(content)
        with open(folder / "campaign.toml", "a", encoding="utf-8") as file:
            file.write(f'[files.points]\npath = "{path}"\n{keys}\n')

    return spoil


def _archive(*names: str) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name in names:
            archive.writestr(name, _HEAD)
    return buffer.getvalue()


def _parquet(table: str, column: str, values: object) -> Spoil:
    """A table as Parquet, one of its columns made anew from its number of rows."""

    def spoil(folder: Path) -> None:
        found = pa.csv.read_csv(folder / f"{table}.csv")
        (folder / f"{table}.csv").unlink()
        place = found.column_names.index(column)
        pq.write_table(found.set_column(place, column, values(len(found))), folder / f"{table}.parquet")  # type: ignore[operator]

    return spoil


def _equal_rows(folder: Path) -> None:
    """Three million rows in some thousand bytes."""
    (folder / "points.csv").unlink()
    names = _HEAD.decode().strip().split(",")
    table = pa.table({name: pa.array(np.zeros(3_000_000)) for name in names})
    pq.write_table(table, folder / "points.parquet", compression="zstd")


CASES = (
    Broken("toml-endless-number", "telescope", toml("0.005", "9" * 5000), ("numbers of at most 4300 digits",)),
    Broken("toml-endless-brackets", "telescope", toml("0.005", "[" * 9000 + "]" * 9000), ("at most 64 tables",)),
    Broken("toml-of-a-film's-size", "telescope", whole("campaign.toml", b"# " * (9 << 20)), ("at most 16 MB",)),
    Broken("toml-path-too-long", "telescope", _mapped("x" * 5000), (r"files\.points\.path",)),
    Broken("toml-path-with-null", "telescope", _mapped("a\\u0000b"), (r"files\.points\.path",)),
    Broken("toml-encoding-of-bytes", "telescope", _mapped("points.csv", keys='encoding = "zlib"'), ("known encoding",)),
    Broken(
        "toml-encoding-of-names", "telescope", _mapped("points.csv", keys='encoding = "undefined"'), ("known encoding",)
    ),
    Broken("toml-separator-of-two", "telescope", _mapped("points.csv", keys='separator = "ab"'), ("separator",)),
    Broken("toml-quote-of-two-bytes", "telescope", _mapped("points.csv", keys='quote = "é"'), ("quote",)),
    Broken(
        "head-obeyed-by-terminals",
        "telescope",
        replaced("points.csv", "x_mm,y_mm,z_mm", "x,y,\x1b[2J"),
        (r"there are .*, \\x1b\[2J",),
    ),
    Broken("points-blank-lines-alone", "telescope", whole("points.csv", _HEAD + b"\n\n ,\n"), ("record below",)),
    Broken(
        "points-comments-alone",
        "telescope",
        _mapped("p.csv", _HEAD + b"# nothing\n" * 9, 'comment = "#"'),
        ("record below",),
    ),
    Broken("points-line-without-end", "telescope", whole("points.csv", _HEAD + b"7" * (65 << 20)), ("lines of at",)),
    Broken(
        "step-beyond-counting", "bench", cell("signals.csv", 3, "step", "9" * 19), ("column step: found '1e\\+19'",)
    ),
    Broken(
        "parquet-of-lists",
        "telescope",
        _parquet("points", "x_mm", lambda rows: pa.array([[1.0]] * rows)),
        (r"points\.parquet, column x_mm: found 'list<.*numbers or of text",),
    ),
    Broken(
        "parquet-of-bytes",
        "telescope",
        _parquet("points", "target", lambda rows: pa.array([b"\xff\xfe"] * rows)),
        (r"points\.parquet, column target: found 'binary'",),
    ),
    Broken("parquet-explodes", "telescope", _equal_rows, (r"points\.parquet: found '3000000 rows'.*250 times",)),
    Broken("archive-in-archive", "telescope", _mapped("p.csv.gz", gzip.compress(gzip.compress(_HEAD))), ("within",)),
    Broken("archive-of-two", "telescope", _mapped("p.csv.zip", _archive("a.csv", "b.csv")), ("found '2 files'",)),
    Broken("archive-leads-out", "telescope", _mapped("p.csv.zip", _archive("../../p.csv", "/p.csv")), ("'2 files'",)),
    Broken("mapping-appended-twice", "telescope", appended("campaign.toml", "[files]\n[files]\n"), ("valid TOML",)),
)
