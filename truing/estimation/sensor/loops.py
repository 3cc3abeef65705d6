"""Hysteresis loops of a load that goes back and forth without fixed steps, from crossings of one level of the drive.

A drive crosses a level rising or falling; the response there is interpolated. The gap between a crossing and its two
neighbours in the other direction is the width of the loop; linear drift cancels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Loops:
    """L gaps (L, W), rising minus falling, at the steps (L,) of the middle crossing; amplitude (L, W): half the
    response's range over the loop."""

    step: NDArray
    gap: NDArray
    amplitude: NDArray

    @property
    def share(self) -> NDArray:
        """Gaps (L, W) as shares of the loop's whole range."""
        return self.gap / (2.0 * self.amplitude)

    @property
    def mean(self) -> NDArray:
        """Mean share (W,)."""
        return np.asarray(self.share.mean(0))

    @property
    def sigma(self) -> NDArray:
        """Standard deviation (W,) of the mean, from the scatter of the loops; NaN for a single loop.

        Neighbouring gaps share a crossing, so only half as many count as independent.
        """
        count = len(self.gap)
        if count < 2:
            return np.full(self.gap.shape[1], np.nan)
        return np.asarray(self.share.std(0, ddof=1) / np.sqrt(count / 2))


def loops(drive: NDArray, response: NDArray, level: float, least: float = 0.0) -> Loops:
    """Return the loops of a response (N, W) to a drive (N,) that goes back and forth through a level.

    Crossings count if the drive moves at least ``least`` from the level in between; others are noise. Raises ValueError
    for fewer than three crossings.
    """
    step, rising = _crossings(drive - level, least)
    if len(step) < 3:
        raise ValueError(f"found {len(step)} crossings of {level:g}, expected at least three for one loop")
    share = (level - drive[step]) / (drive[step + 1] - drive[step])
    at = response[step] + share[:, None] * (response[step + 1] - response[step])
    sign = np.where(rising[1:-1], 1.0, -1.0)
    gap = sign[:, None] * (at[1:-1] - 0.5 * (at[:-2] + at[2:]))
    parts = [response[a + 1 : b + 1] for a, b in zip(step[:-2], step[2:], strict=True)]
    amplitude = np.array([np.ptp(part, axis=0) / 2.0 for part in parts])
    return Loops(step[1:-1], gap, amplitude)


def _crossings(offset: NDArray, least: float) -> tuple[NDArray, NDArray]:
    """Return the steps before crossings of zero, in alternating directions, and the mask of rising ones. The last
    crossing before the drive has moved far enough counts, since it may fluctuate about the level."""
    far = np.flatnonzero(np.abs(offset) >= max(least, np.finfo(float).tiny))
    turns = np.flatnonzero(offset[far[:-1]] * offset[far[1:]] < 0)
    step, rising = [], []
    for first, last in zip(far[turns], far[turns + 1], strict=True):
        sign = np.sign(offset[last])
        inside = np.arange(first, last)
        step.append(int(inside[offset[inside] * sign <= 0][-1]))
        rising.append(bool(sign > 0))
    return np.array(step, np.int64), np.array(rising, bool)
