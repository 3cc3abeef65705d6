"""Rotations and rigid motions as matrices, over arrays of any leading shape."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

X, Y, Z = np.eye(3)


def rotation(vector: Array) -> Array:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3), by Rodrigues' formula."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    skew = np.zeros((*np.shape(vector)[:-1], 3, 3))
    for row, column, part in ((1, 0, 2), (2, 1, 0), (0, 2, 1)):
        skew[..., row, column], skew[..., column, row] = vector[..., part], -vector[..., part]
    return np.eye(3) + np.sinc(angle / np.pi) * skew + 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2 * (skew @ skew)


def about(axis: Array, angle: float) -> Array:
    """Rotation matrix (3, 3) of one angle, rad, about a unit axis."""
    return rotation(axis * angle)


def small_vector(turned: Array) -> Array:
    """Rotation vectors (..., 3) of rotation matrices (..., 3, 3) far from half a turn."""
    twice = np.stack([turned[..., 2, 1], turned[..., 0, 2], turned[..., 1, 0]], -1)
    twice = twice - np.stack([turned[..., 1, 2], turned[..., 2, 0], turned[..., 0, 1]], -1)
    sine = np.linalg.norm(twice, axis=-1, keepdims=True) / 2.0
    cosine = (np.trace(turned, axis1=-2, axis2=-1)[..., None] - 1.0) / 2.0
    angle = np.arctan2(sine, cosine)
    return np.asarray(twice / 2.0 / np.sinc(angle / np.pi))


def motion(turned: Array, moved: Array) -> Array:
    """Rigid motion (4, 4) of a rotation (3, 3) and a translation (3,), m."""
    whole = np.eye(4)
    whole[:3, :3], whole[:3, 3] = turned, moved
    return whole


def inverse(whole: Array) -> Array:
    """Inverse of a rigid motion (4, 4)."""
    return motion(whole[:3, :3].T, -whole[:3, :3].T @ whole[:3, 3])


def roll_pitch_yaw(turned: Array) -> Array:
    """Angles (3,), rad, about the fixed axes x, y, z of a rotation matrix: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    pitch = np.arctan2(-turned[2, 0], np.hypot(turned[0, 0], turned[1, 0]))
    if np.hypot(turned[0, 0], turned[1, 0]) < 1e-9:
        return np.array([np.arctan2(-turned[1, 2], turned[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(turned[2, 1], turned[2, 2]), pitch, np.arctan2(turned[1, 0], turned[0, 0])])


def any_rotation(rng: np.random.Generator) -> Array:
    """Rotation matrix (3, 3) drawn uniformly."""
    w, x, y, z = (lambda q: q / np.linalg.norm(q))(rng.normal(size=4))
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def lower_meeting(about: Array, radius: Array) -> Array:
    """Return the lower point (B, 3) on three spheres about (B, 3, 3) with radii (B, 3)."""
    first = about[:, 0]
    across = about[:, 1:] - first[:, None]
    ex = across[:, 0] / np.linalg.norm(across[:, 0], axis=-1, keepdims=True)
    i = np.sum(ex * across[:, 1], -1, keepdims=True)
    ey = across[:, 1] - i * ex
    ey /= np.linalg.norm(ey, axis=-1, keepdims=True)
    ez = np.cross(ex, ey)
    d, j = np.linalg.norm(across[:, 0], axis=-1), np.sum(ey * across[:, 1], -1)
    x = (radius[:, 0] ** 2 - radius[:, 1] ** 2 + d**2) / (2.0 * d)
    y = (radius[:, 0] ** 2 - radius[:, 2] ** 2 + i[:, 0] ** 2 + j**2 - 2.0 * i[:, 0] * x) / (2.0 * j)
    z = np.sqrt(radius[:, 0] ** 2 - x**2 - y**2)
    z = np.where(ez[:, 2] > 0, -z, z)
    return first + x[:, None] * ex + y[:, None] * ey + z[:, None] * ez
