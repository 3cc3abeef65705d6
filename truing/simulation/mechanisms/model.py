"""Class `MechanismModel`: points of all bodies and poses as a function of the unknowns, with exact derivatives."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import exp_so3, left_jacobian_so3, skew
from truing.inference.model import ErrorPathway
from truing.simulation.cause import Step
from truing.simulation.change import Change
from truing.simulation.effects_model import Prediction
from truing.simulation.inputs import gravity_column, ranks
from truing.simulation.mechanisms.forward_pass import (
    REFERENCE,
    ForwardPass,
    moved_by_shape,
    pass_through,
    propagated,
    simulate,
    structure_response,
)
from truing.simulation.mechanisms.legs.closures import Legs
from truing.simulation.mechanisms.legs.kinematics import (
    reference_change,
    reference_pose,
    unit,
)
from truing.simulation.mechanisms.point_causes import PointCause, PointScene
from truing.simulation.mechanisms.recording import (
    LegFrames,
    RecordedModel,
    Recording,
    designs,
    leg_frames,
    positions,
    record,
    target_rotations,
)
from truing.simulation.mechanisms.state import State
from truing.simulation.mechanisms.weight import Weight, platform_gravity
from truing.simulation.targets import FREE_ANGLE_RAD, FREE_LENGTH_M, LEG, ShapeUnknowns


@dataclass(frozen=True)
class PriorKnowledge:
    """Prior knowledge of a mechanism and its targets; standard deviations in m and rad.

    ``geometry`` gives the sigma of a, b, u, l (0: exact, so no unknown). ``shape`` (K, 3) is the survey in the bodies'
    frames and ``survey`` its unknown errors. ``carrying_legs`` are the legs that carry targets; ``seat_rotation``
    (L, 3, 3) and ``seat`` (L, 3) place each leg's survey frame on the leg in its nominal direction, as start values.
    ``pitch_m`` of the leadscrews, ``flexure_length_m`` and ``weight`` are None if unknown.
    """

    geometry: dict[str, float]
    shape: NDArray
    survey: ShapeUnknowns
    reading_sigma: float
    carrying_legs: NDArray
    seat_rotation: NDArray
    seat: NDArray
    open_geometry: tuple[str, ...] = ()  # of a, b, u, l: those without tolerance, whose sigma is a wide default
    reference_temperature_c: float = 20.0
    pitch_m: float | None = None
    flexure_length_m: float | None = None
    weight: Weight | None = None


@dataclass(frozen=True)
class MechanismModel(RecordedModel):
    """A mechanism with its targets and readings, as a function of the unknowns for a set of effects.

    Unknowns are in standard deviations of their priors, so that a value is a pull. Shared unknowns: geometry, shape of
    the bodies, position of each leg's survey frame, effects. Unknowns of each pose: actuators, rolls of legs.
    """

    nominal: Legs
    known: PriorKnowledge

    @cached_property
    def nominal_direction(self) -> NDArray:
        """Directions (L, 3) of the legs in the nominal reference configuration."""
        return reference_pose(self.nominal).z[0]

    @property
    def _sizes(self) -> dict[str, int]:
        count = self.nominal.count
        sizes = {"a": 3 * count, "b": 3 * count, "u": 2 * count, "l": count}
        sizes = {name: size for name, size in sizes.items() if self.known.geometry.get(name, 0.0) > 0}
        sizes |= {"shape": self.known.survey.modes.shape[-1], "seat": 6 * len(self.known.carrying_legs)}
        return sizes | self._common_sizes

    @property
    def local_size(self) -> int:
        """Number of local unknowns H: actuators (unless exact), rolls, then common errors of photographs."""
        return self._rolls.stop + self._pose_size

    @property
    def _rolls(self) -> slice:
        """Slice of the rolls among the local unknowns."""
        first = self.nominal.count * (self.known.reading_sigma > 0)
        return slice(first, first + len(self.known.carrying_legs))

    @property
    def unpredicted(self) -> NDArray:
        """Mask (H,) of the local unknowns that the mechanism does not predict: rolls of legs, errors of photographs."""
        return np.arange(self.local_size) >= self._rolls.start

    @property
    def part_count(self) -> int:
        """Number of legs L."""
        return self.nominal.count

    @property
    def channel_groups(self) -> NDArray:
        """Number (K,) of each target's body: base, platform, then the legs."""
        return self.targets.body + np.where(self.targets.body == LEG, self.targets.leg, 0)

    def rescaled(self, readings: float, survey: float) -> Self:
        """Return the model with the noise of the readings and of the survey multiplied by factors."""
        surveyed = self.known.survey
        scaled = ShapeUnknowns(surveyed.modes * survey, surveyed.attachment_factor * survey)
        return replace(
            self, known=replace(self.known, survey=scaled, reading_sigma=self.known.reading_sigma * readings)
        )

    @property
    def input_scale(self) -> NDArray:
        """Prior sigma of each reading (L,), m; empty if readings are exact."""
        return np.full(self._rolls.start, self.known.reading_sigma)

    @property
    def error_pathways(self) -> tuple[ErrorPathway, ...]:
        """Directions of errors of the actuators' displacements."""
        legs = range(self.nominal.count)
        return tuple(ErrorPathway("rho", leg, f"leg{leg + 1}", f"rho{leg + 1}_mm") for leg in legs)

    def with_input_factor(self, factor: NDArray) -> Self:
        """Return the model with the prior sigmas of the readings multiplied by factors (B, L)."""
        return replace(self, conditions=replace(self.conditions, input_factor=factor))

    @property
    def _reading_sigma(self) -> tuple[NDArray, NDArray]:
        """Sigma of the actuators' true positions and of the reading errors, (B, L) or (), m per unknown.

        Scatter beyond the readings' noise is no reading error: effects depend on the reading.
        """
        factor, sigma = self.conditions.input_factor, self.known.reading_sigma
        return (np.asarray(sigma), np.asarray(sigma)) if factor is None else (sigma * factor, sigma / factor)

    def legs(self, shared: NDArray) -> Legs:
        """Return the geometry at shared unknowns (G,)."""
        count, legs = self.nominal.count, self.nominal
        moved: dict[str, NDArray] = {
            name: getattr(legs, name) + self._part(shared, name).reshape(count, -1) * self.known.geometry[name]
            for name in ("a", "b")
            if name in self.layout
        }
        if "l" in self.layout:
            moved["l"] = legs.l + self._part(shared, "l") * self.known.geometry["l"]
        if "u" in self.layout:
            moved["u"] = unit(self._tilted(shared))
        return legs.replace(**moved)

    def shape(self, shared: NDArray) -> NDArray:
        """Return the positions (K, 3) of targets relative to the bodies' origins, along the axes of their surveys."""
        shape = self.known.shape + self.known.survey.modes @ self._part(shared, "shape")
        rotation, offset = self._seat_of_legs(shared)
        on_leg = self.targets.body == LEG
        carrying_legs = self.targets.leg[on_leg]
        shape[on_leg] += np.einsum("kji,kj->ki", rotation[carrying_legs], offset[carrying_legs])
        return shape

    def unknowns(self, legs: Legs, effects: dict[str, NDArray]) -> NDArray:
        """Return the shared unknowns (G,) for a geometry and values of the effects."""
        shared = np.zeros(self.shared_size)
        for name in ("a", "b", "l"):
            if name in self.layout:
                gap = getattr(legs, name) - getattr(self.nominal, name)
                shared[self.layout[name]] = gap.ravel() / self.known.geometry[name]
        if "u" in self.layout:
            ahead = np.sum(legs.u * self.nominal.u, -1)[:, None]
            tilt = np.einsum("lij,li->lj", self.transverse_directions, legs.u / ahead)
            shared[self.layout["u"]] = tilt.ravel() / self.known.geometry["u"]
        for cause in self.causes:
            shared[self.layout[cause.key]] = effects[cause.key] / self.effect_sigma(cause)
        return shared

    @property
    def _shared_known(self) -> NDArray:
        known = np.ones(self.shared_size, bool)
        for name in ("seat", *self.known.open_geometry, *(cause.key for cause in self.causes)):
            known[self.layout[name]] = False
        return known

    def _part(self, shared: NDArray, name: str) -> NDArray:
        return shared[self.layout[name]]

    def _actuators(self, local: NDArray) -> NDArray:
        exact = self.known.reading_sigma == 0
        return np.zeros_like(self.conditions.readings) if exact else local[:, : self.nominal.count]

    @cached_property
    def transverse_directions(self) -> NDArray:
        """Two directions (L, 3, 2) across each nominal actuator; the first is closest to the axis of its smallest
        component."""
        u = self.nominal.u
        axis = np.eye(3)[np.argmin(np.abs(u), -1)]
        first = unit(axis - u * np.sum(u * axis, -1)[:, None])
        return np.stack([first, np.cross(u, first)], -1)

    def _tilted(self, shared: NDArray) -> NDArray:
        pulls = self._part(shared, "u").reshape(-1, 2) * self.known.geometry["u"]
        return self.nominal.u + np.einsum("lij,lj->li", self.transverse_directions, pulls)

    def geometry_changes(self, shared: NDArray) -> list[tuple[str, Change]]:
        """Return the derivative of the geometry by its unknowns: part of the layout, and change per prior sigma."""
        count, sigma, layout = self.nominal.count, self.known.geometry, self.layout
        identity = np.eye(3 * count).reshape(1, count, 3, 3 * count)
        changes: list[tuple[str, Change]] = []
        changes += [(name, Change({name: identity * sigma[name]}, 3 * count)) for name in ("a", "b") if name in layout]
        if "u" in layout:
            changes.append(("u", Change({"u": self._direction_change(shared)[None]}, 2 * count)))
        if "l" in layout:
            changes.append(("l", Change({"l": np.eye(count)[None] * sigma["l"]}, count)))
        return changes

    def _direction_change(self, shared: NDArray) -> NDArray:
        """Return the derivative (L, 3, 2L) of the actuators' unit directions."""
        tilted = self._tilted(shared)
        u, length = unit(tilted), np.sqrt(np.sum(tilted * tilted, -1))[:, None, None]
        derivative = (
            self.transverse_directions - u[..., None] * np.einsum("li,lij->lj", u, self.transverse_directions)[:, None]
        ) / length
        spread = np.einsum("lij,lm->limj", derivative, np.eye(len(u)))
        return spread.reshape(len(u), 3, -1) * self.known.geometry["u"]

    def _seat_of_legs(self, shared: NDArray) -> tuple[NDArray, NDArray]:
        rotation, offset = self.known.seat_rotation.astype(shared.dtype), self.known.seat.astype(shared.dtype)
        pulls = self._part(shared, "seat").reshape(-1, 6)
        rotation[self.known.carrying_legs] = exp_so3(pulls[:, 3:] * FREE_ANGLE_RAD) @ rotation[self.known.carrying_legs]
        offset[self.known.carrying_legs] += pulls[:, :3] * FREE_LENGTH_M
        return rotation, offset

    def scale_of(self, name: str) -> NDArray:
        """Return the SI value of one unit of the unknowns of a part of the layout, geometry or effect: (n,) or ()."""
        if name in self.known.geometry:
            return np.asarray(self.known.geometry[name])
        return super().scale_of(name)

    def _known_rows(self, shared: NDArray) -> tuple[NDArray, NDArray]:
        """Return the knowledge of survey and prior campaign as whitened residuals and derivatives."""
        residuals, derivatives = zip(self.survey_rows(shared), super()._known_rows(shared), strict=True)
        return np.concatenate(residuals), np.concatenate(derivatives)

    def survey_rows(self, shared: NDArray) -> tuple[NDArray, NDArray]:
        """Return the survey of targets on attachments as whitened residuals and derivatives of b."""
        indices = np.flatnonzero(self.targets.at_attachment)
        carrying_legs, factor = self.targets.leg[indices], self.known.survey.attachment_factor
        gap = self.known.shape[indices] - self.legs(shared).b[carrying_legs]
        derivative = np.zeros((len(indices), 3, self.shared_size))
        if "b" in self.layout:
            sigma, first = self.known.geometry["b"], self.layout["b"].start
            for axis in range(3):
                derivative[np.arange(len(indices)), axis, first + 3 * carrying_legs + axis] = sigma
        return np.linalg.solve(factor, gap.ravel()), np.linalg.solve(
            factor, derivative.reshape(3 * len(indices), self.shared_size)
        )

    @property
    def blocks(self) -> NDArray | None:
        """Ranks (B,) of the poses in time: any pose can be left out of a fit."""
        poses = len(self.conditions.readings)
        order = self.conditions.covariates.get("order", np.arange(poses))
        return ranks(order)

    @property
    def scene(self) -> PointScene:
        """Scene from which causes propose candidates."""
        known, conditions = self.known, self.conditions
        covariates = dict(conditions.covariates)
        if known.weight is not None:
            down = platform_gravity(self.nominal, conditions.readings, known.weight.up)
            covariates[gravity_column("platform")] = down
        return PointScene(
            self.targets,
            known.shape,
            conditions.readings,
            self.nominal.rho0,
            conditions.poses,
            covariates,
            conditions.span_s,
            known.reference_temperature_c,
            known.pitch_m,
            known.flexure_length_m,
            lengths_apart="u" in self.nominal.closure.geometry,
            weight=known.weight,
            photographed=self.photographed,
        )

    def state(self, shared: NDArray, local: NDArray) -> State:
        """Return the state of the chain before the instrument, at shared (G,) and local (B, H) unknowns."""
        return self._forward_pass(shared, local).state

    def predict(self, shared: NDArray, local: NDArray, by_shared: bool = True) -> Prediction:
        """Return points and derivatives at shared (G,) and local (B, H) unknowns; by the shared ones on request."""
        recording = self.recording(shared, local)
        points = self._with_errors(recording.state.points, shared, local)
        slopes = self._by_shared(shared, recording) if by_shared else None
        return self._prediction(shared, points, slopes, self._by_local(recording))

    def _by_shared(self, shared: NDArray, recording: Recording) -> NDArray:
        """Return the points' derivatives (B, K, 3, G) by the shared unknowns."""
        slopes = np.zeros((*recording.state.points.shape, self.shared_size))
        for part, change, cause in self._changes(shared, recording):
            subsequent = recording.forward_pass.before_recording(cause)
            slopes[..., part] = recording.motion(change, subsequent)
        self._fill_shape(slopes, shared, recording)
        slopes = recording.recorded(slopes)
        self._fill_instruments(slopes, shared, recording)
        self._fill_common(slopes)
        return slopes

    def _by_local(self, recording: Recording) -> NDArray:
        """Return the points' derivatives (B, K, 3, H) by the local unknowns."""
        slopes = np.zeros((*recording.state.points.shape, self.local_size))
        if (reading := self._reading_change) is not None:
            slopes[..., : reading.size] = recording.motion(reading, recording.forward_pass.before_recording())
        self._fill_rolls(slopes, recording)
        slopes = recording.recorded(slopes)
        self._fill_pose_errors(slopes)
        return slopes

    def pathways(self, shared: NDArray, local: NDArray) -> dict[str, NDArray]:
        """Return the derivatives (B, K, 3, n) of recorded points, m, by each pathway of causes, per SI unit.

        Pathways: ``rho``, ``l``, ``delta_bz`` (n = L), and a, b, u (n = 3 L, leg by leg); those that the closure has. A
        cause on a pathway acts after all effects in force of its step: drive for rho, structure for the others.
        """
        recording, count = self.recording(shared, local), self.nominal.count
        structure = recording.forward_pass.subsequent_effects(None, Step.STRUCTURE)
        derivatives = {}
        for name in ("rho", "delta_bz", *self.nominal.closure.geometry):
            shape = (1, count, 3) if name in "abu" else (1, count)
            size = int(np.prod(shape))
            change = Change({name: np.eye(size).reshape(*shape, size)}, size)
            derivatives[name] = recording.recorded(recording.motion(change, structure if name == "rho" else ()))
        return derivatives

    def design_matrix(self, shared: NDArray, local: NDArray) -> Callable[[PointCause], dict[str, NDArray]]:
        """Return the function from a cause to its change of each pathway, (B or 1, n, P), per plausible scale.

        Moved targets are on the pathway ``observed``, n = 3 K, whose derivative is the identity.
        """
        recording = self.recording(shared, local)
        return lambda cause: designs(recording, cause, self.effect_scale(cause))

    def pose_derivatives(self, shared: NDArray, local: NDArray) -> tuple[NDArray, NDArray]:
        """Return the platform's twist per shared (B, 6, G) and per local (B, 6, H) unknown."""
        recording = self.recording(shared, local)
        forward_pass = recording.forward_pass
        by_shared = np.zeros((len(forward_pass.state.rho), 6, self.shared_size))
        by_local = np.zeros((len(forward_pass.state.rho), 6, self.local_size))
        for part, change, cause in self._changes(shared, recording):
            subsequent = forward_pass.before_recording(cause)
            by_shared[..., part] = structure_response(forward_pass, propagated(change, subsequent))[1]
        if (reading := self._reading_change) is not None:
            by_local[..., : reading.size] = structure_response(
                forward_pass, propagated(reading, forward_pass.before_recording())
            )[1]
        return by_shared, by_local

    def _forward_pass(self, shared: NDArray, local: NDArray) -> ForwardPass:
        """Pass the readings through drive and structure."""
        stands, read = (self.conditions.readings + self._actuators(local) * sigma for sigma in self._reading_sigma)
        shape, legs = self.shape(shared), self.legs(shared)
        reference = reference_pose(legs)
        start = State(
            legs,
            stands,
            np.zeros_like(stands),
            indicated=read,
            covariates=self.conditions.covariates,
            targets=self.targets,
            shape=shape,
            moved=np.zeros((1, *shape.shape)),
            reference_temperature_c=self.known.reference_temperature_c,
            nominal_direction=self.nominal_direction,
            reference_direction=reference.z[0],
            reference_rotation=reference.R[0],
        )
        return pass_through(start, self.effects(shared))

    def _recording(self, shared: NDArray, local: NDArray) -> Recording:
        forward_pass = self._forward_pass(shared, local)
        roll = np.zeros(self.conditions.readings.shape, local.dtype)
        roll[:, self.known.carrying_legs] = local[:, self._rolls] * FREE_ANGLE_RAD
        frames = leg_frames(forward_pass.state, self.nominal_direction, roll, self._seat_of_legs(shared)[0])
        state = forward_pass.state
        points, turn = positions(state, self.targets, frames), target_rotations(state, self.targets, frames)
        return record(forward_pass, self.targets, frames, self.effects(shared), points, turn)

    def _changes(self, shared: NDArray, recording: Recording) -> Iterator[tuple[slice, Change, PointCause | None]]:
        """Yield every change upstream of the instrument by shared unknowns: slice of these, change, cause."""
        for name, change in self.geometry_changes(shared):
            yield self.layout[name], self._with_reference(shared, change), None
        for effect in self.effects(shared):
            cause = effect.cause
            if cause.step is not Step.INSTRUMENT:
                change = cause.change(recording.forward_pass.at(cause), effect.values)
                scaled = {name: slope * self.effect_sigma(cause) for name, slope in change.fields.items()}
                yield self.layout[cause.key], Change(scaled, change.size), cause

    @property
    def _reading_change(self) -> Change | None:
        """Change by the local unknowns, which are errors of the readings; None if readings are exact."""
        if self.known.reading_sigma <= 0:
            return None
        count = self.nominal.count
        stands, read = (np.eye(count)[None] * sigma[..., None] for sigma in self._reading_sigma)
        return Change({"indicated": read, "rho": stands}, count)

    def _with_reference(self, shared: NDArray, change: Change) -> Change:
        """Add the change of the reference pose to a change of the geometry, if an effect depends on the reference
        pose."""
        if not any(cause.reads.intersection(REFERENCE) for cause in self.causes):
            return change
        legs = self.legs(shared)
        reference = reference_pose(legs)
        moved = reference_change(legs, reference, change)
        turned = np.einsum("aij,bjk,bap->bikp", skew(np.eye(3)), reference.R, moved.twist[:, 3:])
        return Change({**change.fields, "reference_direction": moved.z, "reference_rotation": turned}, change.size)

    def _fill_shape(self, by_shared: NDArray, shared: NDArray, recording: Recording) -> None:
        """Fill the derivatives by the bodies' shapes and by the positions of the legs' survey frames."""
        turn = recording.state.turn
        follows = turn @ moved_by_shape(recording.forward_pass.before_recording(), turn.shape)
        by_shared[..., self.layout["shape"]] = (turn + follows) @ self.known.survey.modes
        seat_rotation, offset = self._seat_of_legs(shared)
        pulls = self._part(shared, "seat").reshape(-1, 6)
        jacobian = left_jacobian_so3(pulls[:, 3:] * FREE_ANGLE_RAD) * FREE_ANGLE_RAD
        for index, leg in enumerate(self.known.carrying_legs):
            of_leg, seat = self._targets_of_leg(leg), seat_rotation[leg]
            first = self.layout["seat"].start + 6 * index
            seated = turn[:, of_leg] @ seat.T
            pushed = follows[:, of_leg] @ seat.T
            arms = self._arms(recording.state, of_leg) @ seat.T - offset[leg]
            turned = (pushed @ skew(offset[leg]) - seated @ skew(arms)) @ jacobian[index]
            by_shared[:, of_leg, :, first : first + 3] = (seated + pushed) * FREE_LENGTH_M
            by_shared[:, of_leg, :, first + 3 : first + 6] = turned

    def _fill_rolls(self, by_local: NDArray, recording: Recording) -> None:
        first = self._rolls.start
        frames, state = recording.frames, recording.state
        for index, leg in enumerate(self.known.carrying_legs):
            of_leg = self._targets_of_leg(leg)
            arms = np.einsum("bij,bkj->bki", frames.rotation[:, leg], self._arms(state, of_leg))
            by_local[..., first + index][:, of_leg] = np.cross(frames.z[:, leg, None], arms) * FREE_ANGLE_RAD

    def _targets_of_leg(self, leg: int) -> NDArray:
        return np.flatnonzero((self.targets.body == LEG) & (self.targets.leg == leg))

    def _arms(self, state: State, targets: NDArray) -> NDArray:
        """Return the positions (B, k, 3) of some targets relative to the body's origin, along the axes of their
        survey."""
        return np.broadcast_to(state.shape + state.moved, (len(state.rho), *state.shape.shape))[:, targets]


def nominal_leg_frames(legs: Legs, readings: NDArray) -> LegFrames:
    """Return the frames of the legs of the plain mechanism at readings (B, L), m."""
    return leg_frames(simulate(legs, readings), reference_pose(legs).z[0], np.zeros_like(readings))
