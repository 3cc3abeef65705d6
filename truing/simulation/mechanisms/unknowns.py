"""What is not known exactly of a mechanism and of the targets on it, as one vector, and what that stands for.

Unknowns are counted in their prior's standard deviations, so that a value is a pull: shared ones (geometry, shape of
the bodies, how each leg's survey frame sits on its leg, effects) and, pose by pose, local ones (actuators, rolls).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import exp_so3
from truing.simulation.change import Change
from truing.simulation.effects_model import RecordedModel, laid_out
from truing.simulation.mechanisms.legs.closures import Legs
from truing.simulation.mechanisms.legs.kinematics import Forward, forward, leg_vectors, unit
from truing.simulation.targets import LEG, ShapeUnknowns, Targets

# What nothing is known of: wide enough not to pull, narrow enough to keep the equations well scaled.
FREE_LENGTH_M, FREE_ANGLE_RAD, FREE_DIRECTION = 0.01, 0.1, 0.05


@dataclass(frozen=True)
class Known:
    """What is known beforehand of a mechanism and its targets; one standard deviation each, m and rad.

    ``geometry`` gives the sigma of a, b, u, l (0: exact, so no unknown). ``shape`` (K, 3) is the survey in the bodies'
    frames and ``survey`` what it leaves unknown. ``ridden`` are the legs that carry targets; ``seat_rotation``
    (L, 3, 3) and ``seat`` (L, 3) place each leg's survey frame on the upright leg, as a start. ``pitch_m`` of the
    leadscrews and ``flexure_length_m`` are None where they are not known.
    """

    geometry: dict[str, float]
    shape: NDArray
    survey: ShapeUnknowns
    reading_sigma: float
    ridden: NDArray
    seat_rotation: NDArray
    seat: NDArray
    open_geometry: tuple[str, ...] = ()  # of a, b, u, l: those without tolerance, whose sigma is merely wide
    reference_temperature_c: float = 20.0
    pitch_m: float | None = None
    flexure_length_m: float | None = None


@dataclass(frozen=True)
class Conditions:
    """What is known of each pose: readings (B, L) in m, covariates (B,) or (B, L) by column; the poses' names.

    ``span_s`` is the first and last time of the whole campaign, of which these poses may be a part. ``common_errors``
    (B, K, 3, Q): how points, in the model's frame, follow the errors that photographs of all poses share, m;
    ``pose_errors`` (B, K, 3, E) those that the points of each pose share.
    """

    readings: NDArray
    covariates: Mapping[str, NDArray] = field(default_factory=dict)
    poses: tuple[int | str, ...] = ()
    span_s: tuple[float, float] | None = None
    common_errors: NDArray | None = field(default=None, kw_only=True)
    pose_errors: NDArray | None = field(default=None, kw_only=True)


@dataclass(frozen=True)
class Unknowns(RecordedModel):
    """The unknowns of a mechanism with its targets and readings, for a set of effects."""

    nominal: Legs
    targets: Targets
    known: Known
    conditions: Conditions

    @cached_property
    def home(self) -> Forward:
        """Return the platform's pose in the nominal reference configuration, a batch of one."""
        return forward(self.nominal, self.nominal.rho0[None])

    @cached_property
    def upright(self) -> NDArray:
        """Return the legs' directions (L, 3) in the nominal reference configuration."""
        return unit(leg_vectors(self.nominal, self.home.p, self.home.R, self.nominal.rho0[None]))[0]

    @cached_property
    def layout(self) -> dict[str, slice]:
        """Return where each kind of shared unknown stands in the vector."""
        count = self.nominal.count
        sizes = {"a": 3 * count, "b": 3 * count, "u": 2 * count, "l": count}
        sizes = {name: size for name, size in sizes.items() if self.known.geometry.get(name, 0.0) > 0}
        sizes |= {"shape": self.known.survey.modes.shape[-1], "seat": 6 * len(self.known.ridden)}
        sizes |= self._common_sizes | {cause.key: len(cause.parameters(count)) for cause in self.causes}
        return laid_out(sizes)

    @property
    def local_size(self) -> int:
        """Return the number of local unknowns H: actuators (unless exact), then rolls, then what photographs share."""
        return self._rolls.stop + self._pose_size

    @property
    def _rolls(self) -> slice:
        """Return where the rolls stand among the local unknowns."""
        first = self.nominal.count * (self.known.reading_sigma > 0)
        return slice(first, first + len(self.known.ridden))

    @property
    def unpredicted(self) -> NDArray:
        """Return which local unknowns (H,) the mechanism says nothing of: rolls of legs, errors of photographs."""
        return np.arange(self.local_size) >= self._rolls.start

    @property
    def _common_errors(self) -> NDArray | None:
        """Return how points follow the errors that photographs of all poses share."""
        return self.conditions.common_errors

    @property
    def _pose_errors(self) -> NDArray | None:
        """Return how points follow the errors that the photographs of each pose share."""
        return self.conditions.pose_errors

    @property
    def part_count(self) -> int:
        """Return the number of legs L."""
        return self.nominal.count

    @property
    def channel_groups(self) -> NDArray:
        """Return the number of each target's body (K,): base, platform, then the legs."""
        return self.targets.body + np.where(self.targets.body == LEG, self.targets.leg, 0)

    def rescaled(self, readings: float, survey: float) -> Self:
        """Return the model with the noise of readings and of the survey so many times as large."""
        surveyed = self.known.survey
        scaled = ShapeUnknowns(surveyed.modes * survey, surveyed.attachment_factor * survey)
        return replace(
            self, known=replace(self.known, survey=scaled, reading_sigma=self.known.reading_sigma * readings)
        )

    def at(self, conditions: Conditions) -> Self:
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

    def shape(self, shared: NDArray) -> NDArray:
        """Return where targets sit (K, 3), along the axes of the bodies' surveys, from the bodies' origins."""
        shape = self.known.shape + self.known.survey.modes @ self._part(shared, "shape")
        rotation, offset = self._seats(shared)
        on_leg = self.targets.body == LEG
        ridden = self.targets.leg[on_leg]
        shape[on_leg] += np.einsum("kji,kj->ki", rotation[ridden], offset[ridden])
        return shape

    def unknowns(self, legs: Legs, effects: dict[str, NDArray]) -> NDArray:
        """Return the shared unknowns (G,) at which the model has this geometry and these effects' values."""
        shared = np.zeros(self.shared_size)
        for name in ("a", "b", "l"):
            if name in self.layout:
                gap = getattr(legs, name) - getattr(self.nominal, name)
                shared[self.layout[name]] = gap.ravel() / self.known.geometry[name]
        if "u" in self.layout:
            ahead = np.sum(legs.u * self.nominal.u, -1)[:, None]
            tilt = np.einsum("lij,li->lj", self.across, legs.u / ahead)
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
    def across(self) -> NDArray:
        """Two directions (L, 3, 2) across each nominal actuator: the first as near as can be to its smallest axis."""
        u = self.nominal.u
        axis = np.eye(3)[np.argmin(np.abs(u), -1)]
        first = unit(axis - u * np.sum(u * axis, -1)[:, None])
        return np.stack([first, np.cross(u, first)], -1)

    def _tilted(self, shared: NDArray) -> NDArray:
        pulls = self._part(shared, "u").reshape(-1, 2) * self.known.geometry["u"]
        return self.nominal.u + np.einsum("lij,lj->li", self.across, pulls)

    def geometry_changes(self, shared: NDArray) -> list[tuple[str, Change]]:
        """Return how the geometry changes with its unknowns: the part of the layout, and the change per prior sigma."""
        count, sigma, layout = self.nominal.count, self.known.geometry, self.layout
        identity = np.eye(3 * count).reshape(1, count, 3, 3 * count)
        found: list[tuple[str, Change]] = []
        found += [(name, Change({name: identity * sigma[name]}, 3 * count)) for name in ("a", "b") if name in layout]
        if "u" in layout:
            found.append(("u", Change({"u": self._direction_change(shared)[None]}, 2 * count)))
        if "l" in layout:
            found.append(("l", Change({"l": np.eye(count)[None] * sigma["l"]}, count)))
        return found

    def _direction_change(self, shared: NDArray) -> NDArray:
        """Return the derivative (L, 3, 2L) of the actuators' unit directions."""
        tilted = self._tilted(shared)
        u, length = unit(tilted), np.sqrt(np.sum(tilted * tilted, -1))[:, None, None]
        own = (self.across - u[..., None] * np.einsum("li,lij->lj", u, self.across)[:, None]) / length
        spread = np.einsum("lij,lm->limj", own, np.eye(len(u)))
        return spread.reshape(len(u), 3, -1) * self.known.geometry["u"]

    def _seats(self, shared: NDArray) -> tuple[NDArray, NDArray]:
        rotation, offset = self.known.seat_rotation.astype(shared.dtype), self.known.seat.astype(shared.dtype)
        pulls = self._part(shared, "seat").reshape(-1, 6)
        rotation[self.known.ridden] = exp_so3(pulls[:, 3:] * FREE_ANGLE_RAD) @ rotation[self.known.ridden]
        offset[self.known.ridden] += pulls[:, :3] * FREE_LENGTH_M
        return rotation, offset

    def scale_of(self, name: str) -> NDArray:
        """Return what a unit of the unknowns of a part of the layout, geometry or effect, is in SI: (n,) or ()."""
        if name in self.known.geometry:
            return np.asarray(self.known.geometry[name])
        return super().scale_of(name)

    def _known_rows(self, shared: NDArray) -> tuple[NDArray, NDArray]:
        """Return what survey and prior campaigns say beforehand: whitened residual and derivative."""
        residuals, derivatives = zip(self.survey_rows(shared), super()._known_rows(shared), strict=True)
        return np.concatenate(residuals), np.concatenate(derivatives)

    def survey_rows(self, shared: NDArray) -> tuple[NDArray, NDArray]:
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
