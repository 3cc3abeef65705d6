"""Where each unknown of an adjustment stands: images and points pose by pose, then what all poses share.

Only what takes part stands anywhere: images and points with rays, free interior elements of cameras with images,
lengths of bars that are not exactly known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.bundle.camera import PARAMETERS
from truing.estimation.bundle.network import Index, Network


@dataclass(frozen=True)
class Rows:
    """Where the rows of images by points stand, all poses one after the other: start (S + 1,) and shape of each pose's;
    where each image's start (i,), the length of each (i,), and the first column (p,) of each point."""

    start: Index
    shapes: tuple[tuple[int, int], ...]
    image: Index
    length: Index
    column: Index


@dataclass(frozen=True)
class Layout:
    """Numbers of what takes part, and slots: rays (n,) by image, images (i,) and points (p,) by pose, with the slots
    where each pose starts (S + 1,); the image and point slot of every ray, and where each image's rays start (i + 1,);
    distances (q,) and known points by row; the place among the common unknowns of every interior element (C, 10) and
    bar (K,), -1 where it has none."""

    rays: Index
    ray_image: Index
    ray_point: Index
    first_ray: Index
    images: Index
    points: Index
    image_start: Index
    point_start: Index
    distances: Index
    first: Index
    second: Index
    distance_pose: Index
    known: Index
    known_slot: Index
    interior: Index
    bar: Index
    common: tuple[tuple[str, str | int], ...]
    rows: Rows

    @property
    def poses(self) -> int:
        """How many poses there are, those without rays too."""
        return len(self.image_start) - 1


def lay_out(network: Network, used: NDArray[np.bool_], known: bool) -> Layout:
    """Return where the unknowns of the rays used (N,) stand; known: whether known points take part."""
    rays = network.rays
    poses = 1 + max(network.image_pose.max(initial=-1), network.point_pose.max(initial=-1))
    images, image_slot, image_start = _slots(_present(rays.image[used]), network.image_pose, poses)
    rows = np.flatnonzero(used)
    rows = rows[np.argsort(image_slot[rays.image[rows]], kind="stable")]
    seen = _present(rays.point[rows])
    points, point_slot, point_start = _slots(seen, network.point_pose, poses)
    bars = network.bars
    distances = np.flatnonzero((point_slot[bars.first] >= 0) & (point_slot[bars.second] >= 0))
    interior, bar, common = _common(network, images, distances)
    # A known point without a ray is not measured: what is known of it tells nothing of anything else.
    known_rows = np.flatnonzero(point_slot[network.known.point] >= 0) if known else np.empty(0, np.int64)
    return Layout(
        rays=rows,
        ray_image=image_slot[rays.image[rows]],
        ray_point=point_slot[rays.point[rows]],
        first_ray=np.searchsorted(image_slot[rays.image[rows]], np.arange(len(images) + 1)),
        images=images,
        points=points,
        image_start=image_start,
        point_start=point_start,
        distances=distances,
        first=point_slot[bars.first[distances]],
        second=point_slot[bars.second[distances]],
        distance_pose=network.point_pose[bars.first[distances]],
        known=known_rows,
        known_slot=point_slot[network.known.point[known_rows]],
        interior=interior,
        bar=bar,
        common=common,
        rows=_rows(image_start, point_start),
    )


def _present(numbers: Index) -> Index:
    """Return the numbers that occur, each once and in order."""
    return np.flatnonzero(np.bincount(numbers))


def _rows(image_start: Index, point_start: Index) -> Rows:
    """Return where the rows of images stand."""
    images, points = np.diff(image_start), np.diff(point_start)
    lengths = 3 * points
    start = np.concatenate([[0], np.cumsum(6 * images * lengths)])
    pose = np.repeat(np.arange(len(images)), images)
    image = start[pose] + 6 * (np.arange(image_start[-1]) - image_start[pose]) * lengths[pose]
    column = 3 * (np.arange(point_start[-1]) - np.repeat(point_start[:-1], points))
    shapes = tuple(zip((6 * images).tolist(), lengths.tolist(), strict=True))
    return Rows(start, shapes, image, lengths[pose], column)


def _slots(numbers: Index, pose: Index, poses: int) -> tuple[Index, Index, Index]:
    """Return numbers ordered by pose, the slot of every number there is or -1, and the slots where poses start."""
    ordered = numbers[np.argsort(pose[numbers], kind="stable")]
    slot = np.full(len(pose), -1)
    slot[ordered] = np.arange(len(ordered))
    return ordered, slot, np.searchsorted(pose[ordered], np.arange(poses + 1))


def _common(network: Network, images: Index, distances: Index) -> tuple[Index, Index, tuple]:
    """Return the places of interior elements and bars among the common unknowns, and what stands at each."""
    interior = np.full((len(network.cameras), len(PARAMETERS)), -1)
    common: list[tuple[str, str | int]] = []
    for camera in np.unique(network.image_camera[images]):
        for name in network.cameras[camera].free:
            interior[camera, PARAMETERS.index(name)] = len(common)
            common.append((network.cameras[camera].name, name))
    bar = np.full(len(network.bars.length_m), -1)
    for number in np.unique(network.bars.bar[distances]):
        if network.bars.sigma_m[number] > 0:
            bar[number] = len(common)
            common.append(("bar", int(number)))
    return interior, bar, tuple(common)
