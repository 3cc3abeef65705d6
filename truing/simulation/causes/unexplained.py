"""What no cause of the catalogue explains: something follows columns of the campaign, in a form nobody declared.

It competes with the catalogue on equal terms, so that no named cause swallows what it does not explain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Cause, Parameter, Profiles, Scene, Step
from truing.simulation.causes.following import ALL_DRIVES, APPROACH, LAST_STEP, OWN_DRIVE, Following
from truing.simulation.causes.per_leg import choice_share
from truing.simulation.causes.undeclared import FURTHER, IN_PROPORTION, Undeclared
from truing.simulation.causes.unexplained_candidates import (
    PATTERNS,
    POSES_PER_FUNCTION,
    followings,
    patterns,
    target_followings,
)
from truing.simulation.legs import Change
from truing.simulation.state import State

__all__ = ["APPROACH", "LAST_STEP", "OWN_DRIVE", "Quantity", "Unexplained", "unexplained"]


class Quantity(StrEnum):
    """What follows."""

    READINGS = "readings"
    LENGTHS = "lengths"
    ATTACHMENTS = "attachments"
    ATTACHMENTS_SIDEWAYS = "attachments sideways"
    SCALE = "scale"
    TARGETS = "targets"


_STEPS = {Quantity.READINGS: Step.DRIVE, Quantity.SCALE: Step.INSTRUMENT}
# Plausible amplitudes: m, and of the scale relative.
_PLAUSIBLE = {Quantity.SCALE: 2e-5, Quantity.TARGETS: 2e-5}
_PLAUSIBLE_M = 5e-6
_AXES = {Quantity.ATTACHMENTS_SIDEWAYS: "xy", Quantity.TARGETS: "xyz"}


@dataclass(frozen=True)
class Unexplained(Undeclared, Cause):
    """A quantity of all legs, or of ``legs``, or of ``targets`` of a body, follows columns; see `Following`.

    Several targets move together, by smooth patterns over the body, where ``places`` tells two coordinates of each
    between -1 and 1; one by one else.
    """

    quantity: str = Quantity.READINGS
    columns: tuple[str, ...] = (OWN_DRIVE,)
    centres: tuple[float, ...] = (0.0,)
    half_ranges: tuple[float, ...] = (1e-3,)
    form: str = "polynomial"
    degree: int = 1
    first: int = 1
    legs: tuple[int, ...] = ()
    body: str = ""
    targets: tuple[str, ...] = ()
    places: tuple[float, ...] = ()

    id = "unexplained"
    catalogued = False
    step = Step.DRIVE
    reads = frozenset({"indicated"})

    @property
    def following(self) -> Following:
        """Return what it follows."""
        return Following(self.columns, self.centres, self.half_ranges, self.form, self.degree, self.first)

    @property
    def subject(self) -> str:
        """Return the legs or the target that it concerns, as the tables name them."""
        if len(self.targets) == 1:
            return f"target {self.targets[0]}"
        return " ".join(f"leg{leg}" for leg in self.legs)

    def covers(self, covariates: Mapping[str, NDArray], poses: int) -> NDArray:
        """Return the poses (B,) within the range of what it follows, beyond which its form says nothing."""
        return self.within(covariates, poses)

    @property
    def key(self) -> str:
        """Return the name that tells it from others of its kind."""
        parts = (self.id, self.quantity, *self.columns, self.form, self.terms, self.body, self.subject)
        return " ".join(str(part) for part in parts if part)

    @property
    def lasts(self) -> bool:
        """Return whether it stays with the machine: not what follows the time, or concerns targets."""
        return super().lasts and self.quantity != Quantity.TARGETS

    def with_settings(self, **settings: Any) -> Self:
        """Return the cause with settings as read from TOML, of the step at which its quantity is changed."""
        tuples = {key: tuple(v) if isinstance(v, list) else v for key, v in settings.items()}
        return unexplained(**{f.name: getattr(self, f.name) for f in fields(self)} | tuples)  # type: ignore[return-value]

    def candidates(self, scene: Scene) -> Sequence[Cause]:
        """Return everything that legs, bodies and the scale may follow in a campaign."""
        return [unexplained(**found) for found in followings(scene)]

    def profiles(self, scene: Scene) -> Sequence[Profiles]:
        """Return what single targets may follow."""
        return target_followings(scene, unexplained, _PLAUSIBLE[Quantity.TARGETS])

    def further(self, scene: Scene) -> Sequence[Cause]:
        """Return its next terms, of all that it concerns or of single legs among it, as far as poses tell them."""
        if self.form == ALL_DRIVES:
            return ()
        degrees = range(self.degree + 1, min(self.degree + FURTHER, len(scene.poses) // POSES_PER_FUNCTION) + 1)
        concerned = self._concerned(scene.legs) if self._is_of_legs and not self._is_one else ()
        choices = (self.legs, *((leg,) for leg in concerned))
        return [
            replace(self, first=self.degree + 1, degree=degree, legs=legs) for degree in degrees for legs in choices
        ]

    def prior(self, scene: Scene) -> float:
        """Return the weight of this candidate: what is in proportion to one column is likelier than other forms, and
        all legs are likelier than a single one, and that than a pair."""
        weight = IN_PROPORTION if self.in_proportion else 1.0
        return weight * choice_share(len(self.legs), scene.legs) if scene.legs else weight

    def follows(self, legs: int) -> tuple[str, ...]:
        """Return the columns of the configurations that it follows."""
        return self.following.names(legs, self._concerned(legs))

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return the columns without which the platform cannot be predicted."""
        if self.quantity in (Quantity.SCALE, Quantity.TARGETS):
            return ()
        return self.following.needs(legs, self._concerned(legs))

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return one amplitude per leg or target, axis and function; mm, for a scale relative."""
        names = [*self._owners(legs)]
        names = [f"{name}_{axis}" if axis else name for name in names for axis in self._axes]
        functions = range(self.first, self.first + self.following.size(legs))
        scale = _PLAUSIBLE.get(Quantity(self.quantity), _PLAUSIBLE_M)
        unit, si = ("1", 1.0) if self.quantity == Quantity.SCALE else ("mm", 1e-3)
        letter = "drive" if self.form == ALL_DRIVES else "degree" if self.form == "polynomial" else "wave"
        return tuple(Parameter(f"{name}_{letter}{k}".lstrip("_"), unit, scale, si) for name in names for k in functions)

    def alike(self, legs: int) -> tuple[int, ...]:
        """Return the amplitudes of the legs concerned: of several functions those of the last."""
        if self.quantity not in (Quantity.READINGS, Quantity.LENGTHS, Quantity.ATTACHMENTS):
            return ()
        functions = self.following.size(legs)
        return tuple(range(functions - 1, len(self._concerned(legs)) * functions, functions))

    def change(self, state: State, values: NDArray) -> Change:
        """Return the derivative of the quantity by the amplitudes."""
        basis = self.following.basis(state)
        size = len(self.parameters(state.legs.count))
        if self.quantity == Quantity.SCALE:
            return Change({"points": state.points[..., None] * basis[:, :1, None, :]}, size)
        if self.quantity == Quantity.TARGETS:
            return Change({} if state.targets is None else _of_targets(self, state, basis[:, 0]), size)
        rows = np.eye(state.legs.count)[:, np.array(self._concerned(state.legs.count)) - 1]
        own = rows[:, :, None] * basis[:, :, None, :]
        if self.quantity == Quantity.ATTACHMENTS_SIDEWAYS:
            sideways = own[:, :, None, :, None, :] * np.eye(3)[:, None, :2, None]
            return Change({"b": sideways.reshape(*sideways.shape[:3], size)}, size)
        name = {Quantity.READINGS: "rho", Quantity.LENGTHS: "l", Quantity.ATTACHMENTS: "delta_bz"}
        return Change({name[Quantity(self.quantity)]: own.reshape(*own.shape[:2], size)}, size)

    def recorded(self, points: NDArray, state: State, values: NDArray) -> NDArray:
        """Return points, or their motions, (B, K, 3, ...), as an instrument with this scale passes them on."""
        if self.quantity != Quantity.SCALE:
            return points
        factor = 1 + self.following.basis(state)[:, 0] @ values
        return points * factor.reshape(-1, *([1] * (points.ndim - 1)))

    def _concerned(self, legs: int) -> tuple[int, ...]:
        return self.legs or tuple(range(1, legs + 1))

    @property
    def _axes(self) -> str | tuple[str, ...]:
        return _AXES.get(Quantity(self.quantity), ("",))

    @property
    def _is_of_legs(self) -> bool:
        return self.quantity not in (Quantity.SCALE, Quantity.TARGETS)

    @property
    def _is_one(self) -> bool:
        return len(self.legs) == 1 or len(self.targets) == 1 or self.quantity == Quantity.SCALE

    def _owners(self, legs: int) -> tuple[str, ...]:
        if self.quantity == Quantity.SCALE:
            return ("",)
        if self.places:
            return tuple(f"{self.body}_{pattern}" for pattern in PATTERNS)
        return self.targets or tuple(f"leg{leg}" for leg in self._concerned(legs))


class _OfStructure(Unexplained):
    """What follows is a length, an attachment or a target."""

    step = Step.STRUCTURE


class _OfInstrument(Unexplained):
    """What follows is the scale of the measurement."""

    step = Step.INSTRUMENT


def unexplained(**settings: Any) -> Unexplained:
    """Return the cause with these settings, of the step at which its quantity is changed."""
    kinds = {Step.DRIVE: Unexplained, Step.STRUCTURE: _OfStructure, Step.INSTRUMENT: _OfInstrument}
    quantity = Quantity(settings.get("quantity", Quantity.READINGS))
    return kinds[_STEPS.get(quantity, Step.STRUCTURE)](**{**settings, "quantity": str(quantity)})


def _of_targets(cause: Unexplained, state: State, basis: NDArray) -> dict[str, NDArray]:
    """Return the derivative of ``moved`` (B, K, 3, P): each target or pattern along each axis with each function."""
    own = tuple(zip(state.targets.bodies, state.targets.names, strict=True)) if state.targets is not None else ()
    shares = patterns(np.reshape(cause.places, (-1, 2))) if cause.places else np.eye(len(cause.targets))
    over = np.zeros((len(own), shares.shape[1]))
    for place, target in enumerate(cause.targets):
        if (cause.body, target) in own:
            over[own.index((cause.body, target))] = shares[place]
    moved = np.einsum("kq,ij,bm->bkiqjm", over, np.eye(3), basis)
    return {"moved": moved.reshape(*moved.shape[:3], -1)}
