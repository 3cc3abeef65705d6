"""Points of all bodies and poses as a function of what is not known exactly, with exact derivatives.

Unknowns are counted in their prior's standard deviations, so that a value is a pull: shared ones (geometry, shape of
the bodies, how each leg's survey frame sits on its leg, effects) and, pose by pose, local ones (actuators, rolls).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import exp_so3, left_jacobian_so3, skew
from truing.simulation.chain import Cause, Effect, State, carried, simulate
from truing.simulation.kinematics import forward, leg_vectors, pose_change, unit
from truing.simulation.legs import Change, Legs
from truing.simulation.survey import ShapeUnknowns
from truing.simulation.targets import (
    LEG,
    LegFrames,
    Targets,
    leg_frames,
    motion,
    positions,
    shape_rotation,
    target_motion,
)

# What nothing is known of: wide enough not to pull, narrow enough to keep the equations well scaled.
FREE_LENGTH_M, FREE_ANGLE_RAD, FREE_DIRECTION = 0.01, 0.1, 0.05
# An effect's fit is held this many plausible scales wide, so that its prior does not shrink it.
FREE_EFFECT = 10.0


@dataclass(frozen=True)
class Prediction:
    """Points and derivatives per prior sigma, and rows that concern no pose (the survey of attachments)."""

    points: NDArray  # (B, K, 3) m, base frame
    by_shared: NDArray  # (B, K, 3, G) m
    by_local: NDArray  # (B, K, 3, H) m
    survey_residual: NDArray  # (E,) whitened, measured - predicted
    survey_by_shared: NDArray  # (E, G) whitened
    shared_known: NDArray  # (G,) whose prior is knowledge, and not merely wide
    local_known: NDArray  # (H,)


@dataclass(frozen=True)
class Known:
    """What is known beforehand of a mechanism and its targets; one standard deviation each, m and rad.

    ``geometry`` gives the sigma of a, b, u, l (0: exact, so no unknown). ``shape`` (K, 3) is the survey in the bodies'
    frames and ``survey`` what it leaves unknown. ``ridden`` are the legs that carry targets; ``seat_rotation``
    (L, 3, 3) and ``seat`` (L, 3) place each leg's survey frame on the upright leg, as a start.
    """

    geometry: dict[str, float]
    shape: NDArray
    survey: ShapeUnknowns
    reading_sigma: float
    ridden: NDArray
    seat_rotation: NDArray
    seat: NDArray
    open_geometry: tuple[str, ...] = ()  # of a, b, u, l: those without tolerance, whose sigma is merely wide


@dataclass(frozen=True)
class Conditions:
    """What is known of each pose: readings (B, L) in m, covariates (B,) or (B, L) by column."""

    readings: NDArray
    covariates: Mapping[str, NDArray] = field(default_factory=dict)


@dataclass(frozen=True)
class PointModel:
    """A mechanism with its targets and readings; a function of the unknowns for a set of effects."""

    nominal: Legs
    targets: Targets
    known: Known
    conditions: Conditions
    causes: tuple[Cause, ...] = ()

    @cached_property
    def upright(self) -> NDArray:
        """Return the legs' directions (L, 3) in the nominal reference configuration."""
        return upright_directions(self.nominal)

    @cached_property
    def layout(self) -> dict[str, slice]:
        """Return where each kind of shared unknown stands in the vector."""
        count = self.nominal.count
        sizes = {"a": 3 * count, "b": 3 * count, "u": 2 * count, "l": count}
        sizes = {name: size for name, size in sizes.items() if self.known.geometry.get(name, 0.0) > 0}
        sizes |= {"shape": self.known.survey.modes.shape[-1], "seat": 6 * len(self.known.ridden)}
        sizes |= {cause.key: len(cause.parameters(count)) for cause in self.causes}
        ends = np.cumsum(list(sizes.values()))
        return {name: slice(int(end) - size, int(end)) for (name, size), end in zip(sizes.items(), ends, strict=True)}

    @property
    def shared_size(self) -> int:
        """Return the number of shared unknowns G."""
        return max(part.stop for part in self.layout.values())

    @property
    def local_size(self) -> int:
        """Return the number of local unknowns H: actuators (unless exact), then rolls."""
        return self.nominal.count * (self.known.reading_sigma > 0) + len(self.known.ridden)

    @property
    def unpredicted(self) -> NDArray:
        """Return which local unknowns (H,) the mechanism says nothing of: the rolls of the legs."""
        return np.arange(self.local_size) >= self.local_size - len(self.known.ridden)

    def is_named(self, cause: Cause) -> bool:
        """Return whether a cause is one of the catalogue, not merely something that follows a column."""
        return not cause.follows(self.nominal.count)

    def parameter_count(self, cause: Cause) -> int:
        """Return the number of a cause's parameters."""
        return len(cause.parameters(self.nominal.count))

    def widened(self, shared: NDArray, model: PointModel) -> NDArray:
        """Return shared unknowns of this model as those of another, zero where this one has none."""
        wide = np.zeros(model.shared_size)
        if len(shared):
            for name in self.layout.keys() & model.layout.keys():
                wide[model.layout[name]] = self._part(shared, name)
        return wide

    def with_causes(self, causes: Sequence[Cause]) -> PointModel:
        """Return the model with these effects among its unknowns."""
        return replace(self, causes=tuple(causes))

    def at(self, conditions: Conditions) -> PointModel:
        """Return the model at other poses."""
        return replace(self, conditions=conditions)

    def legs(self, shared: NDArray) -> Legs:
        """Return the geometry that shared unknowns (G,) stand for."""
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

    def effects(self, shared: NDArray) -> tuple[Effect, ...]:
        """Return the effects with the values that shared unknowns (G,) stand for."""
        return tuple(Effect(cause, self._part(shared, cause.key) * self.effect_sigma(cause)) for cause in self.causes)

    def shape(self, shared: NDArray) -> NDArray:
        """Return the bodies' shapes (K, 3): base frame, platform frame, upright leg."""
        shape = self.known.shape + self.known.survey.modes @ self._part(shared, "shape")
        rotation, offset = self._seats(shared)
        on_leg = self.targets.body == LEG
        ridden = self.targets.leg[on_leg]
        shape[on_leg] = np.einsum("kij,kj->ki", rotation[ridden], shape[on_leg]) + offset[ridden]
        return shape

    def state(self, shared: NDArray, local: NDArray) -> State:
        """Return the chain's state for shared (G,) and local (B, H) unknowns."""
        rho = self.conditions.readings + self._actuators(local) * self.known.reading_sigma
        return simulate(self.legs(shared), rho, self.effects(shared), self.conditions.covariates)

    def frames(self, state: State, local: NDArray) -> LegFrames:
        """Return the frames of the legs in a state."""
        roll = np.zeros(self.conditions.readings.shape, local.dtype)
        roll[:, self.known.ridden] = local[:, self.local_size - len(self.known.ridden) :] * FREE_ANGLE_RAD
        return leg_frames(state, self.upright, roll)

    def points(self, shared: NDArray, local: NDArray) -> NDArray:
        """Return the predicted points (B, K, 3), m, base frame."""
        state = self.state(shared, local)
        return positions(state, self.targets, self.shape(shared), self.frames(state, local))

    def predict(self, shared: NDArray, local: NDArray) -> Prediction:
        """Return points and all derivatives at shared (G,) and local (B, H) unknowns."""
        state, shape = self.state(shared, local), self.shape(shared)
        frames, effects = self.frames(state, local), self.effects(shared)
        by_shared = np.zeros((*state.rho.shape[:1], *shape.shape, self.shared_size))
        by_local = np.zeros((*by_shared.shape[:-1], self.local_size))
        for part, change in self._changes(shared, state):
            moved = motion(state, self.upright, carried(state, effects, change))
            target = by_local if part is None else by_shared
            target[..., slice(change.size) if part is None else part] = target_motion(
                state, self.targets, shape, frames, moved
            )
        self._fill_shape(by_shared, shared, state, frames)
        self._fill_rolls(by_local, shape, frames)
        points = positions(state, self.targets, shape, frames)
        return Prediction(
            points, by_shared, by_local, *self._survey_rows(shared), self._shared_known, ~self.unpredicted
        )

    def signature(self, cause: Cause, shared: NDArray, local: NDArray) -> NDArray:
        """Return how the points (B, K, 3, P), m, follow a cause's parameters, per plausible scale of each."""
        state = self.state(shared, local)
        scale = np.array([parameter.scale for parameter in cause.parameters(self.nominal.count)])
        change = carried(state, self.effects(shared), cause.change(state))
        moved = motion(state, self.upright, change)
        frames = self.frames(state, local)
        return target_motion(state, self.targets, self.shape(shared), frames, moved) * scale

    def pose_derivatives(self, shared: NDArray, local: NDArray) -> tuple[NDArray, NDArray]:
        """Return the platform's twist per shared (B, 6, G) and per local (B, 6, H) unknown."""
        state, effects = self.state(shared, local), self.effects(shared)
        by_shared = np.zeros((len(state.rho), 6, self.shared_size))
        by_local = np.zeros((len(state.rho), 6, self.local_size))
        for part, change in self._changes(shared, state):
            twist = pose_change(
                state.legs, state.p, state.R, state.rho, state.delta_bz, carried(state, effects, change)
            )
            (by_local if part is None else by_shared)[..., slice(change.size) if part is None else part] = twist
        return by_shared, by_local

    def unknowns(self, legs: Legs, effects: dict[str, NDArray]) -> NDArray:
        """Return the shared unknowns (G,) at which the model has this geometry and these effects' values."""
        shared = np.zeros(self.shared_size)
        for name in ("a", "b", "l"):
            if name in self.layout:
                gap = getattr(legs, name) - getattr(self.nominal, name)
                shared[self.layout[name]] = gap.ravel() / self.known.geometry[name]
        if "u" in self.layout:
            ahead = np.sum(legs.u * self.nominal.u, -1)[:, None]
            tilt = np.einsum("lij,li->lj", self._across, legs.u / ahead)
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

    def effect_sigma(self, cause: Cause) -> NDArray:
        """Return the prior sigma (P,) that a cause's parameters are fitted with."""
        return FREE_EFFECT * np.array([parameter.scale for parameter in cause.parameters(self.nominal.count)])

    @cached_property
    def _across(self) -> NDArray:
        """Two directions (L, 3, 2) across each nominal actuator: the first as near as can be to its smallest axis."""
        u = self.nominal.u
        axis = np.eye(3)[np.argmin(np.abs(u), -1)]
        first = unit(axis - u * np.sum(u * axis, -1)[:, None])
        return np.stack([first, np.cross(u, first)], -1)

    def _tilted(self, shared: NDArray) -> NDArray:
        pulls = self._part(shared, "u").reshape(-1, 2) * self.known.geometry["u"]
        return self.nominal.u + np.einsum("lij,lj->li", self._across, pulls)

    def _seats(self, shared: NDArray) -> tuple[NDArray, NDArray]:
        rotation, offset = self.known.seat_rotation.astype(shared.dtype), self.known.seat.astype(shared.dtype)
        pulls = self._part(shared, "seat").reshape(-1, 6)
        rotation[self.known.ridden] = exp_so3(pulls[:, 3:] * FREE_ANGLE_RAD) @ rotation[self.known.ridden]
        offset[self.known.ridden] += pulls[:, :3] * FREE_LENGTH_M
        return rotation, offset

    def _changes(self, shared: NDArray, state: State) -> list[tuple[slice | None, Change]]:
        """Return every change of the chain's state with its place among the shared unknowns; None: local ones."""
        count, sigma = self.nominal.count, self.known.geometry
        found: list[tuple[slice | None, Change]] = []
        for name in ("a", "b"):
            if name in self.layout:
                identity = np.eye(3 * count).reshape(1, count, 3, 3 * count) * sigma[name]
                found.append((self.layout[name], Change({name: identity}, 3 * count)))
        if "u" in self.layout:
            found.append((self.layout["u"], Change({"u": self._direction_change(shared)[None]}, 2 * count)))
        if "l" in self.layout:
            found.append((self.layout["l"], Change({"l": np.eye(count)[None] * sigma["l"]}, count)))
        for cause in self.causes:
            change = cause.change(state)
            scaled = {name: field * self.effect_sigma(cause) for name, field in change.fields.items()}
            found.append((self.layout[cause.key], Change(scaled, change.size)))
        if self.known.reading_sigma > 0:
            found.append(
                (
                    None,
                    Change(
                        {
                            "indicated": np.broadcast_to(
                                np.eye(count) * self.known.reading_sigma, (*state.rho.shape, count)
                            )
                        },
                        count,
                    ),
                )
            )
        return found

    def _direction_change(self, shared: NDArray) -> NDArray:
        """Return the derivative (L, 3, 2L) of the actuators' unit directions."""
        tilted = self._tilted(shared)
        u, length = unit(tilted), np.sqrt(np.sum(tilted * tilted, -1))[:, None, None]
        own = (self._across - u[..., None] * np.einsum("li,lij->lj", u, self._across)[:, None]) / length
        spread = np.einsum("lij,lm->limj", own, np.eye(len(u)))
        return spread.reshape(len(u), 3, -1) * self.known.geometry["u"]

    def _fill_shape(self, by_shared: NDArray, shared: NDArray, state: State, frames: LegFrames) -> None:
        """Fill in the derivatives by the bodies' shapes and by the seats of the legs' survey frames."""
        rotation, (seat_rotation, _) = shape_rotation(state, self.targets, frames), self._seats(shared)
        own = rotation.copy()
        on_leg = self.targets.body == LEG
        own[:, on_leg] = rotation[:, on_leg] @ seat_rotation[self.targets.leg[on_leg]]
        by_shared[..., self.layout["shape"]] = own @ self.known.survey.modes
        self._fill_seats(by_shared, shared, rotation)

    def _fill_seats(self, by_shared: NDArray, shared: NDArray, rotation: NDArray) -> None:
        shape, (_, offset) = self.shape(shared), self._seats(shared)
        pulls = self._part(shared, "seat").reshape(-1, 6)
        jacobian = left_jacobian_so3(pulls[:, 3:] * FREE_ANGLE_RAD) * FREE_ANGLE_RAD
        for place, leg in enumerate(self.known.ridden):
            own = np.flatnonzero((self.targets.body == LEG) & (self.targets.leg == leg))
            first = self.layout["seat"].start + 6 * place
            by_shared[:, own, :, first : first + 3] = rotation[:, own] * FREE_LENGTH_M
            turned = -skew(shape[own] - offset[leg]) @ jacobian[place]
            by_shared[:, own, :, first + 3 : first + 6] = rotation[:, own] @ turned

    def _fill_rolls(self, by_local: NDArray, shape: NDArray, frames: LegFrames) -> None:
        first = self.local_size - len(self.known.ridden)
        for place, leg in enumerate(self.known.ridden):
            own = np.flatnonzero((self.targets.body == LEG) & (self.targets.leg == leg))
            arms = np.einsum("bij,kj->bki", frames.rotation[:, leg], shape[own])
            by_local[..., first + place][:, own] = np.cross(frames.z[:, leg, None], arms) * FREE_ANGLE_RAD

    def _survey_rows(self, shared: NDArray) -> tuple[NDArray, NDArray]:
        """Return what the survey of targets on attachments says of b: whitened residual and derivative."""
        own = np.flatnonzero(self.targets.at_attachment)
        ridden, factor = self.targets.leg[own], self.known.survey.attachment_factor
        gap = self.known.shape[own] - self.legs(shared).b[ridden]
        derivative = np.zeros((len(own), 3, self.shared_size))
        if "b" in self.layout:
            sigma, first = self.known.geometry["b"], self.layout["b"].start
            for axis in range(3):
                derivative[np.arange(len(own)), axis, first + 3 * ridden + axis] = sigma
        return np.linalg.solve(factor, gap.ravel()), np.linalg.solve(
            factor, derivative.reshape(3 * len(own), self.shared_size)
        )


def upright_directions(legs: Legs) -> NDArray:
    """Return the legs' directions (L, 3) in their reference configuration."""
    rho0 = legs.rho0[None]
    home = forward(legs, rho0)
    return unit(leg_vectors(legs, home.p, home.R, rho0))[0]


def nominal_leg_frames(legs: Legs, readings: NDArray) -> LegFrames:
    """Return the frames of the legs as the plain mechanism has them at readings (B, L), m."""
    return leg_frames(simulate(legs, readings), upright_directions(legs), np.zeros_like(readings))
