"""Causes: drift of single channels with time, temperature, or the refractive index of air; base classes of such
causes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.causes.reading_causes import (
    FEWEST_READINGS,
    HOUR,
    MM,
    BenchScene,
    ReadingCause,
    at_channels,
    channel_subject,
    is_linear,
    is_signal,
    read_channels,
    unit_of,
)
from truing.simulation.bench.load_steps import AIR, MATERIAL, PRESSURE, LoadSteps, ReadingState
from truing.simulation.cause import Parameter, Step
from truing.simulation.inputs import TIME, Missing

# Plausible drift per hour in the channel's unit, and per kelvin: of displacements (0.3 m of steel), rotations, signals.
_PER_HOUR, _SIGNAL_PER_HOUR = 1.0, 0.05  # signals in mV
_PER_KELVIN = {"um": 3.0, "arcsec": 1.0, "mV": 0.05}
_PLAUSIBLE_PATH_M = 0.5
_BOTH = (MATERIAL, AIR)
_NAMES = {MATERIAL: "per_k_material", AIR: "per_k_air"}
# Prior weights: drift in a single run relative to all runs; two temperatures relative to one.
_RUN_SHARE, _TWO_SHARE = 0.5, 0.5
_ALL_SHARE = 0.5


class ChannelCause(ReadingCause):
    """A cause that acts on the readings of a ``channel``, or of all linear channels if empty."""

    channel: str
    step = Step.INSTRUMENT

    @property
    def subject(self) -> str:
        """Channel; empty for all linear ones."""
        return channel_subject(self.channel)

    @property
    def family(self) -> str:
        """Kind and channel."""
        return f"{self.id} {self.channel}".strip()

    def excludes(self, other: ReadingCause) -> bool:
        """True if the other cause is of the same kind and shares a channel with this one."""
        if not isinstance(other, ChannelCause) or self.id != other.id:
            return False
        own_channel, other_channel = self.channel, other.channel
        return (
            own_channel == other_channel
            or (not own_channel and is_linear(other_channel))
            or (not other_channel and is_linear(own_channel))
        )

    def prior(self, scene: BenchScene) -> float:
        """Return the relative prior weight of a channel, or of all linear ones together."""
        return 1.0 if self.channel else _ALL_SHARE * len(read_channels(scene))


class ChannelCourse(ChannelCause):
    """A cause that changes the readings of its channels equally; the load steps alone determine the course."""

    def along(self, steps: LoadSteps) -> NDArray:
        """Return the derivative (B, P) of the readings."""
        raise NotImplementedError

    def channel_slopes(self, steps: LoadSteps) -> tuple[NDArray, NDArray]:
        """Return its channels and the derivative of their readings."""
        return at_channels(steps, self.channel), self.along(steps)

    def slopes(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return the same derivative of all readings, zero for other channels."""
        response, along = self.channel_slopes(state.steps)
        return np.asarray(along[:, None] * response[:, None])


class RunChannelCause(ChannelCourse):
    """A cause that acts on a channel in a run; ``lone``: no other channel of the platform was read in this run."""

    run: int | str
    lone: bool

    @property
    def in_run(self) -> str:
        """Run, with its channel if there are several."""
        return f"run {self.run}" if self.lone else f"run {self.run} {channel_subject(self.channel)}"

    @property
    def affected_part(self) -> str:
        """Channel, in whichever run."""
        return channel_subject(self.channel)

    @property
    def family(self) -> str:
        """Kind, channel and run."""
        return f"{self.id} {self.channel} {self.run}".strip()

    def excludes(self, other: ReadingCause) -> bool:
        """True if the other is the same: a run may also drift with its channel, or lose fringes twice."""
        return self.key == other.key


