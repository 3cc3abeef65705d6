"""Test of an axis: do recorded positions match the targets in the same rows?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from truing.arrays import Array, Index
from truing.belonging.relation import LENGTH_FACTORS, RecordSlip, SlipKind, both_ways

_BETTER = 10.0  # factor by which a slip must reduce the misfit
_OF_SPACING = 0.1  # distance from a target, over the smallest distance of targets, above which slips are tested
_FEW, _PAIR = 0.1, 2  # share of the rows that single mistakes concern, and rows of one exchange
_SMALL_UNITS = (1e3,)  # recorded positions in um
_FOLLOWS = 0.2  # slope of position over target below which positions do not follow targets
_AS_GOOD = 2.0  # factor on the smallest misfit within which slips explain equally well
_FARTHEST = 200  # largest shift of rows that is tested
_LEFT = 0.02  # largest misfit after a slip is undone, as a share of the travel


@dataclass(frozen=True)
class TargetMatch:
    """Rms misfit of positions against targets, in their unit: as recorded, and with the best slip undone.

    ``slips`` apply together; each of ``rivals`` explains as much. ``deviations``: positions are deviations from the
    targets. ``still``: all positions are equal. ``single``: numbers of the few rows, from 1, that are far from their
    targets while all others are near.
    """

    misfit: float
    explained: float | None = None
    slips: tuple[RecordSlip, ...] = ()
    rivals: tuple[RecordSlip, ...] = ()
    deviations: bool = False
    still: bool = False
    single: tuple[int, ...] = ()

    @property
    def is_slip(self) -> bool:
        """True if one of the tested slips explains the misfit."""
        return bool(self.slips) or self.deviations or self.still


def match_targets(target: Array, position: Array) -> TargetMatch:
    """Return the match of positions (N,) with targets (N,), in the order of the rows of their file.

    A common offset is ignored. Tested slips: unit, sign, both, deviations in place of positions, exchanged rows, and a
    shift of rows by less than a cycle, at most 200.
    """
    misfit = _rms(position - target)
    numbers = np.unique(target)
    distant_rows = _apart(target, position) if len(numbers) > 1 else np.empty(0, int)
    if not len(distant_rows):
        return TargetMatch(misfit)
    if np.ptp(position) == 0.0:
        return TargetMatch(misfit, 0.0, (RecordSlip(SlipKind.FROZEN, "position_mm"),), still=True)
    if (exchanged := _exchanged(target, position, distant_rows)) is not None:
        return TargetMatch(misfit, _rms(position[exchanged] - target), (_exchange(exchanged),))
    travel = float(np.ptp(numbers))
    tried = list(_misfit_by_slip(target, position))
    best = min(left for left, _ in tried)
    if best * _BETTER < misfit and best < _LEFT * travel:
        alike = [slips for left, slips in tried if left <= _AS_GOOD * best]
        explained = next(left for left, slips in tried if slips == alike[0])
        return TargetMatch(
            misfit, explained, alike[0], rivals=tuple(match[0] for match in alike[1:] if len(match) == 1)
        )
    centred = target - target.mean()
    if abs(float(centred @ position)) < _FOLLOWS * float(centred @ centred):
        return TargetMatch(misfit, _rms(position), deviations=True)
    return TargetMatch(
        misfit, single=tuple((distant_rows + 1).tolist()) if len(distant_rows) <= _FEW * len(target) else ()
    )


def _apart(target: Array, position: Array) -> Index:
    """Return the rows whose positions are nearer to another target than to their own, or far from all."""
    off = position - target
    return np.flatnonzero(np.abs(off - np.median(off)) > _OF_SPACING * float(np.diff(np.unique(target)).min()))


def _exchanged(target: Array, position: Array, apart: Index) -> Index | None:
    """Return the order of rows (N,) in which a few pairs have each other's positions; None if not all rows apart are
    in such a pair."""
    if not 0 < len(apart) <= max(_PAIR, _FEW * len(target)):
        return None
    order, near = np.arange(len(target)), _OF_SPACING * float(np.diff(np.unique(target)).min())
    offset = float(np.median(position - target))
    left = apart.tolist()
    while left:
        row = left.pop(0)
        fits = [
            other
            for other in left
            if max(abs(position[row] - target[other] - offset), abs(position[other] - target[row] - offset)) <= near
        ]
        if not fits:
            return None
        order[[row, fits[0]]] = fits[0], row
        left.remove(fits[0])
    return order


def _exchange(order: Index) -> RecordSlip:
    rows = np.flatnonzero(order != np.arange(len(order)))
    pairs = [f"row {row + 1} and row {order[row] + 1}" for row in rows.tolist() if row < order[row]]
    return RecordSlip(SlipKind.ROWS_EXCHANGED, "position_mm", tuple(pairs))


def _misfit_by_slip(target: Array, position: Array) -> Iterator[tuple[float, tuple[RecordSlip, ...]]]:
    """Yield the misfit after each slip is undone; simpler slips first."""
    turned = RecordSlip(SlipKind.SIGN, "position_mm")
    yield _rms(-position - target), (turned,)
    for factor in both_ways(LENGTH_FACTORS):
        # positions are hardly recorded in such units, but targets are in the inverse ones
        of_targets = factor < 1.0 and 1.0 / factor not in _SMALL_UNITS
        quantity, slip_factor = ("target_mm", 1.0 / factor) if of_targets else ("position_mm", factor)
        unit = RecordSlip(SlipKind.UNIT, quantity, factor=slip_factor)
        yield _rms(factor * position - target), (unit,)
        yield _rms(-factor * position - target), (unit, turned)
    most = min(2 * len(np.unique(target)) - 1, len(target) // 2, _FARTHEST)
    for shift in sorted({*range(-most, 0), *range(1, most + 1)}, key=abs):
        slip = RecordSlip(SlipKind.ROWS_SHIFTED, "position_mm", shift=shift)
        yield _rms(_shifted(position, shift) - _partners_of_shifted(target, shift)), (slip,)


def _shifted(values: Array, shift: int) -> Array:
    """Return values without the rows that a shift leaves without a partner."""
    return values[shift:] if shift > 0 else values[:shift]


def _partners_of_shifted(values: Array, shift: int) -> Array:
    return values[:-shift] if shift > 0 else values[-shift:]


def _rms(values: Array) -> float:
    """Return the root mean square about the median."""
    return float(np.sqrt(np.mean((values - np.median(values)) ** 2)))
