"""Point clouds, PLY and PCD, by Open3D: coordinates and whatever else each point carries."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from truing.formats.cloud_heads import check_cloud_head
from truing.formats.raw import RawBatch, Unusable, Wanted, consecutive
from truing.open3d_library import load_open3d

_STDERR = 2


def read_point_cloud(path: Path, wanted: Wanted) -> Iterator[RawBatch]:
    """The points of one cloud in one batch; raises Unusable where there are none."""
    import pyarrow as pa

    check_cloud_head(path)
    attributes = _attributes(path)
    kinds = wanted(tuple(attributes), None)
    if kinds is None:
        return
    values = list(attributes.values())
    columns = {i: pa.array(values[i]) for i in kinds}
    yield RawBatch(columns, consecutive(0, len(values[0])))


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
