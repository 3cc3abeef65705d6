"""What each candidate station would tell of the targets and of the camera, its own orientation eliminated."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from truing.estimation.bundle.camera import PARAMETERS, Camera
from truing.estimation.bundle.network import Array, Bars, Index, KnownPoints, Network, Rays, State
from truing.estimation.bundle.planning.stations import Layout, Mask, Stations
from truing.estimation.bundle.projection import linearise, project

_FEWEST = 4  # targets without which a station is of no use


@dataclass(frozen=True)
class PlannedNetwork:
    """A network that would be photographed: the camera, its interior orientation (10,), sigma_px of an image
    coordinate, the bars between targets, and the targets."""

    camera: Camera
    interior: Array
    sigma_px: float
    layout: Layout
    bars: Bars

    def with_stations(self, stations: Stations, seen: Mask) -> tuple[Network, State]:
        """The network that stations (K) with what they see (K, P) make, and its state; rays lie where they belong."""
        image, point = (index.astype(np.int64) for index in np.nonzero(seen))
        rays = Rays(
            image,
            point,
            np.zeros((len(image), 2)),
            np.broadcast_to(self.sigma_px**2 * np.eye(2), (len(image), 2, 2)),
            np.zeros(len(image), np.int64),
        )
        one = np.zeros(stations.count, np.int64)
        poses = np.zeros(len(self.layout.points), np.int64)
        network = Network((self.camera,), one, one, poses, rays, self.bars, KnownPoints.none())
        state = State(self.interior[None], stations.R, stations.centre, self.layout.points, self.bars.length_m)
        return replace(network, rays=replace(rays, xy_px=project(network, state, image, point))), state


def useful(seen: Mask) -> Index:
    """Stations that see enough targets to be worth a photograph."""
    return np.flatnonzero(seen.sum(axis=1) >= _FEWEST)


def station_information(planned: PlannedNetwork, stations: Stations, seen: Mask) -> Array:
    """Information (K, n, n) of each station on points (3 P) and the free elements of the camera, in 1/m^2 and 1/px^2
    .. ."""
    network, state = planned.with_stations(stations, seen)
    rays = network.rays
    at = linearise(network, state, rays.image, rays.point)
    free = [PARAMETERS.index(name) for name in planned.camera.free]
    count, points = stations.count, len(planned.layout.points)
    # every station has a row for every target; those that it does not see are zero
    full = np.zeros((count, points, 2, 6 + 3 + len(free)))
    full[rays.image, rays.point] = np.concatenate([at.by_image, at.by_point, at.by_interior[..., free]], axis=-1)
    full = full.reshape(count, 2 * points, -1) / planned.sigma_px
    of_image, of_point, of_camera = full[..., :6], full[..., 6:9], full[..., 9:]
    own = np.einsum("kpai,pq->kpaqi", of_point.reshape(count, points, 2, 3), np.eye(points))
    other = np.concatenate([own.reshape(count, 2 * points, 3 * points), of_camera], axis=-1)
    scale = np.linalg.norm(of_image, axis=1, keepdims=True)
    basis, _ = np.linalg.qr(of_image / np.where(scale > 0.0, scale, 1.0))
    rest = other - basis @ (np.swapaxes(basis, 1, 2) @ other)
    return np.swapaxes(rest, 1, 2) @ rest


def weak_prior(planned: PlannedNetwork) -> Array:
    """Information (n, n) that says next to nothing: targets to the size of the object, the camera to a tenth of its
    format, and what bars tell."""
    points = planned.layout.points
    size = 2.0 * planned.layout.radius
    half = 0.5 * max(planned.camera.width_px, planned.camera.height_px)
    powers = {"c": 0, "x0": 0, "y0": 0, "A1": 3, "A2": 5, "A3": 7, "B1": 2, "B2": 2, "C1": 1, "C2": 1}
    of_camera = [half ** powers[name] / (0.1 * half) for name in planned.camera.free]
    prior = np.diag(np.concatenate([np.full(points.size, 1.0 / size), of_camera]) ** 2)
    bars = planned.bars
    between = points[bars.second] - points[bars.first]
    sigma = np.sqrt(bars.sigma_m[bars.bar] ** 2 + bars.repeat_sigma_m**2)
    row = np.zeros((len(bars.bar), len(prior)))
    direction = between / np.linalg.norm(between, axis=1, keepdims=True) / np.maximum(sigma, 1e-9)[:, None]
    for axis in range(3):
        np.add.at(row, (np.arange(len(row)), 3 * bars.second + axis), direction[:, axis])
        np.add.at(row, (np.arange(len(row)), 3 * bars.first + axis), -direction[:, axis])
    return prior + row.T @ row
