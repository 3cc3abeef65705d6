"""Forward and inverse kinematics of a parallel mechanism, with exact derivatives of the pose by any change.

Poses are those of the platform in the base frame, p (B, 3) in m and R (B, 3, 3). Attachments are at ``b* = b + delta_bz
z_E``, z of the platform. Equations of the telescope report, as corrected in its reference. In the reference pose all
readings are at their reference, flexures are straight and the platform is undeformed; models of flexures and of
stiffness are relative to it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import exp_so3, skew
from truing.simulation.change import Change
from truing.simulation.mechanisms.legs.closures import Legs

_MAX_ITERATIONS = 30
# Newton's method doubles the digits: after a step below the root of rounding, the error is rounding. Relative to legs.
SMALL_STEP = 1.5e-8
# A step longer than this (in leg lengths, or rad) has left the workspace of any mechanism.
_LOST_STEP = 10.0
# Number of poses with arrays that fit into the processor's cache.
_PIECE = 1024


@dataclass(frozen=True)
class Forward:
    """Poses at a set of readings, and whether the iteration closed all legs."""

    p: NDArray  # (B, 3) m
    R: NDArray  # (B, 3, 3)
    converged: NDArray  # (B,) bool


def attachments(legs: Legs, delta_bz: NDArray | float) -> NDArray:
    """Return b* (..., L, 3) in the platform frame, m."""
    shift = np.asarray(delta_bz)
    return legs.b + shift[..., None] * np.array([0.0, 0.0, 1.0])


def upper_joints(legs: Legs, p: NDArray, R: NDArray, delta_bz: NDArray | float = 0.0) -> NDArray:
    """Return the joints on the platform (..., L, 3), m, base frame."""
    return p[..., None, :] + attachments(legs, delta_bz) @ np.swapaxes(R, -1, -2)


def leg_vectors(legs: Legs, p: NDArray, R: NDArray, rho: NDArray, delta_bz: NDArray | float = 0.0) -> NDArray:
    """Return the vectors (B, L, 3), m, from lower to upper joint, base frame (eq. 5)."""
    return upper_joints(legs, p, R, delta_bz) - legs.closure.lower(legs, rho)


def inverse(legs: Legs, p: NDArray, R: NDArray, delta_bz: NDArray | float = 0.0) -> NDArray:
    """Return the readings (B, L), m, at the pose p, R of the platform (eq. 7)."""
    return legs.closure.invert(legs, upper_joints(legs, p, R, delta_bz) - legs.a)


def forward(legs: Legs, rho: NDArray, delta_bz: NDArray | float = 0.0) -> Forward:
    """Return the poses at readings rho (..., L), m, by Newton's method from the centred platform along the actuators.

    If the legs cannot meet the platform, or the pose is singular, the last pose tried is returned as not converged; the
    others of the batch are unaffected. Raises ValueError for fewer than six legs.
    """
    if rho.ndim != 2 or is_batched(legs):
        return _newton(legs, rho, delta_bz)
    return in_pieces(partial(_newton, legs), rho, np.broadcast_to(delta_bz, rho.shape))


def is_batched(legs: Legs) -> bool:
    """True if the legs differ from pose to pose."""
    return legs.a.ndim > 2 or legs.b.ndim > 2 or legs.u.ndim > 2 or legs.l.ndim > 1


def in_pieces(solve: Callable[..., Forward], *arrays: NDArray) -> Forward:
    """Solve arrays (B, ...) piece by piece: same result, but faster for many poses."""
    parts = [slice(first, first + _PIECE) for first in range(0, max(len(arrays[0]), 1), _PIECE)]
    solutions = [solve(*(array[part] for array in arrays)) for part in parts]
    return Forward(*(np.concatenate([getattr(piece, name) for piece in solutions]) for name in ("p", "R", "converged")))


def _newton(legs: Legs, rho: NDArray, delta_bz: NDArray | float) -> Forward:
    p, R = _centred_start(legs, rho)
    lost = converged = np.zeros(p.shape[:-1], bool)
    size = np.abs(legs.l).max(-1)
    for _ in range(_MAX_ITERATIONS):
        short, towards = legs.closure.close(legs, upper_joints(legs, p, R, delta_bz), rho)
        rows = closure_rows(legs, R, -towards, delta_bz)
        twist, length = bounded_steps(rows, short)
        lost = lost | (length == np.inf)
        p, R = p + twist[..., :3], exp_so3(twist[..., 3:]) @ R
        converged = ~lost & (length < SMALL_STEP * size)
        if np.all(converged | lost):
            break
    return Forward(p, R, converged)


def bounded_steps(rows: NDArray, short: NDArray) -> tuple[NDArray, NDArray]:
    """Return Newton's steps (..., n) for rows (..., L, n) and gaps (..., L), and the largest entry of each step.

    For members of the batch that are singular or diverge, the entry is infinite and the step zero.
    """
    square, wanted = _square(rows, short[..., None])
    try:
        step = np.linalg.solve(square, wanted)[..., 0]
    except np.linalg.LinAlgError:  # does not say which member is singular
        regular = (np.linalg.slogdet(square)[0] != 0)[..., None, None]
        step = np.linalg.solve(np.where(regular, square, np.eye(square.shape[-1])), wanted)[..., 0]
        step = np.where(regular[..., 0], step, np.inf)
    length = np.abs(step).max(-1)
    sound = length < _LOST_STEP
    return np.where(sound[..., None], step, 0.0), np.where(sound, length, np.inf)


def reaches(legs: Legs, rho: NDArray) -> NDArray:
    """Return the mask (B,) of readings rho (B, L), m, at which the legs meet the platform."""
    return forward(legs, rho).converged


def _centred_start(legs: Legs, rho: NDArray) -> tuple[NDArray, NDArray]:
    """Return a start pose ahead of the actuators, aligned with the joints, with the right mean squared leg length."""
    R = _alignment(legs)
    lower = legs.closure.lower(legs, rho)
    middle, joints = lower.mean(-2), legs.b.mean(-2)
    ahead = unit(legs.u.mean(-2))
    offset = (legs.b - joints[..., None, :]) @ np.swapaxes(R, -1, -2) - (lower - middle[..., None, :])
    square = np.mean(legs.closure.length(legs, rho) ** 2 - _dot(offset, offset), -1)
    height = np.sqrt(np.maximum(square.real, 0.0))
    p = middle + height[..., None] * ahead - (R @ joints[..., None])[..., 0]
    return p, np.broadcast_to(R, (*p.shape[:-1], 3, 3))


def _alignment(legs: Legs) -> NDArray:
    """Return the rotation (..., 3, 3) that best aligns the platform's joints with the lower ones at the reference."""
    lower = legs.closure.lower(legs, legs.rho0).real
    spread = np.swapaxes(lower - lower.mean(-2, keepdims=True), -1, -2) @ (legs.b - legs.b.mean(-2, keepdims=True)).real
    left, _, right = np.linalg.svd(np.nan_to_num(spread))  # NaN in the legs: not converged, but no error
    left[..., :, 2] *= np.sign(np.linalg.det(left @ right))[..., None]
    return left @ right


