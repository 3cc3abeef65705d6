"""Slips in the columns of joint readings: two exchanged, one reversed, one in another unit.

A nominal machine misses by parts per thousand of its travel. A misfit of per cents means that readings and measured
links do not belong together; the slip that explains it is named.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from truing.simulation.mechanisms.chains.conditions import ChainConditions
from truing.simulation.mechanisms.chains.start_values import StartValues

# Misfit, as a share of the spread of measured positions, above which readings do not belong to them.
_FOREIGN = 0.02
# A slip explains the misfit if it leaves at most this share of it.
_EXPLAINED = 0.2
_MOST_POSES = 60


class ColumnSlipKind(StrEnum):
    """Sort of slip."""

    EXCHANGED = "exchanged"
    REVERSED = "reversed"
    DEGREES = "degrees-as-radians"
    RADIANS = "radians-as-degrees"


@dataclass(frozen=True)
class ColumnSlip:
    """A slip in the columns of some readings (numbers), and the misfit, m, without and with its correction."""

    kind: ColumnSlipKind
    readings: tuple[int, ...]
    before: float
    after: float


def foreign_share(start: StartValues) -> float:
    """Return the misfit, m, above which joint readings do not belong to the measured positions."""
    return _FOREIGN * start.spread


def does_not_belong(start: StartValues) -> bool:
    """True if the nominal chain misses the measured positions by more than any real machine."""
    return start.rms > foreign_share(start)


def likely_slip(
    conditions: ChainConditions,
    is_revolute: NDArray,
    start_of: Callable[[NDArray, ChainConditions], StartValues],
) -> ColumnSlip | None:
    """Return the slip that explains a large misfit; None if none does.

    ``start_of`` fits the places to some poses, a mask (B,), under conditions of all poses.
    """
    count = len(conditions.readings)
    few = np.zeros(count, bool)
    few[np.unique(np.linspace(0, count - 1, min(count, _MOST_POSES)).round().astype(int))] = True
    before = start_of(few, conditions).rms
    found = []
    for kind, own, readings in _corrected(conditions.readings, is_revolute):
        after = start_of(few, replace(conditions, readings=readings)).rms
        found.append(ColumnSlip(kind, own, before, after))
    best = min(found, key=lambda slip: slip.after, default=None)
    return best if best is not None and best.after < _EXPLAINED * before else None


def _corrected(readings: NDArray, is_revolute: NDArray) -> Iterator[tuple[ColumnSlipKind, tuple[int, ...], NDArray]]:
    """Yield every slip with the readings (B, n) after its correction."""
    count = readings.shape[1]
    for a, b in combinations(range(count), 2):
        if is_revolute[a] == is_revolute[b]:
            own = readings.copy()
            own[:, [a, b]] = readings[:, [b, a]]
            yield ColumnSlipKind.EXCHANGED, (a, b), own
    for k in range(count):
        factors = {ColumnSlipKind.REVERSED: -1.0}
        if is_revolute[k]:
            factors |= {ColumnSlipKind.DEGREES: np.pi / 180.0, ColumnSlipKind.RADIANS: 180.0 / np.pi}
        for kind, factor in factors.items():
            own = readings.copy()
            own[:, k] *= factor
            yield kind, (k,), own
