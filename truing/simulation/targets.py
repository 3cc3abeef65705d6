"""Targets on the bodies of a parallel mechanism: where they are in a state, and how they move when it changes.

All positions are in the base frame, m. Base targets stand still; platform targets move with the platform; a target
that sits on an attachment is the attachment; a leg's targets move with the leg, which turns about its lower joint
the shortest way and, held by alike flexures at both ends, about its own axis half as far as the platform does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import exp_so3, inverse_left_jacobian_so3, log_so3, skew
from truing.simulation.chain import State
from truing.simulation.kinematics import attachment_change, attachments, leg_vectors, pose_change, unit
from truing.simulation.legs import Change

BASE, PLATFORM, LEG = 0, 1, 2


@dataclass(frozen=True)
class Targets:
    """K targets: which kind of body carries each, and which leg it belongs to (counted from 0).

    ``leg`` is the leg that a LEG target rides on, or the attachment that a PLATFORM target sits on; -1 for none.
    """

    body: NDArray  # (K,) of BASE, PLATFORM, LEG
    leg: NDArray  # (K,) int

    @property
    def at_attachment(self) -> NDArray:
        """Return which targets (K,) sit on an attachment."""
        return (self.body == PLATFORM) & (self.leg >= 0)


@dataclass(frozen=True)
class LegFrames:
    """Where the legs stand: lower joints (B, L, 3) and rotations (B, L, 3, 3) from the upright attitude."""

    origin: NDArray
    rotation: NDArray
    z: NDArray  # (B, L, 3) directions


def leg_frames(state: State, upright: NDArray, roll: NDArray) -> LegFrames:
    """Return the frames of the legs, turned from directions upright (L, 3), rolled by roll (B, L) rad beyond half
    the platform's twist."""
    z = unit(leg_vectors(state.legs, state.p, state.R, state.rho, state.delta_bz))
    twist = roll + 0.5 * np.einsum("bli,bi->bl", z, log_so3(state.R))
    rotation = exp_so3(twist[..., None] * z) @ _shortest(upright, z)
    return LegFrames(state.legs.closure.lower(state.legs, state.rho), rotation, z)


def _shortest(start: NDArray, z: NDArray) -> NDArray:
    """Return the rotations (..., 3, 3) that carry unit vectors start to z the shortest way."""
    cross = skew(np.cross(np.broadcast_to(start, z.shape), z))
    return np.eye(3) + cross + cross @ cross / (1 + np.sum(start * z, -1))[..., None, None]


def positions(state: State, targets: Targets, shape: NDArray, frames: LegFrames) -> NDArray:
    """Return the targets (B, K, 3) in the base frame for shapes (K, 3): base frame, platform frame, upright leg."""
    points = np.broadcast_to(shape, (len(state.rho), *shape.shape)).astype(
        np.result_type(shape, state.R, frames.rotation)
    )
    on_platform, on_leg = targets.body == PLATFORM, targets.body == LEG
    upper = attachments(state.legs, state.delta_bz)
    arms = np.where(
        targets.at_attachment[:, None], np.broadcast_to(upper, (len(points), *upper.shape[-2:]))[:, targets.leg], points
    )
    points[:, on_platform] = state.p[:, None] + arms[:, on_platform] @ np.swapaxes(state.R, -1, -2)
    ridden = targets.leg[on_leg]
    turned = np.einsum("bkij,kj->bki", frames.rotation[:, ridden], shape[on_leg])
    points[:, on_leg] = frames.origin[:, ridden] + turned
    return points


@dataclass(frozen=True)
class Motion:
    """How platform, attachments and legs move per parameter of a change, all in the base frame."""

    twist: NDArray  # (B, 6, P) of the platform
    attachment: NDArray  # (B, L, 3, P)
    lower: NDArray  # (B, L, 3, P)
    turn: NDArray  # (B, L, 3, P) rotation of the legs


def motion(state: State, upright: NDArray, change: Change) -> Motion:
    """Return the motion of all bodies that a change of the state brings about; exact."""
    legs, R = state.legs, state.R
    twist = pose_change(legs, state.p, R, state.rho, state.delta_bz, change)
    arms = attachments(legs, state.delta_bz) @ np.swapaxes(R, -1, -2)
    attachment = attachment_change(legs, R, change) + _carried(twist, arms)
    lower = np.broadcast_to(legs.closure.lower_change(legs, state.rho, change), attachment.shape)
    g = leg_vectors(legs, state.p, R, state.rho, state.delta_bz)
    return Motion(twist, attachment, lower, _leg_turn(state, upright, unit(g), attachment - lower, g, twist))


def _leg_turn(state: State, upright: NDArray, z: NDArray, dg: NDArray, g: NDArray, twist: NDArray) -> NDArray:
    """Return the legs' rotation: across z from z x dz, along z from the shortest way and half the platform's twist."""
    dg = dg / np.sqrt(np.sum(g * g, -1))[..., None, None]
    dz = dg - z[..., None] * np.einsum("bli,blip->blp", z, dg)[..., None, :]
    theta = log_so3(state.R)
    platform = np.einsum("bij,bjp->bip", inverse_left_jacobian_so3(theta), twist[:, 3:])
    half = 0.5 * (np.einsum("bi,blip->blp", theta, dz) + np.einsum("bli,bip->blp", z, platform))
    normal = np.cross(np.broadcast_to(upright, z.shape), z) / (1 + np.sum(upright * z, -1))[..., None]
    along = half - np.einsum("bli,blip->blp", normal, dz)
    return np.cross(z[..., None], dz, axis=2) + z[..., None] * along[..., None, :]


def _carried(twist: NDArray, arms: NDArray) -> NDArray:
    """Return the motion (B, N, 3, P) of points at arms (B, N, 3) on a body with a twist (B, 6, P)."""
    return twist[:, None, :3] + np.cross(twist[:, None, 3:], arms[..., None], axis=2)


def target_motion(state: State, targets: Targets, shape: NDArray, frames: LegFrames, moved: Motion) -> NDArray:
    """Return how the targets move (B, K, 3, P), base frame, when the bodies do."""
    result = np.zeros((len(state.rho), len(shape), 3, moved.twist.shape[-1]))
    away = (targets.body == PLATFORM) & (targets.leg < 0)
    result[:, away] = _carried(moved.twist, shape[away] @ np.swapaxes(state.R, -1, -2))
    result[:, targets.at_attachment] = moved.attachment[:, targets.leg[targets.at_attachment]]
    on_leg = targets.body == LEG
    ridden = targets.leg[on_leg]
    arms = np.einsum("bkij,kj->bki", frames.rotation[:, ridden], shape[on_leg])
    turned = np.cross(moved.turn[:, ridden], arms[..., None], axis=2)
    result[:, on_leg] = moved.lower[:, ridden] + turned
    return result


def shape_rotation(state: State, targets: Targets, frames: LegFrames) -> NDArray:
    """Return the rotation (B, K, 3, 3) from each target's shape to the base frame; zero for one on an attachment."""
    rotation = np.zeros((len(state.rho), len(targets.body), 3, 3))
    rotation[:, targets.body == BASE] = np.eye(3)
    rotation[:, (targets.body == PLATFORM) & (targets.leg < 0)] = state.R[:, None]
    on_leg = targets.body == LEG
    rotation[:, on_leg] = frames.rotation[:, targets.leg[on_leg]]
    return rotation
