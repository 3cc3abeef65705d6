"""Slips in the columns of joint readings (exchanged, reversed, another unit, coupled, shifted rows) and wrong zeros.

A nominal chain misses measured positions by thousandths of its travel. If it misses them by per cents, readings and
positions do not belong together. Then the slip that explains the misfit is searched for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from itertools import combinations, pairwise, product

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Mask
from truing.simulation.mechanisms.chains.conditions import ChainConditions
from truing.simulation.mechanisms.chains.start_values import StartValues

# Misfit, as a share of the spread of measured positions, above which readings do not belong to them.
_FOREIGN = 0.02
# A slip explains the misfit if it leaves at most this share of it.
_EXPLAINED = 0.2
_MOST_POSES = 60
# Fewer zeros suffice if their misfit is at most this many times that of all zeros; steps of their fit.
_AS_GOOD, _STEPS = 2.0, 30
_QUARTERS = (0.0, np.pi / 2.0, -np.pi / 2.0, np.pi)  # rad, that conventions of a zero differ by
_MOST_OFFSET = 2  # joints whose reversed, exchanged or rescaled readings another zero may resemble


class ColumnSlipKind(StrEnum):
    """Sort of slip."""

    EXCHANGED = "exchanged"
    REVERSED = "reversed"
    DEGREES = "degrees-as-radians"
    RADIANS = "radians-as-degrees"
    GON = "gon-as-degrees"
    # A joint that counts from a fixed direction: the reading of the joint before is missing in its own, or included.
    ADDED = "lacks-the-one-before"
    SUBTRACTED = "holds-the-one-before"
    ZEROS = "zeros"
    DOWN = "a-row-too-far-down"
    UP = "a-row-too-far-up"
    UPSIDE_DOWN = "rows-reversed"


# Recorded angles times these are right.
UNIT_FACTORS = {ColumnSlipKind.DEGREES: np.pi / 180.0, ColumnSlipKind.RADIANS: 180.0 / np.pi, ColumnSlipKind.GON: 0.9}


@dataclass(frozen=True)
class ColumnSlip:
    """A slip in the columns of some readings (numbers), and the misfit, m, without and with its correction.

    ``offsets``: what zeros lack, rad or m, one for each reading; empty for other slips.
    """

    kind: ColumnSlipKind
    readings: tuple[int, ...]
    before: float
    after: float
    offsets: tuple[float, ...] = ()

    def corrected(self, readings: NDArray) -> NDArray:
        """Return readings (B, n) after the correction of exchanged columns or of zeros."""
        result = readings.copy()
        if self.kind is ColumnSlipKind.EXCHANGED:
            result[:, list(self.readings)] = readings[:, list(self.readings[::-1])]
        result[:, list(self.readings[: len(self.offsets)])] += self.offsets
        return result


def foreign_misfit(start: StartValues) -> float:
    """Return the misfit, m, above which joint readings do not belong to the measured positions."""
    return _FOREIGN * start.spread


def does_not_belong(start: StartValues) -> bool:
    """True if the nominal chain misses the measured positions by more than any real machine."""
    return start.rms > foreign_misfit(start)


def likely_slip(
    conditions: ChainConditions,
    is_revolute: NDArray,
    start_of: Callable[[NDArray, ChainConditions], StartValues],
) -> ColumnSlip | None:
    """Return the slip that explains a large misfit, or zeros of joints that are far off; None if nothing does.

    ``start_of`` fits the places to some poses, a mask (B,), under conditions of all poses.
    """
    few = few_poses(len(conditions.readings))
    recorded = start_of(few, conditions)
    before = recorded.rms
    found = []
    for kind, columns, readings in corrected_columns(conditions.readings, is_revolute):
        after = start_of(few, replace(conditions, readings=readings))
        # Of distances the spread is that of the machine: one that stands still explains nothing.
        if after.rms * recorded.spread < _EXPLAINED * before * after.spread:
            found.append(ColumnSlip(kind, columns, before, after.rms))
    best = min(found, key=lambda slip: slip.after, default=None)
    is_explained = best is not None and best.after < _EXPLAINED * min(before, recorded.spread)
    if best is not None and is_explained and not _is_offset(best, conditions, partial(start_of, few)):
        return best
    return _zeros(conditions, is_revolute, partial(start_of, few))


def half_turns_as_good(
    slip: ColumnSlip,
    conditions: ChainConditions,
    is_revolute: NDArray,
    start_of: Callable[[Mask, ChainConditions], StartValues],
) -> list[ColumnSlip]:
    """Return zeros of single joints, off by about half a turn, that explain as much as a reversed column.

    Half a turn of one joint of a wrist reverses the next one, if their axes are square to each other.
    """
    if slip.kind is not ColumnSlipKind.REVERSED:
        return []
    start = partial(start_of, few_poses(len(conditions.readings)))
    before = start(conditions)
    turned = [_with_zeros(conditions, (int(k),), before, start, np.array([np.pi])) for k in np.flatnonzero(is_revolute)]
    return [candidate for candidate in turned if candidate.after <= _AS_GOOD * slip.after]


def few_poses(count: int) -> Mask:
    """Mask (B,) of some poses, evenly over the campaign, that suffice for the comparison of slips."""
    few = np.zeros(count, bool)
    few[np.unique(np.linspace(0, count - 1, min(count, _MOST_POSES)).round().astype(int))] = True
    return few


def _is_offset(
    slip: ColumnSlip, conditions: ChainConditions, start_of: Callable[[ChainConditions], StartValues]
) -> bool:
    """Return True if other zeros of the same one or two joints explain clearly more: a wrong zero is no slip."""
    if len(slip.readings) > _MOST_OFFSET:
        return False
    zeros = _with_zeros(conditions, slip.readings, start_of(conditions), start_of)
    return _AS_GOOD * zeros.after < slip.after


def _zeros(
    conditions: ChainConditions, is_revolute: NDArray, start_of: Callable[[ChainConditions], StartValues]
) -> ColumnSlip | None:
    """Return the fewest zeros whose offsets join readings and measured links; None if all of them do not.

    Zeros of joints that turn, a mask (n,), are also sought from quarter turns, of one joint or of two.
    """
    every = tuple(range(conditions.readings.shape[1]))
    before = start_of(conditions)
    quarters = _quarter_turns(conditions, is_revolute, start_of)
    tried = [_with_zeros(conditions, every, before, start_of, zeros) for zeros in (np.zeros(len(every)), quarters)]
    all_zeros = min(tried, key=lambda slip: slip.after)
    if all_zeros.after > foreign_misfit(before):
        return None
    start = np.array(all_zeros.offsets)
    chosen: tuple[int, ...] = ()
    while True:
        trials = [
            _with_zeros(conditions, (*chosen, k), before, start_of, start[[*chosen, k]])
            for k in every
            if k not in chosen
        ]
        best = min(trials, key=lambda slip: slip.after)
        chosen = best.readings
        if best.after <= _AS_GOOD * all_zeros.after or len(chosen) == len(every):
            return best


def _quarter_turns(
    conditions: ChainConditions, is_revolute: NDArray, start_of: Callable[[ChainConditions], StartValues]
) -> Array:
    """Return the quarter turns (n,), rad, of one joint or two that leave the least misfit; a mask (n,) of those that
    turn."""
    angles = np.flatnonzero(is_revolute)
    pairs = [(a, b) for a, b in combinations(angles, 2)] or [(a, a) for a in angles]
    trials = [np.zeros(len(is_revolute))]
    for a, b in pairs:
        for one, other in product(_QUARTERS, repeat=2):
            turn = np.zeros(len(is_revolute))
            turn[[a, b]] = one, other
            trials.append(turn)
    distinct = np.unique(trials, axis=0)
    moved = (replace(conditions, readings=conditions.readings + turn) for turn in distinct)
    misfits = np.nan_to_num([start_of(one).rms for one in moved], nan=np.inf)
    return np.asarray(distinct[int(np.argmin(misfits))])


def _with_zeros(
    conditions: ChainConditions,
    chosen: tuple[int, ...],
    before: StartValues,
    start_of: Callable[[ChainConditions], StartValues],
    start: NDArray | None = None,
) -> ColumnSlip:
    """Return the offsets of the chosen zeros that fit best, sought from ``start`` (P,), rad or m, else from zero."""
    from scipy.optimize import least_squares

    def moved(offsets: NDArray) -> ChainConditions:
        readings = conditions.readings.copy()
        readings[:, list(chosen)] += offsets
        return replace(conditions, readings=readings)

    first = np.zeros(len(chosen)) if start is None else start
    fit = least_squares(lambda offsets: np.nan_to_num(start_of(moved(offsets)).errors).ravel(), first, max_nfev=_STEPS)
    return ColumnSlip(
        ColumnSlipKind.ZEROS, chosen, before.rms, start_of(moved(fit.x)).rms, tuple(float(value) for value in fit.x)
    )


def corrected_columns(
    readings: NDArray, is_revolute: NDArray
) -> Iterator[tuple[ColumnSlipKind, tuple[int, ...], NDArray]]:
    """Yield every slip with the readings (B, n) after its correction; units of all angles together are one slip."""
    every = tuple(range(readings.shape[1]))
    for a, b in combinations(every, 2):
        if is_revolute[a] == is_revolute[b]:
            corrected = readings.copy()
            corrected[:, [a, b]] = readings[:, [b, a]]
            yield ColumnSlipKind.EXCHANGED, (a, b), corrected
    angles = tuple(int(k) for k in np.flatnonzero(is_revolute))
    scaled: list[tuple[ColumnSlipKind, float, tuple[int, ...]]] = [(ColumnSlipKind.REVERSED, -1.0, (k,)) for k in every]
    scaled += [(ColumnSlipKind.REVERSED, -1.0, every)] if len(every) > 1 else []
    for kind, factor in UNIT_FACTORS.items():
        scaled += [(kind, factor, (k,)) for k in angles]
        scaled += [(kind, factor, angles)] if len(angles) > 1 else []
    for kind, factor, columns in scaled:
        corrected = readings.copy()
        corrected[:, list(columns)] *= factor
        yield kind, columns, corrected
    for kind, sign in ((ColumnSlipKind.ADDED, 1.0), (ColumnSlipKind.SUBTRACTED, -1.0)):
        for a, b in pairwise(angles):
            corrected = readings.copy()
            corrected[:, b] += sign * readings[:, a]
            yield kind, (a, b), corrected
    for kind, rows in ((ColumnSlipKind.DOWN, -1), (ColumnSlipKind.UP, 1)):
        yield kind, every, np.roll(readings, rows, 0)
    yield ColumnSlipKind.UPSIDE_DOWN, every, readings[::-1]
