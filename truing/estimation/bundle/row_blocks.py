"""Layout of the normal equations' image-by-point blocks: whole rows in small poses, a block per ray in large ones.

In a pose of many points, the rows of all images over all points would need most of the memory. Nearly all of it would
be zero. There only the block of each ray is stored, and points are eliminated ray by ray.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.arrays import Array, Index, Mask

# Points of a pose up to which rows are dense: joint covariance of all of them, 9 doubles a pair, 70 MB here.
MOST_DENSE_POINTS = 1000
# Shape of a ray's block: an image by a point.
_BLOCK = (6, 3)


@dataclass(frozen=True)
class PointRays:
    """Rays of a large pose, by point.

    loose (b,): points that are eliminated, by number in the pose; their rays (n,) by number in the pose, from
    first (b + 1,), with the place of each ray's image among the kept unknowns (n,). tied (t,): ends of distances, in
    ascending order, which are kept; their rays (r,) with the places of image (r,) and point (r,).
    """

    loose: Index
    rays: Index
    first: Index
    image_place: Index
    tied: Index
    tied_rays: Index
    tied_image_place: Index
    tied_place: Index
    images: int

    @property
    def kept(self) -> int:
        """Number of kept unknowns: six per image, three per end of a distance."""
        return 6 * self.images + 3 * len(self.tied)

    @property
    def eliminated_indices(self) -> Index:
        """Places (3 b,) of the eliminated unknowns among those of the pose."""
        return 6 * self.images + coordinates(self.loose)

    @property
    def kept_indices(self) -> Index:
        """Places (k,) of the kept unknowns among those of the pose."""
        return np.concatenate([np.arange(6 * self.images), 6 * self.images + coordinates(self.tied)])


def coordinates(points: Index) -> Index:
    """Return the places (3 n,) of the coordinates of points (n,)."""
    return (3 * points[:, None] + np.arange(3)).ravel()


@dataclass(frozen=True)
class RowBlocks:
    """Places of the image-by-point blocks, all poses in sequence.

    start (S + 1,) and shape per pose: (6 i, 3 p), or (rays, 6, 3) if large; first entry of each ray's block (n,) and
    length of a row (i,); rays by point of each large pose, else None.
    """

    start: Index
    shapes: tuple[tuple[int, ...], ...]
    ray: Index
    length: Index
    by_point: tuple[PointRays | None, ...]


def is_large(images: Index, points: Index) -> Mask:
    """Return the poses (S,) whose points are eliminated ray by ray, from their numbers of images and points.

    In other poses, the images are eliminated if that leaves the smaller system; the covariance of all points is dense.
    """
    return np.asarray((points > MOST_DENSE_POINTS) & (points > 2 * images))


def row_blocks(
    image_start: Index, point_start: Index, first_ray: Index, ray_image: Index, ray_point: Index, tied: Mask
) -> RowBlocks:
    """Return the layout of the blocks.

    First slot of images and points of each pose (S + 1,); first ray of each image (i + 1,); image and point slot of
    each ray (n,). tied (p,): ends of distances.
    """
    images, points, first = np.diff(image_start), np.diff(point_start), first_ray[image_start]
    rays = np.diff(first)
    is_by_ray = is_large(images, points)
    length = np.where(is_by_ray, _BLOCK[1], 3 * points)
    start = np.concatenate([[0], np.cumsum(np.where(is_by_ray, 18 * rays, 18 * images * points))])
    image_pose = np.repeat(np.arange(len(images)), images)
    pose = image_pose[ray_image]
    offset_in_rows = 6 * (ray_image - image_start[pose]) * length[pose] + 3 * (ray_point - point_start[pose])
    first_entry = start[pose] + np.where(is_by_ray[pose], 18 * (np.arange(len(pose)) - first[pose]), offset_in_rows)
    shapes, by_point = [], []
    for s, is_large_pose in enumerate(is_by_ray.tolist()):
        images_of_pose, points_of_pose = slice(first[s], first[s + 1]), slice(point_start[s], point_start[s + 1])
        shapes.append((int(rays[s]), *_BLOCK) if is_large_pose else (6 * int(images[s]), 3 * int(points[s])))
        slots = ray_image[images_of_pose] - image_start[s], ray_point[images_of_pose] - point_start[s]
        by_point.append(point_rays(*slots, tied[points_of_pose], int(images[s])) if is_large_pose else None)
    return RowBlocks(start, tuple(shapes), first_entry, length[image_pose], tuple(by_point))


def point_rays(image: Index, point: Index, tied: Mask, images: int) -> PointRays:
    """Return the rays (n,) of a pose by point; image and point (n,) within the pose; tied (p,): ends of distances."""
    order = np.argsort(point, kind="stable")
    eliminated_rays = order[~tied[point[order]]]
    end_rays = order[tied[point[order]]]
    eliminated, ends = np.flatnonzero(~tied), np.flatnonzero(tied)
    first = np.searchsorted(point[eliminated_rays], np.append(eliminated, len(tied)))
    point_index = 6 * images + 3 * np.searchsorted(ends, point[end_rays])
    return PointRays(
        eliminated,
        eliminated_rays,
        first,
        6 * image[eliminated_rays],
        ends,
        end_rays,
        6 * image[end_rays],
        point_index,
        images,
    )


def put_tied_rows(rays: PointRays, blocks: Array, kept: Array) -> None:
    """Add the image-by-point blocks (n, 6, 3) of the rays of tied points to the kept system (k, k)."""
    row = rays.tied_image_place[:, None, None] + np.arange(6)[:, None]
    column = rays.tied_place[:, None, None] + np.arange(3)
    np.add.at(kept, (row, column), blocks[rays.tied_rays])
