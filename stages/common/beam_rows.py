"""Linear relation between channels and platform motion, from the declared beams."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from truing.arrays import Array
from truing.estimation.interferometry.recorded_steps import CHANNELS, angular_rows, linear_rows

if TYPE_CHECKING:
    from truing.schemas.interferometer import Beams, RotationAxis

_MM = 1e-3
LINEAR = 3  # channels ahead of the angular ones


def channel_rows(beams: Beams) -> Array:
    """Matrix (6, 6) from displacement (m) and rotation vector (rad) of the platform's origin to channels."""
    rows = []
    for k, name in enumerate(CHANNELS):
        beam = getattr(beams, name)
        rows.append(
            linear_rows(beam_direction(k, beam), _MM * np.array(beam.arm_mm))
            if k < LINEAR
            else angular_rows(beam_direction(k, beam))
        )
    return np.stack(rows)


def beam_direction(k: int, beam: RotationAxis) -> Array:
    """Direction (3,) in which a channel, by number, counts positive."""
    return np.eye(LINEAR)[k % LINEAR] if beam.direction is None else np.array(beam.direction)
