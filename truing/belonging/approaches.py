"""Do positions of an axis belong to the targets that they are written beside?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from truing.arrays import Array
from truing.belonging.relation import LENGTH_FACTORS, RecordSlip, SlipKind, both_ways

_BETTER = 10.0  # times smaller is the misfit that a slip has to leave
_OF_SPACING = 0.1  # misfit over the smallest distance of targets, from which on a slip is looked for
_FOLLOWS = 0.2  # change of the position over that of the target, below which it does not follow at all
_AS_GOOD = 2.0  # times the smallest misfit: slips that explain as much
_FARTHEST = 200  # rows that positions are looked for away from their targets
_LEFT = 0.02  # of the travel: what a slip may leave once undone


@dataclass(frozen=True)
class TargetMatch:
    """Rms misfit of positions against targets, in their unit: as recorded, and with the slip undone that explains it.

    ``slips`` hold together; each of ``rivals`` explains as much. ``deviations``: the positions are deviations from the
    targets. ``still``: all positions are one.
    """

    misfit: float
    explained: float | None = None
    slips: tuple[RecordSlip, ...] = ()
    rivals: tuple[RecordSlip, ...] = ()
    deviations: bool = False
    still: bool = False

    @property
    def is_slip(self) -> bool:
        """Whether something that was tried explains the misfit."""
        return bool(self.slips) or self.deviations or self.still


def match_targets(target: Array, position: Array) -> TargetMatch:
    """Return how positions (N,) match targets (N,), in the order of the rows of their file.

    A common offset counts for nothing. Tried are units, signs, both, deviations in place of positions, and positions
    that stand fewer rows away from their targets than a cycle has, 200 at most.
    """
    misfit = _rms(position - target)
    places = np.unique(target)
    if len(places) < 2 or misfit <= _OF_SPACING * float(np.diff(places).min()):
        return TargetMatch(misfit)
    if np.ptp(position) == 0.0:
        return TargetMatch(misfit, 0.0, (RecordSlip(SlipKind.FROZEN, "position_mm"),), still=True)
    travel = float(np.ptp(places))
    tried = list(_tried(target, position))
    best = min(left for left, _ in tried)
    if best * _BETTER < misfit and best < _LEFT * travel:
        alike = [slips for left, slips in tried if left <= _AS_GOOD * best]
        explained = next(left for left, slips in tried if slips == alike[0])
        return TargetMatch(misfit, explained, alike[0], rivals=tuple(one[0] for one in alike[1:] if len(one) == 1))
    centred = target - target.mean()
    if abs(float(centred @ position)) < _FOLLOWS * float(centred @ centred):
        return TargetMatch(misfit, _rms(position), deviations=True)
    return TargetMatch(misfit)


def _tried(target: Array, position: Array) -> Iterator[tuple[float, tuple[RecordSlip, ...]]]:
    """The misfit that each slip leaves, once undone; the plainer slips first."""
    turned = RecordSlip(SlipKind.SIGN, "position_mm")
    yield _rms(-position - target), (turned,)
    for factor in both_ways(LENGTH_FACTORS):
        unit = RecordSlip(SlipKind.UNIT, "position_mm", factor=factor)
        yield _rms(factor * position - target), (unit,)
        yield _rms(-factor * position - target), (unit, turned)
    most = min(2 * len(np.unique(target)) - 1, len(target) // 2, _FARTHEST)
    for shift in sorted({*range(-most, 0), *range(1, most + 1)}, key=abs):
        slip = RecordSlip(SlipKind.ROWS_SHIFTED, "position_mm", shift=shift)
        yield _rms(_moved(position, shift) - _kept(target, shift)), (slip,)


def _moved(values: Array, shift: int) -> Array:
    """Values that stand ``shift`` rows too far down, beside the rows that they belong to."""
    return values[shift:] if shift > 0 else values[:shift]


def _kept(values: Array, shift: int) -> Array:
    return values[:-shift] if shift > 0 else values[-shift:]


def _rms(values: Array) -> float:
    """Root mean square about the median."""
    return float(np.sqrt(np.mean((values - np.median(values)) ** 2)))
