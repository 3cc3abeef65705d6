"""PhotoModeler's text export of a project: cameras of photos, object points with sigmas, marks on photos.

One file of blocks that end with a blank line: five header lines, six lines per photo (name; position and angles; their
sigmas; covariances, or nothing; interior orientation; its sigmas), control points, object points, marks. Saved tables
of 2-D and 3-D points are text with column names, and need no reader.

A mark has a sigma of 0 if the program states none. Points matched by the program (SmartPoints) have such marks and
their own numbering: one number may denote a SmartPoint and another point that a person marked.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask
from truing.formats.guess import MappingKeys
from truing.formats.interior_orientation import CORNER, Row, camera_row, from_corrections
from truing.formats.raw import RawBatch, Unusable, Wanted, finite_numbers, integer_columns, one_batch

_LARGEST = 1 << 28
_HEAD = 5
_PER_PHOTO = 6
_PHOTO = "a photo in six lines: name, position and angles, their sigmas, covariances, interior orientation, its sigmas"
_FREE = "c x0 y0 A1 A2 A3 B1 B2"


@dataclass(frozen=True)
class _Photo:
    name: str
    number: int
    interior: Array
    line: int


@dataclass(frozen=True)
class _NumberBlock:
    """Lines of numbers (N, K), and the line in the file of the first, from 1."""

    rows: Array
    first: int

    @property
    def lines(self) -> list[int]:
        return list(range(self.first, self.first + len(self.rows)))


@dataclass(frozen=True)
class _Export:
    size: tuple[int, int]
    photos: list[_Photo]
    points: _NumberBlock
    marks: _NumberBlock


def read_photomodeler(path: Path, wanted: Wanted, table: str) -> Iterator[RawBatch]:
    """Yield the rows of ``table``: image_points, cameras, else points; raises Unusable for other files."""
    export = _read(path)
    if table == "image_points":
        yield from one_batch(_rays(export), wanted, lines=export.marks.lines)
    elif table == "cameras":
        photos = list({tuple(photo.interior): photo for photo in reversed(export.photos)}.values())[::-1]
        rows = [_camera(export, photo) for photo in photos]
        lines = [photo.line for photo in photos]
        yield from one_batch({name: [row[name] for row in rows] for name in rows[0]}, wanted, lines=lines)
    else:
        yield from one_batch(_points(export), wanted, "m", export.points.lines)


def _read(path: Path) -> _Export:
    with path.open("rb") as stream:
        content = stream.read(_LARGEST + 1)
    lines = content[:_LARGEST].decode("cp1252", errors="replace").splitlines()
    if len(content) > _LARGEST or b"\0" in content or len(lines) < _HEAD:
        raise Unusable("PhotoModeler's text export, with a header of five lines")
    tolerance = finite_numbers(lines[1], "tolerance, iterations, width and height of the photos in pixels", 2)
    if len(tolerance) < 4 or not (tolerance[2:4] >= 1).all():
        expected = (
            "width and height of the photos in pixels after tolerance and iterations; pixels have no size without them"
        )
        raise Unusable(expected, row=2, value=lines[1][:80])
    photos, at = _photos(lines)
    _, at = _block(lines, at, 7, "a control point: number, x y z, their sigmas")
    points, at = _block(lines, at, 7, "an object point: number, x y z, their sigmas")
    marks, at = _block(lines, at, 6, "a mark: photo, point, x y in pixels, their sigmas in pixels")
    width, height = integer_columns(tolerance[2:4], "pixels", [2, 2]).tolist()
    return _Export((width, height), photos, points, marks)


def _photos(lines: list[str]) -> tuple[list[_Photo], int]:
    """Return the photos, and the line after the blank one that ends them."""
    photos, at = [], _HEAD
    while at < len(lines) and lines[at].strip():
        if at + _PER_PHOTO > len(lines):
            raise Unusable(_PHOTO, row=at + 1, value=lines[at][:80])
        number, _, name = lines[at].strip().partition(" ")
        interior = finite_numbers(lines[at + 4], _PHOTO, at + 5)
        if not number.isdigit() or len(interior) != 11 or interior[0] != int(number):
            raise Unusable(_PHOTO, row=at + 1, value=lines[at][:80])
        photos.append(_Photo(PureWindowsPath(name.strip()).name or number, int(number), interior[1:], at + 1))
        at += _PER_PHOTO
    if not photos:
        raise Unusable(_PHOTO, row=_HEAD + 1)
    return photos, at + 1


def _block(lines: list[str], at: int, count: int, expected: str) -> tuple[_NumberBlock, int]:
    """Return lines of ``count`` numbers up to a blank one, and the line after that."""
    rows, first = [], at + 1
    while at < len(lines) and lines[at].strip():
        rows.append(finite_numbers(lines[at], expected, at + 1, count))
        at += 1
    return _NumberBlock(np.array(rows).reshape(-1, count), first), at + 1


def _rays(export: _Export) -> MappingKeys:
    marks, lines = export.marks.rows, export.marks.lines
    photo, point = integer_columns(marks[:, 0], "photos", lines), integer_columns(marks[:, 1], "points", lines)
    photos = {photo.number: photo for photo in export.photos}
    unknown = np.flatnonzero(~np.isin(photo, list(photos)))
    if len(unknown):
        row = int(unknown[0])
        raise Unusable("marks on photos of the file", row=lines[row], column="photo", value=str(photo[row]))
    cameras = {number: str(_camera(export, one)["camera"]) for number, one in photos.items()}
    stated = _stated(marks)
    shared = np.isin(point, point[stated]) & np.isin(point, _numbered_twice(export))
    return {
        "image": np.array([photos[number].name for number in photo.tolist()], dtype=object),
        "camera": np.array([cameras[number] for number in photo.tolist()], dtype=object),
        "point": _names(point, shared & ~stated),
        "x_px": marks[:, 2] - CORNER,
        "y_px": marks[:, 3] - CORNER,
        "sigma_x_px": _or_empty(marks[:, 4], stated),
        "sigma_y_px": _or_empty(marks[:, 5], stated),
    }


def _numbered_twice(export: _Export) -> Array:
    """Return numbers of two points: twice among object points, or on one photo with and without a sigma."""
    numbers, times = np.unique(export.points.rows[:, 0], return_counts=True)
    marks = export.marks.rows
    kinds = np.column_stack([marks[:, :2], _stated(marks)])
    on_photo, kinds_on_photo = np.unique(np.unique(kinds, axis=0)[:, :2], axis=0, return_counts=True)
    return np.concatenate([numbers[times > 1], on_photo[kinds_on_photo > 1, 1]])


def _names(numbers: Index, matched: Mask) -> NDArray[np.object_]:
    """Return names of points: their numbers, or ``smart 6`` for a matched point with the number of another point."""
    plain = numbers.astype(str).astype(object)
    return np.where(matched, "smart " + plain, plain)


def _stated(rows: Array) -> Mask:
    """Return the mask of lines (N, K) that end in positive sigmas: others state none, or are fixed (negative)."""
    return np.asarray((rows[:, 4:] > 0.0).all(axis=1))


def _or_empty(values: Array, there: Mask) -> list[float | None]:
    return [float(value) if known else None for value, known in zip(values, there, strict=True)]


def _camera(export: _Export, photo: _Photo) -> Row:
    """Return the camera of a photo: principal distance, principal point from the upper left corner, format in mm, K1 K2
    K3 P1 P2. Photos with equal interior orientation share one camera, named by the first of them."""
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
    name = f"camera of {first.name}" if len({tuple(photo.interior) for photo in export.photos}) > 1 else "camera"
    return {**camera_row(name, export.size, ten, pixel_um=1e3 * p), "free": _FREE}


def _points(export: _Export) -> MappingKeys:
    """Return the object points; fixed ones have no sigma here, and a negative one in the file. The second point of a
    duplicate number is the matched one."""
    points = export.points.rows
    number = integer_columns(points[:, 0], "points", export.points.lines)
    again = np.ones(len(number), dtype=bool)
    again[np.unique(number, return_index=True)[1]] = False
    stated = _stated(points)
    return {
        "target": _names(number, again),
        **{name: points[:, 1 + axis] for axis, name in enumerate(("x", "y", "z"))},
        **{name: _or_empty(points[:, 4 + axis], stated) for axis, name in enumerate(("sx", "sy", "sz"))},
    }
