"""Hidden effects on the bench outside the catalogue: a diagnosis must name their inputs, and no cause.

Amounts are m or rad of a channel at the largest value of what drives them; each effect names the columns it follows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tests.blind.generator.named_effect import Parameter
from tests.blind.generator.quaternions import Array
from tests.blind.generator.sensor.effects import Effect, Setting
from tests.blind.generator.sensor.layout import CHANNELS, FILE_UNIT, LOADS, UNITS
from tests.blind.generator.sensor.schedule import Schedule


@dataclass(frozen=True)
class Strange(Effect):
    """An effect in no catalogue on the readings of one channel."""

    channel: int
    amount: float
    id = "unexplained"
    as_noise: ClassVar[bool] = False  # whether nothing but more noise can be seen of it

    def parameters(self) -> Mapping[str, Parameter]:
        return {"amount": (self.amount / FILE_UNIT[self.channel], UNITS[self.channel])}

    @property
    def subject(self) -> str:
        return f"channel {CHANNELS[self.channel]}"

    def course(self, setting: Setting) -> Array:
        """Course of the reading (S,), at most about 1."""
        raise NotImplementedError

    def instrument(self, readings: Array, moved: Array, setting: Setting) -> Array:
        changed = readings.copy()
        changed[:, self.channel] += self.amount * self.course(setting)
        return changed


def column_of(schedule: Schedule, name: str) -> Array:
    """A column (S,), less its mean, over its largest departure from it."""
    away = schedule.column(name) - schedule.column(name).mean()
    return away / np.abs(away).max()


@dataclass(frozen=True)
class StrangeOfLoad(Strange):
    """It follows the load along one axis."""

    axis: int

    @property
    def drivers(self) -> tuple[str, ...]:
        return (LOADS[self.axis],)

    def share(self, setting: Setting) -> Array:
        """The load (S,) over the largest of its axis."""
        return setting.schedule.load[:, self.axis] / setting.schedule.limit[self.axis]


class JointSlips(StrangeOfLoad):
    """Stick-slip: beyond half of the range a joint gives way, and snaps back below."""

    def course(self, setting: Setting) -> Array:
        x = self.share(setting)
        return np.sign(x) * (np.abs(x) > 0.45)


class Bulges(StrangeOfLoad):
    """The platform bulges under a load, whichever way it points."""

    def course(self, setting: Setting) -> Array:
        return self.share(setting) ** 2


class SettlesForGood(StrangeOfLoad):
    """The mount settles with the largest load that there has been so far, and does not come back."""

    def course(self, setting: Setting) -> Array:
        schedule, most = setting.schedule, np.empty(len(setting.schedule.run))
        size = np.abs(self.share(setting))
        for start in np.unique(schedule.first):
            own = schedule.first == start
            most[own] = np.maximum.accumulate(size[own])
        return most


class Remembers(StrangeOfLoad):
    """A part of the load of two steps before is still there."""

    def course(self, setting: Setting) -> Array:
        schedule, x = setting.schedule, self.share(setting)
        before = np.concatenate([np.zeros(2), x[:-2]])
        return np.where(schedule.step >= 2, before, 0.0)


@dataclass(frozen=True)
class LoadProduct(Strange):
    """A channel moves with the product of the loads along two axes."""

    axes: tuple[int, int]

    @property
    def drivers(self) -> tuple[str, ...]:
        return tuple(LOADS[axis] for axis in self.axes)

    def course(self, setting: Setting) -> Array:
        first, second = ((setting.schedule.load / setting.schedule.limit)[:, axis] for axis in self.axes)
        return first * second


@dataclass(frozen=True)
class FollowsColumn(Strange):
    """A channel follows a column of the weather: humidity in a beam splitter's glue, pressure on a box."""

    column: str

    @property
    def drivers(self) -> tuple[str, ...]:
        return (self.column,)

    def course(self, setting: Setting) -> Array:
        return column_of(setting.schedule, self.column)


@dataclass(frozen=True)
class LoadCellWarms(StrangeOfLoad):
    """The load cell's gain follows the temperature of the air: the product of both."""

    @property
    def drivers(self) -> tuple[str, ...]:
        return (LOADS[self.axis], "air_temperature_c")

    def course(self, setting: Setting) -> Array:
        return self.share(setting) * column_of(setting.schedule, "air_temperature_c")


@dataclass(frozen=True)
class Breathes(Strange):
    """A channel breathes with a period in s: a pump, a door, an air conditioner."""

    period: float
    phase: float

    @property
    def drivers(self) -> tuple[str, ...]:
        return ("time_s",)

    def course(self, setting: Setting) -> Array:
        return np.sin(2 * np.pi * setting.schedule.time_s / self.period + self.phase)


@dataclass(frozen=True)
class SettlesAfterLunch(Strange):
    """After every long break the mount settles once more, with a time constant in s."""

    tau: float
    LONG = 1800.0

    @property
    def drivers(self) -> tuple[str, ...]:
        return ("time_s",)

    def course(self, setting: Setting) -> Array:
        schedule, course = setting.schedule, np.zeros(len(setting.schedule.run))
        pause = np.diff(schedule.time_s, prepend=-np.inf)
        for n in range(1, len(course)):
            if schedule.run[n] == schedule.run[n - 1]:
                kept = course[n - 1] * np.exp(-pause[n] / self.tau)
                course[n] = 1.0 if pause[n] > self.LONG else kept
        return course


@dataclass(frozen=True)
class InterpolationError(Strange):
    """The interferometer's phase has an error with a period of half a wavelength: after steps of many fringes nothing
    is left of its shape.
    """

    phase: float
    as_noise = True

    def instrument(self, readings: Array, moved: Array, setting: Setting) -> Array:
        changed, seen = readings.copy(), readings[:, self.channel]
        changed[:, self.channel] += self.amount * np.sin(4 * np.pi * seen / setting.wavelength + self.phase)
        return changed


@dataclass(frozen=True)
class NoisyChannel(Strange):
    """One channel trembles: its noise is 1 + amount times the instrument's."""

    def parameters(self) -> Mapping[str, Parameter]:
        return {"amount": (self.amount, "1")}

    def instrument(self, readings: Array, moved: Array, setting: Setting) -> Array:
        return readings

    def scatter(self, scatter: Array, setting: Setting) -> Array:
        trembling = scatter.copy()
        trembling[:, self.channel] *= 1 + self.amount
        return trembling


@dataclass(frozen=True)
class NoiseGrows(Effect):
    """All readings scatter more under the load of one axis: exp(growth) times as much at the end of its range."""

    growth: float
    axis: int
    id = "unexplained"

    def parameters(self) -> Mapping[str, Parameter]:
        return {"growth": (self.growth, "1")}

    @property
    def drivers(self) -> tuple[str, ...]:
        return (LOADS[self.axis],)

    def scatter(self, scatter: Array, setting: Setting) -> Array:
        x = np.abs(setting.schedule.load[:, self.axis]) / setting.schedule.limit[self.axis]
        return scatter * np.exp(self.growth * x)[:, None]
