"""The network that all libraries adjust: 60 images of 100 targets, one camera with two terms of radial distortion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from truing.estimation.bundle.camera import Camera
from truing.estimation.bundle.network import Bars, KnownPoints, Network, NetworkState, Rays, project
from truing.estimation.rotation import exp_so3

SIGMA_PX = 0.05
FREE = ("c", "A1", "A2")
FORMAT = (4000, 3000)
_INTERIOR = np.array([3500.0, 0, 0, -5e-9, 1e-16, 0, 0, 0, 0, 0])


@dataclass(frozen=True)
class Problem:
    """A network, and the start of every library."""

    network: Network
    start: NetworkState


def draw(poses: int, images: int, points: int, seed: int = 1) -> Problem:
    """Return a network of images around the targets, each of which shows all targets, and start values. These are off
    by a centimetre, half a degree and one per cent of the principal distance."""
    rng = np.random.default_rng(seed)
    count = poses * images
    azimuth = np.tile(2 * np.pi * np.arange(images) / images, poses)
    height, reach = np.deg2rad(rng.uniform(35, 75, count)), rng.uniform(2.2, 2.8, count)
    towards = np.stack([np.cos(height) * np.cos(azimuth), np.cos(height) * np.sin(azimuth), np.sin(height)], -1)
    right = np.cross([0.0, 0.0, 1.0], -towards)
    right /= np.linalg.norm(right, axis=-1)[:, None]
    axes = np.stack([right, np.cross(-towards, right), -towards], -1)
    quarter = np.pi / 2 * rng.integers(0, 4, count)[:, None] * [0.0, 0.0, 1.0]
    truth = NetworkState(
        _INTERIOR[None],
        axes @ exp_so3(quarter),
        reach[:, None] * towards,
        rng.normal(size=(poses * points, 3)) * [0.35, 0.35, 0.15],
        np.empty(0),
    )
    image_pose, point_pose = np.repeat(np.arange(poses), images), np.repeat(np.arange(poses), points)
    image, point = np.nonzero(image_pose[:, None] == point_pose)
    camera = Camera("camera", *FORMAT, free=FREE)
    rays = Rays(image, point, np.zeros((len(image), 2)), *_errors(len(image)))
    network = Network(
        (camera,), np.zeros(count, np.int64), image_pose, point_pose, rays, Bars.none(), KnownPoints.none()
    )
    xy = project(network, truth, image, point) + SIGMA_PX * rng.normal(size=(len(image), 2))
    start = NetworkState(
        np.where(np.arange(10) == 0, 1.01 * _INTERIOR, 0.0)[None],
        exp_so3(np.deg2rad(0.5) * rng.normal(size=(count, 3))) @ truth.R,
        truth.centre + 0.01 * rng.normal(size=truth.centre.shape),
        truth.points + 0.01 * rng.normal(size=truth.points.shape),
        truth.bar_length_m,
    )
    return Problem(replace(network, rays=replace(rays, xy_px=xy)), start)


def _errors(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the covariances (N, 2, 2) of rays in px^2 and their kinds (N,)."""
    return np.tile(SIGMA_PX**2 * np.eye(2), (count, 1, 1)), np.zeros(count, np.int64)


def sum_of_squares(problem: Problem, state: NetworkState) -> float:
    """Return the sum of squares over the variance of the rays, which is the same for all libraries."""
    rays = problem.network.rays
    v = rays.xy_px - project(problem.network, state, rays.image, rays.point)
    return float(np.sum(v**2)) / SIGMA_PX**2


def with_radial(state: NetworkState, f: float, k1: float, k2: float) -> NetworkState:
    """Return a state with the principal distance and radial terms of others: r^2 and r^4 in the tangent plane."""
    interior = np.zeros((1, 10))
    interior[0, [0, 3, 4]] = f, k1 / f**2, k2 / f**4
    return replace(state, interior=interior)
