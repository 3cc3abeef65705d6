"""Simulation of a mechanism through drive, structure and instrument, and exact propagation of changes through this
chain.

An effect (a cause with values of its parameters) changes the state at its own step. Subsequent effects respond to this
change, in value and in derivative.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import skew
from truing.simulation.cause import Effect, Step
from truing.simulation.change import Change
from truing.simulation.mechanisms.legs.closures import Legs
from truing.simulation.mechanisms.legs.kinematics import forward, pose_change, reference_pose
from truing.simulation.mechanisms.point_causes import PointCause, applied
from truing.simulation.mechanisms.state import State
from truing.simulation.trace import Trace

EffectAtState = tuple[Effect[PointCause], State]
POSE = "pose"
_OF_LEGS = ("a", "b", "u", "l")
REFERENCE = ("reference_direction", "reference_rotation")
# Each round reduces the error at least a hundredfold, so that six rounds reach rounding.
_ROUNDS = 6
_TINY = 1e-30


@dataclass(frozen=True)
class ForwardPass(Trace[PointCause, State]):
    """Forward pass of the state of a mechanism, or of bodies."""

    def before_recording(self, cause: PointCause | None = None) -> tuple[EffectAtState, ...]:
        """Return the effects of drive and structure; only those after a cause, if one is given."""
        return self.subsequent_effects(cause, Step.DRIVE, Step.STRUCTURE)

    @cached_property
    def pose_response(self) -> Change:
        """Response of the structure's effects to a twist of the platform, per component (m and rad)."""
        structure = self.subsequent_effects(None, Step.STRUCTURE)
        if not any(POSE in effect.cause.reads for effect, _ in structure):
            return Change({}, 6)
        shifted = np.broadcast_to(np.eye(3, 6), (1, 3, 6))
        turned = np.zeros((*self.state.R.shape, 6))
        turned[..., 3:] = np.einsum("aij,bjk->bika", skew(np.eye(3)), self.state.R)
        answer = propagated(Change({"p": shifted, "R": turned}, 6), structure)
        return Change({name: slope for name, slope in answer.fields.items() if name not in ("p", "R")}, 6)


def simulate(
    legs: Legs,
    rho: NDArray,
    effects: Sequence[Effect[PointCause]] = (),
    covariates: Mapping[str, NDArray] | None = None,
) -> State:
    """Return the state, with the platform's poses, at indicated positions rho (B, L), m, under the given effects."""
    pose = reference_pose(legs)
    start = State(
        legs,
        rho,
        np.zeros_like(rho),
        indicated=rho,
        covariates=covariates or {},
        nominal_direction=pose.z[0],
        reference_direction=pose.z[0],
        reference_rotation=pose.R[0],
    )
    return pass_through(start, effects).state


def pass_through(start: State, effects: Sequence[Effect[PointCause]]) -> ForwardPass:
    """Pass a state through drive and structure.

    Effects that depend on the pose are found by iteration: each round uses the pose of the round before.
    """
    driven = ForwardPass(start, (), {}).through(Step.DRIVE, effects, applied)
    reads = (effect.cause.reads for effect in effects if effect.cause.step is Step.STRUCTURE)
    rounds = _ROUNDS if any(POSE in fields for fields in reads) else 0
    entry = _posed(driven.state, driven.state) if rounds else driven.state
    for _ in range(rounds):
        entry = _posed(driven.entering(entry).through(Step.STRUCTURE, effects, applied).state, driven.state)
    built = driven.entering(entry).through(Step.STRUCTURE, effects, applied)
    return built.entering(_posed(built.state, built.state)).through(Step.STRUCTURE, (), applied)


def _posed(state: State, target: State) -> State:
    """Return the target with the pose that the legs of ``state`` lead to."""
    reached = forward(state.legs, state.rho, state.delta_bz)
    return replace(target, p=reached.p, R=reached.R, converged=reached.converged)


