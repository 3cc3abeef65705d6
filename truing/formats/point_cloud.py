"""Point clouds, PLY and PCD, by Open3D: coordinates and whatever else each point carries."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from truing.formats.raw import RawBatch, Unusable, Wanted, consecutive
from truing.open3d_library import load_open3d

_ANNOUNCED = re.compile(rb"^(?:element \S+|POINTS|WIDTH|HEIGHT) +(\d+)", re.MULTILINE)
_HEADER = 1 << 16
_STDERR = 2
_DIGITS = 18  # a number of more is larger than any file
_POINTS_PER_BYTE = 100  # PLY is never compressed; where PCD is, by LZF, equal points shrink to a hundredth


def read_point_cloud(path: Path, wanted: Wanted) -> Iterator[RawBatch]:
    """The points of one cloud in one batch; raises Unusable where there are none."""
    import pyarrow as pa

    _check_announced(path)
    attributes = _attributes(path)
    kinds = wanted(tuple(attributes), None)
    if kinds is None:
        return
    values = list(attributes.values())
    columns = {i: pa.array(values[i]) for i in kinds}
    yield RawBatch(columns, consecutive(0, len(values[0])))


def _check_announced(path: Path) -> None:
    """A few bytes may announce any number of points, and memory would have to hold them."""
    size = path.stat().st_size
    with path.open("rb") as file:
        announced = [int(digits[:_DIGITS]) for digits in _ANNOUNCED.findall(file.read(_HEADER))]
    if max(announced, default=0) > (1 if path.suffix.lower() == ".ply" else _POINTS_PER_BYTE) * size:
        ending = path.suffix.removeprefix(".").upper()
        raise Unusable(f"a whole {ending} file; this one announces more points than its size can hold")


@contextmanager
def _unheard() -> Iterator[None]:
    """Nothing of what the reader of PLY writes to the terminal, for it is told as a fault."""
    try:
        kept = os.dup(_STDERR)
    except OSError:  # there is no terminal
        yield
        return
    try:
        with open(os.devnull, "wb") as nothing:
            os.dup2(nothing.fileno(), _STDERR)
        yield
    finally:
        os.dup2(kept, _STDERR)
        os.close(kept)


def _attributes(path: Path) -> dict[str, NDArray]:
    try:
        open3d = load_open3d()
    except ImportError as error:
        raise Unusable(f"XYZ or text here: {error}") from None
    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error), _unheard():
        try:
            cloud = open3d.t.io.read_point_cloud(str(path))
        except RuntimeError as error:
            raise Unusable("a point cloud that Open3D can read", value=str(error).splitlines()[0][:80]) from None
    if "positions" not in cloud.point or not len(cloud.point.positions):
        raise Unusable(f"a whole {path.suffix.removeprefix('.').upper()} file with points")
    points = cloud.point.positions.numpy().astype(np.float64)
    found = dict(zip("xyz", np.ascontiguousarray(points.T), strict=True))
    for name, values in cloud.point.items():
        if name != "positions" and values.shape[-1] == 1:
            found[name] = values.numpy().ravel()
    return found
