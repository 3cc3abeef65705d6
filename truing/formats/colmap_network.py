"""A whole COLMAP model as a network of rays, from the three files that lie side by side."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from truing.formats.colmap_model import ColmapImage, read_cameras, read_images, read_points
from truing.formats.companions import companions
from truing.formats.interior_orientation import CORNER, Row
from truing.formats.raw import Unusable

Array = NDArray[np.float64]
Index = NDArray[np.int64]


_LEAST = 1e-6  # the length of a quaternion, which COLMAP writes as 1


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


def read_network(points_file: Path, row_of: Callable[..., Row]) -> ColmapNetwork | None:
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
        [row_of(camera) for camera in cameras],
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
