"""Effects of foreign worlds: shapes drawn from random functions, several of them at once.

A foreign world is a machine that nobody described: random smooth functions of several inputs, fields that bend a whole
body, a base that wanders, actuators that land elsewhere each time with heavy tails, friction that remembers, and a
quantity that nobody recorded. What may be said of it is that it is unexplained, and what drives it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from tests.blind.generator.campaign import Campaign
from tests.blind.generator.effects import Setting
from tests.blind.generator.machine import BodyPoses, Machine
from tests.blind.generator.quaternions import Array
from tests.blind.generator.smooth import own_part, random_function, random_walk, remanence
from tests.blind.generator.strange import Strange, column_of

TAILS = 2.0  # degrees of freedom of Student's t: one pose in ten lands four times as far off as the typical one


@dataclass(frozen=True)
class Foreign(Strange):
    """An effect of ``size`` (mm at its largest) whose shape the seed alone knows."""

    size: float
    seed: int

    def of_driver(self, driver: str) -> Foreign:
        """The part of the effect that depends on one of its drivers alone."""
        return self


@dataclass(frozen=True)
class OfInputs(Foreign):
    """An effect that is a random function of ``inputs``, or its part that depends on the column ``own`` alone."""

    inputs: tuple[str, ...]
    own: str = field(default="", kw_only=True)

    @property
    def drivers(self) -> tuple[str, ...]:
        return self.inputs

    def of_driver(self, driver: str) -> Foreign:
        return replace(self, own=driver)

    def course(self, drho: Array, setting: Setting, seed: int) -> Array:
        """The function at every pose (N,)."""
        known = np.column_stack([_input(name, drho, setting) for name in self.inputs])
        return own_part(known, seed, self.inputs.index(self.own)) if self.own else random_function(known, seed)


@dataclass(frozen=True)
class ForeignDrives(OfInputs):
    """Actuators of ``legs`` go wrong by a function each of several actuators' displacements and further columns."""

    legs: tuple[int, ...]

    def drive(self, drho: Array, setting: Setting) -> Array:
        changed = drho.copy()
        for leg in self.legs:
            changed[:, leg - 1] += self.size * self.course(drho, setting, self.seed + leg)
        return changed


@dataclass(frozen=True)
class ForeignField(OfInputs):
    """The platform, or the base, bends by a field over its places, as a function of ``inputs`` says how far."""

    body: str

    def structure(self, machine: Machine, setting: Setting) -> None:
        course = self.course(machine.drho, setting, self.seed)
        joints = machine.b if self.body == "platform" else machine.a
        marks = setting.marks.of(self.body)
        places = np.concatenate([joints[0], setting.marks.place[marks]])
        field = np.column_stack([random_function(places[:, :2], self.seed + 1 + axis) for axis in range(3)])
        shift = self.size * course[:, None, None] * field
        joints += shift[:, : joints.shape[1]]
        machine.marks[:, marks] += shift[:, joints.shape[1] :]


@dataclass(frozen=True)
class WanderingBase(Foreign):
    """The joints of the base wander slowly and independently, along an unrecorded course."""

    @property
    def drivers(self) -> tuple[str, ...]:
        return ("time_s",)

    def structure(self, machine: Machine, setting: Setting) -> None:
        time = setting.schedule.time_s[:, None]
        for leg in range(machine.a.shape[1]):
            for axis in range(3):
                machine.a[:, leg, axis] += self.size * random_function(time, self.seed + 3 * leg + axis)


class LandsElsewhere(Foreign):
    """Every approach lands elsewhere, with heavy tails."""

    @property
    def drivers(self) -> tuple[str, ...]:
        return ()

    def drive(self, drho: Array, setting: Setting) -> Array:
        scatter = np.random.default_rng(self.seed).standard_t(TAILS, drho.shape)
        return drho + self.size * np.clip(scatter / 10, -1, 1)


