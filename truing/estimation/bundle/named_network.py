"""A network of rays with the names behind its numbers, and the rays as images show them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.estimation.bundle.network import Index, Network, Rays
from truing.estimation.bundle.start_values import Markers

Array = NDArray[np.float64]
Names = NDArray[np.object_]
Pose = int | str


@dataclass(frozen=True)
class NamedNetwork:
    """A network, and who is who in it: poses (S), images (I) by name, points (P) by name with body and target ("" where
    not known), kinds of target; row (N,) of each ray in the table image_points; bars by name and which of them
    check."""

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
        """The network with further rays to further points, which only they see; point (n,) counts these from 0."""
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
    """The table image_points as arrays, a row each: pose and image (N,) by number, names, coordinates, kinds;
    semi_axes_px (N, 2) and angle (N,) of circles, NaN where not measured."""

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
