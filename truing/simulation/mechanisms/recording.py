"""Positions of targets and their derivatives, and points as recorded by instruments; base class `RecordedModel`.

All positions are in the base frame, m. Base targets are fixed; platform targets move with the platform; a target on an
attachment is at the attachment. Targets on a leg move with the leg, which turns about its lower joint by the smallest
angle. With like flexures at both ends, it also turns about its own axis by half the platform's twist.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self, cast

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import exp_so3, inverse_left_jacobian_so3, log_so3, skew
from truing.simulation.cause import OBSERVED, Effect, Step
from truing.simulation.change import Change
from truing.simulation.effects_model import EffectsModel
from truing.simulation.mechanisms.forward_pass import EffectAtState, ForwardPass, propagated, structure_response
from truing.simulation.mechanisms.legs.kinematics import (
    attachment_change,
    attachments,
    leg_vectors,
    point_motion,
    shortest_turn,
    unit,
)
from truing.simulation.mechanisms.point_causes import Photographed, PointCause, applied
from truing.simulation.mechanisms.state import State
from truing.simulation.targets import LEG, PLATFORM, Targets


@dataclass(frozen=True)
class Conditions:
    """Data of each pose: readings (B, L) in m, covariates (B,) or (B, L) by column, and names of the poses.

    ``span_s`` is the first and last time of the whole campaign, of which these poses may be a part. ``common_errors``
    (B, K, 3, Q): derivative of points, in the model's frame, m, by the errors common to the photographs of all poses;
    ``pose_errors`` (B, K, 3, E): by those common to the points of each pose. ``input_factor`` (B, H): factor of the
    prior sigmas of inputs; None for 1.
    """

    readings: NDArray
    covariates: Mapping[str, NDArray] = field(default_factory=dict)
    poses: tuple[int | str, ...] = ()
    span_s: tuple[float, float] | None = None
    common_errors: NDArray | None = field(default=None, kw_only=True)
    pose_errors: NDArray | None = field(default=None, kw_only=True)
    input_factor: NDArray | None = field(default=None, kw_only=True)


@dataclass(frozen=True)
class LegFrames:
    """Frames of the legs: lower joints (B, L, 3), rotations (B, L, 3, 3) from the axes of their targets' survey."""

    origin: NDArray
    rotation: NDArray
    z: NDArray  # (B, L, 3) directions


def leg_frames(state: State, nominal: NDArray, roll: NDArray, seats: NDArray | None = None) -> LegFrames:
    """Return the frames of the legs, turned from nominal directions (L, 3) by the smallest angle and about their own
    axes.

    The angle about the axis is roll (B, L) rad plus half the platform's twist. seats (L, 3, 3) are the rotations from
    the axes of a leg's survey to the leg in its nominal direction; None: identity.
    """
    z = unit(leg_vectors(state.legs, state.p, state.R, state.rho, state.delta_bz))
    twist = roll + 0.5 * np.einsum("bli,bi->bl", z, log_so3(state.R))
    rotation = exp_so3(twist[..., None] * z) @ shortest_turn(nominal, z)
    lower = state.legs.closure.lower(state.legs, state.rho)
    return LegFrames(lower, rotation if seats is None else rotation @ seats, z)


def target_rotations(state: State, targets: Targets, frames: LegFrames) -> NDArray:
    """Return the rotations (B, K, 3, 3) from the axes of each target's survey to the base frame."""
    kind = np.result_type(state.R, frames.rotation)
    turn = np.broadcast_to(np.eye(3, dtype=kind), (len(state.rho), len(targets.body), 3, 3)).copy()
    turn[:, targets.body == PLATFORM] = state.R[:, None]
    on_leg = targets.body == LEG
    turn[:, on_leg] = frames.rotation[:, targets.leg[on_leg]]
    return turn


