"""Photogrammetric network: cameras, images, rays, points, prior knowledge, and the names.

A pose of the campaign is a state of the object that does not move while it is photographed. Each pose has its own
points and measurement frame; cameras and scale bars are common to all poses. The collinearity equations with exact
derivatives are in `truing.estimation.bundle.camera`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index
from truing.estimation.bundle.camera import Camera, derivatives, image_coordinates

Names = NDArray[np.object_]
Pose = int | str


@dataclass(frozen=True)
class Rays:
    """Measured image points: image (N,) and point (N,) by number, xy_px (N, 2), cov_px2 (N, 2, 2); kind (N,) of target
    by number (rays of one kind and camera share a variance component)."""

    image: Index
    point: Index
    xy_px: Array
    cov_px2: Array
    kind: Index

    @property
    def count(self) -> int:
        """Number of rays."""
        return len(self.image)


@dataclass(frozen=True)
class Bars:
    """Distances between pairs of points of a pose.

    bar (L,) by number, first and second (L,) points, repeat_sigma_m (L,): scatter of one distance about the length of
    its bar, 0 for a rigid bar. Per bar: length_m (K,) as calibrated with sigma_m (K,), one error common to all poses.
    """

    bar: Index
    first: Index
    second: Index
    repeat_sigma_m: Array
    length_m: Array
    sigma_m: Array

    @classmethod
    def none(cls) -> Bars:
        """Return an empty set of scale bars."""
        empty, numbers = np.empty(0), np.empty(0, np.int64)
        return cls(numbers, numbers, numbers, empty, empty, empty)


@dataclass(frozen=True)
class KnownPoints:
    """Points with coordinates known beforehand: point (M,) by number, xyz_m (M, 3) in the frame of their pose, cov_m2
    (M, 3, 3)."""

    point: Index
    xyz_m: Array
    cov_m2: Array

    @classmethod
    def none(cls) -> KnownPoints:
        """Return an empty set of known points."""
        return cls(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3, 3)))


@dataclass(frozen=True)
class Markers:
    """Square markers of known size: corners (M, 4) as point numbers in order around the square, edge length size_m
    (M,)."""

    corners: Index
    size_m: Array

    @classmethod
    def none(cls) -> Markers:
        """Return an empty set of markers."""
        return cls(np.empty((0, 4), np.int64), np.empty(0))


@dataclass(frozen=True)
class Network:
    """Input of an adjustment: cameras (C), image_camera (I,) and image_pose (I,) by number, point_pose (P,) by number,
    rays, bars, known points.

    Poses are numbered from 0 without gaps.
    """

    cameras: tuple[Camera, ...]
    image_camera: Index
    image_pose: Index
    point_pose: Index
    rays: Rays
    bars: Bars
    known: KnownPoints

    @property
    def poses(self) -> int:
        """Number of poses, including those without images or points."""
        return 1 + int(max(self.image_pose.max(initial=-1), self.point_pose.max(initial=-1)))


@dataclass(frozen=True)
class NetworkState:
    """Values of all unknowns: interior (C, 10) in the order of camera.PARAMETERS, points (P, 3) in m, bar_length_m
    (K,), and image orientations.

    In the measurement frame of the pose, R (I, 3, 3) rotates camera axes into measurement axes and centre (I, 3) is in
    m. A camera sees X at R^T (X - centre). The error of an image is (delta of the centre, theta) with R <- exp(theta)
    R.
    """

    interior: Array
    R: Array
    centre: Array
    points: Array
    bar_length_m: Array


@dataclass(frozen=True)
class PoseNetwork:
    """One pose as a network with its own numbering, all cameras and no bars; image, point and ray map back."""

    number: int
    network: Network
    image: Index
    point: Index
    ray: Index

    def part_of(self, state: NetworkState) -> NetworkState:
        """Return the part of a full state that belongs to the pose."""
        return NetworkState(
            state.interior, state.R[self.image], state.centre[self.image], state.points[self.point], np.empty(0)
        )


def pose_networks(network: Network) -> list[PoseNetwork]:
    """Return one network per pose."""
    rays, known = network.rays, network.known
    networks = []
    for pose in range(network.poses):
        image, point = np.flatnonzero(network.image_pose == pose), np.flatnonzero(network.point_pose == pose)
        to_image, to_point = np.full(len(network.image_pose), -1), np.full(len(network.point_pose), -1)
        to_image[image], to_point[point] = np.arange(len(image)), np.arange(len(point))
        ray = np.flatnonzero((to_image[rays.image] >= 0) & (to_point[rays.point] >= 0))
        index = np.flatnonzero(to_point[known.point] >= 0)
        alone = Network(
            network.cameras,
            network.image_camera[image],
            np.zeros(len(image), np.int64),
            np.zeros(len(point), np.int64),
            Rays(
                to_image[rays.image[ray]], to_point[rays.point[ray]], rays.xy_px[ray], rays.cov_px2[ray], rays.kind[ray]
            ),
            Bars.none(),
            KnownPoints(to_point[known.point[index]], known.xyz_m[index], known.cov_m2[index]),
        )
        networks.append(PoseNetwork(pose, alone, image, point, ray))
    return networks


@dataclass(frozen=True)
class NamedNetwork:
    """A network with names: poses (S), images (I), points (P) with body and target ("" if unknown), kinds of target.

    row (N,): row of each ray in the table image_points; bars by name, with the check bars marked.
    """

    network: Network
    poses: tuple[Pose, ...]
    images: Names
    points: Names
    bodies: Names
    targets: Names
    kinds: tuple[str, ...]
    row: Index
    bars: tuple[str, ...]
    markers: Markers

    def with_rays(self, image: Index, point: Index, rows: Index, table: ImagePoints, names: Names) -> NamedNetwork:
        """Return the network with further rays to further points, which only these rays see; point (n,) counts them
        from 0."""
        first, rays = len(self.points), self.network.rays
        fresh = len(names)
        pose = np.zeros(fresh, np.int64)
        pose[point] = self.network.image_pose[image]
        more = Rays(
            np.concatenate([rays.image, image]),
            np.concatenate([rays.point, first + point]),
            np.concatenate([rays.xy_px, table.xy_px[rows]]),
            np.concatenate([rays.cov_px2, table.cov_px2[rows]]),
            np.concatenate([rays.kind, table.kind[rows]]),
        )
        network = replace(self.network, point_pose=np.concatenate([self.network.point_pose, pose]), rays=more)
        nobody = np.full(fresh, "", dtype=object)
        return replace(
            self,
            network=network,
            points=np.concatenate([self.points, names]),
            bodies=np.concatenate([self.bodies, nobody]),
            targets=np.concatenate([self.targets, nobody]),
            row=np.concatenate([self.row, rows]),
        )


@dataclass(frozen=True)
class ImagePoints:
    """The table image_points as arrays, one entry per row.

    pose and image (N,) by number, names, coordinates, kinds; semi_axes_px (N, 2) and angle (N,) of circles, NaN if not
    measured.
    """

    image: Index
    pose: Index
    point: Names
    body: Names
    target: Names
    xy_px: Array
    cov_px2: Array
    kind: Index
    kinds: tuple[str, ...]
    semi_axes_px: Array
    angle_rad: Array


@dataclass(frozen=True)
class LinearisedRays:
    """Rays at a state: computed xy_px (N, 2) with derivatives by_image (N, 2, 6) in the order (centre, theta); by_point
    (N, 2, 3), and by_interior (N, 2, 10) of the ray's camera."""

    xy_px: Array
    by_image: Array
    by_point: Array
    by_interior: Array


