"""What nature does on the bench and a plain simulation leaves out: one class per effect, at the step where it acts.

Axes of load and channels are told by their place, 0 to 5. ``Per`` one of them is what nearly all effects are.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tests.blind.generator.quaternions import Array, unit
from tests.blind.generator.sensor import air
from tests.blind.generator.sensor.layout import AXES, CHANNELS, FILE_UNIT, UNITS
from tests.blind.generator.sensor.machine import Machine
from tests.blind.generator.sensor.schedule import HOUR_S, Schedule, unloading

Parameter = tuple[float | str | None, str]  # value, unit
XYZ = ("x", "y", "z")
SMALLEST = 0.02  # of the range: over so much load a joint goes through its clearance


@dataclass(frozen=True)
class Setting:
    """What an effect may look at."""

    schedule: Schedule
    machine: Machine
    wavelength: float


class Effect:
    """An effect changes the chain at one or more of its steps; where it does nothing, the step is left as it is."""

    id: ClassVar[str]

    def parameters(self) -> Mapping[str, Parameter]:
        """Name to value and unit, named as in the campaign format."""
        raise NotImplementedError

    @property
    def subject(self) -> str:
        """What it concerns, empty for the whole."""
        return ""

    @property
    def drivers(self) -> tuple[str, ...]:
        """Columns that it follows, of an effect that is in no catalogue and known by these alone."""
        return ()

    def drive(self, wrench: Array, setting: Setting) -> Array:
        """What the load of each axis really brings (S, 6 axes, 6), N and N m."""
        return wrench

    def structure(self, deflection: Array, setting: Setting) -> Array:
        """How the platform answers the load of each axis (S, 6 axes, 6), m and rad."""
        return deflection

    def instrument(self, readings: Array, moved: Array, setting: Setting) -> Array:
        """Readings (S, 6), m and rad, of a platform that has moved (S, 6)."""
        return readings

    def electric(self, signals: Array, setting: Setting) -> Array:
        """Signals (S, C), mV, without their noise."""
        return signals

    def scatter(self, scatter: Array, setting: Setting) -> Array:
        """How many times the instrument's noise each reading has (S, 6)."""
        return scatter


def as_record(effect: Effect) -> dict[str, object]:
    """The effect as it stands in the file of truths."""
    values = {name: {"value": value, "unit": unit} for name, (value, unit) in effect.parameters().items()}
    told = {"cause": effect.id, "subject": effect.subject, "parameters": values}
    if effect.id == "unexplained":
        told |= {"kind": type(effect).__name__, "follows": " ".join(effect.drivers)}
    return json.loads(json.dumps(told))


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
        told: dict[str, Parameter] = {}
        for suffix, values in (("", self.ratio), ("_asymmetry", self.apart), ("_growth", self.growth)):
            for place, value in enumerate(values):
                if value:
                    name = f"{'force' if place < 3 else 'moment'}_{XYZ[place % 3]}{suffix}"
                    told[name] = (value, ("1/m", "1", "1", "m")[2 * (self.axis < 3) + (place >= 3)])
        return told

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
        """What is added to the deflection d (S, 6)."""
        raise NotImplementedError


class StiffnessScale(Elastic):
    """The stiffness along an axis is (1 + scale) times the simulated."""

    id, name = "stiffness-scale", "scale"

    def more(self, d: Array, setting: Setting) -> Array:
        return d / (1 + self.amount) - d


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


@dataclass(frozen=True)
class ZeroDrift(Effect):
    """The zero of a channel walks in all runs, or that of one run which watches one channel; m or rad per second."""

    channel: int
    rate: float
    run: int | None = None
    id = "zero-drift"

    @property
    def subject(self) -> str:
        return f"channel {CHANNELS[self.channel]}" if self.run is None else f"run {self.run}"

    def parameters(self) -> Mapping[str, Parameter]:
        return {"rate": (self.rate * HOUR_S / FILE_UNIT[self.channel], f"{UNITS[self.channel]}/h")}

    def instrument(self, readings: Array, moved: Array, setting: Setting) -> Array:
        schedule = setting.schedule
        walked = self.rate * schedule.since_start
        return _plus(readings, self.channel, walked if self.run is None else walked * (schedule.run == self.run))


@dataclass(frozen=True)
class PerChannel(Effect):
    """An effect on the readings of one channel."""

    channel: int

    @property
    def subject(self) -> str:
        return f"channel {CHANNELS[self.channel]}"


@dataclass(frozen=True)
class ThermalDrift(PerChannel):
    """A reading follows the temperature of the material or of the air from the start of the run, m or rad per K."""

    material: float
    of_air: float
    id = "thermal-drift"

    def parameters(self) -> Mapping[str, Parameter]:
        per_k = {"per_k_material": self.material, "per_k_air": self.of_air}
        unit_of = f"{UNITS[self.channel]}/K"
        return {name: (value / FILE_UNIT[self.channel], unit_of) for name, value in per_k.items() if value}

    def instrument(self, readings: Array, moved: Array, setting: Setting) -> Array:
        since = setting.schedule.air - setting.schedule.air[setting.schedule.first]
        return _plus(readings, self.channel, self.material * since[:, 3] + self.of_air * since[:, 0])


