"""Marker trajectories: C3D by ezc3d in a process with limits, and TRC as delimited text."""

from __future__ import annotations

import importlib.util
import json
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
import pyarrow as pa

from truing.arrays import Array
from truing.child_processes import child_environment
from truing.formats.c3d_child import FACTS, POINTS, REASON
from truing.formats.raw import RawBatch, Unusable, Wanted, consecutive
from truing.formats.text import BLOCK, utf8_chunks
from truing.schemas.mapping import FileMapping

SECONDS = 30.0  # in addition to time in proportion to a file's size
_BYTES_PER_SECOND = 1e6
_MEMORY = 2 << 30  # bytes, in addition to memory in proportion to a file's size
_MEMORY_PER_BYTE = 40
_BLOCK = 512
_MAGIC = 0x50
_ORDERS = {84: ("<", 3), 85: ("<", 1), 86: (">", 0)}  # processor: byte order, and the byte of a real's sign
_WHOLE = "an undamaged C3D file"
_MOST = 0xFFFF  # largest count of a header; longer recordings also show this value
_C3D_COLUMNS = ("frame", "time_s", "label", "x", "y", "z", "residual")
_TRC_HEADER_LINES = 5


@dataclass(frozen=True)
class Trajectories:
    """Markers over frames: ``xyz`` (3, markers, frames) in ``unit``, residuals (markers, frames), negative or NaN for a
    marker not seen; ``rate`` in Hz."""

    labels: list[str]
    xyz: Array
    residuals: Array
    first: int
    rate: float
    unit: str


def read_trajectories(path: Path) -> Trajectories:
    """Return the markers of a C3D file; raises Unusable if it is damaged, truncated or no C3D file."""
    if importlib.util.find_spec("ezc3d") is None:
        raise Unusable("TRC or text here: C3D needs ezc3d, which this platform has no wheel of")
    announced = announced_frames(path)
    with tempfile.TemporaryDirectory(prefix="truing-") as folder:
        trajectories = _read_in_process(path, Path(folder))
    if not trajectories.xyz.size:
        raise Unusable("at least one marker and frame")
    frames = trajectories.xyz.shape[2]
    if len(trajectories.labels) < trajectories.xyz.shape[1]:
        raise Unusable(
            "a label for every marker",
            value=f"{len(trajectories.labels)} labels of {trajectories.xyz.shape[1]} markers",
        )
    if announced is not None and frames != announced:
        raise Unusable(f"{_WHOLE}; its header announces {announced} frames, {frames} could be read: export it again")
    if not (np.isfinite(trajectories.rate) and trajectories.rate > 0):
        raise Unusable("a C3D file with a frame rate above 0 Hz", value=f"{trajectories.rate:g}")
    return trajectories


def announced_frames(path: Path) -> int | None:
    """Return the number of frames in a header, None if it exceeds the header's range.

    Raises Unusable for an invalid header, or one that announces more than the file holds.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_BLOCK)
        if len(head) < _BLOCK or head[1] != _MAGIC or not head[0]:
            raise Unusable(f"{_WHOLE}, which begins with a header of {_BLOCK} bytes")
        start = (head[0] - 1) * _BLOCK
        file.seek(start)
        parameters = file.read(4)
    if len(parameters) < 4 or parameters[3] not in _ORDERS:
        raise Unusable(f"{_WHOLE}; its parameters are not where its header says")
    order, sign = _ORDERS[parameters[3]]
    markers, analog, first, last = struct.unpack(f"{order}4H", head[2:10])
    (data,) = struct.unpack(f"{order}H", head[16:18])
    value = 4 if head[12 + sign] & 0x80 else 2  # bytes per value: reals for a negative scale, else integers
    begin = max(start + parameters[2] * _BLOCK, (data - 1) * _BLOCK)
    frames = last - first + 1 if first <= last < _MOST else None
    needed = begin + (frames or 0) * (4 * markers + analog) * value
    if needed > size:
        raise Unusable(f"{_WHOLE}; its header announces {needed} bytes", value=f"{size} bytes")
    return frames


def _read_in_process(path: Path, folder: Path) -> Trajectories:
    """Return the trajectories, read in a process with limits of time and memory."""
    size = path.stat().st_size
    memory = _MEMORY + _MEMORY_PER_BYTE * size
    words = [sys.executable, "-P", "-m", "truing.formats.c3d_child", str(path.resolve()), str(folder), str(memory)]
    seconds = SECONDS + size / _BYTES_PER_SECOND
    try:
        subprocess.run(
            words,
            env=child_environment(),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=seconds,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise Unusable(f"{_WHOLE}; this one is damaged: it was not read after {seconds:.0f} s") from None
    if (reason := folder / REASON).exists():
        raise Unusable(_WHOLE, value=reason.read_text(encoding="utf-8"))
    if not (folder / FACTS).exists():
        raise Unusable(f"{_WHOLE}; this one is damaged")
    facts = json.loads((folder / FACTS).read_text(encoding="utf-8"))
    values = np.fromfile(folder / POINTS).reshape(4, facts["markers"], facts["frames"])
    labels = facts["labels"][: facts["markers"]]
    return Trajectories(labels, values[:3], values[3], facts["first"], facts["rate"], facts["unit"])


def read_c3d(path: Path, wanted: Wanted) -> Iterator[RawBatch]:
    """Yield one row per frame and marker, null for a marker not seen; raises Unusable for other files."""
    trajectories = read_trajectories(path)
    kinds = wanted(_C3D_COLUMNS, trajectories.unit)
    if kinds is None:
        return
    _, count, frames = trajectories.xyz.shape
    xyz, residuals = trajectories.xyz.transpose(2, 1, 0).reshape(-1, 3), trajectories.residuals.T.ravel()
    is_observed = np.isfinite(xyz).all(axis=1) & (residuals >= 0)
    frame = np.repeat(np.arange(trajectories.first, trajectories.first + frames), count)
    names = pa.DictionaryArray.from_arrays(
        pa.array(np.tile(np.arange(count, dtype=np.int32), frames)), trajectories.labels
    )
    columns = [pa.array(frame), pa.array((frame - trajectories.first) / trajectories.rate), names]
    columns += [pa.array(np.ascontiguousarray(xyz[:, axis]), mask=~is_observed) for axis in range(3)]
    columns.append(pa.array(residuals))
    yield RawBatch({position: columns[position] for position in kinds}, consecutive(0, frames * count))


def trc_as_delimited(stream: IO[bytes], entry: FileMapping) -> FileMapping:
    """Return the mapping that reads a TRC file as wide delimited text; raises Unusable for an invalid header."""
    head = next(utf8_chunks(stream, entry.encoding, BLOCK), b"").decode(errors="replace").splitlines()
    if len(head) < _TRC_HEADER_LINES or "Frame" not in head[3]:
        raise Unusable("the five header lines of a TRC file", row=1)
    settings = dict(zip(head[1].split("\t"), head[2].split("\t"), strict=False))
    markers = [name.strip() for name in head[3].split("\t")[2:] if name.strip()]
    names = ("frame", "time_s", *(f"{marker}:{axis}" for marker in markers for axis in "xyz"))
    columns_of_marker = {
        "separator": "\t",
        "header": False,
        "names": names,
        "skip_lines": _TRC_HEADER_LINES,
        "wide": "{label}:{axis}",
        "unit": entry.unit or settings.get("Units", "mm").strip() or "mm",
    }
    return entry.model_copy(update=columns_of_marker)
