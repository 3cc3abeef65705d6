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
    frequencies = np.linspace(first, 1 / SHORTEST_M, grid_size(moved))
    kept: list[tuple[float, NDArray]] = []
    for frequency in frequencies[:MOST_PITCHES]:
        spans = _spans(2 * np.pi * frequency * moved)
        if not any(_alike(spans, other) for _, other in kept):
            kept.append((float(frequency), spans))
    return [1 / frequency for frequency, _ in kept]


def _spans(turns: NDArray) -> NDArray:
    """Return orthonormal bases (L, B, 2) of sine and cosine of turns (B, L) less means; zero where they vanish."""
    waves = np.stack([np.sin(turns), np.cos(turns)], -1)
    centred = np.moveaxis(waves - waves.mean(0), 1, 0)
    directions, sizes, _ = np.linalg.svd(centred, full_matrices=False)
    return directions * (sizes > 0.05 * np.sqrt(len(turns)))[:, None]


def _alike(one: NDArray, other: NDArray) -> bool:
    """Return whether the first spans lie within the others, leg by leg."""
    rest = one - other @ (np.swapaxes(other, 1, 2) @ one)
    return bool(np.abs(rest).max(initial=0.0) < 1 and np.sqrt(np.sum(rest**2, 1)).max(initial=0.0) < _ALIKE)
