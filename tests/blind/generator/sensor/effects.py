"""Hidden effects on the bench that a plain simulation leaves out: one class each, at the step where it acts.

Axes of load and channels are given by their place, 0 to 5. ``Per`` one of them is what nearly all effects are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tests.blind.generator.named_effect import NamedEffect, Parameter
from tests.blind.generator.quaternions import Array
from tests.blind.generator.sensor.layout import AXES, FILE_UNIT, UNITS
from tests.blind.generator.sensor.machine import Machine, sharing
from tests.blind.generator.sensor.schedule import Schedule, unloading

XYZ = ("x", "y", "z")
SMALLEST = 0.02  # of the range: over so much load a joint goes through its clearance


@dataclass(frozen=True)
class Setting:
    """Inputs of an effect."""

    schedule: Schedule
    machine: Machine
    wavelength: float


class Effect(NamedEffect):
    """An effect changes the chain at one or more of its steps; where it does nothing, the step is left as it is."""

    def drive(self, wrench: Array, setting: Setting) -> Array:
        """True wrench under the load of each axis (S, 6 axes, 6), N and N m."""
        return wrench

    def structure(self, deflection: Array, setting: Setting) -> Array:
        """Deflection of the platform under the load of each axis (S, 6 axes, 6), m and rad."""
        return deflection

    def instrument(self, readings: Array, moved: Array, setting: Setting) -> Array:
        """Readings (S, 6), m and rad, of a platform that has moved (S, 6)."""
        return readings

    def electric(self, signals: Array, setting: Setting) -> Array:
        """Signals (S, C), mV, without their noise."""
        return signals


@dataclass(frozen=True)
class PerLoad(Effect):
    """An effect of the load along one axis."""

    axis: int

    @property
    def subject(self) -> str:
        return f"load {AXES[self.axis]}"

    def load(self, setting: Setting) -> Array:
        """The load (S,) along the axis, N or N m."""
        return setting.schedule.load[:, self.axis]

    def share(self, setting: Setting) -> Array:
        """The load (S,) over the largest of its axis."""
        return self.load(setting) / setting.schedule.limit[self.axis]


@dataclass(frozen=True)
class LoadEccentricity(PerLoad):
    """A force passes ``beside`` (3,) the origin, m; a torque brings a force along, ``beside`` (3,) per N m."""

    beside: tuple[float, float, float]
    id = "load-eccentricity"

    def parameters(self) -> Mapping[str, Parameter]:
        own = {axis: value for axis, value in zip(XYZ, self.beside, strict=True) if value}
        if self.axis < 3:
            return {f"offset_{axis}": (1e3 * value, "mm") for axis, value in own.items()}
        return {f"force_{axis}": (value, "1/m") for axis, value in own.items()}

    def drive(self, wrench: Array, setting: Setting) -> Array:
        along, brought = np.eye(3)[self.axis % 3], np.zeros(6)
        if self.axis < 3:
            brought[3:] = np.cross(np.array(self.beside), along)
        else:
            brought[:3] = self.beside
        return _with(wrench, self.axis, self.load(setting)[:, None] * brought)


@dataclass(frozen=True)
class LoadImbalance(PerLoad):
    """Two units on one axis: a parasitic wrench (6,) per load, ``apart`` more of it for positive than negative loads,
    and ``growth`` more at the range's end than at no load.
    """

    ratio: tuple[float, ...]
    apart: tuple[float, ...]
    growth: tuple[float, ...] = (0.0,) * 6
    id = "load-imbalance"

    def parameters(self) -> Mapping[str, Parameter]:
        parameters: dict[str, Parameter] = {}
        for suffix, values in (("", self.ratio), ("_asymmetry", self.apart), ("_growth", self.growth)):
            for place, value in enumerate(values):
                if value:
                    name = f"{'force' if place < 3 else 'moment'}_{XYZ[place % 3]}{suffix}"
                    parameters[name] = (value, ("1/m", "1", "1", "m")[2 * (self.axis < 3) + (place >= 3)])
        return parameters

    def drive(self, wrench: Array, setting: Setting) -> Array:
        F, size = self.load(setting)[:, None], np.abs(self.share(setting))[:, None]
        brought = F * np.array(self.ratio) + np.abs(F) / 2 * np.array(self.apart) + F * size * np.array(self.growth)
        return _with(wrench, self.axis, brought)


@dataclass(frozen=True)
class Elastic(PerLoad):
    """An effect on the deflection under one axis: on all of it, or on what goes along the load alone."""

    amount: float
    along_only: bool = False
    name: ClassVar[str]

    def parameters(self) -> Mapping[str, Parameter]:
        return {self.name: (self.amount, "1")}

    def structure(self, deflection: Array, setting: Setting) -> Array:
        d = deflection[:, self.axis]
        more = self.more(d, setting)
        return _with(deflection, self.axis, more * np.eye(6)[self.axis] if self.along_only else more)

    def more(self, d: Array, setting: Setting) -> Array:
        """Amount added to the deflection d (S, 6)."""
        raise NotImplementedError


class StiffnessScale(Elastic):
    """The stiffness along an axis is (1 + scale) times the simulated."""

    id, name = "stiffness-scale", "scale"

    def more(self, d: Array, setting: Setting) -> Array:
        return d / (1 + self.amount) - d


@dataclass(frozen=True)
class LegStiffness(Effect):
    """One leg is (1 + scale) times as stiff as it should be, in all its parts."""

    leg: int
    scale: float
    id = "leg-stiffness"

    @property
    def subject(self) -> str:
        return f"leg{self.leg + 1}"

    def parameters(self) -> Mapping[str, Parameter]:
        return {"scale": (self.scale, "1")}

    def structure(self, deflection: Array, setting: Setting) -> Array:
        legs = setting.machine.legs
        softer = np.ones(legs.parts.shape[:2])
        plain = sharing(legs, softer).compliance
        softer[self.leg] = 1 / (1 + self.scale)
        return deflection @ (sharing(legs, softer).compliance @ np.linalg.inv(plain)).T


class StiffnessAsymmetry(Elastic):
    """Softer one way than the other."""

    id, name = "stiffness-asymmetry", "asymmetry"

    def more(self, d: Array, setting: Setting) -> Array:
        return self.amount / 2 * np.sign(self.load(setting))[:, None] * d


class StiffnessNonlinear(Elastic):
    """Softer or stiffer towards the ends of the range."""

    id, name = "stiffness-nonlinear", "cubic"

    def more(self, d: Array, setting: Setting) -> Array:
        return self.amount * (self.share(setting) ** 2)[:, None] * d


class Hysteresis(Elastic):
    """On the way down the platform stays behind, most at half of the range, not at its ends."""

    id, name = "hysteresis", "width"

    def more(self, d: Array, setting: Setting) -> Array:
        down = unloading(setting.schedule.load, setting.schedule.run)[:, self.axis]
        x = self.share(setting)
        bulge = np.where(down, np.sign(x) * np.sin(np.pi * np.clip(np.abs(x), 0.0, 1.0)), 0.0)
        largest = setting.machine.compliance[:, self.axis] * setting.schedule.limit[self.axis]
        return self.amount * bulge[:, None] * largest


@dataclass(frozen=True)
class PlayHysteresis(PerLoad):
    """A slider with friction follows the load once that is ``threshold`` of the range ahead of it, all day long; the
    deflection stays behind by half the ``width`` of its largest while the load is ahead, and as much ahead after it."""

    width: float
    threshold: float
    id = "play-hysteresis"

    def parameters(self) -> Mapping[str, Parameter]:
        return {"width": (self.width, "1"), "threshold": (self.threshold, "1")}

    def structure(self, deflection: Array, setting: Setting) -> Array:
        load, slider, behind = self.share(setting), 0.0, np.zeros(len(deflection))
        for n, x in enumerate(load):
            slider = max(x - self.threshold, min(x + self.threshold, slider))
            behind[n] = (x - slider) / self.threshold
        behind = behind - behind[setting.schedule.first]  # readings are set to zero as a run begins
        largest = setting.machine.compliance[:, self.axis] * setting.schedule.limit[self.axis]
        return _with(deflection, self.axis, -0.5 * self.width * behind[:, None] * largest)


@dataclass(frozen=True)
class JointClearance(PerLoad):
    """A joint has play: half of it is gone through, m or rad, over the smallest loads."""

    clearance: float
    id = "joint-clearance"

    def parameters(self) -> Mapping[str, Parameter]:
        return {"clearance": (self.clearance / FILE_UNIT[self.axis], UNITS[self.axis])}

    def structure(self, deflection: Array, setting: Setting) -> Array:
        side = np.clip(self.share(setting) / SMALLEST, -1.0, 1.0)
        return _with(deflection, self.axis, self.clearance / 2 * side[:, None] * np.eye(6)[self.axis])


@dataclass(frozen=True)
class Creep(Effect):
    """A share of the deflection comes late: each load is held from the reading before until its own."""

    axes: tuple[int, ...]  # all or one
    fraction: float
    tau: float
    id = "creep"

    @property
    def subject(self) -> str:
        return f"load {AXES[self.axes[0]]}" if len(self.axes) == 1 else ""

    def parameters(self) -> Mapping[str, Parameter]:
        return {"fraction": (self.fraction, "1"), "tau": (self.tau, "s")}

    def structure(self, deflection: Array, setting: Setting) -> Array:
        schedule, late = setting.schedule, np.zeros_like(deflection)
        for n in range(1, len(late)):
            if schedule.run[n] == schedule.run[n - 1]:
                kept = np.exp(-(schedule.time_s[n] - schedule.time_s[n - 1]) / self.tau)
                late[n] = kept * late[n - 1] + (1 - kept) * deflection[n]
        chosen = np.isin(np.arange(6), self.axes)[:, None]
        return deflection + self.fraction * np.where(chosen, late, 0.0)


def _with(values: Array, axis: int, more: Array) -> Array:
    """Values (S, 6, 6) with more (S, 6) under the load of one axis."""
    changed = values.copy()
    changed[:, axis] += more
    return changed
