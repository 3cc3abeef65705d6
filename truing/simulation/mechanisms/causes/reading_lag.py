"""Cause `ReadingLag`: readings of a moving machine are late against the measured poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Parameter, Step
from truing.simulation.change import Change
from truing.simulation.inputs import RATE
from truing.simulation.mechanisms.point_causes import PointCause, PointScene
from truing.simulation.mechanisms.state import State

PLAUSIBLE_LAG = Parameter("lag", "s", 0.05)


@dataclass(frozen=True)
class ReadingLag(PointCause):
    """All readings are as old as the lag when the pose is measured; a machine that stands still does not show it."""

    id = "reading-lag"
    step = Step.DRIVE
    reads = frozenset()
    is_persistent = False

    def candidates(self, scene: PointScene) -> Sequence[ReadingLag]:
        """Return the cause if the machine was measured while it moved."""
        return (self,) if scene.varies(RATE) else ()

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the lag, negative where the poses are late."""
        return (PLAUSIBLE_LAG,)

    def change(self, state: State, values: NDArray) -> Change:
        """Return d rho / d lag: the rate of the readings, 0 where no motion is known."""
        rate = state.covariates.get(RATE, np.zeros(state.rho.shape))
        return Change({"rho": rate[..., None]}, 1)