def closure_rows(legs: Legs, R: NDArray, z: NDArray, delta_bz: NDArray | float = 0.0) -> NDArray:
    """Return the rows [z, R b* x z] (B, L, 6): derivative of a leg's length by a twist (v; omega) of the platform."""
    arms = attachments(legs, delta_bz) @ np.swapaxes(R, -1, -2)
    arms, z = np.broadcast_arrays(arms, z)
    rows = np.empty((*z.shape[:-1], 6), np.result_type(arms, z))
    rows[..., :3] = z
    for axis in range(3):  # np.cross takes three times as long
        j, k = (axis + 1) % 3, (axis + 2) % 3
        rows[..., 3 + axis] = arms[..., j] * z[..., k] - arms[..., k] * z[..., j]
    return rows


def inverse_jacobian(legs: Legs, p: NDArray, R: NDArray, rho: NDArray, delta_bz: NDArray | float = 0.0) -> NDArray:
    """Return d rho / d twist (B, L, 6) at constant deformation, 6-pus (eq. 8), columns m/m and m/rad."""
    z = unit(leg_vectors(legs, p, R, rho, delta_bz))
    return closure_rows(legs, R, z, delta_bz) / np.sum(z * legs.u, -1)[..., None]


def pose_change(legs: Legs, p: NDArray, R: NDArray, rho: NDArray, delta_bz: NDArray, change: Change) -> NDArray:
    """Return the twist (B, 6, P) of the platform per parameter of a change, from the exact differential of the closure.

    z . (v + omega x R b* + R (db + z_E d delta_bz) - dc) = d length; c is the lower joint of a straight leg.
    """
    upper = upper_joints(legs, p, R, delta_bz)
    z = -legs.closure.close(legs, upper, rho)[1]
    moved = np.einsum("...li,...lip->...lp", z, attachment_change(legs, R, change))
    wanted = legs.closure.close_change(legs, upper, rho, change) - moved
    return solve_rows(closure_rows(legs, R, z, delta_bz), wanted)