def positions(state: State, targets: Targets, frames: LegFrames) -> NDArray:
    """Return the positions (B, K, 3), m, of the targets in the base frame, with displacements."""
    kind = np.result_type(state.shape, state.moved, state.R, frames.rotation)
    points = np.broadcast_to(state.shape + state.moved, (len(state.rho), len(targets.body), 3)).astype(kind)
    _set_attached_positions(points, state, targets)
    on_platform, on_leg = targets.body == PLATFORM, targets.body == LEG
    points[:, on_platform] = state.p[:, None] + points[:, on_platform] @ np.swapaxes(state.R, -1, -2)
    ridden = targets.leg[on_leg]
    turned = np.einsum("bkij,bkj->bki", frames.rotation[:, ridden], points[:, on_leg])
    points[:, on_leg] = frames.origin[:, ridden] + turned
    return points


def _set_attached_positions(positions: NDArray, state: State, targets: Targets) -> None:
    """Set the positions (B, K, 3) of targets on attachments, in the platform's frame, with displacements."""
    seats = targets.at_attachment
    upper = attachments(state.legs, state.delta_bz)
    moved = np.broadcast_to(state.moved, positions.shape)[:, seats]
    positions[:, seats] = np.broadcast_to(upper, (len(positions), *upper.shape[-2:]))[:, targets.leg[seats]] + moved


@dataclass(frozen=True)
class MotionDerivatives:
    """Derivatives of the motion of platform, attachments, legs and targets by the parameters of a change.

    All in the base frame, except ``moved``: targets on their bodies, along the axes of the surveys; None if they are
    fixed.
    """

    twist: NDArray  # (B, 6, P) of the platform
    attachment: NDArray  # (B, L, 3, P)
    lower: NDArray  # (B, L, 3, P)
    turn: NDArray  # (B, L, 3, P) rotation of the legs
    moved: NDArray | None  # (B, K, 3, P)


def motion(forward_pass: ForwardPass, nominal: NDArray, change: Change) -> MotionDerivatives:
    """Return the exact motion of all bodies due to a change at the end of the structure."""
    state = forward_pass.state
    legs, R = state.legs, state.R
    change, twist = structure_response(forward_pass, change)
    arms = attachments(legs, state.delta_bz) @ np.swapaxes(R, -1, -2)
    attachment = attachment_change(legs, R, change) + point_motion(twist, arms)
    lower = np.broadcast_to(legs.closure.lower_change(legs, state.rho, change), attachment.shape)
    g = leg_vectors(legs, state.p, R, state.rho, state.delta_bz)
    turn = _leg_turn(state, nominal, unit(g), attachment - lower, g, twist)
    return MotionDerivatives(twist, attachment, lower, turn, change.fields.get("moved"))


def _leg_turn(state: State, nominal: NDArray, z: NDArray, dg: NDArray, g: NDArray, twist: NDArray) -> NDArray:
    """Return the legs' rotation: across z from z x dz; along z from the smallest turn and half the platform's twist."""
    dg = dg / np.sqrt(np.sum(g * g, -1))[..., None, None]
    dz = dg - z[..., None] * np.einsum("bli,blip->blp", z, dg)[..., None, :]
    theta = log_so3(state.R)
    platform = np.einsum("bij,bjp->bip", inverse_left_jacobian_so3(theta), twist[:, 3:])
    half = 0.5 * (np.einsum("bi,blip->blp", theta, dz) + np.einsum("bli,bip->blp", z, platform))
    normal = np.cross(np.broadcast_to(nominal, z.shape), z) / (1 + np.sum(nominal * z, -1))[..., None]
    along = half - np.einsum("bli,blip->blp", normal, dz)
    return skew(z) @ dz + z[..., None] * along[..., None, :]


