"""PhotoModeler's text export of a project: cameras of photos, object points with sigmas, marks on photos.

One file, in blocks that a blank line ends: a head of five lines, six lines per photo (name; position and angles;
their sigmas; covariances, or nothing; interior orientation; its sigmas), control points, object points, marks. Saved
tables of 2-D and of 3-D points are text with names of columns, and need no reader.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.formats.interior_orientation import CORNER, Row, camera_row, from_corrections
from truing.formats.raw import RawBatch, Unusable, Wanted
from truing.formats.whole_file import one_batch, whole_numbers

_LARGEST = 1 << 28
_HEAD = 5
_PER_PHOTO = 6
_PHOTO = "a photo in six lines: name, position and angles, their sigmas, covariances, interior orientation, its sigmas"
_FREE = "c x0 y0 A1 A2 A3 B1 B2"


@dataclass(frozen=True)
class _Photo:
    name: str
    number: int
    interior: NDArray[np.float64]


@dataclass(frozen=True)
class _Export:
    size: tuple[int, int]
    photos: list[_Photo]
    points: NDArray[np.float64]
    marks: NDArray[np.float64]


def read_photomodeler(path: Path, wanted: Wanted, table: str) -> Iterator[RawBatch]:
    """The rows of ``table``: image_points, cameras, else points; raises Unusable where the file is no such export."""
    export = _read(path)
    if table == "image_points":
        yield from one_batch(_rays(export), wanted)
    elif table == "cameras":
        rows = list({str(row["camera"]): row for row in (_camera(export, photo) for photo in export.photos)}.values())
        yield from one_batch({name: [row[name] for row in rows] for name in rows[0]}, wanted)
    else:
        yield from one_batch(_points(export), wanted, "m")


def _read(path: Path) -> _Export:
    with path.open("rb") as stream:
        content = stream.read(_LARGEST + 1)
    lines = content[:_LARGEST].decode("cp1252", errors="replace").splitlines()
    if len(content) > _LARGEST or b"\0" in content or len(lines) < _HEAD:
        raise Unusable("PhotoModeler's text export, with a head of five lines")
    tolerance = _row(lines, 1, "tolerance, iterations, width and height of the photos in pixels")
    if len(tolerance) < 4 or not (tolerance[2:4] >= 1).all():
        expected = (
            "width and height of the photos in pixels after tolerance and iterations; pixels have no size without them"
        )
        raise Unusable(expected, row=2, value=lines[1][:80])
    photos, at = _photos(lines)
    _, at = _block(lines, at, 7, "a control point: number, x y z, their sigmas")
    points, at = _block(lines, at, 7, "an object point: number, x y z, their sigmas")
    marks, at = _block(lines, at, 6, "a mark: photo, point, x y in pixels, their sigmas in pixels")
    width, height = whole_numbers(tolerance[2:4], "pixels", [2, 2]).tolist()
    return _Export((width, height), photos, points, marks)


def _photos(lines: list[str]) -> tuple[list[_Photo], int]:
    """The photos, and the line after the blank one that ends them."""
    photos, at = [], _HEAD
    while at < len(lines) and lines[at].strip():
        if at + _PER_PHOTO > len(lines):
            raise Unusable(_PHOTO, row=at + 1, value=lines[at][:80])
        number, _, name = lines[at].strip().partition(" ")
        interior = _row(lines, at + 4, _PHOTO)
        if not number.isdigit() or len(interior) != 11 or interior[0] != int(number):
            raise Unusable(_PHOTO, row=at + 1, value=lines[at][:80])
        photos.append(_Photo(PureWindowsPath(name.strip()).name or number, int(number), interior[1:]))
        at += _PER_PHOTO
    if not photos:
        raise Unusable(_PHOTO, row=_HEAD + 1)
    return photos, at + 1


def _block(lines: list[str], at: int, count: int, expected: str) -> tuple[NDArray[np.float64], int]:
    """Lines of ``count`` numbers up to a blank one (N, count), and the line after that."""
    rows = []
    while at < len(lines) and lines[at].strip():
        rows.append(_row(lines, at, expected))
        if len(rows[-1]) != count:
            raise Unusable(expected, row=at + 1, value=lines[at][:80])
        at += 1
    return np.array(rows).reshape(-1, count), at + 1


def _row(lines: list[str], at: int, expected: str) -> NDArray[np.float64]:
    try:
        found = np.array(lines[at].split(), dtype=np.float64)
    except ValueError:
        raise Unusable(expected, row=at + 1, value=lines[at][:80]) from None
    if not np.isfinite(found).all():
        raise Unusable(f"{expected}, all of them finite", row=at + 1, value=lines[at][:80])
    return found


def _rays(export: _Export) -> dict[str, Any]:
    photo = whole_numbers(export.marks[:, 0], "photos")
    photos = {one.number: one for one in export.photos}
    if unknown := sorted(set(photo.tolist()) - set(photos)):
        raise Unusable("marks on photos of the file", column="photo", value=str(unknown[0]))
    cameras = {number: str(_camera(export, one)["camera"]) for number, one in photos.items()}
    return {
        "image": np.array([photos[number].name for number in photo.tolist()], dtype=object),
        "camera": np.array([cameras[number] for number in photo.tolist()], dtype=object),
        "point": whole_numbers(export.marks[:, 1], "points").astype(str).astype(object),
        "x_px": export.marks[:, 2] - CORNER,
        "y_px": export.marks[:, 3] - CORNER,
        "sigma_x_px": export.marks[:, 4],
        "sigma_y_px": export.marks[:, 5],
    }


def _camera(export: _Export, photo: _Photo) -> Row:
    """The camera of a photo: principal distance, principal point from the upper left corner, format in mm, K1 K2 K3
    P1 P2.

    Photos of one interior orientation have one camera, which is named by the first of them.
    """
    first = next(one for one in export.photos if np.array_equal(one.interior, photo.interior))
    c, xp, yp, width_mm, height_mm, *corrections = first.interior
    if min(c, width_mm, height_mm) <= 0:
        raise Unusable("a principal distance and a format above 0", column="photo", value=first.name)
    width, height = export.size
    pitch = np.array([width_mm / width, height_mm / height])
    point = (xp - width_mm / 2, yp - height_mm / 2)
    c, x0, y0, a1, a2, a3, b1, b2, *_ = from_corrections(c, point, (width_mm, height_mm), corrections)
    p = pitch[0]
    ten = [
        c / pitch[1],
        x0 / p,
        y0 / pitch[1],
        a1 * p**2,
        a2 * p**4,
        a3 * p**6,
        b1 * p,
        b2 * p,
        pitch[1] / p - 1.0,
        0.0,
    ]
    name = f"camera of {first.name}" if len({tuple(one.interior) for one in export.photos}) > 1 else "camera"
    return {**camera_row(name, export.size, ten, pixel_um=1e3 * p), "free": _FREE}


def _points(export: _Export) -> dict[str, Any]:
    """Object points; what was held fixed has no sigma here, and a negative one in the file."""
    sigmas = np.where((export.points[:, 4:] > 0).all(axis=1, keepdims=True), export.points[:, 4:], np.nan)
    return {
        "target": whole_numbers(export.points[:, 0], "points").astype(str).astype(object),
        **{name: export.points[:, 1 + axis] for axis, name in enumerate(("x", "y", "z"))},
        **{name: [None if np.isnan(v) else v for v in sigmas[:, i]] for i, name in enumerate(("sx", "sy", "sz"))},
    }
