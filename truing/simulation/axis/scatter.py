"""Cause `AxisScatter`: an axis stops at random positions when it comes from one side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.inference.model import ScatterCandidate
from truing.simulation.axis.causes import AxisScene, ElementCause
from truing.simulation.axis.rows import TRANSMISSION, Axis, AxisRows
from truing.simulation.cause import Parameter, Step
from truing.simulation.inputs import Missing

_FEWEST = 6  # rows from either side


@dataclass(frozen=True)
class AxisScatter(ElementCause):
    """The axis stops at random positions when it comes up (``direction`` 1) or down (-1).

    ``element`` is the transmission, whose load then stands at random behind the motor; or empty: the axis as a whole,
    about its command. Equal scatter from both sides is larger noise.
    """

    element: str = TRANSMISSION
    direction: int = 0

    id = "approach-scatter"
    step = Step.DRIVE
    is_persistent = False
    lacking = Missing.APPROACH

    def candidates(self, scene: AxisScene) -> Sequence[AxisScatter]:
        """Return none: scatter has no mean effect."""
        return ()

    def scatters(self, scene: AxisScene) -> Sequence[ScatterCandidate[AxisScatter]]:
        """Return each input of the rows, from each side."""
        sides = [(direction, scene.rows.direction == direction) for direction in (1, -1)]
        if min(came.sum() for _, came in sides) < _FEWEST:
            return ()
        with_axis = replace(self, kind_of_axis=scene.axis.kind)
        return [
            ScatterCandidate(replace(with_axis, element=name, direction=direction), came[:, None] & mark, True)
            for name, mark in zip(scene.stops, np.eye(len(scene.stops), dtype=bool), strict=True)
            for direction, came in sides
        ]

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the scatter, one sigma in addition to the declared noise."""
        return (self._length("scatter"),)

    def slopes(self, rows: AxisRows, axis: Axis) -> NDArray:
        """Return zero: there is no mean effect."""
        return np.zeros((len(rows.command), len(axis.encoders), 1))
