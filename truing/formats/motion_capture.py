"""Marker trajectories: C3D by ezc3d, and TRC as the delimited text that it is."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import IO

import numpy as np

from truing.formats.c3d_file import read_trajectories
from truing.formats.raw import RawBatch, Unusable, Wanted, consecutive
from truing.formats.text import BLOCK, utf8_chunks
from truing.schemas.mapping import FileMapping

_C3D_COLUMNS = ("frame", "time_s", "label", "x", "y", "z", "residual")
_TRC_HEADER_LINES = 5


def read_c3d(path: Path, wanted: Wanted) -> Iterator[RawBatch]:
    """One row per frame and marker, null where the marker was not seen; raises Unusable where it is no C3D."""
    import pyarrow as pa

    found = read_trajectories(path)
    kinds = wanted(_C3D_COLUMNS, found.unit)
    if kinds is None:
        return
    _, count, frames = found.xyz.shape
    xyz, residuals = found.xyz.transpose(2, 1, 0).reshape(-1, 3), found.residuals.T.ravel()
    seen = np.isfinite(xyz).all(axis=1) & (residuals >= 0)
    frame = np.repeat(np.arange(found.first, found.first + frames), count)
    names = pa.DictionaryArray.from_arrays(pa.array(np.tile(np.arange(count, dtype=np.int32), frames)), found.labels)
    columns = [pa.array(frame), pa.array((frame - found.first) / found.rate), names]
    columns += [pa.array(np.ascontiguousarray(xyz[:, axis]), mask=~seen) for axis in range(3)]
    columns.append(pa.array(residuals))
    yield RawBatch({position: columns[position] for position in kinds}, consecutive(0, frames * count))


def trc_as_delimited(stream: IO[bytes], entry: FileMapping) -> FileMapping:
    """The mapping that reads a TRC file as wide delimited text; raises Unusable where its header is not one."""
    head = next(utf8_chunks(stream, entry.encoding, BLOCK), b"").decode(errors="replace").splitlines()
    if len(head) < _TRC_HEADER_LINES or "Frame" not in head[3]:
        raise Unusable("the five header lines of a TRC file", row=1)
    settings = dict(zip(head[1].split("\t"), head[2].split("\t"), strict=False))
    markers = [name.strip() for name in head[3].split("\t")[2:] if name.strip()]
    names = ("frame", "time_s", *(f"{marker}:{axis}" for marker in markers for axis in "xyz"))
    found = {
        "separator": "\t",
        "header": False,
        "names": names,
        "skip_lines": _TRC_HEADER_LINES,
        "wide": "{label}:{axis}",
        "unit": entry.unit or settings.get("Units", "mm").strip() or "mm",
    }
    return entry.model_copy(update=found)
