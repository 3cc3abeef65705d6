"""Hidden effects outside the catalogue: a diagnosis must name their inputs, and no cause.

Amounts are per leg (L,), zero where a leg is spared; each effect names the columns of configurations.csv that drive
it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tests.blind.generator.effects import Effect, PerLeg, Setting
from tests.blind.generator.machine import BODIES, BodyPoses, Machine, move_attachments
from tests.blind.generator.named_effect import Parameter
from tests.blind.generator.quaternions import Array, rotate

DAY_S = 86400.0


class Strange(Effect):
    """An effect in no catalogue: its inputs are reported instead of parameters."""

    id = "unexplained"

    def parameters(self) -> Mapping[str, Parameter]:
        return {}


class StrangePerLeg(Strange, PerLeg):
    """One number per leg, mm at the largest value of what drives it."""

    def parameters(self) -> Mapping[str, Parameter]:
        return {f"amount_{leg}": (float(self.amount[leg - 1]), "mm") for leg in self.legs}

    @property
    def own_drives(self) -> tuple[str, ...]:
        return tuple(f"rho{leg}_mm" for leg in self.legs)


def column_of(setting: Setting, name: str) -> Array:
    """A column of the configurations (N,), less its mean, over its largest departure from it."""
    schedule = setting.schedule
    known = {"time_s": schedule.time_s, "temperature_c": schedule.temperature_c, **schedule.further}
    away = known[name] - known[name].mean()
    return away / np.abs(away).max()


def _over_stroke(drho: Array) -> Array:
    return drho / np.abs(drho).max()


@dataclass(frozen=True)
class ReadingsFollow(StrangePerLeg):
    """Swelling housings: what actuators indicate follows a column, humidity for one."""

    column: str

    @property
    def drivers(self) -> tuple[str, ...]:
        return (self.column,)

    def drive(self, drho: Array, setting: Setting) -> Array:
        return drho + column_of(setting, self.column)[:, None] * self.amount


@dataclass(frozen=True)
class CrossCoupling(StrangePerLeg):
    """The common bench bends: the neighbour's displacement adds to the actuator's own."""

    @property
    def drivers(self) -> tuple[str, ...]:
        count = len(self.amount)
        return tuple(f"rho{leg % count + 1}_mm" for leg in self.legs)

    def drive(self, drho: Array, setting: Setting) -> Array:
        return drho + self.amount * np.roll(_over_stroke(drho), -1, axis=1)


@dataclass(frozen=True)
class DriveProduct(StrangePerLeg):
    """An actuator yields with the product of two displacements."""

    pair: tuple[int, int]

    @property
    def drivers(self) -> tuple[str, ...]:
        return tuple(f"rho{leg}_mm" for leg in self.pair)

    def drive(self, drho: Array, setting: Setting) -> Array:
        first, second = (_over_stroke(drho)[:, leg - 1] for leg in self.pair)
        return drho + (first * second)[:, None] * self.amount


@dataclass(frozen=True)
class AttachmentsFollow(StrangePerLeg):
    """The platform bends: attachments shift along its z with a column, a load for one."""

    column: str

    @property
    def drivers(self) -> tuple[str, ...]:
        return (self.column,)

    def structure(self, machine: Machine, setting: Setting) -> None:
        shift = column_of(setting, self.column)[:, None] * self.amount
        move_attachments(machine, setting.marks, shift[..., None] * [0.0, 0.0, 1.0])


@dataclass(frozen=True)
class TimeOfDay(StrangePerLeg):
    """Legs breathe once in ``period`` seconds: sun through a window, an air conditioner."""

    period: float
    phase: float

    @property
    def drivers(self) -> tuple[str, ...]:
        return ("time_s",)

    def structure(self, machine: Machine, setting: Setting) -> None:
        wave = np.sin(2 * np.pi * setting.schedule.time_s / self.period + self.phase)
        machine.length += wave[:, None] * self.amount


@dataclass(frozen=True)
class FadingMemory(StrangePerLeg):
    """Hysteresis with memory: an actuator lags by its last moves, each forgotten by ``kept`` with every further one."""

    kept: float

    @property
    def drivers(self) -> tuple[str, ...]:
        return self.own_drives

    def drive(self, drho: Array, setting: Setting) -> Array:
        lag, still = np.zeros_like(drho), np.zeros(drho.shape[1])
        in_time = np.argsort(setting.schedule.time_s)
        before = drho[in_time[0]]
        for now in in_time:
            still = self.kept * still + (drho[now] - before)
            lag[now], before = still, drho[now]
        return drho - self.amount * lag / np.abs(lag).max()


@dataclass(frozen=True)
class Sticking(StrangePerLeg):
    """An actuator sticks beyond ``limit`` (of the largest displacement): it stays behind what it indicates."""

    limit: float

    @property
    def drivers(self) -> tuple[str, ...]:
        return self.own_drives

    def drive(self, drho: Array, setting: Setting) -> Array:
        beyond = np.maximum(_over_stroke(drho) - self.limit, 0.0) / (1 - self.limit)
        return drho - self.amount * beyond


@dataclass(frozen=True)
class WarmingScrew(StrangePerLeg):
    """The leadscrew's pitch grows with temperature: a gain that is the product of drive and temperature."""

    @property
    def drivers(self) -> tuple[str, ...]:
        return (*self.own_drives, "temperature_c")

    def drive(self, drho: Array, setting: Setting) -> Array:
        return drho + self.amount * _over_stroke(drho) * column_of(setting, "temperature_c")[:, None]


@dataclass(frozen=True)
class RefractingAir(Strange):
    """The scale of the measurement follows the pressure of the air by ``scale`` at its largest departure."""

    scale: float

    @property
    def drivers(self) -> tuple[str, ...]:
        return ("pressure_hpa",)

    def instrument(self, points: Array, body_poses: BodyPoses, setting: Setting) -> Array:
        return points * (1 + self.scale * column_of(setting, "pressure_hpa")[:, None, None])


@dataclass(frozen=True)
class WanderingTarget(Strange):
    """One target's holder bends with a column, by ``shift`` (mm, body frame) at its largest departure."""

    body: str
    target: str
    shift: tuple[float, float, float]
    column: str

    @property
    def subject(self) -> str:
        return f"target {self.target}"

    @property
    def drivers(self) -> tuple[str, ...]:
        return (self.column,)

    def instrument(self, points: Array, body_poses: BodyPoses, setting: Setting) -> Array:
        turn = body_poses.turn[:, BODIES.index(self.body)]
        moved = points.copy()
        way = column_of(setting, self.column)[:, None] * np.array(self.shift)
        moved[:, setting.marks.index(self.body, self.target)] += rotate(turn, way)
        return moved


@dataclass(frozen=True)
class GrowingNoise(Strange):
    """Shimmering air: the noise of all points is exp(``growth`` x column) times the instrument's."""

    growth: float
    column: str

    @property
    def drivers(self) -> tuple[str, ...]:
        return (self.column,)

    def scatter(self, scatter: Array, setting: Setting) -> Array:
        return scatter * np.exp(self.growth * column_of(setting, self.column))[:, None]


@dataclass(frozen=True)
class VibratingTarget(Strange):
    """One target trembles: its noise is ``times`` the instrument's, whatever else is."""

    body: str
    target: str
    times: float

    @property
    def subject(self) -> str:
        return f"target {self.target}"

    def scatter(self, scatter: Array, setting: Setting) -> Array:
        trembling = scatter.copy()
        trembling[:, setting.marks.index(self.body, self.target)] *= self.times
        return trembling
