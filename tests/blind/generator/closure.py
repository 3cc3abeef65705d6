"""Pose of the platform: the closure of the legs, as polynomials in the quaternion of the platform."""

from __future__ import annotations

import numpy as np

from tests.blind.generator.quaternions import Array, rotate, unit

STEP_LIMIT = 1e-11  # mm and quaternion units: far below any noise, above rounding at half a metre
ROUNDS = 60
UNIT_WEIGHT = 1e7  # mm^2: however legs disagree, they do not stretch the quaternion


class NotAssembled(Exception):
    """The legs do not reach: no platform pose closes the loops near the one that was sought."""


def platform_pose(lower: Array, upper: Array, length: Array, height: float) -> tuple[Array, Array]:
    """Poses p (N, 3), q (N, 4) with |p + R(q) upper - lower| = length for all legs of all N poses.

    ``lower`` (N, L, 3) are the lower joints in the base frame, ``upper`` (N, L, 3) the upper ones in the
    platform frame, ``length`` (N, L), all mm; Newton's method on L + 1 polynomials (squared lengths and
    |q|^2 = 1) in seven unknowns, started level at ``height``. Where legs are fewer than six the pose is one of
    many, near the start; where they are more, the one that meets all squared lengths best.
    """
    p = np.tile([0.0, 0.0, height], (len(lower), 1))
    q = np.tile([1.0, 0.0, 0.0, 0.0], (len(lower), 1))
    for _ in range(ROUNDS):
        value, slope = _polynomials(p, q, lower, upper, length)
        step = _least_step(slope, value)
        p, q = p - step[:, :3], q - step[:, 3:]
        if np.max(np.abs(step)) < STEP_LIMIT:
            return p, unit(q)
    raise NotAssembled(f"the loops do not close: last step {np.max(np.abs(step)):.2g}")


def _least_step(slope: Array, value: Array) -> Array:
    if slope.shape[1] == slope.shape[2]:
        return np.linalg.solve(slope, value[..., None])[..., 0]
    weight = np.append(np.ones(slope.shape[1] - 1), UNIT_WEIGHT)
    return np.einsum("nij,nj->ni", np.linalg.pinv(weight[:, None] * slope), weight * value)


def _polynomials(p: Array, q: Array, lower: Array, upper: Array, length: Array) -> tuple[Array, Array]:
    """Values (N, L + 1) and derivatives (N, L + 1, 7) by (p, q)."""
    leg = p[:, None] + rotate(q[:, None], upper) - lower
    value = np.empty((len(p), leg.shape[1] + 1))
    value[:, :-1] = np.sum(leg * leg, axis=-1) - length**2
    value[:, -1] = np.sum(q * q, axis=-1) - 1
    slope = np.zeros((*value.shape, 7))
    slope[:, :-1, :3] = 2 * leg
    slope[:, :-1, 3:] = 2 * np.einsum("nia,niab->nib", leg, _turning(q[:, None], upper))
    slope[:, -1, 3:] = 2 * q
    return value, slope


def _turning(q: Array, v: Array) -> Array:
    """Derivative (..., 3, 4) of rotate(q, v) by the four components of q."""
    w, r = q[..., :1], q[..., 1:]
    by_w = 2 * w * v + 2 * np.cross(r, v)
    cross = np.cross(v[..., None, :], np.eye(3))  # row j is v x e_j
    by_r = (
        2 * np.sum(r * v, axis=-1)[..., None, None] * np.eye(3)
        + 2 * r[..., :, None] * v[..., None, :]
        - 2 * v[..., :, None] * r[..., None, :]
        - 2 * w[..., None] * np.swapaxes(cross, -1, -2)
    )
    return np.concatenate([by_w[..., None], by_r], axis=-1)


def flexed_length(length: Array, flexure: Array, bent_low: Array, bent_high: Array) -> Array:
    """Distance between the joints of legs with flexures of length ``flexure`` at both ends (report, eq 14 to
    17, beta = 1/4).

    ``bent_low`` and ``bent_high`` are cosines of the angle by which each flexure is bent; straight ones leave
    ``length``.
    """
    return length - flexure + _end_shift(flexure, bent_low) + _end_shift(flexure, bent_high)


def _end_shift(flexure: Array, cosine: Array) -> Array:
    # The positive root of x^2 + l c x / 2 - l^2 / 2 = 0: the leg's axis meets the circle of radius 3 l / 4.
    return flexure / 2 * (np.sqrt(2 + (cosine / 2) ** 2) - cosine / 2)
