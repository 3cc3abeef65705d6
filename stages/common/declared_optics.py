"""The geometry of beams that campaign.toml declares, as rows by which channels follow the platform's motion."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from truing.arrays import Array
from truing.estimation.interferometry.recorded_steps import CHANNELS, angular_rows, linear_rows
from truing.simulation.bench.known_readings import Optics

if TYPE_CHECKING:
    from truing.schemas.interferometer import Axis, Beams, Interferometer


_MM = 1e-3
_LINEAR = 3


def declared_optics(section: Interferometer) -> Optics:
    """Cosine and Abbe terms of every channel, and what sigmas leave open of them and of the frame's growth."""
    growth = [
        _MM * abs(own.length_mm) * own.expansion_sigma_per_k * np.eye(len(CHANNELS))[k]
        for k, name in enumerate(CHANNELS[:_LINEAR])
        if (own := getattr(section.material, name)) is not None and own.length_mm * own.expansion_sigma_per_k
    ]
    beams = beam_optics(section.beams)
    return replace(beams, growth=np.stack(growth)) if growth else beams


def beam_optics(beams: Beams) -> Optics:
    """Cosine and Abbe terms alone."""
    changes = [change for k, name in enumerate(CHANNELS) for change in _changes(k, getattr(beams, name))]
    plain = Optics.plain()
    return Optics(channel_rows(beams), np.stack(changes) if changes else plain.by_angle, plain.growth)


def channel_rows(beams: Beams) -> Array:
    """Rows (6, 6) by which channels follow displacement (m) and rotation vector (rad) of the platform's origin."""
    found = []
    for k, name in enumerate(CHANNELS):
        beam = getattr(beams, name)
        found.append(
            linear_rows(_direction(k, beam), _MM * np.array(beam.arm_mm))
            if k < _LINEAR
            else angular_rows(_direction(k, beam))
        )
    return np.stack(found)


def _direction(k: int, beam: Axis) -> Array:
    return np.eye(_LINEAR)[k % _LINEAR] if beam.direction is None else np.array(beam.direction)


def _changes(k: int, beam: Axis) -> list[Array]:
    """How the rows (6, 6) change per sigma of a channel's angles across its direction, and of its arm across it."""
    direction = _direction(k, beam)
    across = np.linalg.svd(direction[None])[2][1:]  # (2, 3)
    turned = np.zeros((2, 6))
    if k < _LINEAR:
        arm, arm_sigma = _MM * np.array(beam.arm_mm), _MM * beam.arm_sigma_mm  # type: ignore[attr-defined]
        unit = direction / np.linalg.norm(direction)
        turned[:, :_LINEAR], turned[:, _LINEAR:] = across, np.cross(arm, across)
        shifted = np.column_stack([np.zeros((2, _LINEAR)), np.cross(across, unit)])
    else:
        turned[:, _LINEAR:], shifted, arm_sigma = across, np.zeros((2, 6)), 0.0
    own = np.concatenate([beam.direction_sigma_rad * turned, arm_sigma * shifted])
    return [np.outer(np.eye(len(CHANNELS))[k], row) for row in own if row.any()]
