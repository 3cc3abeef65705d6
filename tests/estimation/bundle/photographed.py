"""Networks with rays by an independent camera model from textbook equations; only argument types come from the tested
code."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm as matrix_exponential

from truing.estimation.bundle.camera import Camera
from truing.estimation.bundle.network import Bars, KnownPoints, Network, NetworkState, Rays

WIDTH, HEIGHT = 4000, 3000
TRUE_INTERIOR = np.array([4300.0, 25.0, -18.0, -6e-9, 4e-16, 0.0, 2e-8, -3e-8, 0.0, 0.0])


@dataclass(frozen=True)
class Photographed:
    """A network, the state that made it, and which rays carry a gross error of how many pixels."""

    network: Network
    truth: NetworkState
    gross: np.ndarray
    gross_px: np.ndarray


def looking(centres, targets, rolls):
    """Rotations whose third axis points from the centres to the targets, turned about it by the rolls."""
    forward = targets - centres
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    side = np.cross(forward, np.array([0.02, 0.1, 1.0]))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    down = np.cross(forward, side)
    c, s = np.cos(rolls)[:, None], np.sin(rolls)[:, None]
    return np.stack([c * side + s * down, c * down - s * side, forward], axis=2)


def photograph(interior, camera, R, centre, points):
    """Image coordinates (2,) of points as one camera sees them, and their depth."""
    u = np.einsum("...ji,...j->...i", R, points - centre)
    c, x0, y0, A1, A2, A3, B1, B2, C1, C2 = interior
    x, y = c * u[..., 0] / u[..., 2], c * u[..., 1] / u[..., 2]
    q, q0 = x**2 + y**2, camera.balancing_radius_px**2
    radial = A1 * (q - q0) + A2 * (q**2 - q0**2) + A3 * (q**3 - q0**3)
    px = (camera.width_px - 1) / 2 + x0 + x * (1 + radial) + B1 * (q + 2 * x * x) + 2 * B2 * x * y + C1 * x + C2 * y
    py = (camera.height_px - 1) / 2 + y0 + y * (1 + radial) + B2 * (q + 2 * y * y) + 2 * B1 * x * y
    return np.stack([px, py], axis=-1), u[..., 2]


def simulate(
    seed=0, images=12, points=40, poses=1, planar=False, sigma_px=0.1, gross=0.0, cameras=1, spread=1.2, bars=True,
    known=0, interior=TRUE_INTERIOR, missed=0.1, distance=3.0, deviations=None, body=None,
):  # fmt: skip
    """A body of points about 1 m across, seen from a cap of directions, every other image rolled by 90 degrees."""
    rng = np.random.default_rng(seed)
    lens = tuple(Camera(f"camera{k}", WIDTH, HEIGHT, 1300.0, 5e-6) for k in range(cameras))
    values = np.stack([interior + np.r_[150.0 * k, np.zeros(9)] for k in range(cameras)])
    cloud = rng.uniform(-0.5, 0.5, (poses, points, 3)) * ([1, 1, 0.02] if planar else [1, 1, 0.6])
    if body is not None:
        cloud[:] = body
    total = poses * images
    tilt, around = rng.uniform(0.25, spread, total), np.arange(total) * 2.4 + rng.uniform(0, 0.3, total)
    away = np.stack([np.sin(tilt) * np.cos(around), np.sin(tilt) * np.sin(around), np.cos(tilt)], axis=1)
    centre = away * rng.uniform(0.9, 1.1, (total, 1)) * distance
    R = looking(centre, rng.normal(0, 0.05, (total, 3)), np.arange(total) % 2 * np.pi / 2 + rng.normal(0, 0.1, total))
    image_pose, image_camera = np.repeat(np.arange(poses), images), np.arange(total) % cameras
    rows = []
    for i in range(total):
        at, depth = photograph(
            values[image_camera[i]] + (0 if deviations is None else deviations[image_pose[i]]),
            lens[image_camera[i]], R[i], centre[i], cloud[image_pose[i]],
        )  # fmt: skip
        inside = (depth > 0) & (at > 0).all(1) & (at < [WIDTH - 1, HEIGHT - 1]).all(1)
        inside &= rng.random(points) > missed
        seen = np.flatnonzero(inside)
        rows.append((np.full(len(seen), i), seen + points * image_pose[i], at[seen]))
    image, point, xy = (np.concatenate(part) for part in zip(*rows, strict=True))
    N = len(image)
    xy = xy + rng.normal(0, sigma_px, (N, 2))
    bad = rng.random(N) < gross
    error = 10 ** rng.uniform(np.log10(5), np.log10(500), N) * bad
    turn = rng.uniform(0, 2 * np.pi, N)
    xy = xy + error[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    cov = np.broadcast_to(np.eye(2) * sigma_px**2, (N, 2, 2)).copy()
    flat = cloud.reshape(-1, 3)
    first = np.arange(poses) * points
    lengths = np.linalg.norm(flat[first + 1] - flat[first], axis=1)  # a bar of its own in every pose
    held = Bars(np.arange(poses), first, first + 1, np.full(poses, 1e-5), lengths, np.full(poses, 1e-5))
    numbers = (np.arange(poses)[:, None] * points + np.arange(known)).ravel()
    certain = (
        KnownPoints(numbers, flat[numbers], np.broadcast_to(np.eye(3) * 1e-10, (len(numbers), 3, 3)).copy())
        if known
        else KnownPoints.none()
    )
    network = Network(
        lens, image_camera, image_pose, np.repeat(np.arange(poses), points),
        Rays(image, point, xy, cov, np.zeros(N, np.int64)), held if bars else Bars.none(), certain,
    )  # fmt: skip
    truth = NetworkState(values, R, centre, flat, held.length_m if bars else np.empty(0))
    return Photographed(network, truth, bad, error)


def guess(lens, factor=1.0, known=True):
    """Interior parameters to start from: the true principal distance times a factor, or unknown."""
    start = np.zeros((len(lens), 10))
    start[:, 0] = TRUE_INTERIOR[0] * factor if known else np.nan
    return start


def off_by(made, rng, degrees=10.0, share=0.1):
    """The true state with orientations turned and everything else off: centres and points by a share of their distance,
    principal distances by the share."""
    truth = made.truth
    axes = rng.normal(size=truth.centre.shape)
    axes *= np.radians(degrees) / np.linalg.norm(axes, axis=1, keepdims=True)
    skewed = np.cross(np.eye(3)[None], axes[:, None])  # rows e_k x a = -[a]x, the generator's transpose
    turn = np.stack([matrix_exponential(-block) for block in skewed])
    distance = np.linalg.norm(truth.centre, axis=1, keepdims=True)
    centre = truth.centre + share * distance * unit(rng.normal(size=truth.centre.shape))
    size = np.sqrt((truth.points**2).sum(axis=1).mean())
    points = truth.points + share * size * unit(rng.normal(size=truth.points.shape))
    interior = truth.interior * np.r_[1 + share, np.zeros(9)]
    return NetworkState(interior, turn @ truth.R, centre, points, truth.bar_length_m.copy())


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def shape_error(points, truth):
    """The largest distance (m) of points (n, 3) from true ones after the best similarity."""
    p, q = points - points.mean(0), truth - truth.mean(0)
    U, s, Vt = np.linalg.svd(q.T @ p)
    D = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    R, scale = U @ D @ Vt, (s * np.diag(D)).sum() / (p**2).sum()
    return float(np.linalg.norm(scale * p @ R.T - q, axis=1).max())
