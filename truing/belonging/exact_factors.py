"""Wrong units of loads or readings, recognised by a known factor that a whole group of responses has exactly.

The factor may be near one, as of lbf ft and N m, so that its size alone could be a wrong stiffness. But a wrong
stiffness does not change a whole group by one factor and leave all other responses as they are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.belonging.plausible_slips import RecordedColumn
from truing.belonging.relation import FORCE_UNITS, TORQUE_UNITS, RecordSlip, SlipKind

_WIDTH, _PART = 0.1, 0.2  # largest deviation from a factor, as a logarithm, and as a share of the factor's own
# Logarithms: a factor nearer to one may be a stiffness; one farther off may concern a single response.
_NEAR, _FAR = 0.2, 0.6
_FEWEST, _FEWEST_OTHERS = 3, 2  # responses (column and load axis) of the group, and others that are as expected


@dataclass(frozen=True)
class MainRatios:
    """Logarithms of main responses over expected ones (P,), by column and load axis; the median over the runs."""

    column: Index
    axis: Index
    ratio: Array

    @classmethod
    def of_responses(cls, column: Index, direction: Array, size: Array, expected: Array) -> MainRatios | None:
        """Return the ratios of responses (C,) to loads (C, 6) along single axes; None with loads along several, or with
        a response of the wrong sign."""
        if not len(size) or (np.count_nonzero(direction, axis=1) != 1).any() or (size * expected <= 0.0).any():
            return None
        axis, ratio = np.argmax(direction != 0.0, axis=1), np.log(size / expected)
        pairs, at = np.unique(np.column_stack([column, axis]), axis=0, return_inverse=True)
        median = [np.median(ratio[np.ravel(at) == k]) for k in range(len(pairs))]
        return cls(pairs[:, 0], pairs[:, 1], np.array(median))


@dataclass(frozen=True)
class ExactFactor:
    """A unit that explains responses, and their rms relative misfit as recorded and in that unit."""

    slip: RecordSlip
    before: float
    after: float


def exact_factor(ratios: MainRatios, columns: Sequence[RecordedColumn]) -> ExactFactor | None:
    """Return the unit that explains the ratios of one group, where all others are as expected; None if none does."""
    found = [
        ExactFactor(slip, _rms(ratios.ratio[concerns]), _rms(ratios.ratio[concerns] - expected))
        for concerns, expected, slip in _groups(ratios, columns)
        if _explains(ratios, concerns, expected)
    ]
    return min(found, key=lambda one: one.after, default=None)


def _explains(ratios: MainRatios, concerns: Mask, expected: float) -> bool:
    size = abs(expected)
    width = min(_WIDTH, _PART * size)
    if size < _NEAR or (~concerns).sum() < _FEWEST_OTHERS or concerns.sum() < (1 if size > _FAR else _FEWEST):
        return False
    right, others = np.abs(ratios.ratio[concerns] - expected), np.abs(ratios.ratio[~concerns])
    return bool(right.max() < width and others.max() < width)


def _rms(ratio: Array) -> float:
    return float(np.sqrt(np.mean(np.expm1(ratio) ** 2)))


def _groups(ratios: MainRatios, columns: Sequence[RecordedColumn]) -> Iterator[tuple[Mask, float, RecordSlip]]:
    """Yield groups (P,), with the logarithm of the ratio that a unit gives them.

    A reading times its factor is right, so its ratio is that of 1 / factor; a load times its factor is right, so that
    the response per recorded unit is too large by the factor.
    """
    is_torque = ratios.axis >= 3
    for quantity, concerns, factors in (("force", ~is_torque, FORCE_UNITS), ("torque", is_torque, TORQUE_UNITS)):
        for factor in factors:
            yield concerns, float(np.log(factor)), RecordSlip(SlipKind.UNIT, quantity, factor=factor)
    for quantity in dict.fromkeys(column.quantity for column in columns):
        alike = [k for k, column in enumerate(columns) if column.quantity == quantity]
        for chosen in (alike, *([k] for k in alike)):
            concerns = np.isin(ratios.column, chosen)
            names = () if chosen == alike else (columns[chosen[0]].name,)
            for factor in columns[alike[0]].factors:
                yield concerns, float(-np.log(factor)), RecordSlip(SlipKind.UNIT, quantity, names, factor)
