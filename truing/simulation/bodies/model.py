"""Class `BodyModel`: points of bodies without a mechanism as a function of the unknowns, with exact derivatives.

The pose of such a body is fitted; the model only states that its targets keep their positions on it. A body that stands
still has one pose for the campaign, except for the jitter of the instrument; the frame of the measurement is then one
frame too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Mask
from truing.estimation.rotation import exp_so3, left_jacobian_so3, rigid_motions
from truing.simulation.cause import OBSERVED, Step
from truing.simulation.effects_model import Prediction
from truing.simulation.mechanisms.forward_pass import ForwardPass, moved_by_shape
from truing.simulation.mechanisms.legs.closures import Closure, Legs
from truing.simulation.mechanisms.point_causes import PointCause, PointScene, applied
from truing.simulation.mechanisms.recording import (
    FROM_PHOTOGRAPHS,
    Conditions,
    LegFrames,
    RecordedModel,
    Recording,
    designs,
    record,
)
from truing.simulation.mechanisms.state import State
from truing.simulation.targets import FREE_ANGLE_RAD, FREE_LENGTH_M, ShapeUnknowns

# First number of bodies without a mechanism: causes on base, platform or legs do not apply to them.
FIRST_BODY = 3
_POSE = 6
_FREE_POSE = np.diag([FREE_LENGTH_M] * 3 + [FREE_ANGLE_RAD] * 3)
_NOT_MOVED = np.zeros((1, 0, 3, 0))
_NO_LEGS = Legs(np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3)), np.empty(0), np.empty(0), Closure())
_NO_FRAMES = LegFrames(np.empty((0, 0, 3)), np.empty((0, 0, 3, 3)), np.empty((0, 0, 3)))


@dataclass(frozen=True)
class BodyConditions(Conditions):
    """Data of each pose, and start values R (B, N, 3, 3), t (B, N, 3) of the poses of N bodies.

    R and t lead from the body's frame to the model's, m; ``readings`` is (B, 0). ``level`` (B, N) numbers the places of
    a body that stands still: one, or one for every combination of the drives that move it.
    """

    R: NDArray = field(default_factory=lambda: np.empty((0, 0, 3, 3)))
    t: NDArray = field(default_factory=lambda: np.empty((0, 0, 3)))
    level: NDArray = field(default_factory=lambda: np.empty((0, 0), int))

    def subset(self, rows: Mask) -> Self:
        """Return the conditions at some poses (mask B)."""
        return replace(
            self,
            readings=self.readings[rows],
            covariates={name: values[rows] for name, values in self.covariates.items()},
            poses=tuple(pose for pose, is_kept in zip(self.poses, rows, strict=True) if is_kept),
            R=self.R[rows],
            t=self.t[rows],
            level=self.level[rows],
            input_factor=None if self.input_factor is None else self.input_factor[rows],
        )


@dataclass(frozen=True)
class KnownBodies:
    """Prior knowledge of N bodies and their K targets; m and rad.

    ``shape`` (K, 3) in the bodies' frames, with its unknown errors ``survey``; ``surveyed`` (W,) marks those whose
    prior is knowledge, not a wide default. ``levels`` (N,) is the number of places of a still body, 0 for others;
    ``jitter`` (N, 6, 6) is a square root of the covariance of its pose (shift of the targets' centre, then rotation).
    ``lead`` is the body whose frame the model uses in every pose; -1 if the measurement has one frame for the campaign.
    """

    shape: NDArray
    survey: ShapeUnknowns
    surveyed: NDArray
    levels: NDArray
    jitter: NDArray
    lead: int
    drives: tuple[str, ...] = ()
    placed: tuple[str, ...] = ()
    reference_temperature_c: float = 20.0

    @property
    def is_stationary(self) -> NDArray:
        """Mask (N,) of the bodies that stand still."""
        return np.asarray(self.levels > 0)


@dataclass(frozen=True)
class BodyModel(RecordedModel):
    """Bodies with their targets, as a function of the unknowns for a set of effects."""

    conditions: BodyConditions
    known: KnownBodies

    nominal = _NO_LEGS

    @cached_property
    def channel_groups(self) -> NDArray:
        """Number (K,) of each target's body."""
        return self.targets.body - FIRST_BODY

    @property
    def _sizes(self) -> dict[str, int]:
        sizes = {"shape": self.known.survey.modes.shape[-1], "seat": _POSE * int(self.known.levels.sum())}
        return sizes | self._common_sizes

    @cached_property
    def _local(self) -> dict[int, slice]:
        """Slice of each body's pose among the local unknowns; bodies that stand still come first."""
        order = [*np.flatnonzero(self.known.is_stationary), *np.flatnonzero(~self.known.is_stationary)]
        fitted = [int(body) for body in order if body != self.known.lead]
        return {body: slice(_POSE * n, _POSE * (n + 1)) for n, body in enumerate(fitted)}

    @property
    def local_size(self) -> int:
        """Number of local unknowns H: six for each body except the leading one, then common errors of photographs."""
        return _POSE * len(self._local) + self._pose_size

    @property
    def unpredicted(self) -> NDArray:
        """Mask (H,) of the local unknowns that the model does not predict: poses of bodies that do not stand still."""
        return np.arange(self.local_size) >= _POSE * int(self.known.is_stationary.sum())

    @property
    def blocks(self) -> NDArray | None:
        """None: no block of poses can be left out, because effects of time and drives would have to be extrapolated."""
        return None

    @property
    def scene(self) -> PointScene:
        """Scene from which causes propose candidates."""
        conditions = self.conditions
        return PointScene(
            self.targets,
            self.known.shape,
            conditions.readings,
            np.empty(0),
            conditions.poses,
            conditions.covariates,
            conditions.span_s,
            self.known.reference_temperature_c,
            drives=self.known.drives,
            placed=self.known.placed,
            still=tuple(self._name(int(body)) for body in np.flatnonzero(self.known.is_stationary)),
            photographed=self.photographed,
        )

    def rescaled(self, readings: float, survey: float) -> Self:
        """Return the model with the jitter and the survey's noise multiplied by factors."""
        factors = np.where(self.known.surveyed, survey, 1.0)
        modes = replace(self.known.survey, modes=self.known.survey.modes * factors)
        return replace(self, known=replace(self.known, survey=modes, jitter=self.known.jitter * readings))

    @property
    def input_scale(self) -> NDArray:
        """Prior sigma of the shift of each still body, for each component of its pose (H,), m."""
        jitter = self.known.jitter[self.known.is_stationary]
        return np.repeat(np.sqrt(np.sum(jitter[:, :3] ** 2, (1, 2)) / 3), _POSE)

    def with_input_factor(self, factor: NDArray) -> Self:
        """Return the model with the jitter of still bodies multiplied by factors (B, H)."""
        return replace(self, conditions=replace(self.conditions, input_factor=factor))

    def _jittered(self, body: int) -> NDArray:
        """Return the factor (B, 6), or (1, 6), of the prior sigmas of a body's pose."""
        factor = self.conditions.input_factor
        return (
            np.ones((1, _POSE))
            if factor is None or not self.known.is_stationary[body]
            else factor[:, self._local[body]]
        )

    def predict(self, shared: NDArray, local: NDArray, by_shared: bool = True) -> Prediction:
        """Return points and derivatives at shared (G,) and local (B, H) unknowns; by the shared ones on request."""
        recording = self.recording(shared, local)
        by_local = np.zeros((*recording.state.points.shape, self.local_size))
        for body, channels, slope in self._by_pose(shared, local, recording):
            if body in self._local:
                factor = self._pose_factor(body) * self._jittered(body)[:, None]
                by_local[:, channels, :, self._local[body]] = slope @ factor[:, None]
        by_local = recording.recorded(by_local)
        self._fill_pose_errors(by_local)
        slopes = self._by_shared(shared, local, recording) if by_shared else None
        return self._prediction(shared, self._with_errors(recording.state.points, shared, local), slopes, by_local)

    def _by_shared(self, shared: NDArray, local: NDArray, recording: Recording) -> NDArray:
        """Return the points' derivatives (B, K, 3, G) by the shared unknowns."""
        slopes = np.zeros((*recording.state.points.shape, self.shared_size))
        turn = recording.state.turn
        follows = moved_by_shape(recording.forward_pass.before_recording(), turn.shape)
        slopes[..., self.layout["shape"]] = (turn + turn @ follows) @ self.known.survey.modes
        for body, channels, slope in self._by_pose(shared, local, recording):
            for level in range(self.known.levels[body]):
                there = (self.conditions.level[:, body] == level)[:, None, None, None]
                slopes[:, channels, :, self._pose_slice(body, level)] = np.where(there, slope @ _FREE_POSE, 0.0)
        self._fill_structure(slopes, shared, recording)
        slopes = recording.recorded(slopes)
        self._fill_instruments(slopes, shared, recording)
        self._fill_common(slopes)
        return slopes

    def pathways(self, shared: NDArray, local: NDArray) -> dict[str, NDArray]:
        """Return no pathway: effects on bodies move their points directly."""
        return {}

    def design_matrix(self, shared: NDArray, local: NDArray) -> Callable[[PointCause], dict[str, NDArray]]:
        """Return the function from a cause to its change of the pathway ``observed``, (B or 1, 3 K, P), per
        plausible scale."""
        recording = self.recording(shared, local)

        def found(cause: PointCause) -> dict[str, NDArray]:
            reported = designs(recording, cause, self.effect_scale(cause))
            return {name: design for name, design in reported.items() if name == OBSERVED}

        return found

    @property
    def _shared_known(self) -> NDArray:
        known = np.zeros(self.shared_size, bool)
        known[self.layout["shape"]] = self.known.surveyed
        known[self.layout.get(FROM_PHOTOGRAPHS, slice(0))] = True
        return known

    def _name(self, body: int) -> str:
        return self.targets.bodies[int(np.flatnonzero(self.channel_groups == body)[0])]

    def _pose_slice(self, body: int, level: int = 0) -> slice:
        first = self.layout["seat"].start + _POSE * (int(self.known.levels[:body].sum()) + level)
        return slice(first, first + _POSE)

    def _pose_factor(self, body: int) -> NDArray:
        return np.asarray(self.known.jitter[body]) if self.known.is_stationary[body] else _FREE_POSE

    def _pose(self, body: int, shared: NDArray, local: NDArray) -> NDArray:
        """Return the deviation (B, 6) of a body's pose from its start value: shift of its centre, rotation vector."""
        pose = np.zeros((len(self.conditions.t), _POSE), np.result_type(shared, local))
        if body in self._local:
            pose = pose + (local[:, self._local[body]] * self._jittered(body)) @ self._pose_factor(body).T
        if self.known.is_stationary[body]:
            levels = int(self.known.levels[body])
            first = self._pose_slice(body).start
            seats = shared[first : first + _POSE * levels].reshape(levels, _POSE) @ _FREE_POSE
            pose = pose + seats[self.conditions.level[:, body]]
        return pose

    @cached_property
    def _centres(self) -> NDArray:
        """Mean position (N, 3) of each body's targets in its frame."""
        in_group = (self.channel_groups == body for body in range(len(self.known.levels)))
        return np.stack([self.known.shape[there].mean(0) for there in in_group])

    def _recording(self, shared: NDArray, local: NDArray) -> Recording:
        """Return the recorded points of the bodies with the effects in force."""
        forward_pass = self._forward_pass(shared)
        positions = self._target_positions(forward_pass)
        kind = np.result_type(positions, shared, local)
        points, turn = np.empty(positions.shape, kind), np.empty((*positions.shape, 3), kind)
        for body, centre in enumerate(self._centres):
            channels, pose = self.channel_groups == body, self._pose(body, shared, local)
            start = self.conditions.R[:, body]
            R = exp_so3(pose[:, 3:]) @ start
            middle = self.conditions.t[:, body] + start @ centre + pose[:, :3]
            points[:, channels] = middle[:, None] + (positions[:, channels] - centre) @ np.swapaxes(R, -1, -2)
            turn[:, channels] = R[:, None]
        return record(forward_pass, self.targets, _NO_FRAMES, self.effects(shared), points, turn)

    def _forward_pass(self, shared: NDArray) -> ForwardPass:
        """Return the forward pass with the targets' shape and displacements on their bodies."""
        none = self.conditions.readings
        shape = self.known.shape + self.known.survey.modes @ shared[self.layout["shape"]]
        state = State(
            _NO_LEGS,
            none,
            none,
            indicated=none,
            covariates=self.conditions.covariates,
            targets=self.targets,
            shape=shape,
            moved=np.zeros((1, *shape.shape)),
            reference_temperature_c=self.known.reference_temperature_c,
        )
        return ForwardPass(state, (), {}).through(Step.STRUCTURE, self.effects(shared), applied)

    def _target_positions(self, forward_pass: ForwardPass) -> NDArray:
        """Return the positions (B, K, 3) of the targets in the frames of their bodies."""
        state = forward_pass.state
        return np.broadcast_to(state.shape + state.moved, (len(self.conditions.t), *state.shape.shape))

    def _by_pose(self, shared: NDArray, local: NDArray, recording: Recording) -> Iterator[tuple[int, NDArray, NDArray]]:
        """Yield each body, its targets, and their derivatives (B, k, 3, 6) by a shift and a rotation vector of its
        pose."""
        turn, points = recording.state.turn, self._target_positions(recording.forward_pass)
        for body, centre in enumerate(self._centres):
            channels = self.channel_groups == body
            arms = np.einsum("bkij,bkj->bki", turn[:, channels], points[:, channels] - centre)
            jacobian = left_jacobian_so3(self._pose(body, shared, local)[:, 3:])
            slope = rigid_motions(arms)
            slope[..., 3:] = slope[..., 3:] @ jacobian[:, None]
            yield body, channels, slope

    def _fill_structure(self, by_shared: NDArray, shared: NDArray, recording: Recording) -> None:
        for effect in self.effects(shared):
            cause = effect.cause
            if cause.step is Step.STRUCTURE and len(effect.values):
                slope = cause.change(recording.forward_pass.at(cause), effect.values).fields.get("moved", _NOT_MOVED)
                indices = np.flatnonzero(np.any(slope != 0.0, (0, 2, 3)))  # few targets of many
                motion = recording.state.turn[:, indices] @ (slope[:, indices] * self.effect_sigma(cause))
                by_shared[:, indices, :, self.layout[cause.key]] = motion
