"""Base class `ReadingCause` of causes that act on a bench, their scene `BenchScene`, and names of channels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.load_steps import CHANNELS, LINEAR, LOADS, LoadSteps, ReadingState
from truing.simulation.bench.six_upur.loading import AXES
from truing.simulation.cause import Cause, ChannelScene, Step

FIELDS = {Step.DRIVE: "wrench", Step.STRUCTURE: "deflection", Step.INSTRUMENT: "readings"}
ARCSEC = np.pi / 180.0 / 3600.0
UM, MV, MM, HOUR = 1e-6, 1e-3, 1e-3, 3600.0
# Least number of steps on either side of an onset, for a cause on a single channel.
FEWEST_READINGS = 3


@dataclass(frozen=True)
class BenchScene(ChannelScene["ReadingCause"]):
    """Scene of causes that act on a bench: B load steps, and the mask of existing readings of K channels."""

    steps: LoadSteps

    @property
    def covariates(self) -> Mapping[str, NDArray]:
        """Columns (B,) known at each step."""
        return self.steps.covariates

    @property
    def size(self) -> tuple[int, int]:
        """Number of load steps B and of channels K."""
        return len(self.steps.run), len(self.steps.channels)

    @property
    def inputs(self) -> Mapping[str, NDArray]:
        """Loads (B,) along the axes that were loaded."""
        loads = zip(LOADS, self.steps.load.T, strict=True)
        return {name: values for name, values in loads if values.any()}


class ReadingCause(Cause[BenchScene]):
    """Base class of causes that change one field of a `ReadingState` by their step: wrench, deflection or readings.

    The change may be proportional to that field; otherwise it may depend only on known data of the load steps.
    """

    def slopes(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return the derivative (B, ..., P) of its field by the parameters at values (P,), SI."""
        raise NotImplementedError

    def channel_slopes(self, steps: LoadSteps) -> tuple[NDArray, NDArray] | None:
        """Return the mask (K,) of the channels whose readings it changes, and the derivative (B, P) of each, where the
        load steps alone determine it; None for other causes."""
        return None

    def moved(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return the change of its field at values (P,); for a linear cause, slopes times values."""
        return np.asarray(self.slopes(state, values) @ values)

    def passed_on(self, slopes: NDArray, state: ReadingState, values: NDArray) -> NDArray:
        """Return earlier changes (B, ..., Q) of its field after the effect; unchanged if the effect only adds."""
        return slopes


def unit_of(channel: str) -> tuple[str, float]:
    """Return the unit of a channel's readings in the tables, and its SI value."""
    if channel not in CHANNELS:
        return "mV", MV
    return ("um", UM) if is_linear(channel) else ("arcsec", ARCSEC)


def is_linear(channel: str) -> bool:
    """True if a channel reads a displacement."""
    return channel in CHANNELS[:LINEAR]


def is_signal(channel: str) -> bool:
    """True if a channel is a signal of the sensor itself."""
    return channel not in CHANNELS


def channel_subject(channel: str) -> str:
    """Return the subject of a channel as in the tables; empty for all channels."""
    if not channel:
        return ""
    return f"signal {channel}" if is_signal(channel) else f"channel {channel}"


def at_channels(steps: LoadSteps, channel: str) -> NDArray:
    """Return the mask (K,) of the channels of a name; of all linear ones if it is empty."""
    return np.array([is_linear(name) if not channel else name == channel for name in steps.channels])


def is_force(axis: str) -> bool:
    """True if a load axis is that of a force."""
    return axis in AXES[:LINEAR]


def loaded_axes(scene: BenchScene) -> list[str]:
    """Return the axes that were loaded."""
    return [axis for axis, loaded in zip(AXES, scene.steps.loaded, strict=True) if loaded]


def read_channels(scene: BenchScene) -> list[str]:
    """Return the channels that were read."""
    names = scene.steps.channels
    return [names[index] for index in np.flatnonzero(scene.recorded.sum(0))]
