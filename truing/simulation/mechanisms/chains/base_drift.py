"""Cause `BaseDrift`: the base of a chain moves steadily against the instrument."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Parameter, Step
from truing.simulation.inputs import ORDER, TIME
from truing.simulation.mechanisms.chains.causes import ChainCause, ChainScene
from truing.simulation.mechanisms.chains.conditions import ChainInputs

_MM = 1e-3  # metres of a millimetre
MOTION = (
    *(Parameter(f"d{axis}", "mm", 1e-4, _MM) for axis in "xyz"),
    *(Parameter(f"turn_{axis}", "rad", 1e-4) for axis in "xyz"),
)


@dataclass(frozen=True)
class BaseDrift(ChainCause):
    """The base moves steadily against the instrument, in one series or all; parameters: from its first to last pose."""

    id = "base-drift"
    step = Step.INSTRUMENT
    is_persistent = False

    start: float = 0.0
    span: float = 1.0
    column: str = ORDER

    def candidates(self, scene: ChainScene) -> Sequence[BaseDrift]:
        """Return the drift with time, or with the order of poses if times are unknown."""
        covariates = scene.covariates
        column = TIME if TIME in covariates else ORDER
        values = covariates[column]
        if not np.isfinite(values).all() or not np.ptp(values) > 0.0:
            return ()
        return (replace(self, start=float(values.min()), span=float(np.ptp(values)), column=column),)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the motion from the first to the last pose, in the frame of the base."""
        return MOTION

    def twists(self, machine: ChainInputs) -> NDArray:
        """Return the motion in proportion to time."""
        share = (machine.conditions.covariates[self.column] - self.start) / self.span
        return machine.at_node(0, share[:, None, None] * np.eye(6))
