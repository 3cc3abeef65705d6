"""Uncertainty of the declared beam geometry."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from truing.arrays import Array
from truing.estimation.interferometry.recorded_steps import CHANNELS
from truing.simulation.bench.known_readings import Optics
from truing.stages.common.beam_rows import LINEAR, beam_direction, channel_rows

if TYPE_CHECKING:
    from truing.schemas.interferometer import Beams, Interferometer, RotationAxis


_MM = 1e-3


def declared_optics(section: Interferometer) -> Optics:
    """Cosine and Abbe terms of every channel, with their uncertainties and that of the frame's expansion."""
    growth = [
        _MM * abs(expansion.length_mm) * expansion.expansion_sigma_per_k * np.eye(len(CHANNELS))[k]
        for k, name in enumerate(CHANNELS[:LINEAR])
        if (expansion := getattr(section.material, name)) is not None
        and expansion.length_mm * expansion.expansion_sigma_per_k
    ]
    beams = beam_optics(section.beams)
    return replace(beams, growth=np.stack(growth)) if growth else beams


def beam_optics(beams: Beams) -> Optics:
    """Cosine and Abbe terms alone."""
    changes = [change for k, name in enumerate(CHANNELS) for change in _changes(k, getattr(beams, name))]
    plain = Optics.plain()
    return Optics(channel_rows(beams), np.stack(changes) if changes else plain.by_angle, plain.growth)


def _changes(k: int, beam: RotationAxis) -> list[Array]:
    """Change of the rows (6, 6) per sigma of a channel's transverse angles, and of its arm across it."""
    direction = beam_direction(k, beam)
    across = np.linalg.svd(direction[None])[2][1:]  # (2, 3)
    turned = np.zeros((2, 6))
    if k < LINEAR:
        arm, arm_sigma = _MM * np.array(beam.arm_mm), _MM * beam.arm_sigma_mm  # type: ignore[attr-defined]
        unit = direction / np.linalg.norm(direction)
        turned[:, :LINEAR], turned[:, LINEAR:] = across, np.cross(arm, across)
        shifted = np.column_stack([np.zeros((2, LINEAR)), np.cross(across, unit)])
    else:
        turned[:, LINEAR:], shifted, arm_sigma = across, np.zeros((2, 6)), 0.0
    sigma = np.concatenate([beam.direction_sigma_rad * turned, arm_sigma * shifted])
    return [np.outer(np.eye(len(CHANNELS))[k], row) for row in sigma if row.any()]
