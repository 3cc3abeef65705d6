"""COLMAP models, text and binary, as tables (image rays, cameras, object points) and as a network of rays.

Layout: https://colmap.github.io/format.html. Every count is checked against the remaining size of the file before
memory is allocated.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index
from truing.formats.file_search import companion_files
from truing.formats.interior_orientation import CORNER, Row, camera_row, from_pinhole
from truing.formats.raw import RawBatch, Unusable, Wanted, finite_numbers, integer_columns, one_batch

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
_LEAST = 1e-6  # least length of a quaternion, which COLMAP normalises to 1
# positions of (k1, k2, k3, p1, p2) among the parameters of each model; one or two focal lengths
_SHAPES: dict[str, tuple[int, tuple[int | None, ...]]] = {
    "SIMPLE_PINHOLE": (1, (None,) * 5),
    "PINHOLE": (2, (None,) * 5),
    "SIMPLE_RADIAL": (1, (3, None, None, None, None)),
    "RADIAL": (1, (3, 4, None, None, None)),
    "OPENCV": (2, (4, 5, None, 6, 7)),
    "FULL_OPENCV": (2, (4, 5, 8, 6, 7)),
}
_FREE = {
    "SIMPLE_PINHOLE": "c x0 y0",
    "PINHOLE": "c x0 y0 C1",
    "SIMPLE_RADIAL": "c x0 y0 A1",
    "RADIAL": "c x0 y0 A1 A2",
    "OPENCV": "c x0 y0 A1 A2 B1 B2 C1",
    "FULL_OPENCV": "c x0 y0 A1 A2 A3 B1 B2 C1",
}


@dataclass(frozen=True)
class ColmapCamera:
    """A camera: number, name of its model, format in px, parameters; ``line`` as in `ColmapImage`."""

    number: int
    model: str
    size: tuple[int, int]
    parameters: tuple[float, ...]
    line: int | None = None


@dataclass(frozen=True)
class ColmapImage:
    """An image: quaternion (4,) w x y z and translation (3,) from world to camera, camera, name, rays.

    xy (N, 2): in px from the corner of the format; point (N,): of each ray, -1 without one. ``line``: line of its rays
    in a text file, from 1; None in a binary file.
    """

    number: int
    quaternion: Array
    translation: Array
    camera: int
    name: str
    xy: Array
    point: Index
    line: int | None = None


@dataclass(frozen=True)
class ColmapPoint:
    """A point: coordinates in the model's unit, mean reprojection error in px, number of rays; ``line`` as in
    `ColmapImage`."""

    number: int
    xyz: tuple[float, float, float]
    error: float
    rays: int
    line: int | None = None


def read_cameras(path: Path) -> list[ColmapCamera]:
    """Return the cameras of a model; raises Unusable for a damaged or incomplete file."""
    if _is_text(path):
        return [_camera_of_line(row, words) for row, words in _lines(path)]
    data = _Bytes(path)
    return [_camera(data) for _ in data.counted(24)]


def read_images(path: Path) -> list[ColmapImage]:
    """Return the images of a model; raises Unusable for a damaged or incomplete file."""
    if _is_text(path):
        return list(_images_of_lines(path))
    data = _Bytes(path)
    return [_image(data) for _ in data.counted(73)]


def read_points(path: Path) -> list[ColmapPoint]:
    """Return the points of a model; raises Unusable for a damaged or incomplete file."""
    if _is_text(path):
        return [_point_of_line(row, words) for row, words in _lines(path)]
    data = _Bytes(path)
    return [_point(data) for _ in data.counted(51)]


def _is_text(path: Path) -> bool:
    """True if a file is text: a binary one begins with a count of eight bytes, the last of them 0."""
    with path.open("rb") as stream:
        head = stream.read(64)
    return b"\0" not in head and bool(head)


class _Bytes:
    """A binary file, read from its beginning, with errors for a premature end."""

    def __init__(self, path: Path) -> None:
        if path.stat().st_size > _LARGEST:
            raise Unusable(f"a file of at most {_LARGEST >> 20} MB", value=f"{path.stat().st_size >> 20} MB")
        self.content, self.at = path.read_bytes(), 0

    def take(self, layout: str) -> tuple[Any, ...]:
        size = struct.calcsize(layout)
        if self.at + size > len(self.content):
            raise self._truncated_file("values")
        self.at += size
        return struct.unpack_from(layout, self.content, self.at - size)

    def counted(self, smallest: int) -> Iterator[int]:
        """Yield the number of each record announced by the file; a record has at least ``smallest`` bytes."""
        (count,) = self.take("<Q")
        self.room_for(count, smallest, "records")
        yield from range(count)
        if self.at < len(self.content):
            raise Unusable(
                f"the end of the file after {count} records", value=f"{len(self.content) - self.at} bytes more"
            )

    def room_for(self, count: int, size: int, what: str) -> None:
        if count * size > len(self.content) - self.at:
            raise self._truncated_file(f"{count} {what}")

    def text(self) -> str:
        end = self.content.find(b"\0", self.at, self.at + _LONGEST_NAME)
        if end < 0:
            raise self._truncated_file("a name")
        text_read, self.at = self.content[self.at : end], end + 1
        return text_read.decode(errors="replace")

    def array(self, layout: np.dtype[Any], count: int) -> NDArray:
        self.room_for(count, layout.itemsize, "rays")
        array_read = np.frombuffer(self.content, layout, count, self.at)
        self.at += count * layout.itemsize
        return array_read

    def _truncated_file(self, what: str) -> Unusable:
        left = len(self.content) - self.at
        return Unusable(
            f"an undamaged file of a COLMAP model: {what} from byte {self.at} on", value=f"{left} bytes left"
        )


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
    data.array(np.dtype("<u8"), length)  # image and index of each ray, which the images also contain
    return ColmapPoint(number, (x, y, z), error, length)


def _lines(path: Path, *, blank: bool = False) -> Iterator[tuple[int, list[str]]]:
    """Yield number and words of each line except comments; ``blank`` includes lines without words."""
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
    numbers = finite_numbers(" ".join([words[0], *words[2:4]]), expected, row)
    number, width, height = integer_columns(numbers, "cameras and pixels", [row] * 3).tolist()
    return ColmapCamera(
        number, words[1], (width, height), tuple(finite_numbers(" ".join(words[4:]), expected, row).tolist()), row
    )


def _images_of_lines(path: Path) -> Iterator[ColmapImage]:
    lines = _lines(path, blank=True)
    expected = "an image: number, qw qx qy qz, tx ty tz, camera, name"
    for row, words in lines:
        if not words:
            continue
        if len(words) < 10:
            raise Unusable(expected, row=row, value=" ".join(words)[:80])
        numbers = finite_numbers(" ".join(words[:9]), expected, row)
        number, camera = integer_columns(numbers[[0, 8]], "images and cameras", [row] * 2).tolist()
        second, rays = next(lines, (row + 1, None))
        if rays is None or len(rays) % 3:
            raise Unusable("the image's rays in threes, x y point", row=second, value=f"{len(rays or ())} numbers")
        rays_of_image = finite_numbers(" ".join(rays), "rays: x y point", second).reshape(-1, 3)
        name, xy, point = (
            " ".join(words[9:]),
            rays_of_image[:, :2],
            integer_columns(rays_of_image[:, 2], "points", [second] * len(rays_of_image)),
        )
        yield ColmapImage(number, numbers[1:5], numbers[5:8], camera, name, xy, point, second)


def _point_of_line(row: int, words: list[str]) -> ColmapPoint:
    expected = "a point: number, x y z, red green blue, error, track"
    if len(words) < 8 or len(words) % 2:
        raise Unusable(expected, row=row, value=" ".join(words)[:80])
    number, x, y, z, *_, error = finite_numbers(" ".join(words[:8]), expected, row)
    (named,) = integer_columns(np.array([number]), "points", [row]).tolist()
    return ColmapPoint(named, (float(x), float(y), float(z)), float(error), (len(words) - 8) // 2, row)


@dataclass(frozen=True)
class ColmapNetwork:
    """A network of rays: cameras as rows of the table ``cameras``, images, points and rays.

    Images: camera (I,) by number, R (I, 3, 3) from camera into model, centre (I, 3); points (P, 3) in the order of
    their file; rays: image (N,) and point (N,) by number, xy_px (N, 2).
    """

    cameras: list[Row]
    image_camera: Index
    R: Array
    centre: Array
    points: Array
    ray_image: Index
    ray_point: Index
    ray_px: Array


Estimate = Callable[[ColmapNetwork], "Array | None"]


"""From a network the covariances (P, 3, 3) of its points, NaN of those that it does not determine; None of none."""


def read_network(points_file: Path) -> ColmapNetwork | None:
    """Return the network of the points in a file; None without cameras and images next to it.

    Raises Unusable if one of the files is damaged.
    """
    beside = {path.name.lower().split(".")[0]: path for path in companion_files(points_file)}
    if not {"cameras", "images"} <= beside.keys():
        return None
    cameras, images = read_cameras(beside["cameras"]), read_images(beside["images"])
    points = read_points(points_file)
    place_of_camera = {camera.number: index for index, camera in enumerate(cameras)}
    place_of_point = {point.number: index for index, point in enumerate(points)}
    R = np.array([_world_to_camera(image) for image in images]).reshape(-1, 3, 3).transpose(0, 2, 1)
    translation = np.array([image.translation for image in images]).reshape(-1, 3)
    image = np.repeat(np.arange(len(images)), [len(image_of_rays.point) for image_of_rays in images])
    number = np.concatenate([np.empty(0, np.int64), *(image_of_rays.point for image_of_rays in images)])
    xy = np.concatenate([np.empty((0, 2)), *(image_of_rays.xy for image_of_rays in images)])
    point = np.array([place_of_point.get(int(point_number), -1) for point_number in number], dtype=np.int64)
    return ColmapNetwork(
        [camera_of(camera) for camera in cameras],
        np.array([place_of_camera.get(image_of_rays.camera, 0) for image_of_rays in images], dtype=np.int64),
        R,
        -np.einsum("nij,nj->ni", R, translation),
        np.array([world_point.xyz for world_point in points]).reshape(-1, 3),
        image[point >= 0],
        point[point >= 0],
        xy[point >= 0] - CORNER,
    )


def _world_to_camera(image: ColmapImage) -> Array:
    """Return the rotation matrix of an image's quaternion w x y z; raises Unusable for a quaternion of length zero."""
    length = float(np.linalg.norm(image.quaternion))
    if not (_LEAST < length < 1.0 / _LEAST and np.isfinite([*image.translation, *image.xy.ravel()]).all()):
        expected = "an image with a quaternion, a translation and rays in finite numbers"
        raise Unusable(expected, column="image", value=image.name)
    w, x, y, z = image.quaternion / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def read_colmap(path: Path, wanted: Wanted, table: str, raw: Path, estimate: Estimate | None) -> Iterator[RawBatch]:
    """Yield the rows of ``table`` from a file of a model: image_points of images, cameras of cameras, else points.

    Points get standard deviations by ``estimate`` if the rest of the model is next to the file; ``raw``: the file
    before decompression. Raises Unusable if the file is damaged or holds another table.
    """
    if table == "image_points":
        images = read_images(path)
        lines = [image.line for image in images for _ in image.point]
        yield from one_batch(_rays(images), wanted, lines=_text_lines(lines))
    elif table == "cameras":
        cameras = read_cameras(path)
        rows, lines = [camera_of(camera) for camera in cameras], [camera.line for camera in cameras]
        columns = {name: [row[name] for row in rows] for name in (rows[0] if rows else {"camera": 0})}
        yield from one_batch(columns, wanted, lines=_text_lines(lines))
    else:
        points = read_points(path)
        lines = [point.line for point in points]
        yield from one_batch({**_points(points), **_spread(raw, estimate)}, wanted, lines=_text_lines(lines))