def format_centres(network: Network) -> tuple[Array, Array]:
    """Return the centre of the format (C, 2) and the balancing radius (C,) in px of each camera."""
    cameras = network.cameras
    centres = np.array([camera.centre_px for camera in cameras]).reshape(-1, 2)
    return centres, np.array([camera.balancing_radius_px for camera in cameras])


def in_camera_axes(state: NetworkState, image: Index, point: Index) -> Array:
    """Return the points (N, 3) in the axes of the cameras that see them, m."""
    return np.einsum("nji,nj->ni", state.R[image], state.points[point] - state.centre[image])


def project(network: Network, state: NetworkState, image: Index, point: Index) -> Array:
    """Return image coordinates (N, 2) in px of points in images; NaN for a point that is not in front of its camera."""
    centre, radius = format_centres(network)
    camera = network.image_camera[image]
    X = in_camera_axes(state, image, point)
    X[X[:, 2] <= 0] = np.nan
    return image_coordinates(state.interior[camera], centre[camera], radius[camera], X)


def linearise(network: Network, state: NetworkState, image: Index, point: Index) -> LinearisedRays:
    """Return rays (N) with their derivatives; NaN for a point that is not in front of its camera."""
    format_centre, radius = format_centres(network)
    camera = network.image_camera[image]
    interior, arm = state.interior[camera], state.points[point] - state.centre[image]
    X = np.einsum("nji,nj->ni", state.R[image], arm)
    X[X[:, 2] <= 0] = np.nan
    by_direction, by_interior = derivatives(interior, radius[camera], X)
    by_point = np.einsum("nki,nji->nkj", by_direction, state.R[image])
    by_image = np.concatenate([-by_point, np.cross(by_point, arm[:, None])], -1)
    xy = image_coordinates(interior, format_centre[camera], radius[camera], X)
    return LinearisedRays(xy, by_image, by_point, by_interior)