def propagated(change: Change, subsequent: Sequence[EffectAtState]) -> Change:
    """Add the responses of subsequent effects, in their order, to a change."""
    fields = dict(change.fields)
    for effect, state in subsequent:
        for name, slope in _effect_response(effect, state, fields, change.size).items():
            fields[name] = fields.get(name, 0.0) + slope
    return Change(fields, change.size)


def structure_response(forward_pass: ForwardPass, change: Change) -> tuple[Change, NDArray]:
    """Return a change at the end of the structure, with the response to the pose's motion, and the exact twist (B,
    6, P)."""
    twist = _twist(forward_pass.state, change)
    if not forward_pass.pose_response.fields:
        return change, twist
    answer = forward_pass.pose_response
    twist = np.linalg.solve(np.eye(6) - _twist(forward_pass.state, answer), twist)
    fields = dict(change.fields)
    for name, slope in answer.fields.items():
        fields[name] = fields.get(name, 0.0) + np.einsum("b...q,bqp->b...p", slope, twist)
    return Change(fields, change.size), twist


def _twist(state: State, change: Change) -> NDArray:
    return pose_change(state.legs, state.p, state.R, state.rho, state.delta_bz, change)


def moved_by_shape(subsequent: Sequence[EffectAtState], shape: tuple[int, ...]) -> NDArray:
    """Return the derivative of `moved` by each target's own shape, an array (B, K, 3, 3) of the given shape."""
    total = np.zeros(shape)
    for effect, state in subsequent:
        if "shape" in effect.cause.reads:
            for axis, nudge in enumerate(1j * _TINY * np.eye(3)):
                shift = effect.cause.shift(replace(state, shape=state.shape + nudge), effect.values).get("moved")
                total[..., axis] += 0.0 if shift is None else shift.imag / _TINY
    return total


def _effect_response(
    effect: Effect[PointCause], state: State, fields: Mapping[str, NDArray], size: int
) -> dict[str, NDArray]:
    """Return the derivatives (B, ..., P) of an effect's shift when the fields that it reads change; by complex step."""
    reads = effect.cause.reads | ({"p", "R"} if POSE in effect.cause.reads else set())
    driven = {name: slope for name, slope in fields.items() if name in reads}
    if not driven:
        return {}
    poses = len(state.rho)
    shifts = effect.cause.shift(_nudged(state, driven, size), effect.values)
    return {
        name: np.moveaxis(
            np.broadcast_to(shift.imag / _TINY, (size * poses, *shift.shape[1:])).reshape(
                size, poses, *shift.shape[1:]
            ),
            0,
            -1,
        )
        for name, shift in shifts.items()
        if np.iscomplexobj(shift)
    }


def _nudged(state: State, driven: Mapping[str, NDArray], size: int) -> State:
    """Return ``size`` copies of the B poses of a state, one after the other, with tiny imaginary parts of its
    fields."""
    poses = len(state.rho)

    def copies(array: NDArray, slope: NDArray | None = None) -> NDArray:
        many = np.broadcast_to(array, (size, poses, *array.shape[1:]))
        if slope is not None:
            many = many + 1j * _TINY * np.moveaxis(slope, -1, 0)
        return many.reshape(size * poses, *many.shape[2:])

    posed = ("p", "R") if len(state.p) else ()
    nudged: dict[str, Any] = {
        name: copies(getattr(state, name), driven.get(name)) for name in ("indicated", "rho", "delta_bz", *posed)
    }
    nudged |= {name: copies(getattr(state, name)[None], driven[name]) for name in REFERENCE if name in driven}
    joints = {}
    for name in _OF_LEGS:
        array, rank = getattr(state.legs, name), 1 if name == "l" else 2
        if name in driven or array.ndim > rank:
            joints[name] = copies(array if array.ndim > rank else array[None], driven.get(name))
    covariates = {name: copies(value) for name, value in state.covariates.items()}
    return replace(state, **nudged, covariates=covariates, legs=state.legs.replace(**joints))
