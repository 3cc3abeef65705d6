"""Pose from readings, readings from pose, and the exact derivative of the pose by whatever changes.

Poses are those of the platform in the base frame, p (B, 3) in m and R (B, 3, 3). Attachments stand at
``b* = b + delta_bz z_E``, z of the platform. Equations of the telescope report, as corrected in its reference.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import exp_so3
from truing.simulation.legs import Change, Legs

_MAX_ITERATIONS = 30
# Newton doubles the digits: a step below this leaves the next one at rounding.
_SMALL_STEP = 1e-9


@dataclass(frozen=True)
class Forward:
    """Poses that a set of readings leads to, and whether the iteration closed all legs."""

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
    """Return the readings (B, L), m, at which the platform stands at p, R (eq. 7)."""
    return legs.closure.invert(legs, upper_joints(legs, p, R, delta_bz) - legs.a)


def inverse_deforming(legs: Legs, p: NDArray, R: NDArray, shift: Callable[[NDArray], NDArray]) -> NDArray:
    """Return the readings (B, L), m, where attachments shift by ``shift(rho - rho0)`` (eq. 7 with eq. 1-3).

    Fixed point; each round contracts by the norm of the deformation, about 0.05 for the published one.
    """
    rho = inverse(legs, p, R)
    for _ in range(_MAX_ITERATIONS):
        before, rho = rho, inverse(legs, p, R, shift(rho - legs.rho0))
        if np.max(np.abs(rho - before)) == 0.0:
            break
    return rho


def forward(legs: Legs, rho: NDArray, delta_bz: NDArray | float = 0.0) -> Forward:
    """Return the poses reached with readings rho (B, L), m, by Newton from the centred, level platform."""
    p, R = _level_start(legs, rho)
    converged = np.zeros(len(p), bool)
    for _ in range(_MAX_ITERATIONS):
        short, towards = legs.closure.close(legs, upper_joints(legs, p, R, delta_bz), rho)
        twist = solve_rows(closure_rows(legs, R, -towards, delta_bz), short[..., None])[..., 0]
        p, R = p + twist[..., :3], exp_so3(twist[..., 3:]) @ R
        step = np.abs(twist).max(-1)
        converged = np.asarray(step < _SMALL_STEP * np.abs(legs.l).max())
        if converged.all():
            break
    return Forward(p, R, converged)


def reaches(legs: Legs, rho: NDArray) -> NDArray:
    """Return for which readings rho (B, L), m, the legs meet the platform at all, reading by reading."""
    return np.array([_meets(legs, reading[None]) for reading in rho], bool)


def _meets(legs: Legs, rho: NDArray) -> bool:
    try:
        return bool(forward(legs, rho).converged.all())
    except np.linalg.LinAlgError:
        return False


def _level_start(legs: Legs, rho: NDArray) -> tuple[NDArray, NDArray]:
    """Return a start whose mean squared leg length is right, ahead of the actuators, without rotation."""
    lower = legs.closure.lower(legs, rho)
    ahead = legs.u.mean(-2)
    ahead = ahead / np.sqrt(np.sum(ahead * ahead, -1, keepdims=True))
    offset = (legs.b - legs.b.mean(-2, keepdims=True)) - (lower - lower.mean(-2, keepdims=True))
    square = np.mean(legs.closure.length(legs, rho) ** 2 - np.sum(offset * offset, -1), -1)
    height = np.sqrt(np.maximum(square.real, 0.0))
    p = lower.mean(-2) - legs.b.mean(-2) + height[..., None] * ahead
    return p, np.broadcast_to(np.eye(3), (*p.shape[:-1], 3, 3))


def closure_rows(legs: Legs, R: NDArray, z: NDArray, delta_bz: NDArray | float = 0.0) -> NDArray:
    """Return the rows [z, R b* x z] (B, L, 6): change of a leg's length by a twist (v; omega) of the platform."""
    arms = attachments(legs, delta_bz) @ np.swapaxes(R, -1, -2)
    return np.concatenate([z, np.cross(arms, z)], -1)


def inverse_jacobian(legs: Legs, p: NDArray, R: NDArray, rho: NDArray, delta_bz: NDArray | float = 0.0) -> NDArray:
    """Return d rho / d twist (B, L, 6) at constant deformation, 6-pus (eq. 8), columns m/m and m/rad."""
    z = unit(leg_vectors(legs, p, R, rho, delta_bz))
    return closure_rows(legs, R, z, delta_bz) / np.sum(z * legs.u, -1)[..., None]


def pose_change(legs: Legs, p: NDArray, R: NDArray, rho: NDArray, delta_bz: NDArray, change: Change) -> NDArray:
    """Return the twist (B, 6, P) of the platform per parameter of a change; exact, from the closure's differential.

    z . (v + omega x R b* + R (db + z_E d delta_bz) - dc) = d length, c the lower joint of a straight leg.
    """
    upper = upper_joints(legs, p, R, delta_bz)
    z = -legs.closure.close(legs, upper, rho)[1]
    moved = np.einsum("...li,...lip->...lp", z, attachment_change(legs, R, change))
    wanted = legs.closure.close_change(legs, upper, rho, change) - moved
    return solve_rows(closure_rows(legs, R, z, delta_bz), wanted)


def attachment_change(legs: Legs, R: NDArray, change: Change) -> NDArray:
    """Return the derivative (B, L, 3, P), base frame, of the attachments on a platform that stands still."""
    moved = np.einsum("...ij,...ljp->...lip", R, change.get("b", (legs.count, 3)))
    return moved + R[..., None, :, 2, None] * change.get("delta_bz", (legs.count,))[..., None, :]


def solve_rows(rows: NDArray, wanted: NDArray) -> NDArray:
    """Return the twists (B, 6, P) that meet L >= 6 leg conditions, least squares beyond six.

    Raises ValueError for fewer than six legs, which leave the platform free.
    """
    if rows.shape[-2] < 6:
        raise ValueError(f"found {rows.shape[-2]} legs, expected at least 6: fewer leave the platform free to move")
    if rows.shape[-2] == 6:
        return np.linalg.solve(rows, np.broadcast_to(wanted, (*rows.shape[:-2], *wanted.shape[-2:])))
    transposed = np.swapaxes(rows, -1, -2)
    return np.linalg.solve(transposed @ rows, transposed @ wanted)


def unit(v: NDArray) -> NDArray:
    """Return vectors (..., 3) divided by their length, real or complex."""
    return v / np.sqrt(np.sum(v * v, -1))[..., None]