def attachment_change(legs: Legs, R: NDArray, change: Change) -> NDArray:
    """Return the derivative (B, L, 3, P), base frame, of the attachments on a fixed platform."""
    moved = np.einsum("...ij,...ljp->...lip", R, change.get("b", (legs.count, 3)))
    return moved + R[..., None, :, 2, None] * change.get("delta_bz", (legs.count,))[..., None, :]


def solve_rows(rows: NDArray, wanted: NDArray) -> NDArray:
    """Return the twists (B, 6, P) that satisfy L >= 6 leg conditions, in the least-squares sense for L > 6.

    Raises ValueError for fewer than six legs, which leave the platform free.
    """
    return np.linalg.solve(*_square(rows, wanted))


def _square(rows: NDArray, wanted: NDArray) -> tuple[NDArray, NDArray]:
    """Return a square system: the rows themselves, or their normal equations."""
    count, unknowns = rows.shape[-2:]
    if count < unknowns:
        raise ValueError(f"found {count} legs, expected at least {unknowns}: fewer leave the platform free to move")
    if count > unknowns:
        transposed = np.swapaxes(rows, -1, -2)
        return transposed @ rows, transposed @ wanted
    return rows, np.broadcast_to(wanted, (*rows.shape[:-2], *wanted.shape[-2:]))


def unit(v: NDArray) -> NDArray:
    """Return vectors (..., 3) divided by their length, real or complex."""
    return v / np.sqrt(_dot(v, v))[..., None]


def _dot(v: NDArray, w: NDArray) -> NDArray:
    """Return products (...) of vectors (..., 3) without conjugation; faster than a sum of products."""
    return np.einsum("...i,...i->...", v, w)


def shortest_turn(start: NDArray, z: NDArray) -> NDArray:
    """Return the rotations (..., 3, 3) of smallest angle that carry unit vectors start to z."""
    cross = skew(np.cross(start, z))
    return np.eye(3) + cross + cross @ cross / (1 + np.sum(start * z, -1))[..., None, None]


@dataclass(frozen=True)
class ReferencePose:
    """Pose p0 (..., 3) m, R0 (..., 3, 3) and directions z0 (..., L, 3) of the legs, base frame; at least one leading
    axis."""

    p: NDArray
    R: NDArray
    z: NDArray


@dataclass(frozen=True)
class ReferenceChange:
    """Derivatives by P parameters: twist (v; omega) (..., 6, P) of the reference pose, and of z0 (..., L, 3, P)."""

    twist: NDArray
    z: NDArray


def reference_pose(legs: Legs) -> ReferencePose:
    """Return the pose of the mechanism with rigid legs at its reference readings.

    Raises ValueError for fewer than six legs, which do not determine the pose.
    """
    rho0 = np.atleast_2d(legs.rho0)
    reference = forward(legs, rho0)
    return ReferencePose(reference.p, reference.R, unit(leg_vectors(legs, reference.p, reference.R, rho0)))


def reference_change(legs: Legs, reference: ReferencePose, change: Change) -> ReferenceChange:
    """Return the derivative of the reference pose by a change of a, b, u, l and rho0; exact if the legs close."""
    rho0 = np.atleast_2d(legs.rho0)
    moved = _at_reference(change)
    twist = reference_twist(legs, reference.p, reference.R, change)
    arms = legs.b @ np.swapaxes(reference.R, -1, -2)
    upper = point_motion(twist, arms) + attachment_change(legs, reference.R, moved)
    g = leg_vectors(legs, reference.p, reference.R, rho0)
    turned = upper - legs.closure.lower_change(legs, rho0, moved)
    across = turned - reference.z[..., None] * np.einsum("...li,...lip->...lp", reference.z, turned)[..., None, :]
    return ReferenceChange(twist, across / np.sqrt(np.sum(g * g, -1))[..., None, None])


def reference_twist(legs: Legs, p: NDArray, R: NDArray, change: Change) -> NDArray:
    """Return the twist (..., 6, P) of the reference pose p (..., 3), R (..., 3, 3) per parameter of a change.

    It does not depend on the deformation.
    """
    return pose_change(legs, p, R, legs.rho0, np.zeros(1), _at_reference(change))


def _at_reference(change: Change) -> Change:
    """Return a change of the geometry as seen by rigid legs whose readings stay at their reference."""
    fields = {name: field for name, field in change.fields.items() if name in ("a", "b", "u", "l")}
    driven = {"rho": change.fields["rho0"]} if "rho0" in change.fields else {}
    return Change(fields | driven, change.size)


def point_motion(twist: NDArray, arms: NDArray) -> NDArray:
    """Return the motion (..., L, 3, P) of points at arms (..., L, 3) on a body with twists (..., 6, P)."""
    return twist[..., None, :3, :] + skew(-arms) @ twist[..., None, 3:, :]  # np.cross takes twice as long
