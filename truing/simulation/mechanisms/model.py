"""Points of all bodies and poses as a function of what is not known exactly, with exact derivatives."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import left_jacobian_so3, skew
from truing.simulation.cause import Cause, Scene, Step
from truing.simulation.change import Change
from truing.simulation.effects_model import Prediction
from truing.simulation.mechanisms.forward_pass import (
    REFERENCE,
    Passage,
    carried,
    moved_by_shape,
    passed,
    settled,
    simulate,
)
from truing.simulation.mechanisms.legs.closures import Legs
from truing.simulation.mechanisms.legs.kinematics import forward, home_change, home_pose, leg_vectors, unit
from truing.simulation.mechanisms.recording import LegFrames, Recording, designs, leg_frames, record
from truing.simulation.mechanisms.state import State
from truing.simulation.mechanisms.unknowns import FREE_ANGLE_RAD, FREE_LENGTH_M, Unknowns
from truing.simulation.targets import LEG


@dataclass(frozen=True)
class PointModel(Unknowns):
    """A mechanism with its targets and readings; a function of the unknowns for a set of effects."""

    @property
    def blocks(self) -> NDArray | None:
        """Return the poses' ranks in time (B,): any can be left out together."""
        poses = len(self.conditions.readings)
        order = self.conditions.covariates.get("order", np.arange(poses))
        return np.argsort(np.argsort(order, kind="stable"))

    @property
    def scene(self) -> Scene:
        """Return what the campaign offers to causes when they propose candidates."""
        known, conditions = self.known, self.conditions
        return Scene(
            self.targets,
            known.shape,
            conditions.readings,
            self.nominal.rho0,
            conditions.poses,
            conditions.covariates,
            conditions.span_s,
            known.reference_temperature_c,
            known.pitch_m,
            known.flexure_length_m,
            lengths_apart="u" in self.nominal.closure.geometry,
            photographed=self.photographed is not None,
            scale_bars=self.photographed.scale_bars if self.photographed else (),
            scale_height_m=self.photographed.scale_height_m if self.photographed else 0.0,
        )

    def state(self, shared: NDArray, local: NDArray) -> State:
        """Return the chain's state for shared (G,) and local (B, H) unknowns, before instruments."""
        return self._passage(shared, local).state

    def predict(self, shared: NDArray, local: NDArray, by_shared: bool = True) -> Prediction:
        """Return points and derivatives at shared (G,) and local (B, H) unknowns; by the shared ones if asked for."""
        recording = self._recording(shared, local)
        points = self._with_errors(recording.state.points, shared, local)
        slopes, rows = np.empty((*points.shape, 0)), (np.empty(0), np.empty((0, 0)))
        if by_shared:
            slopes, rows = self._by_shared(shared, recording), self._known_rows(shared)
        return Prediction(points, slopes, self._by_local(recording), *rows, self._shared_known, self._local_known)

    def _by_shared(self, shared: NDArray, recording: Recording) -> NDArray:
        """Return the points' derivatives (B, K, 3, G) by the shared unknowns."""
        slopes = np.zeros((*recording.state.points.shape, self.shared_size))
        for part, change, cause in self._changes(shared, recording):
            met = recording.passage.met if cause is None else recording.passage.downstream(cause)
            slopes[..., part] = recording.motion(change, met)
        self._fill_shape(slopes, shared, recording)
        slopes = recording.recorded(slopes)
        self._fill_instruments(slopes, shared, recording)
        self._fill_common(slopes)
        return slopes

    def _by_local(self, recording: Recording) -> NDArray:
        """Return the points' derivatives (B, K, 3, H) by the local unknowns."""
        slopes = np.zeros((*recording.state.points.shape, self.local_size))
        if (reading := self._reading_change) is not None:
            slopes[..., : reading.size] = recording.motion(reading, recording.passage.met)
        self._fill_rolls(slopes, recording)
        slopes = recording.recorded(slopes)
        self._fill_pose_errors(slopes)
        return slopes

    def pathways(self, shared: NDArray, local: NDArray) -> dict[str, NDArray]:
        """Return how recorded points (B, K, 3, n), m, follow each channel by which a cause may act, per SI unit.

        ``rho``, ``l``, ``delta_bz`` (n = L) and a, b, u (n = 3 L, leg by leg), as far as the closure has them. A
        channel is what a cause after all those in force would change: of the drive for rho, of the structure else.
        """
        recording, count = self._recording(shared, local), self.nominal.count
        structure = recording.passage.of_structure
        found = {}
        for name in ("rho", "delta_bz", *self.nominal.closure.geometry):
            shape = (1, count, 3) if name in "abu" else (1, count)
            size = int(np.prod(shape))
            change = Change({name: np.eye(size).reshape(*shape, size)}, size)
            found[name] = recording.recorded(recording.motion(change, structure if name == "rho" else ()))
        return found

    def design_matrix(self, shared: NDArray, local: NDArray) -> Callable[[Cause], dict[str, NDArray]]:
        """Return what tells a cause's change of each channel, (B or 1, n, P), per plausible scale of its parameters.

        Targets that it moves are told on the pathway ``observed``, n = 3 K, whose motions are the identity.
        """
        recording = self._recording(shared, local)
        return lambda cause: designs(recording, cause, self.effect_scale(cause))

    def pose_derivatives(self, shared: NDArray, local: NDArray) -> tuple[NDArray, NDArray]:
        """Return the platform's twist per shared (B, 6, G) and per local (B, 6, H) unknown."""
        recording = self._recording(shared, local)
        passage = recording.passage
        by_shared = np.zeros((len(passage.state.rho), 6, self.shared_size))
        by_local = np.zeros((len(passage.state.rho), 6, self.local_size))
        for part, change, cause in self._changes(shared, recording):
            met = passage.met if cause is None else passage.downstream(cause)
            by_shared[..., part] = settled(passage, carried(change, met))[1]
        if (reading := self._reading_change) is not None:
            by_local[..., : reading.size] = settled(passage, carried(reading, passage.met))[1]
        return by_shared, by_local

    def _passage(self, shared: NDArray, local: NDArray) -> Passage:
        """Return how the readings pass drive and structure."""
        rho = self.conditions.readings + self._actuators(local) * self.known.reading_sigma
        shape, legs = self.shape(shared), self.legs(shared)
        reference = home_pose(legs)
        start = State(
            legs,
            rho,
            np.zeros_like(rho),
            indicated=rho,
            covariates=self.conditions.covariates,
            targets=self.targets,
            shape=shape,
            moved=np.zeros((1, *shape.shape)),
            reference_temperature_c=self.known.reference_temperature_c,
            upright=self.upright,
            straight=reference.z[0],
            home=reference.R[0],
        )
        return passed(start, self.effects(shared))

    def _recording(self, shared: NDArray, local: NDArray) -> Recording:
        passage = self._passage(shared, local)
        roll = np.zeros(self.conditions.readings.shape, local.dtype)
        roll[:, self.known.ridden] = local[:, self._rolls] * FREE_ANGLE_RAD
        frames = leg_frames(passage.state, self.upright, roll, self._seats(shared)[0])
        return record(passage, self.targets, frames, self.effects(shared))

    def _changes(self, shared: NDArray, recording: Recording) -> Iterator[tuple[slice, Change, Cause | None]]:
        """Yield every change upstream of instruments by shared unknowns: its place among these, its cause."""
        for name, change in self.geometry_changes(shared):
            yield self.layout[name], self._with_reference(shared, change), None
        for effect in self.effects(shared):
            cause = effect.cause
            if cause.step is not Step.INSTRUMENT:
                change = cause.change(recording.at(cause), effect.values)
                scaled = {name: slope * self.effect_sigma(cause) for name, slope in change.fields.items()}
                yield self.layout[cause.key], Change(scaled, change.size), cause

    @property
    def _reading_change(self) -> Change | None:
        """Return the change by local unknowns: what the readings are off; None where they are exact."""
        if self.known.reading_sigma <= 0:
            return None
        count = self.nominal.count
        shift = np.eye(count)[None] * self.known.reading_sigma
        return Change({"indicated": shift, "rho": shift}, count)

    def _with_reference(self, shared: NDArray, change: Change) -> Change:
        """Return a change of the geometry with what it does to the reference, where an effect counts from that."""
        if not any(cause.reads.intersection(REFERENCE) for cause in self.causes):
            return change
        legs = self.legs(shared)
        home = home_pose(legs)
        moved = home_change(legs, home, change)
        turned = np.einsum("aij,bjk,bap->bikp", skew(np.eye(3)), home.R, moved.twist[:, 3:])
        return Change({**change.fields, "straight": moved.z, "home": turned}, change.size)

    def _fill_shape(self, by_shared: NDArray, shared: NDArray, recording: Recording) -> None:
        """Fill in the derivatives by the bodies' shapes and by the seats of the legs' survey frames."""
        turn = recording.state.turn
        follows = turn @ moved_by_shape(recording.passage.met, turn.shape)
        by_shared[..., self.layout["shape"]] = (turn + follows) @ self.known.survey.modes
        seat_rotation, offset = self._seats(shared)
        pulls = self._part(shared, "seat").reshape(-1, 6)
        jacobian = left_jacobian_so3(pulls[:, 3:] * FREE_ANGLE_RAD) * FREE_ANGLE_RAD
        for place, leg in enumerate(self.known.ridden):
            own, seat = self._riding(leg), seat_rotation[leg]
            first = self.layout["seat"].start + 6 * place
            upright = turn[:, own] @ seat.T
            pushed = follows[:, own] @ seat.T
            arms = self._arms(recording.passage.state, own) @ seat.T - offset[leg]
            turned = (pushed @ skew(offset[leg]) - upright @ skew(arms)) @ jacobian[place]
            by_shared[:, own, :, first : first + 3] = (upright + pushed) * FREE_LENGTH_M
            by_shared[:, own, :, first + 3 : first + 6] = turned

    def _fill_rolls(self, by_local: NDArray, recording: Recording) -> None:
        first = self._rolls.start
        frames, state = recording.frames, recording.passage.state
        for place, leg in enumerate(self.known.ridden):
            own = self._riding(leg)
            arms = np.einsum("bij,bkj->bki", frames.rotation[:, leg], self._arms(state, own))
            by_local[..., first + place][:, own] = np.cross(frames.z[:, leg, None], arms) * FREE_ANGLE_RAD

    def _riding(self, leg: int) -> NDArray:
        return np.flatnonzero((self.targets.body == LEG) & (self.targets.leg == leg))

    def _arms(self, state: State, own: NDArray) -> NDArray:
        """Return where some targets (B, k, 3) are, along the axes of their survey, from the body's origin."""
        return np.broadcast_to(state.shape + state.moved, (len(state.rho), *state.shape.shape))[:, own]


def upright_directions(legs: Legs) -> NDArray:
    """Return the legs' directions (L, 3) in their reference configuration."""
    rho0 = legs.rho0[None]
    home = forward(legs, rho0)
    return unit(leg_vectors(legs, home.p, home.R, rho0))[0]


def nominal_leg_frames(legs: Legs, readings: NDArray) -> LegFrames:
    """Return the frames of the legs as the plain mechanism has them at readings (B, L), m."""
    return leg_frames(simulate(legs, readings), upright_directions(legs), np.zeros_like(readings))