@dataclass(frozen=True)
class ZeroDrift(RunChannelCause):
    """The zero of a channel drifts linearly from the start of each run, or of ``run`` only.

    ``scale_per_s``: a plausible rate.
    """

    channel: str = "dz"
    run: int | str = ""
    of_run: bool = False
    lone: bool = False
    scale_per_s: float = 1e-6 / HOUR

    id = "zero-drift"
    lacking = Missing.TIME
    reach = 30.0
    is_persistent = False

    @property
    def subject(self) -> str:
        """Channel, or run, with its channel if there are several."""
        return self.in_run if self.of_run else channel_subject(self.channel)

    @property
    def key(self) -> str:
        """Unique name of the candidate."""
        return f"{self.family} {'run' if self.of_run else 'all'}"

    def candidates(self, scene: BenchScene) -> Sequence[ZeroDrift]:
        """Return every channel and signal, and every channel of every run, with at least three readings; none
        without times."""
        steps, is_observed = scene.steps, scene.recorded
        if not steps.is_timed or steps.longest_s <= 0.0:
            return ()
        zero_drifts: list[ZeroDrift] = [
            ZeroDrift(channel, scale_per_s=_rate(channel, steps)) for channel in read_channels(scene)
        ]
        runs = np.flatnonzero(steps.rank == 0)
        for code, first in enumerate(runs if len(runs) > 1 else ()):
            within = dict(zip(steps.channels, is_observed[steps.code == code].sum(0).tolist(), strict=True))
            read = [channel for channel, count in within.items() if count and not is_signal(channel)]
            label = steps.run[first].item()
            known = [channel for channel, count in within.items() if count > FEWEST_READINGS and not is_signal(channel)]
            zero_drifts += [ZeroDrift(c, label, True, read == [c], _rate(c, steps)) for c in known]
        return zero_drifts

    def prior(self, scene: BenchScene) -> float:
        """Return the weight: all runs of a channel together are as probable as the single runs together."""
        if not self.of_run:
            return 1.0
        runs = len(np.unique(scene.steps.code))
        return _RUN_SHARE / max(runs, 1)

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return the time."""
        return (TIME,)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the rate per hour."""
        unit, si = unit_of(self.channel)
        return (Parameter("rate", f"{unit}/h", self.scale_per_s, si / HOUR),)

    def along(self, steps: LoadSteps) -> NDArray:
        """Return d readings / d rate: the time since the run's start, s."""
        passed = np.where(steps.run == self.run, steps.in_run_s, 0.0) if self.of_run else steps.in_run_s
        return np.asarray(passed[:, None])


@dataclass(frozen=True)
class ThermalDrift(ChannelCourse):
    """A channel's reading depends on temperatures of material and air, relative to the first step of each run."""

    channel: str = "dz"
    columns: tuple[str, ...] = (MATERIAL,)

    id = "thermal-drift"
    lacking = Missing.TEMPERATURE
    reach = 30.0

    def candidates(self, scene: BenchScene) -> Sequence[ThermalDrift]:
        """Return every channel, and all linear ones together, with each temperature that varies, and with both."""
        steps = scene.steps
        known = [column for column in _BOTH if steps.varies(column)]
        forms = [(column,) for column in known] + ([_BOTH] if len(known) == len(_BOTH) else [])
        channels = read_channels(scene)
        several = sum(is_linear(channel) for channel in channels) > 1
        return [ThermalDrift(c, form) for c in ([""] if several else []) + channels for form in forms]

    def prior(self, scene: BenchScene) -> float:
        """Return the relative prior weight of a channel with one temperature, or two."""
        return super().prior(scene) * (_TWO_SHARE if len(self.columns) > 1 else 1.0)

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return the temperatures."""
        return self.columns

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the drift per kelvin of each temperature."""
        unit, si = unit_of(self.channel or "dx")
        scale = _PER_KELVIN[unit] * si
        return tuple(Parameter(_NAMES[column], f"{unit}/K", scale, si) for column in self.columns)

    def along(self, steps: LoadSteps) -> NDArray:
        """Return d readings / d drift: the temperatures minus those of the run's first step."""
        return np.stack([steps.since_first(column) for column in self.columns], -1)


@dataclass(frozen=True)
class DeadPath(ChannelCourse):
    """The refractive index of air changes the length of an uncompensated path, relative to the start of each run."""

    channel: str = ""

    id = "dead-path"
    reach = 30.0  # a forgotten path may be metres long

    def candidates(self, scene: BenchScene) -> Sequence[DeadPath]:
        """Return every linear channel, and all of them together, if the index of air is known to vary."""
        if not scene.steps.air_varies:
            return ()
        return [DeadPath(channel) for channel in linear_or_all(scene)]

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return the air's temperature and pressure."""
        return (AIR, PRESSURE)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the length of the path."""
        return (Parameter("dead_path", "mm", _PLAUSIBLE_PATH_M, MM),)

    def along(self, steps: LoadSteps) -> NDArray:
        """Return d readings / d path: the index minus that of the run's first step."""
        return np.asarray(steps.index_since_first[:, None])


def linear_or_all(scene: BenchScene) -> list[str]:
    """Return every linear channel that was read; before them, if there are several, the empty name for all."""
    linear = [channel for channel in read_channels(scene) if is_linear(channel)]
    return ([""] if len(linear) > 1 else []) + linear


def _rate(channel: str, steps: LoadSteps) -> float:
    """Return a plausible rate of a channel's zero, SI per second; in runs shorter than an hour, it is larger."""
    plausible = (_SIGNAL_PER_HOUR if is_signal(channel) else _PER_HOUR) * unit_of(channel)[1]
    return float(plausible / min(HOUR, steps.longest_s))
