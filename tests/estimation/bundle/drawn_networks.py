"""Networks drawn at random; an independent camera model computes their rays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from truing.estimation.bundle.camera import PARAMETERS, Camera
from truing.estimation.bundle.network import Bars, KnownPoints, Network, NetworkState, Rays

INTERIOR = np.array([3500.0, 5.0, -7.0, -5e-9, 1e-16, -1e-24, 1e-7, -2e-7, 1e-4, 5e-5])
WIDTH, HEIGHT, RADIUS = 4000, 3000, 1000.0
LENGTH = 0.8


def photograph(interior, R, centre, point):
    """Return the image coordinates (2,), px, of one point in one camera."""
    c, x0, y0, *rest = interior
    k1, k2, k3 = rest[0] * c**2, rest[1] * c**4, rest[2] * c**6
    p1, p2, affinity, shear = rest[3] * c, rest[4] * c, rest[5], rest[6]
    X, Y, Z = (point - centre) @ R
    a, b = X / Z, Y / Z
    q, q0 = a**2 + b**2, (RADIUS / c) ** 2
    gain = 1 + k1 * (q - q0) + k2 * (q**2 - q0**2) + k3 * (q**3 - q0**3)
    x = a * gain + p1 * (q + 2 * a**2) + 2 * p2 * a * b + affinity * a + shear * b
    y = b * gain + p2 * (q + 2 * b**2) + 2 * p1 * a * b
    return np.array([(WIDTH - 1) / 2 + x0 + c * x, (HEIGHT - 1) / 2 + y0 + c * y])


def looking(rng, azimuth):
    """Return axes (3, 3) and centre (3,) of a camera that looks at the origin from about 2.5 m, rolled by quarters."""
    height = np.deg2rad(rng.uniform(35, 75))
    centre = rng.uniform(2.2, 2.8) * np.array(
        [np.cos(height) * np.cos(azimuth), np.cos(height) * np.sin(azimuth), np.sin(height)]
    )
    forward = -centre / np.linalg.norm(centre)
    right = np.cross([0.0, 0.0, 1.0], forward)
    right /= np.linalg.norm(right)
    axes = [right, np.cross(forward, right)]
    for _ in range(rng.integers(4)):
        axes = [axes[1], -axes[0]]
    return np.stack([*axes, forward], 1), centre


def draw(rng, poses=1, images=6, points=12, cameras=1, free=PARAMETERS, bars=True, repeat=0.0):
    """Return a network without noise and its true state: the first two points of every pose are the ends of one bar."""
    stands = [looking(rng, 2 * np.pi * k / images) for _ in range(poses) for k in range(images)]
    R, centre = np.array([axes for axes, _ in stands]), np.array([place for _, place in stands])
    xyz = rng.normal(size=(poses, points, 3)) * [0.4, 0.4, 0.15]
    span = xyz[:, 1] - xyz[:, 0]
    xyz[:, 1] = xyz[:, 0] + LENGTH * span / np.linalg.norm(span, axis=-1)[:, None]
    xyz = xyz.reshape(-1, 3)
    image_pose, point_pose = np.repeat(np.arange(poses), images), np.repeat(np.arange(poses), points)
    image, point = np.nonzero(image_pose[:, None] == point_pose)
    xy = np.array([photograph(INTERIOR, R[i], centre[i], xyz[p]) for i, p in zip(image, point, strict=True)])
    count = len(image)
    rays = Rays(image, point, xy, np.tile(0.05**2 * np.eye(2), (count, 1, 1)), np.zeros(count, np.int64))
    first = points * np.arange(poses)
    none = np.zeros(poses, np.int64)
    known_bars = Bars(none, first, first + 1, np.full(poses, repeat), np.array([LENGTH]), np.array([1e-5]))
    named = tuple(Camera(f"camera {k}", WIDTH, HEIGHT, RADIUS, free=tuple(free)) for k in range(cameras))
    own = known_bars if bars else Bars.none()
    network = Network(named, np.arange(len(R)) % cameras, image_pose, point_pose, rays, own, KnownPoints.none())
    return network, NetworkState(np.tile(INTERIOR, (cameras, 1)), R, centre, xyz, np.full(len(own.length_m), LENGTH))


def noisy(rng, network):
    """Return the network with rays and bars measured once more, with the errors that their covariances say."""
    rays, bars = network.rays, network.bars
    errors = np.einsum("nij,nj->ni", np.linalg.cholesky(rays.cov_px2), rng.normal(size=(rays.count, 2)))
    lengths = bars.length_m + bars.sigma_m * rng.normal(size=len(bars.length_m))
    return replace(network, rays=replace(rays, xy_px=rays.xy_px + errors), bars=replace(bars, length_m=lengths))


def uneven(rng, network):
    """Return the network with a covariance of its own for every ray."""
    root = 0.05 * (np.eye(2) + 0.5 * rng.normal(size=(network.rays.count, 2, 2)))
    cov = root @ root.transpose(0, 2, 1) + 0.02**2 * np.eye(2)
    return replace(network, rays=replace(network.rays, cov_px2=cov))


def disturbed(rng, state, turn=0.01, shift=0.01, stretch=0.01):
    """Return a start: camera axes turned, centres and points shifted, no distortion, principal distance too long."""
    skewed = turn * rng.normal(size=(len(state.R), 3))
    angle = np.linalg.norm(skewed, axis=-1)[:, None, None] + 1e-300
    x, y, z = (skewed / angle[..., 0]).T
    none = np.zeros_like(x)
    K = np.array([[none, -z, y], [z, none, -x], [-y, x, none]]).transpose(2, 0, 1)
    about = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
    interior = np.zeros_like(state.interior)
    interior[:, 0] = state.interior[:, 0] * (1 + stretch)
    return NetworkState(
        interior,
        about @ state.R,
        state.centre + shift * rng.normal(size=state.centre.shape),
        state.points + shift * rng.normal(size=state.points.shape),
        state.bar_length_m.copy(),
    )
