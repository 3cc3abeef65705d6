"""Marker trajectories: C3D by ezc3d, and TRC as the delimited text that it is."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import numpy as np

from schemas.mapping import FileMapping
from truing.formats.raw import RawBatch, Unusable, Wanted, consecutive
from truing.formats.text import BLOCK, utf8_chunks

_C3D_COLUMNS = ("frame", "time_s", "label", "x", "y", "z", "residual")
_TRC_HEADER_LINES = 5
_WINDOWS_ERROR = 0xC0000000  # exit codes from here on are those of a process that the system has ended


def read_c3d(path: Path, wanted: Wanted) -> Iterator[RawBatch]:
    """One row per frame and marker, null where the marker was not seen; raises Unusable where it is no C3D."""
    import pyarrow as pa

    labels, points, residuals, first, rate, unit = _c3d(path)
    kinds = wanted(_C3D_COLUMNS, unit)
    if kinds is None:
        return
    frames, count = points.shape[2], len(labels)
    xyz = points[:3].transpose(2, 1, 0).reshape(-1, 3)
    seen = np.isfinite(xyz).all(axis=1) & (residuals.T.ravel() >= 0)
    frame = np.repeat(np.arange(first, first + frames), count)
    names = pa.DictionaryArray.from_arrays(pa.array(np.tile(np.arange(count, dtype=np.int32), frames)), labels)
    columns = [pa.array(frame), pa.array((frame - first) / rate), names]
    columns += [pa.array(np.ascontiguousarray(xyz[:, axis]), mask=~seen) for axis in range(3)]
    columns.append(pa.array(residuals.T.ravel()))
    yield RawBatch({position: columns[position] for position in kinds}, consecutive(0, frames * count))


def _open_c3d(path: Path):  # type: ignore[no-untyped-def]
    try:
        import ezc3d
    except ModuleNotFoundError:
        raise Unusable("TRC or text here: C3D needs ezc3d, which this platform has no wheel of") from None
    _try_elsewhere(path)
    try:
        return ezc3d.c3d(str(path))
    except Exception as error:  # ezc3d lets the exceptions of its C++ through under several types
        raise Unusable("a whole C3D file", value=str(error).splitlines()[0][:80]) from None


def _try_elsewhere(path: Path) -> None:
    """Read the file in a process of its own first: damaged ones end whatever process ezc3d reads them in."""
    words = [sys.executable, "-c", "import sys, ezc3d; ezc3d.c3d(sys.argv[1])", str(path.resolve())]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(words, env=environment, stdin=subprocess.DEVNULL, capture_output=True, check=False)
    if done.returncode < 0 or done.returncode >= _WINDOWS_ERROR:
        raise Unusable("a whole C3D file; this one is damaged")


def _c3d(path: Path) -> tuple[list[str], np.ndarray, np.ndarray, int, float, str]:
    file = _open_c3d(path)
    points = file["data"]["points"]
    if not points.size:
        raise Unusable("at least one marker and frame")
    group = file["parameters"]["POINT"]
    labels = [label for key in sorted(group) if key.startswith("LABELS") for label in group[key]["value"]]
    header = file["header"]["points"]
    residuals = file["data"]["meta_points"]["residuals"][0]
    unit = (group["UNITS"]["value"] if "UNITS" in group else []) or ["mm"]
    first, rate = int(header["first_frame"]), float(header["frame_rate"])
    return labels[: points.shape[1]], points, residuals, first, rate, unit[0]


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
