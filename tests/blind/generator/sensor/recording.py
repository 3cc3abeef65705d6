"""Hidden effects in recorded readings and signals: beams, air, zeros, fringes, bridges that leak, rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tests.blind.generator.named_effect import Parameter
from tests.blind.generator.quaternions import Array, unit
from tests.blind.generator.sensor import air
from tests.blind.generator.sensor.effects import XYZ, Effect, Setting
from tests.blind.generator.sensor.layout import AXES, CHANNELS, FILE_UNIT, UNITS
from tests.blind.generator.sensor.schedule import HOUR_S


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
        first = 3 * (self.channel // 3)
        towards = {f"tilt_{CHANNELS[first + k]}": self.angle * part for k, part in enumerate(self.aside) if part}
        return {"angle": (self.angle, "rad"), **{name: (tilt, "rad") for name, tilt in towards.items()}}

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
    """Air changes its index over an unknown path of the beam, m."""

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
class ZeroStep(Effect):
    """From a step on until the end of the run, readings (6,), m and rad, and signals (C,), mV, stand elsewhere."""

    run: int
    from_step: int
    readings: tuple[float, ...] = ()
    signals: tuple[float, ...] = ()
    id = "zero-step"

    def _moved(self) -> list[tuple[str, str, float, str]]:
        """Channels or signals with their word, amount and unit."""
        rows = [("channel", CHANNELS[k], value / FILE_UNIT[k], UNITS[k]) for k, value in enumerate(self.readings)]
        rows += [("signal", f"v{k + 1}", value, "mV") for k, value in enumerate(self.signals)]
        return [row for row in rows if row[2]]

    @property
    def subject(self) -> str:
        moved = self._moved()
        several = "signals" if self.signals else "displacements"
        return f"run {self.run} {' '.join(moved[0][:2]) if len(moved) == 1 else several}"

    def parameters(self) -> Mapping[str, Parameter]:
        moved = self._moved()
        named = {("shift" if len(moved) == 1 else f"shift_{name}"): (value, unit) for _, name, value, unit in moved}
        return {**named, "from_step": (float(self.from_step), "1")}

    def _late(self, setting: Setting) -> Array:
        schedule = setting.schedule
        return (schedule.run == self.run) & (schedule.step >= self.from_step)

    def instrument(self, readings: Array, moved: Array, setting: Setting) -> Array:
        return readings + np.outer(self._late(setting), self.readings) if self.readings else readings

    def electric(self, signals: Array, setting: Setting) -> Array:
        return signals + np.outer(self._late(setting), self.signals) if self.signals else signals


@dataclass(frozen=True)
class NoisyRun(Effect):
    """The noise of all displacements is ``times`` the instrument's in one run; ``alone`` is the only channel there."""

    run: int
    times: float
    alone: int | None = None
    id = "noise-burst"

    @property
    def subject(self) -> str:
        return f"run {self.run} {'displacements' if self.alone is None else f'channel {CHANNELS[self.alone]}'}"

    def parameters(self) -> Mapping[str, Parameter]:
        return {"noise_ratio": (self.times, "1")}

    def scatter(self, scatter: Array, setting: Setting) -> Array:
        return scatter * np.where(setting.schedule.run == self.run, self.times, 1.0)[:, None]


@dataclass(frozen=True)
class Crosstalk(Effect):
    """A signal channel carries a fraction of another; both given by their place."""

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
class SignalNonlinear(Effect):
    """A signal bends away from its line: with its square (1/mV) and its cube (1/mV^2) from where it is unloaded, and by
    ``coupled`` (6, 6), mV, times the shares of every two loads."""

    signal: int
    quadratic: float = 0.0
    cubic: float = 0.0
    coupled: tuple[tuple[float, ...], ...] = ()
    id = "signal-nonlinear"

    @property
    def subject(self) -> str:
        return f"signal v{self.signal + 1}"

    def parameters(self) -> Mapping[str, Parameter]:
        own = {"quadratic": (self.quadratic, "1/mV"), "cubic": (self.cubic, "1/mV^2")}
        both = {
            f"{AXES[i]}_{AXES[j]}": (value, "mV") for i, row in enumerate(self.coupled) for j, value in enumerate(row)
        }
        return {name: (value, unit) for name, (value, unit) in {**own, **both}.items() if value}

    def electric(self, signals: Array, setting: Setting) -> Array:
        schedule, bent = setting.schedule, signals.copy()
        own = signals[:, self.signal] - signals[~np.any(schedule.load, axis=1), self.signal].mean()
        bent[:, self.signal] += self.quadratic * own**2 + self.cubic * own**3
        if self.coupled:
            loads = schedule.load / schedule.limit
            bent[:, self.signal] += np.einsum("si,ij,sj->s", loads, np.array(self.coupled), loads)
        return bent


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


def _plus(readings: Array, channel: int, more: Array) -> Array:
    changed = readings.copy()
    changed[:, channel] += more
    return changed


def across(channel: int, towards: float) -> tuple[float, float, float]:
    """The unit vector across a channel's axis in the direction ``towards``, rad."""
    way = np.zeros(3)
    way[(channel + 1) % 3], way[(channel + 2) % 3] = np.cos(towards), np.sin(towards)
    return tuple(unit(way).tolist())
