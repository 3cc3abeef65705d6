"""The network of a single pose, cut out of the whole, and the way back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.estimation.bundle.network import Bars, Index, KnownPoints, Network, Rays, State


@dataclass(frozen=True)
class PoseNetwork:
    """A pose with its own numbers and the cameras of the whole, without bars; image, point and ray lead back."""

    number: int
    network: Network
    image: Index
    point: Index
    ray: Index

    def part_of(self, state: State) -> State:
        """Return the pose's part of a state of the whole."""
        return State(
            state.interior, state.R[self.image], state.centre[self.image], state.points[self.point], np.empty(0)
        )


def pose_networks(network: Network) -> list[PoseNetwork]:
    """Return the networks of all poses."""
    rays, known = network.rays, network.known
    found = []
    for pose in range(1 + int(max(network.image_pose.max(initial=-1), network.point_pose.max(initial=-1)))):
        image, point = np.flatnonzero(network.image_pose == pose), np.flatnonzero(network.point_pose == pose)
        to_image, to_point = np.full(len(network.image_pose), -1), np.full(len(network.point_pose), -1)
        to_image[image], to_point[point] = np.arange(len(image)), np.arange(len(point))
        ray = np.flatnonzero((to_image[rays.image] >= 0) & (to_point[rays.point] >= 0))
        held = np.flatnonzero(to_point[known.point] >= 0)
        alone = Network(
            network.cameras,
            network.image_camera[image],
            np.zeros(len(image), np.int64),
            np.zeros(len(point), np.int64),
            Rays(
                to_image[rays.image[ray]], to_point[rays.point[ray]], rays.xy_px[ray], rays.cov_px2[ray], rays.kind[ray]
            ),
            Bars.none(),
            KnownPoints(to_point[known.point[held]], known.xyz_m[held], known.cov_m2[held]),
        )
        found.append(PoseNetwork(pose, alone, image, point, ray))
    return found
