"""Test of two clocks: are the readings of all legs late against the measured poses by the same time?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from truing.arrays import Array
from truing.belonging.evidence import Physics, log_evidence

_FEWEST_POSES = 12
# Log evidence, prior odds included, from which on a lag is worth a look, and from which on it is clear.
_NOTED, _CLEAR = 15.0, 65.0


@dataclass(frozen=True)
class ClockLag:
    """Time by which readings are late, s, and its standard deviation; ``is_clear``: no other effect explains it."""

    seconds: float
    sigma: float
    is_clear: bool


@dataclass(frozen=True)
class Courses:
    """Movement of the required readings in time.

    rate (B, L): per s. ways (B, L, 2): directions of the movements before and after each pose, 0 or of size 1. last
    (B, L): the movement before, scaled to unit spread.
    """

    rate: Array
    ways: Array
    last: Array

    @classmethod
    def of(cls, required: Array, time_s: Array) -> Courses | None:
        """Return the courses of readings (B, L) at times (B,) in s; None where poses are too few or share a time."""
        order = np.argsort(time_s)
        if len(order) < _FEWEST_POSES or np.any(np.diff(time_s[order]) <= 0.0):
            return None
        rate, ways = np.empty(required.shape), np.zeros((*required.shape, 2))
        rate[order] = np.gradient(required[order], time_s[order], axis=0)
        moves, last = np.diff(required[order], axis=0), np.zeros(required.shape)
        ways[order[1:], :, 0], ways[order[:-1], :, 1] = np.sign(moves), np.sign(moves)
        last[order[1:]] = moves / np.maximum(moves.std(axis=0), 1e-300)
        return cls(rate, ways, last)


def clock_lag(
    misfit: Array, courses: Courses, effects: Sequence[Physics], settling: Sequence[Physics], noise: float
) -> ClockLag | None:
    """Return the lag of readings that is more probable than physical effects alone; None if none is.

    misfit (B, L): readings minus those that the poses require. effects: what may act on each of the L readings, with
    lost motion; ``settling``: the same, and the movement before each pose. Both follow the motion as a lag does, and
    poses at standstill may show them, but no lag.
    """
    along = information = 0.0
    for leg, known in enumerate(effects):
        rate = courses.rate[:, leg]
        residual = rate - known.left @ (known.size**2 / (known.size**2 + noise**2) * (known.left.T @ rate))
        along += float(residual @ misfit[:, leg])
        information += float(residual @ rate)
    if information <= 0.0:
        return None
    slope = along / information
    gains = [
        [log_evidence(misfit[:, leg] - slope * courses.rate[:, leg], known, noise)]
        - np.array([log_evidence(misfit[:, leg], rival, noise) for rival in (known, settling[leg])])
        for leg, known in enumerate(effects)
    ]
    gain = float(np.sum(gains, axis=0).min())
    return ClockLag(-slope, noise / float(np.sqrt(information)), gain > _CLEAR) if gain > _NOTED else None
