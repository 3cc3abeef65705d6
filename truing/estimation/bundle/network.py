"""A photogrammetric network: which image saw which point where, and what else is known of the points.

A pose of the campaign is a state of the object that holds still while it is photographed: each pose has its own points
and its own measurement frame; cameras and scale bars are common to all poses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.bundle.camera import Camera

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Rays:
    """Image points as measured: image (N,) and point (N,) by number, xy_px (N, 2), cov_px2 (N, 2, 2), kind (N,) of
    target, by number (rays of one kind and camera share a variance component)."""

    image: Index
    point: Index
    xy_px: Array
    cov_px2: Array
    kind: Index

    @property
    def count(self) -> int:
        """How many rays there are."""
        return len(self.image)


@dataclass(frozen=True)
class Bars:
    """Distances between pairs of points of a pose: bar (L,) by number, first and second (L,) points, repeat_sigma_m
    (L,) of one distance about its bar's length, 0 where the bar is rigid; per bar length_m (K,) as calibrated and
    sigma_m (K,) of it, one error common to all poses."""

    bar: Index
    first: Index
    second: Index
    repeat_sigma_m: Array
    length_m: Array
    sigma_m: Array

    @classmethod
    def none(cls) -> Bars:
        """No scale bar at all."""
        empty, numbers = np.empty(0), np.empty(0, np.int64)
        return cls(numbers, numbers, numbers, empty, empty, empty)


@dataclass(frozen=True)
class KnownPoints:
    """Points whose coordinates are known beforehand: point (M,) by number, xyz_m (M, 3) in the frame of their pose,
    cov_m2 (M, 3, 3)."""

    point: Index
    xyz_m: Array
    cov_m2: Array

    @classmethod
    def none(cls) -> KnownPoints:
        """No known point at all."""
        return cls(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3, 3)))


@dataclass(frozen=True)
class Network:
    """What is adjusted: cameras (C), image_camera (I,) and image_pose (I,) by number, point_pose (P,) by number, the
    rays, and what else is known. Poses are numbered from 0 without gaps."""

    cameras: tuple[Camera, ...]
    image_camera: Index
    image_pose: Index
    point_pose: Index
    rays: Rays
    bars: Bars
    known: KnownPoints


@dataclass(frozen=True)
class State:
    """Values of all unknowns: interior (C, 10) in the order of camera.PARAMETERS, points (P, 3) in m, bar_length_m
    (K,).

    Images are seen from the measurement frame of their pose: R (I, 3, 3) turns camera axes into measurement axes,
    centre (I, 3) in m. A camera sees X at R^T (X - centre); an image's error is (delta of the centre, theta),
    R <- exp(theta) R.
    """

    interior: Array
    R: Array
    centre: Array
    points: Array
    bar_length_m: Array
