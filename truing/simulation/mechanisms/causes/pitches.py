"""The pitches of a leadscrew that a campaign's readings can tell apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SHORTEST_M, LONGEST_M = 0.2e-3, 5e-3
# Steps of frequency per turn more over the range of the displacements: no pitch falls between two of the grid.
_OVERSAMPLING = 2.5
# Waves are alike where each lies within this of the span of the other: the sine of the angle between the spans.
_ALIKE = 0.2
# Displacements over hundreds of turns tell more pitches apart than can be tried; the shortest are left out then.
MOST_PITCHES = 400


def pitch_spacing(moved: NDArray) -> float:
    """Return the spacing (1/m) of the grid of frequencies for displacements (B, L), m."""
    longest = float(np.ptp(moved, axis=0).max()) if len(moved) else 0.0
    return 1 / (_OVERSAMPLING * max(longest, SHORTEST_M))


def grid_size(moved: NDArray) -> int:
    """Return how many pitches from 0.2 to 5 mm displacements (B, L), m, could tell apart, wherever they stood."""
    return int(np.ceil((1 / SHORTEST_M - 1 / LONGEST_M) / pitch_spacing(moved))) + 1


def distinct_pitches(moved: NDArray) -> list[float]:
    """Return pitches (m) from 0.2 to 5 mm, longest first, whose waves of displacements (B, L) differ.

    Displacements on a few levels show the same waves for many pitches; of such, the longest stands for all. At most
    400.
    """
    first = 1 / LONGEST_M + pitch_spacing(moved) / 2
    frequencies = np.linspace(first, 1 / SHORTEST_M, grid_size(moved))[:MOST_PITCHES]
    alike = _alike(_spans(2 * np.pi * frequencies[:, None, None] * moved))
    kept: list[int] = []
    for wave in range(len(frequencies)):
        if not alike[wave, kept].any():
            kept.append(wave)
    return [1 / float(frequency) for frequency in frequencies[kept]]


def _spans(turns: NDArray) -> NDArray:
    """Return orthonormal bases (F, L, B, 2) of sine and cosine of turns (F, B, L) less means; zero for none."""
    waves = np.stack([np.sin(turns), np.cos(turns)], -1)
    centred = np.moveaxis(waves - waves.mean(1, keepdims=True), 2, 1)
    directions, sizes, _ = np.linalg.svd(centred, full_matrices=False)
    return directions * (sizes > 0.05 * np.sqrt(turns.shape[1]))[:, :, None]


def _alike(spans: NDArray) -> NDArray:
    """Return (F, F) whether the span (F, L, B, 2) of the row lies within that of the column, leg by leg."""
    waves, _, poses, _ = spans.shape
    alike = np.ones((waves, waves), bool)
    for leg in np.moveaxis(spans, 1, 0):
        columns = np.moveaxis(leg, 1, 0).reshape(poses, 2 * waves)
        within = ((columns.T @ columns) ** 2).reshape(waves, 2, waves, 2).sum(3)
        beside = np.sum(leg**2, 1)[:, :, None] - within
        alike &= (beside < _ALIKE**2).all(1)
    return alike