def _text_lines(lines: list[int | None]) -> list[int] | None:
    """Return the lines of a text file; None for a binary file."""
    known = [line for line in lines if line is not None]
    return known if len(known) == len(lines) else None


def _rays(images: list[ColmapImage]) -> dict[str, object]:
    counts = [len(image.point) for image in images]
    at = np.repeat(np.arange(len(images)), counts)
    xy = np.concatenate([np.empty((0, 2)), *(image.xy for image in images)])
    point = np.concatenate([np.empty(0, np.int64), *(image.point for image in images)])
    names = np.array([image.name for image in images], dtype=object)
    cameras = np.array([str(image.camera) for image in images], dtype=object)
    return {
        "image": names[at],
        "camera": cameras[at],
        "point": np.where(point < 0, "", point.astype(str)).astype(object),
        "x_px": xy[:, 0] - CORNER,
        "y_px": xy[:, 1] - CORNER,
    }


def camera_of(camera: ColmapCamera) -> Row:
    """Return a camera as a row of the table ``cameras``; raises Unusable for models other than perspective with
    polynomials."""
    shape = _SHAPES.get(camera.model)
    values = camera.parameters
    if shape is None or any(values[9:]):
        raise Unusable(
            f"a camera of perspective and polynomials: {', '.join(_SHAPES)} with k4 k5 k6 = 0",
            column="model",
            value=f"camera {camera.number}: {camera.model}",
        )
    count, positions = shape
    distortion = [0.0 if position is None else values[position] for position in positions]
    ten = from_pinhole((values[0], values[count - 1]), (values[count], values[count + 1]), camera.size, distortion)
    return {**camera_row(str(camera.number), camera.size, ten), "free": _FREE[camera.model]}


def _points(points: list[ColmapPoint]) -> dict[str, object]:
    xyz = np.array([point.xyz for point in points]).reshape(-1, 3)
    return {
        "target": np.array([str(point.number) for point in points], dtype=object),
        **{name: xyz[:, axis] for axis, name in enumerate(("x", "y", "z"))},
        "error": np.array([point.error for point in points]),
        "rays": np.array([point.rays for point in points]),
    }


def _spread(raw: Path, estimate: Estimate | None) -> dict[str, object]:
    """Return standard deviations and correlations of points, empty if not determined; no columns without estimate."""
    network = None if estimate is None else read_network(raw)
    covariance = None if network is None or estimate is None else estimate(network)
    if covariance is None:
        return {}
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    columns = {f"s{axis}": sigma[:, i] for i, axis in enumerate("xyz")}
    columns |= {
        f"r{a}{b}": covariance[:, i, j] / (sigma[:, i] * sigma[:, j])
        for (i, a), (j, b) in combinations(enumerate("xyz"), 2)
    }
    return {name: [None if np.isnan(value) else float(value) for value in values] for name, values in columns.items()}
