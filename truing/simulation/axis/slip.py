"""Cause `EncodersDisagree`: the encoders at motor and load diverge in proportion to the path that the axis travels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.simulation.axis.causes import AxisScene, ElementCause, shown_elements
from truing.simulation.axis.rows import LOAD, MEASURED, MOTOR, TRANSMISSION, Axis, AxisRows
from truing.simulation.cause import Parameter, Step
from truing.simulation.inputs import Missing

_PLAUSIBLE_SLIP = 1e-4
# The drive, or the encoder at the load. An error of the motor encoder has the signature of the drive.
_ELEMENTS = (TRANSMISSION, LOAD)
# Least part of the path, relative to its spread, that neither time, order nor command reproduces.
_DISTINCT = 0.1


@dataclass(frozen=True)
class EncodersDisagree(ElementCause):
    """Slip, or lost counts: motor and load encoder part by slip x path travelled since the first row.

    ``is_witnessed``: an outside instrument shows which of the two encoders is right. Slip in movements up alone is half
    as much in all movements, and a scale error.
    """

    element: str = TRANSMISSION
    is_witnessed: bool = False

    id = "encoders-disagree"
    step = Step.STRUCTURE
    share = 0.2  # a drift is likelier, and almost like it where time and path grow together
    is_persistent = False

    def missing_input(self, scene: AxisScene) -> Missing | None:
        """Return both encoders, or a path that time, order and command do not reproduce."""
        return Missing.UNEVEN_PATH if {MOTOR, LOAD} <= set(scene.axis.encoders) else Missing.BOTH_ENCODERS

    def candidates(self, scene: AxisScene) -> Sequence[EncodersDisagree]:
        """Return drive and load encoder, if both were recorded."""
        axis = scene.axis
        if not {MOTOR, LOAD} <= set(axis.encoders) or _distinct(scene.rows) < _DISTINCT:
            return ()
        with_axis = replace(self, kind_of_axis=axis.kind, is_witnessed=MEASURED in axis.encoders)
        with_axis = replace(with_axis, plausible=axis.spread / float(np.ptp(scene.rows.travelled)))
        return [replace(with_axis, element=name) for name in shown_elements(axis, _ELEMENTS)]

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the change of the difference per path."""
        return (Parameter("slip", "1", max(_PLAUSIBLE_SLIP, self.plausible)),)

    def slopes(self, rows: AxisRows, axis: Axis) -> NDArray:
        """Return the path, for the encoders that respond."""
        return np.asarray((rows.travelled[:, None] * axis.response(self.element))[..., None])


def _distinct(rows: AxisRows) -> float:
    """Return the part of the path that time, order and command do not reproduce, relative to its spread; 0 without
    movement."""
    path = rows.travelled
    columns = [np.ones_like(path), rows.command, rows.order, rows.time_s]
    scaled = [(column - column.mean()) / (np.std(column) or 1.0) for column in columns[1:] if np.isfinite(column).all()]
    design = np.stack([columns[0], *scaled], 1)
    residual = path - design @ np.linalg.lstsq(design, path, rcond=None)[0]
    return float(np.std(residual) / (np.std(path) or 1.0))