@dataclass(frozen=True)
class Remembers(Foreign):
    """Friction in actuators of ``legs`` remembers all turning points."""

    legs: tuple[int, ...]

    @property
    def drivers(self) -> tuple[str, ...]:
        return tuple(f"rho{leg}_mm" for leg in self.legs)

    def of_driver(self, driver: str) -> Foreign:
        return replace(self, legs=tuple(leg for leg in self.legs if f"rho{leg}_mm" == driver))

    def drive(self, drho: Array, setting: Setting) -> Array:
        in_time, changed = np.argsort(setting.schedule.time_s), drho.copy()
        for leg in self.legs:
            changed[in_time, leg - 1] += self.size * remanence(drho[in_time, leg - 1], self.seed + leg)
        return changed


class NobodyRecorded(Foreign):
    """Legs grow with an unrecorded quantity, each by its own share."""

    @property
    def drivers(self) -> tuple[str, ...]:
        return ()

    def structure(self, machine: Machine, setting: Setting) -> None:
        in_time = np.argsort(setting.schedule.time_s)
        walk = np.empty(len(in_time))
        walk[in_time] = random_walk(len(in_time), self.seed)
        share = np.random.default_rng(self.seed + 1).uniform(-1, 1, machine.length.shape[1])
        machine.length += self.size * walk[:, None] * share


class ForeignPoints(Foreign):
    """Every recorded point is displaced by a field over the measured space: an instrument with errors of its own."""

    @property
    def drivers(self) -> tuple[str, ...]:
        return ()

    def instrument(self, points: Array, body_poses: BodyPoses, setting: Setting) -> Array:
        places = points.reshape(-1, 3)
        off = np.column_stack([random_function(places, self.seed + axis) for axis in range(3)])
        return points + self.size * off.reshape(points.shape)


def _input(name: str, drho: Array, setting: Setting) -> Array:
    if name.startswith("rho"):
        return drho[:, int(name.removeprefix("rho").removesuffix("_mm")) - 1]
    return column_of(setting, name)


OfSize = Callable[[float], Foreign]
Draw = Callable[[Campaign, np.random.Generator], OfSize]


def _of(build: Callable[[Campaign, np.random.Generator, int], Foreign]) -> Draw:
    def draw(campaign: Campaign, rng: np.random.Generator) -> OfSize:
        effect = build(campaign, rng, int(rng.integers(2**31)))
        return lambda size: replace(effect, size=size)

    return draw


def _drives(campaign: Campaign, rng: np.random.Generator) -> tuple[str, ...]:
    legs = campaign.readings.shape[1]
    return tuple(f"rho{leg + 1}_mm" for leg in sorted(rng.choice(legs, int(rng.integers(1, 3)), replace=False)))


def _inputs(campaign: Campaign, rng: np.random.Generator) -> tuple[str, ...]:
    """One or two displacements; half of the time another input in addition, or in their place."""
    other = str(rng.choice(["time_s", "temperature_c", *campaign.schedule.further]))
    return ((other,), (*_drives(campaign, rng), other), *2 * (_drives(campaign, rng),))[rng.integers(4)]


def _some_legs(campaign: Campaign, rng: np.random.Generator) -> tuple[int, ...]:
    legs = campaign.readings.shape[1]
    count = int(rng.choice([1, 2, 3, legs]))
    return tuple(sorted((rng.choice(legs, count, replace=False) + 1).tolist()))


def _foreign_drives(campaign: Campaign, rng: np.random.Generator, seed: int) -> Foreign:
    legs = _some_legs(campaign, rng)
    return ForeignDrives(0.0, seed, _inputs(campaign, rng), legs)


FOREIGN: Mapping[str, Draw] = {
    "foreign drives": _of(lambda c, rng, seed: _foreign_drives(c, rng, seed)),
    "foreign field of the platform": _of(lambda c, rng, seed: ForeignField(0.0, seed, _inputs(c, rng), "platform")),
    "foreign field of the base": _of(lambda c, rng, seed: ForeignField(0.0, seed, _inputs(c, rng), "base")),
    "wandering base": _of(lambda c, rng, seed: WanderingBase(0.0, seed)),
    "lands elsewhere": _of(lambda c, rng, seed: LandsElsewhere(0.0, seed)),
    "friction remembers": _of(lambda c, rng, seed: Remembers(0.0, seed, _some_legs(c, rng))),
    "nobody recorded it": _of(lambda c, rng, seed: NobodyRecorded(0.0, seed)),
    "foreign instrument": _of(lambda c, rng, seed: ForeignPoints(0.0, seed)),
}
