"""Reader of point clouds, PLY and PCD: the announced number of points, with all numbers of each."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from itertools import chain, islice
from pathlib import Path
from typing import IO

import numpy as np
import pyarrow as pa

from truing.formats.cloud_files import CloudLayout, pcd_layout, pcd_points, ply_layout, ply_vertices
from truing.formats.delimited import read_delimited
from truing.formats.raw import Kind, RawBatch, Unusable, Wanted, consecutive
from truing.schemas.mapping import FileMapping

_LINES = 1 << 20  # bytes of lines processed together


def cloud_layout(path: Path, file_format: str) -> CloudLayout:
    """Return the header of a cloud; raises Unusable if it is damaged."""
    return ply_layout(path) if file_format == "ply" else pcd_layout(path)


def read_point_cloud(path: Path, file_format: str, entry: FileMapping, wanted: Wanted) -> Iterator[RawBatch]:
    """Yield the points of one cloud; raises Unusable if they differ from its header."""
    layout = cloud_layout(path, file_format)
    if layout.form == "ascii":
        with path.open("rb") as stream:
            yield from _read_text(stream, layout, entry, wanted)
        return
    kinds = wanted(layout.names, None)
    if kinds is None:
        return
    data = np.fromfile(path, dtype=np.uint8)
    records = ply_vertices(layout, data) if file_format == "ply" else pcd_points(layout, data)
    values = layout.columns(records)
    yield RawBatch({i: pa.array(values[i]) for i in kinds}, consecutive(0, layout.points))


def cloud_as_delimited(layout: CloudLayout, entry: FileMapping) -> FileMapping:
    """Return the mapping that reads the points of a cloud written as text."""
    columns_of_cloud = {
        "separator": "whitespace",
        "header": False,
        "names": layout.names,
        "skip_lines": layout.lines + sum(element.count for element in layout.before),
        "comment": None,
        "keep_lines": None,
        "quote": "",
    }
    return entry.model_copy(update=columns_of_cloud)


def _read_text(stream: IO[bytes], layout: CloudLayout, entry: FileMapping, wanted: Wanted) -> Iterator[RawBatch]:
    as_delimited = cloud_as_delimited(layout, entry)
    width = len(layout.names)
    kinds_of_rows: list[Mapping[int, Kind] | None] = []

    def kinds_of_columns(names: tuple[str, ...], unit: str | None) -> Mapping[int, Kind] | None:
        if names != layout.names:
            expected = f"{width} numbers in every row, as the header announces"
            raise Unusable(expected, row=as_delimited.skip_lines + 1, value=f"{len(names)} numbers")
        kinds_of_rows.append(wanted(names, unit))
        return kinds_of_rows[0]

    rows = _RowStream(stream, as_delimited.skip_lines, layout.points)
    yield from read_delimited(rows, as_delimited, kinds_of_columns)  # type: ignore[arg-type]
    if kinds_of_rows == [None]:
        return
    if rows.held != layout.points:
        expected = f"{layout.points} points, as the header announces, each in a line with a line feed: export it again"
        raise Unusable(expected, value=f"{rows.held} points")
    _check_beyond(rows.remaining_lines(), layout)


def _check_beyond(lines: Iterator[bytes], layout: CloudLayout) -> None:
    """Refuse more lines after the points than announced: they may be further points, or the points may be other
    data."""
    more = sum(element.count for element in layout.after)
    for element in layout.after:
        for line in islice(lines, element.count):
            more -= 1
            if not element.fits(line.split(), layout.points):
                expected = f"a line of {element.name} here, with what the header announces for it"
                raise Unusable(expected, value=line.decode("latin-1").strip()[:40])
    beyond = sum(1 for _ in lines)
    if more or beyond:
        expected = f"{sum(element.count for element in layout.after)} lines after the points, as the header announces"
        raise Unusable(expected, value=f"{beyond} more" if beyond else f"{more} fewer")


class _RowStream:
    """A stream that ends after some lines and rows, not counting blank ones."""

    def __init__(self, stream: IO[bytes], lines: int, rows: int) -> None:
        self._stream, self._lines, self._rows = stream, lines, rows
        self._rest: list[bytes] = []
        self.held = 0

    def read(self, size: int) -> bytes:
        """Return at least ``size`` bytes of complete lines, fewer at the end."""
        buffer = io.BytesIO()
        while self.held < self._rows and buffer.tell() < size and (lines := self._stream.readlines(_LINES)):
            size_read = 0
            for line in lines:
                size_read += 1
                if self._lines:
                    self._lines -= 1
                elif line.strip():
                    self.held += 1
                    if self.held == self._rows:
                        break
            buffer.writelines(lines[:size_read])
            self._rest = lines[size_read:]
        return buffer.getvalue()

    def remaining_lines(self) -> Iterator[bytes]:
        """Yield the remaining lines, except blank ones."""
        return (line for line in chain(self._rest, self._stream) if line.strip())