@dataclass(frozen=True)
class CosineError(PerChannel):
    """A beam at an angle to its axis, towards ``aside`` (3,), a unit vector across it: across for the other shifts, or
    the other turns.
    """

    angle: float
    aside: tuple[float, float, float]
    id = "cosine-error"

    def parameters(self) -> Mapping[str, Parameter]:
        return {"angle": (self.angle, "rad")}

    def instrument(self, readings: Array, moved: Array, setting: Setting) -> Array:
        first = 3 * (self.channel // 3)
        seen = moved[:, first : first + 3]
        along = (np.cos(self.angle) - 1) * seen[:, self.channel - first]
        return _plus(readings, self.channel, along + np.sin(self.angle) * seen @ np.array(self.aside))


@dataclass(frozen=True)
class AbbeOffset(PerChannel):
    """A linear channel watches a point an ``arm`` (3,) from the origin, m."""

    arm: tuple[float, float, float]
    id = "abbe-offset"

    def parameters(self) -> Mapping[str, Parameter]:
        return {f"arm_{axis}": (1e3 * value, "mm") for axis, value in zip(XYZ, self.arm, strict=True) if value}

    def instrument(self, readings: Array, moved: Array, setting: Setting) -> Array:
        return _plus(readings, self.channel, np.cross(moved[:, 3:], np.array(self.arm))[:, self.channel])


@dataclass(frozen=True)
class DeadPath(PerChannel):
    """Air changes its index over a path of the beam that nobody knows of, m."""

    path: float
    id = "dead-path"

    def parameters(self) -> Mapping[str, Parameter]:
        return {"dead_path": (1e3 * self.path, "mm")}

    def instrument(self, readings: Array, moved: Array, setting: Setting) -> Array:
        n = air.index(setting.schedule.air)
        return _plus(readings, self.channel, (n - n[setting.schedule.first]) * self.path)


@dataclass(frozen=True)
class FringeSlip(PerChannel):
    """From a step on until the end of the run, a linear channel has lost or won a number of half wavelengths."""

    run: int
    alone: bool  # whether the run watches this channel only
    count: int
    from_step: int
    id = "fringe-slip"

    @property
    def subject(self) -> str:
        return f"run {self.run}" if self.alone else f"run {self.run} channel {CHANNELS[self.channel]}"

    def parameters(self) -> Mapping[str, Parameter]:
        return {"count": (float(self.count), "1"), "from_step": (float(self.from_step), "1")}

    def instrument(self, readings: Array, moved: Array, setting: Setting) -> Array:
        schedule = setting.schedule
        late = (schedule.run == self.run) & (schedule.step >= self.from_step)
        return _plus(readings, self.channel, late * self.count * setting.wavelength / 2)


@dataclass(frozen=True)
class Crosstalk(Effect):
    """A signal channel carries a fraction of another; both told by their place."""

    signal: int
    source: int
    fraction: float
    id = "crosstalk"

    @property
    def subject(self) -> str:
        return f"signal v{self.signal + 1}"

    def parameters(self) -> Mapping[str, Parameter]:
        return {"fraction": (self.fraction, "1"), "source": (f"v{self.source + 1}", "")}

    def electric(self, signals: Array, setting: Setting) -> Array:
        carried = signals.copy()
        carried[:, self.signal] += self.fraction * signals[:, self.source]
        return carried


@dataclass(frozen=True)
class RowsExchanged(Effect):
    """The signals of two steps of a run were written down in each other's row."""

    run: int
    steps: tuple[int, int]
    id = "rows-exchanged"

    @property
    def subject(self) -> str:
        return f"run {self.run}"

    def parameters(self) -> Mapping[str, Parameter]:
        return {"steps": (" ".join(map(str, self.steps)), "")}

    def electric(self, signals: Array, setting: Setting) -> Array:
        schedule, written = setting.schedule, signals.copy()
        one, other = (np.flatnonzero((schedule.run == self.run) & (schedule.step == step))[0] for step in self.steps)
        written[[one, other]] = signals[[other, one]]
        return written


def _with(values: Array, axis: int, more: Array) -> Array:
    """Values (S, 6, 6) with more (S, 6) under the load of one axis."""
    changed = values.copy()
    changed[:, axis] += more
    return changed


def _plus(readings: Array, channel: int, more: Array) -> Array:
    changed = readings.copy()
    changed[:, channel] += more
    return changed


def across(channel: int, towards: float) -> tuple[float, float, float]:
    """The unit vector across a channel's axis in the direction ``towards``, rad."""
    way = np.zeros(3)
    way[(channel + 1) % 3], way[(channel + 2) % 3] = np.cos(towards), np.sin(towards)
    return tuple(unit(way).tolist())
