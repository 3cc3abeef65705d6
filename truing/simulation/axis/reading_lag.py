"""Cause `AxisReadingLag`: readings of a moving axis are late against its commands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.simulation.axis.causes import AxisScene, ElementCause
from truing.simulation.axis.rows import Axis, AxisRows
from truing.simulation.cause import Parameter, Step
from truing.simulation.mechanisms.causes.reading_lag import PLAUSIBLE_LAG


@dataclass(frozen=True)
class AxisReadingLag(ElementCause):
    """An encoder, or all of them, reads where the axis was sent the lag before.

    A clock of its own makes an encoder late, following error makes all of them late. ``element``: the encoder; empty:
    all with the same lag.
    """

    element: str = ""

    id = "reading-lag"
    step = Step.DRIVE
    is_persistent = False

    def candidates(self, scene: AxisScene) -> Sequence[AxisReadingLag]:
        """Return all encoders together, and each of several, if the axis was recorded in motion."""
        encoders = scene.axis.encoders
        if not scene.rows.rate.any() or not encoders:
            return ()
        return [replace(self, element=name) for name in ("", *(encoders if len(encoders) > 1 else ()))]

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the lag, negative where the readings are early."""
        return (PLAUSIBLE_LAG,)

    def slopes(self, rows: AxisRows, axis: Axis) -> NDArray:
        """Return minus the rate of the command, for the encoders concerned."""
        late = np.array([not self.element or name == self.element for name in axis.encoders], float)
        return (-rows.rate[:, None] * late)[..., None]
