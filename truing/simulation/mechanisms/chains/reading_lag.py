"""Cause `ChainReadingLag`: readings of a moving chain are late against the measured places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Parameter, Step
from truing.simulation.inputs import RATE
from truing.simulation.mechanisms.causes.reading_lag import PLAUSIBLE_LAG
from truing.simulation.mechanisms.chains.causes import ChainCause, ChainScene
from truing.simulation.mechanisms.chains.conditions import ChainInputs


@dataclass(frozen=True)
class ChainReadingLag(ChainCause):
    """The readings of all joints are as old as the lag when the tip is measured."""

    id = "reading-lag"
    step = Step.DRIVE
    is_persistent = False

    def candidates(self, scene: ChainScene) -> Sequence[ChainReadingLag]:
        """Return the cause if the chain was measured while it moved."""
        rate = scene.covariates.get(RATE)
        return (self,) if rate is not None and rate.any() else ()

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the lag, negative where the measured places are late."""
        return (PLAUSIBLE_LAG,)

    def deviations(self, machine: ChainInputs) -> NDArray:
        """Return the rates of the readings, 0 where no motion is known."""
        rate = machine.conditions.covariates.get(RATE, np.zeros(machine.readings.shape))
        return np.asarray(rate[..., None])
