"""What causes share that act on readings of a bench: which field they change, and what meets them downstream."""

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
# What is wrong of a channel and has a name of its own wants this many steps at least on either side.
FEWEST = 3


@dataclass(frozen=True)
class BenchScene(ChannelScene["ReadingCause"]):
    """What a campaign that loads a sensor offers to causes: B load steps and which readings of K channels there are."""

    steps: LoadSteps

    @property
    def covariates(self) -> Mapping[str, NDArray]:
        """The columns that are known of each step, (B,)."""
        return self.steps.covariates

    @property
    def size(self) -> tuple[int, int]:
        """The number of load steps B and of channels K."""
        return len(self.steps.run), len(self.steps.channels)

    @property
    def inputs(self) -> Mapping[str, NDArray]:
        """The loads (B,) along the axes that were loaded."""
        loads = zip(LOADS, self.steps.load.T, strict=True)
        return {name: values for name, values in loads if values.any()}


class ReadingCause(Cause[BenchScene]):
    """A cause that changes one field of a `ReadingState`: the wrench, the deflection, or the readings, by its step.

    The change may depend on that field, in proportion, and on nothing else that is not known of the steps.
    """

    def slopes(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return the derivative (B, ..., P) of its field by the parameters at values (P,), SI."""
        raise NotImplementedError

    def moved(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return by how much its field changes at values (P,); where that is linear in them, slopes times values."""
        return np.asarray(self.slopes(state, values) @ values)

    def passed_on(self, slopes: NDArray, state: ReadingState, values: NDArray) -> NDArray:
        """Return what becomes of changes (B, ..., Q) of its field that meet the effect: the same, if it only adds."""
        return slopes


def unit_of(channel: str) -> tuple[str, float]:
    """Return the unit of a channel's readings in the tables, and what one is in SI."""
    if channel not in CHANNELS:
        return "mV", MV
    return ("um", UM) if is_linear(channel) else ("arcsec", ARCSEC)


def is_linear(channel: str) -> bool:
    """Return whether a channel reads a displacement."""
    return channel in CHANNELS[:LINEAR]


def is_signal(channel: str) -> bool:
    """Return whether a channel is a signal of the sensor itself."""
    return channel not in CHANNELS


def whose(channel: str) -> str:
    """Return a channel as the tables name it as subject; all are named by nothing."""
    if not channel:
        return ""
    return f"signal {channel}" if is_signal(channel) else f"channel {channel}"


def at_channels(steps: LoadSteps, channel: str) -> NDArray:
    """Return which channels (K,) one name stands for: that one, or all linear ones."""
    return np.array([is_linear(name) if not channel else name == channel for name in steps.channels])


def is_force(axis: str) -> bool:
    """Return whether a load axis is that of a force."""
    return axis in AXES[:LINEAR]


def loaded_axes(scene: BenchScene) -> list[str]:
    """Return the axes that were loaded."""
    return [axis for axis, loaded in zip(AXES, scene.steps.loaded, strict=True) if loaded]


def read_channels(scene: BenchScene) -> list[str]:
    """Return the channels that were read."""
    names = scene.steps.channels
    return [names[place] for place in np.flatnonzero(scene.recorded.sum(0))]
