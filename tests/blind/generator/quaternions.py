"""Rotations as unit quaternions (w, x, y, z); the last axis is the quaternion, the axes before it
broadcast.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
IDENTITY: Array = np.array([1.0, 0.0, 0.0, 0.0])


def rotate(q: Array, v: Array) -> Array:
    """Turn vectors v (..., 3) by q (..., 4); homogeneous of degree two in q, so exact only for |q| = 1."""
    w, r = q[..., :1], q[..., 1:]
    along = np.sum(r * v, axis=-1, keepdims=True)
    return (w * w - np.sum(r * r, axis=-1, keepdims=True)) * v + 2 * along * r + 2 * w * np.cross(r, v)


def compose(outer: Array, inner: Array) -> Array:
    """The quaternion (..., 4) that turns first by ``inner``, then by ``outer``."""
    w1, r1, w2, r2 = outer[..., :1], outer[..., 1:], inner[..., :1], inner[..., 1:]
    w = w1 * w2 - np.sum(r1 * r2, axis=-1, keepdims=True)
    return np.concatenate([w, w1 * r2 + w2 * r1 + np.cross(r1, r2)], axis=-1)


def inverse(q: Array) -> Array:
    """The quaternion (..., 4) that turns back."""
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def unit(v: Array) -> Array:
    """The vectors (..., k) divided by their length."""
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def shortest_arc(start: Array, end: Array) -> Array:
    """The rotation (..., 4) without twist that takes the unit vector ``start`` to ``end`` (never opposite
    ones).
    """
    w = 1 + np.sum(start * end, axis=-1, keepdims=True)
    return unit(np.concatenate([w, np.cross(start, end)], axis=-1))


def halfway(q1: Array, q2: Array) -> Array:
    """The rotation (..., 4) midway between two."""
    same_side = np.where(np.sum(q1 * q2, axis=-1, keepdims=True) < 0, -1.0, 1.0)
    return unit(q1 + same_side * q2)


def from_vector(theta: Array) -> Array:
    """The quaternion (..., 4) of a rotation vector theta (..., 3) in rad."""
    angle = np.linalg.norm(theta, axis=-1, keepdims=True)
    return np.concatenate([np.cos(angle / 2), np.sinc(angle / (2 * np.pi)) * theta / 2], axis=-1)


def to_vector(q: Array) -> Array:
    """The rotation vector (..., 3) in rad, of length at most pi."""
    q = np.where(q[..., :1] < 0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, q[..., :1])
    return q[..., 1:] * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-300), 2.0)


def with_axis(z: Array) -> Array:
    """The frame (..., 4) whose third axis is the unit vector z and whose second is perpendicular to the
    base's x.
    """
    x = unit(np.array([1.0, 0.0, 0.0]) - z[..., :1] * z)
    upright = shortest_arc(np.broadcast_to([0.0, 0.0, 1.0], z.shape), z)
    x_now = rotate(upright, np.broadcast_to([1.0, 0.0, 0.0], z.shape))
    return compose(shortest_arc(x_now, x), upright)


def fit_motion(source: Array, target: Array) -> tuple[Array, Array]:
    """Least-squares q (N, 4), t (N, 3) with target = rotate(q, source) + t; points (N, M, 3), M >= 3 (Horn
    1987).

    The rotation is the eigenvector to the largest eigenvalue of Horn's 4 x 4 matrix, not a singular value
    decomposition.
    """
    centre_s, centre_t = source.mean(axis=-2), target.mean(axis=-2)
    s = np.einsum("...ki,...kj->...ij", source - centre_s[..., None, :], target - centre_t[..., None, :])
    skew = np.stack([s[..., 1, 2] - s[..., 2, 1], s[..., 2, 0] - s[..., 0, 2], s[..., 0, 1] - s[..., 1, 0]], -1)
    trace = np.trace(s, axis1=-2, axis2=-1)[..., None]
    horn = np.empty((*s.shape[:-2], 4, 4))
    horn[..., 0, 0] = trace[..., 0]
    horn[..., 0, 1:] = horn[..., 1:, 0] = skew
    horn[..., 1:, 1:] = s + np.swapaxes(s, -1, -2) - trace[..., None] * np.eye(3)
    q = np.linalg.eigh(horn)[1][..., :, -1]
    return q, centre_t - rotate(q, centre_s)
