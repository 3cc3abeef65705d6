"""The files of a COLMAP model, text and binary: cameras, images with their rays, points with their tracks.

Layout: https://colmap.github.io/format.html. Every count is held against what is left of the file before anything is
made of it.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.formats.raw import Unusable, whole_numbers

# number -> (name, number of parameters)
MODELS = {
    0: ("SIMPLE_PINHOLE", 3),
    1: ("PINHOLE", 4),
    2: ("SIMPLE_RADIAL", 4),
    3: ("RADIAL", 5),
    4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8),
    6: ("FULL_OPENCV", 12),
    7: ("FOV", 5),
    8: ("SIMPLE_RADIAL_FISHEYE", 4),
    9: ("RADIAL_FISHEYE", 5),
    10: ("THIN_PRISM_FISHEYE", 12),
    11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
}
_PARAMETERS = dict(MODELS.values())
_LONGEST_NAME = 4096
_RAY = np.dtype([("xy", "<f8", 2), ("point", "<i8")])
_LARGEST = 1 << 30


@dataclass(frozen=True)
class ColmapCamera:
    """A camera: its number, the name of its model, its format in px, its parameters; ``line`` as of an image."""

    number: int
    model: str
    size: tuple[int, int]
    parameters: tuple[float, ...]
    line: int | None = None


@dataclass(frozen=True)
class ColmapImage:
    """An image: quaternion (4,) w x y z and translation (3,) from world to camera, its camera, its name, its rays
    xy (N, 2) in px from the format's corner, and the point (N,) of each, -1 where it has none.

    ``line`` is where its rays stand in a text, from 1; None in a binary file."""

    number: int
    quaternion: NDArray[np.float64]
    translation: NDArray[np.float64]
    camera: int
    name: str
    xy: NDArray[np.float64]
    point: NDArray[np.int64]
    line: int | None = None


@dataclass(frozen=True)
class ColmapPoint:
    """A point: coordinates in the model's own unit, mean reprojection error in px, how many rays it has; ``line`` as of
    an image."""

    number: int
    xyz: tuple[float, float, float]
    error: float
    rays: int
    line: int | None = None


def read_cameras(path: Path) -> list[ColmapCamera]:
    """The cameras of a model; raises Unusable where the file is no whole one."""
    if _is_text(path):
        return [_camera_of_line(row, words) for row, words in _lines(path)]
    data = _Bytes(path)
    return [_camera(data) for _ in data.counted(24)]


def read_images(path: Path) -> list[ColmapImage]:
    """The images of a model; raises Unusable where the file is no whole one."""
    if _is_text(path):
        return list(_images_of_lines(path))
    data = _Bytes(path)
    return [_image(data) for _ in data.counted(73)]


def read_points(path: Path) -> list[ColmapPoint]:
    """The points of a model; raises Unusable where the file is no whole one."""
    if _is_text(path):
        return [_point_of_line(row, words) for row, words in _lines(path)]
    data = _Bytes(path)
    return [_point(data) for _ in data.counted(51)]


def _is_text(path: Path) -> bool:
    """Whether a file begins as text does: a binary one begins with a count of eight bytes, the last of them 0."""
    with path.open("rb") as stream:
        head = stream.read(64)
    return b"\0" not in head and bool(head)


class _Bytes:
    """A binary file that is read from its beginning, and says where it ends too early."""

    def __init__(self, path: Path) -> None:
        if path.stat().st_size > _LARGEST:
            raise Unusable(f"a file of at most {_LARGEST >> 20} MB", value=f"{path.stat().st_size >> 20} MB")
        self.content, self.at = path.read_bytes(), 0

    def take(self, layout: str) -> tuple[Any, ...]:
        size = struct.calcsize(layout)
        if self.at + size > len(self.content):
            raise self._ends("values")
        self.at += size
        return struct.unpack_from(layout, self.content, self.at - size)

    def counted(self, smallest: int) -> Iterator[int]:
        """As many numbers as the file says it has records; none of them is shorter than ``smallest`` bytes."""
        (count,) = self.take("<Q")
        self.room_for(count, smallest, "records")
        yield from range(count)
        if self.at < len(self.content):
            raise Unusable(
                f"the end of the file after {count} records", value=f"{len(self.content) - self.at} bytes more"
            )

    def room_for(self, count: int, size: int, what: str) -> None:
        if count * size > len(self.content) - self.at:
            raise self._ends(f"{count} {what}")

    def text(self) -> str:
        end = self.content.find(b"\0", self.at, self.at + _LONGEST_NAME)
        if end < 0:
            raise self._ends("a name")
        found, self.at = self.content[self.at : end], end + 1
        return found.decode(errors="replace")

    def array(self, layout: np.dtype[Any], count: int) -> NDArray[Any]:
        self.room_for(count, layout.itemsize, "rays")
        found = np.frombuffer(self.content, layout, count, self.at)
        self.at += count * layout.itemsize
        return found

    def _ends(self, what: str) -> Unusable:
        left = len(self.content) - self.at
        return Unusable(f"a whole file of a COLMAP model: {what} from byte {self.at} on", value=f"{left} bytes left")


def _camera(data: _Bytes) -> ColmapCamera:
    number, model, width, height = data.take("<IiQQ")
    if model not in MODELS:
        raise Unusable(f"a camera model from 0 to {max(MODELS)}", value=str(model), column="model")
    name, count = MODELS[model]
    return ColmapCamera(number, name, (width, height), data.take(f"<{count}d"))


def _image(data: _Bytes) -> ColmapImage:
    number, *motion, camera = data.take("<I7dI")
    name = data.text()
    (count,) = data.take("<Q")
    rays = data.array(_RAY, count)
    return ColmapImage(number, np.array(motion[:4]), np.array(motion[4:]), camera, name, rays["xy"], rays["point"])


def _point(data: _Bytes) -> ColmapPoint:
    number, x, y, z, _, _, _, error, length = data.take("<Q3d3BdQ")
    data.array(np.dtype("<u8"), length)  # image and place of each ray in it: the images say the same
    return ColmapPoint(number, (x, y, z), error, length)


def _lines(path: Path, *, blank: bool = False) -> Iterator[tuple[int, list[str]]]:
    """Number and words of each line that is no comment; ``blank`` keeps lines without words."""
    with path.open(encoding="utf-8", errors="replace") as stream:
        for row, line in enumerate(stream, start=1):
            if not line.startswith("#") and (blank or line.strip()):
                yield row, line.split()


def _camera_of_line(row: int, words: list[str]) -> ColmapCamera:
    expected = "a camera: number, model, width, height, parameters"
    if len(words) < 5 or words[1] not in _PARAMETERS:
        raise Unusable(expected, row=row, value=" ".join(words)[:80])
    if len(words) != 4 + _PARAMETERS[words[1]]:
        raise Unusable(f"{_PARAMETERS[words[1]]} parameters of {words[1]}", row=row, value=f"{len(words) - 4} of them")
    given = _numbers(row, [words[0], *words[2:4]], expected)
    number, width, height = whole_numbers(given, "cameras and pixels", [row] * 3).tolist()
    return ColmapCamera(number, words[1], (width, height), tuple(_numbers(row, words[4:], expected).tolist()), row)


def _images_of_lines(path: Path) -> Iterator[ColmapImage]:
    lines = _lines(path, blank=True)
    expected = "an image: number, qw qx qy qz, tx ty tz, camera, name"
    for row, words in lines:
        if not words:
            continue
        if len(words) < 10:
            raise Unusable(expected, row=row, value=" ".join(words)[:80])
        numbers = _numbers(row, words[:9], expected)
        number, camera = whole_numbers(numbers[[0, 8]], "images and cameras", [row] * 2).tolist()
        second, rays = next(lines, (row + 1, None))
        if rays is None or len(rays) % 3:
            raise Unusable("the image's rays in threes, x y point", row=second, value=f"{len(rays or ())} numbers")
        found = _numbers(second, rays, "rays: x y point").reshape(-1, 3)
        name, xy, point = " ".join(words[9:]), found[:, :2], whole_numbers(found[:, 2], "points", [second] * len(found))
        yield ColmapImage(number, numbers[1:5], numbers[5:8], camera, name, xy, point, second)


def _point_of_line(row: int, words: list[str]) -> ColmapPoint:
    expected = "a point: number, x y z, red green blue, error, track"
    if len(words) < 8 or len(words) % 2:
        raise Unusable(expected, row=row, value=" ".join(words)[:80])
    number, x, y, z, *_, error = _numbers(row, words[:8], expected)
    (named,) = whole_numbers(np.array([number]), "points", [row]).tolist()
    return ColmapPoint(named, (float(x), float(y), float(z)), float(error), (len(words) - 8) // 2, row)


def _numbers(row: int, words: list[str], expected: str) -> NDArray[np.float64]:
    try:
        found = np.array(words, dtype=np.float64)
    except ValueError:
        raise Unusable(expected, row=row, value=" ".join(words)[:80]) from None
    if not np.isfinite(found).all():
        raise Unusable(f"{expected}, all of them finite", row=row, value=" ".join(words)[:80])
    return found
