"""Further uncatalogued effects, added after the diagnosis was complete; the diagnosis was not adapted to them.

What they show is kept apart from what was there while the diagnosis was built.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tests.blind.generator.named_effect import Parameter
from tests.blind.generator.quaternions import Array
from tests.blind.generator.sensor.effects import Effect, Setting
from tests.blind.generator.sensor.layout import LOADS
from tests.blind.generator.sensor.strange import Strange, StrangeOfLoad, column_of


@dataclass(frozen=True)
class TouchesAStop(StrangeOfLoad):
    """Pushed beyond a share of its range one way the platform touches a stop, and goes on more slowly."""

    way: float
    FREE = 0.5

    def course(self, setting: Setting) -> Array:
        return np.maximum(self.way * self.share(setting) - self.FREE, 0.0) / (1.0 - self.FREE)


class SticksInTheMiddle(StrangeOfLoad):
    """Between a quarter and two thirds of the range, pulled one way, something holds the platform aside."""

    def course(self, setting: Setting) -> Array:
        x = self.share(setting)
        return ((x > 0.25) & (x < 0.65)).astype(float)


class SeatsInContact(StrangeOfLoad):
    """A contact of two curved bodies gives with the load to the power of two thirds (Hertz)."""

    def course(self, setting: Setting) -> Array:
        x = self.share(setting)
        return np.sign(x) * np.abs(x) ** (2.0 / 3.0)


class Tires(StrangeOfLoad):
    """The loaded part becomes softer in the course of the campaign."""

    @property
    def drivers(self) -> tuple[str, ...]:
        return (LOADS[self.axis], "time_s")

    def course(self, setting: Setting) -> Array:
        time = setting.schedule.time_s
        return self.share(setting) * (time - time[0]) / np.ptp(time)


class BeltInHumidAir(StrangeOfLoad):
    """The belt that brings the load gives with the humidity of the air: the product of both."""

    @property
    def drivers(self) -> tuple[str, ...]:
        return (LOADS[self.axis], "relative_humidity_pct")

    def course(self, setting: Setting) -> Array:
        return self.share(setting) * column_of(setting.schedule, "relative_humidity_pct")


@dataclass(frozen=True)
class BendsWithWarmth(Strange):
    """A channel follows the square of the air's departure from its mean temperature: a bimetal at its turning point."""

    @property
    def drivers(self) -> tuple[str, ...]:
        return ("air_temperature_c",)

    def course(self, setting: Setting) -> Array:
        return column_of(setting.schedule, "air_temperature_c") ** 2


@dataclass(frozen=True)
class RestlessHours(Effect):
    """Somebody works next door for a third of the campaign: all readings scatter exp(growth) times as much."""

    growth: float
    start: float  # share of the campaign's time
    id = "unexplained"
    LASTS = 0.33

    def parameters(self) -> Mapping[str, Parameter]:
        return {"growth": (self.growth, "1")}

    @property
    def drivers(self) -> tuple[str, ...]:
        return ("time_s",)

    def scatter(self, scatter: Array, setting: Setting) -> Array:
        time = setting.schedule.time_s
        share = (time - time[0]) / np.ptp(time)
        restless = (share >= self.start) & (share <= self.start + self.LASTS)
        return scatter * np.where(restless, np.exp(self.growth), 1.0)[:, None]