def target_motion(state: State, targets: Targets, frames: LegFrames, bodies: MotionDerivatives) -> NDArray:
    """Return the motion (B, K, 3, P) of the targets, base frame, due to the motion of the bodies."""
    positions = np.broadcast_to(state.shape + state.moved, (len(state.rho), len(targets.body), 3))
    result = np.zeros((*positions.shape, bodies.twist.shape[-1]))
    free, seats, on_leg = (targets.body == PLATFORM) & (targets.leg < 0), targets.at_attachment, targets.body == LEG
    back = np.swapaxes(state.R, -1, -2)
    result[:, free] = point_motion(bodies.twist, positions[:, free] @ back)
    moved = np.broadcast_to(state.moved, positions.shape)[:, seats] @ back
    result[:, seats] = bodies.attachment[:, targets.leg[seats]] + _motion_under_rotation(
        bodies.twist[:, None, 3:], moved
    )
    ridden = targets.leg[on_leg]
    arms = np.einsum("bkij,bkj->bki", frames.rotation[:, ridden], positions[:, on_leg])
    result[:, on_leg] = bodies.lower[:, ridden] + _motion_under_rotation(bodies.turn[:, ridden], arms)
    if bodies.moved is not None:
        result += target_rotations(state, targets, frames) @ bodies.moved
    return result


def _motion_under_rotation(rotation: NDArray, arms: NDArray) -> NDArray:
    """Return the motion (B, N, 3, P) of arms (B, N, 3) under rotations (B, N or 1, 3, P)."""
    return skew(-arms) @ rotation


@dataclass(frozen=True)
class Recording:
    """A complete forward pass with recorded points, and the frames of the legs."""

    forward_pass: ForwardPass
    targets: Targets
    frames: LegFrames

    @property
    def state(self) -> State:
        """State with points and rotations as recorded."""
        return self.forward_pass.state

    def motion(self, change: Change, subsequent: Sequence[EffectAtState]) -> NDArray:
        """Return the motion (B, K, 3, P) of the targets, m, base frame, due to a change and the effects ``subsequent``
        after it."""
        bodies = motion(self.forward_pass, self.state.nominal_direction, propagated(change, subsequent))
        return target_motion(self.state, self.targets, self.frames, bodies)

    def recorded(self, motions: NDArray, cause: PointCause | None = None) -> NDArray:
        """Return motions of points (B, K, 3, P) as recorded: by all effects of the instrument, or by those after a
        cause."""
        for effect, state in self.forward_pass.subsequent_effects(cause, Step.INSTRUMENT):
            motions = effect.cause.recorded(motions, state, effect.values)
        return motions

    @cached_property
    def turn(self) -> NDArray:
        """Derivative (B, K, 3, 3) of recorded points by shifts along the axes of their bodies."""
        return self.recorded(self.state.turn)


def record(
    forward_pass: ForwardPass,
    targets: Targets,
    frames: LegFrames,
    effects: Sequence[Effect[PointCause]],
    points: NDArray,
    turn: NDArray,
) -> Recording:
    """Record points (B, K, 3), m, and the rotations (B, K, 3, 3) of their axes, with the effects of the instrument."""
    seen = forward_pass.entering(replace(forward_pass.state, points=points, turn=turn))
    return Recording(seen.through(Step.INSTRUMENT, effects, applied), targets, frames)


def designs(recording: Recording, cause: PointCause, scale: NDArray) -> dict[str, NDArray]:
    """Return a cause's change per scale (P,) of its parameters by pathway, (B or 1, n, P).

    The index within a pathway is leg, or 3 leg + axis; within the observations 3 target + axis.
    """
    design_columns: dict[str, NDArray] = {}
    for name, slope in cause.change(recording.forward_pass.at(cause), np.zeros(len(scale))).fields.items():
        slope = slope * scale
        if name == "moved":
            slope = recording.turn @ slope
        pathway = OBSERVED if name in ("moved", "points") else name
        flat = slope.reshape(len(slope), -1, len(scale))
        design_columns[pathway] = design_columns[pathway] + flat if pathway in design_columns else flat
    return design_columns


def _equal(first: NDArray, second: NDArray) -> bool:
    """Return True for arrays of the same type and values."""
    return first.dtype == second.dtype and np.array_equal(first, second)


# Part of the shared unknowns with the errors common to all photographs.
FROM_PHOTOGRAPHS = "photographs"


