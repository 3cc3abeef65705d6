"""COLMAP models as tables (rays of images, cameras, object points), and as a network of rays."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.formats.colmap_model import ColmapCamera, ColmapImage, ColmapPoint, read_cameras, read_images, read_points
from truing.formats.file_search import companions
from truing.formats.interior_orientation import CORNER, Row, camera_row, from_pinhole
from truing.formats.raw import RawBatch, Unusable, Wanted, one_batch

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_LEAST = 1e-6  # the length of a quaternion, which COLMAP writes as 1
# what of (k1, k2, k3, p1, p2) each model has, by position among its parameters; one focal length or two
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
class ColmapNetwork:
    """Cameras as rows of the table ``cameras``; images: camera (I,) by number, R (I, 3, 3) from camera into model,
    centre (I, 3); points (P, 3) in the order of their file; rays: image (N,) and point (N,) by number, xy_px (N, 2)."""

    cameras: list[Row]
    image_camera: Index
    R: Array
    centre: Array
    points: Array
    ray_image: Index
    ray_point: Index
    ray_px: Array


Estimate = Callable[[ColmapNetwork], "NDArray[np.float64] | None"]


"""From a network the covariances (P, 3, 3) of its points, NaN of those that it does not determine; None of none."""


def read_network(points_file: Path) -> ColmapNetwork | None:
    """The network of the points in a file; None where cameras and images do not lie beside it.

    Raises Unusable where one of the files is damaged.
    """
    beside = {path.name.lower().split(".")[0]: path for path in companions(points_file)}
    if not {"cameras", "images"} <= beside.keys():
        return None
    cameras, images = read_cameras(beside["cameras"]), read_images(beside["images"])
    points = read_points(points_file)
    place_of_camera = {camera.number: place for place, camera in enumerate(cameras)}
    place_of_point = {point.number: place for place, point in enumerate(points)}
    R = np.array([_world_to_camera(image) for image in images]).reshape(-1, 3, 3).transpose(0, 2, 1)
    translation = np.array([image.translation for image in images]).reshape(-1, 3)
    image = np.repeat(np.arange(len(images)), [len(one.point) for one in images])
    number = np.concatenate([np.empty(0, np.int64), *(one.point for one in images)])
    xy = np.concatenate([np.empty((0, 2)), *(one.xy for one in images)])
    point = np.array([place_of_point.get(int(one), -1) for one in number], dtype=np.int64)
    return ColmapNetwork(
        [camera_of(camera) for camera in cameras],
        np.array([place_of_camera.get(one.camera, 0) for one in images], dtype=np.int64),
        R,
        -np.einsum("nij,nj->ni", R, translation),
        np.array([one.xyz for one in points]).reshape(-1, 3),
        image[point >= 0],
        point[point >= 0],
        xy[point >= 0] - CORNER,
    )


def _world_to_camera(image: ColmapImage) -> Array:
    """The rotation matrix of an image's quaternion w x y z; raises Unusable where it is none."""
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
    """The rows of ``table`` that a file of a model holds: image_points of images, cameras of cameras, else points, with
    standard deviations by ``estimate`` where the rest of the model lies beside the file, ``raw`` before it was
    unpacked.

    Raises Unusable where the file is damaged or holds another table.
    """
    if table == "image_points":
        images = read_images(path)
        lines = [image.line for image in images for _ in image.point]
        yield from one_batch(_rays(images), wanted, lines=_known(lines))
    elif table == "cameras":
        cameras = read_cameras(path)
        rows, lines = [camera_of(camera) for camera in cameras], [camera.line for camera in cameras]
        columns = {name: [row[name] for row in rows] for name in (rows[0] if rows else {"camera": 0})}
        yield from one_batch(columns, wanted, lines=_known(lines))
    else:
        points = read_points(path)
        lines = [point.line for point in points]
        yield from one_batch({**_points(points), **_spread(raw, estimate)}, wanted, lines=_known(lines))


def _known(lines: list[int | None]) -> list[int] | None:
    """The lines of a text; None of a binary file, which has none."""
    known = [line for line in lines if line is not None]
    return known if len(known) == len(lines) else None


def _rays(images: list[ColmapImage]) -> dict[str, Any]:
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
    """A camera as a row of the table ``cameras``; raises Unusable where it is none of perspective and polynomials."""
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


def _points(points: list[ColmapPoint]) -> dict[str, Any]:
    xyz = np.array([point.xyz for point in points]).reshape(-1, 3)
    return {
        "target": np.array([str(point.number) for point in points], dtype=object),
        **{name: xyz[:, axis] for axis, name in enumerate(("x", "y", "z"))},
        "error": np.array([point.error for point in points]),
        "rays": np.array([point.rays for point in points]),
    }


def _spread(raw: Path, estimate: Estimate | None) -> dict[str, Any]:
    """Standard deviations and correlations of points, empty where they are not determined; no columns without
    estimate."""
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
