"""Arrays of rays, cameras, states and equations, grouped for the compiled kernels."""

from __future__ import annotations

from typing import NamedTuple

from truing.arrays import Array, Index


class RayArrays(NamedTuple):
    """Rays (n,), sorted by image: image coordinates (n, 2) in px, roots (n, 3) of their information, first ray of each
    image (i + 1,), and point of each ray."""

    xy: Array
    roots: Array
    first: Index
    point: Index


class CameraArrays(NamedTuple):
    """Camera of each image (i,); interior (C, 10), format centre (C, 2) and balancing radius (C,) of cameras, px."""

    of_image: Index
    interior: Array
    format_centre: Array
    radius: Array


class StateArrays(NamedTuple):
    """Rotations (i, 3, 3) and centres (i, 3) of images, and points (p, 3), m."""

    R: Array
    centre: Array
    points: Array


class EquationArrays(NamedTuple):
    """Normal equations to fill in.

    slot (C, 10): interior elements among the common unknowns, -1 if none. images (i, 6, 6), points (p, 3, 3), common
    (c, c + 1) and their sides (., c + 1). flat: blocks between images and points. first_entry (n,): first entry of each
    ray in flat; stride (i,): length of the rows of an image.
    """

    slot: Index
    first_entry: Index
    stride: Index
    images: Array
    image_sides: Array
    points: Array
    point_sides: Array
    common: Array
    flat: Array


class EntryArrays(NamedTuple):
    """Blocks (n, 3, 6) of points by kept unknowns, which begin at offsets (n,); those of each point (p,) are from start
    to stop."""

    blocks: Array
    offset: Index
    start: Index
    stop: Index


class RayBlocks(NamedTuple):
    """Blocks (., 6, 3) of all rays of a pose, rays (n,) of eliminated points, and the first of each point (b + 1,)."""

    blocks: Array
    ray: Index
    first: Index


class PoseCovarianceArrays(NamedTuple):
    """Covariances of images (i, 6, 6), points (p, 3, 3) and both for each ray (n, 6, 3), given the common unknowns.

    Derivatives of images (i, 6, c) and points (p, 3, c) by the common unknowns, which have the covariance (c, c).
    """

    images: Array
    points: Array
    cross: Array
    images_by_common: Array
    points_by_common: Array
    common: Array


class RayPairs(NamedTuple):
    """Points (m,), and two rays (m,) of each."""

    point: Index
    one: Index
    other: Index


class SortedRays(NamedTuple):
    """Rays (n,) sorted by point, from first (P + 1,).

    direction (n, 2): X/Z, Y/Z in the camera's frame; scale (n,): principal distance in px; R (n, 3, 3) and centre
    (n, 3): pose of the ray's image.
    """

    direction: Array
    scale: Array
    R: Array
    centre: Array
    first: Index


class PoseRays(NamedTuple):
    """Rays (n,) of one pose: image and point by number in the network, and by slot in the pose."""

    image: Index
    point: Index
    image_slot: Index
    point_slot: Index