@dataclass(frozen=True)
class RecordedModel(EffectsModel[PointCause]):
    """Base class of models of points of bodies; ``photographed`` is set if points were computed from images."""

    targets: Targets
    conditions: Conditions
    photographed: Photographed | None = field(default=None, kw_only=True)

    channel_word = "target"

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Names (K,) of the targets."""
        return self.targets.names

    @property
    def channel_kinds(self) -> tuple[str, ...]:
        """Body (K,) of each target."""
        return self.targets.bodies

    @property
    def survey(self) -> slice:
        """Slice of the unknown shapes of the bodies."""
        return self.layout["shape"]

    def at(self, conditions: Conditions) -> Self:
        """Return the model at other poses."""
        return replace(self, conditions=conditions)

    @abstractmethod
    def _recording(self, shared: NDArray, local: NDArray) -> Recording:
        """Return the recording with the effects in force."""

    def recording(self, shared: NDArray, local: NDArray) -> Recording:
        """Return the recording with the effects in force; the last one is kept, for fits ask several times in a row."""
        last = self.__dict__.get("_last_recording")
        if last is not None and _equal(last[0], shared) and _equal(last[1], local):
            return cast(Recording, last[2])
        found = self._recording(shared, local)
        self.__dict__["_last_recording"] = shared.copy(), local.copy(), found
        return found

    def points(self, shared: NDArray, local: NDArray) -> NDArray:
        """Return the predicted points (B, K, 3), m, in the model's frame."""
        return self._with_errors(self.recording(shared, local).state.points, shared, local)

    def rotations(self, shared: NDArray, local: NDArray) -> NDArray:
        """Return the derivatives (B, K, 3, 3) of recorded points by shifts along the axes of the bodies' surveys."""
        return self.recording(shared, local).turn

    @property
    def _common_sizes(self) -> dict[str, int]:
        """Number of errors common to the photographs of all poses, by part; empty without photographs."""
        return {} if self.photographed is None else {FROM_PHOTOGRAPHS: self.photographed.errors}

    @property
    def _pose_size(self) -> int:
        """Number of errors common to the points of a pose; these are the last local unknowns."""
        return 0 if self.photographed is None else self.photographed.pose_errors

    @property
    def _local_known(self) -> NDArray:
        """Mask (H,) of the local unknowns whose prior is knowledge."""
        known = ~self.unpredicted
        return np.asarray(known | (np.arange(len(known)) >= len(known) - self._pose_size))

    def _with_errors(self, points: NDArray, shared: NDArray, local: NDArray) -> NDArray:
        """Return points (B, K, 3) plus the common errors of the photographs of all poses, and of each pose."""
        conditions = self.conditions
        if conditions.common_errors is not None:
            points = points + conditions.common_errors @ shared[self.layout[FROM_PHOTOGRAPHS]]
        if conditions.pose_errors is not None:
            errors = local[:, None, local.shape[1] - self._pose_size :, None]
            points = points + (conditions.pose_errors @ errors)[..., 0]
        return points

    def _fill_pose_errors(self, by_local: NDArray) -> None:
        """Fill the derivatives by the common errors of each pose's photographs."""
        if self.conditions.pose_errors is not None:
            by_local[..., by_local.shape[-1] - self._pose_size :] = self.conditions.pose_errors

    def _fill_common(self, by_shared: NDArray) -> None:
        """Fill the derivatives by the common errors of all photographs."""
        if self.conditions.common_errors is not None:
            by_shared[..., self.layout[FROM_PHOTOGRAPHS]] = self.conditions.common_errors

    def _fill_instruments(self, by_shared: NDArray, shared: NDArray, recording: Recording) -> None:
        """Fill the derivatives by the parameters of the instrument's effects."""
        for effect in self.effects(shared):
            cause = effect.cause
            if cause.step is Step.INSTRUMENT and len(effect.values):
                slope = cause.change(recording.forward_pass.at(cause), effect.values).fields[
                    "points"
                ] * self.effect_sigma(cause)
                by_shared[..., self.layout[cause.key]] = recording.recorded(slope, cause)
