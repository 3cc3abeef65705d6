"""Rows of an axis whose reading does not belong to their command: exchanged, shifted, in another unit, copied."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.belonging.assignment import cheapest_columns

_NEAR = 0.02  # distance of a reading from its command, over the travel, up to which it belongs to it
_LEAST_SHARE = 0.5  # least share of the rows that agree
_FEWEST = 3  # fewest rows in another unit or shifted
_MOST = 300  # most rows among which an exchange is sought
_EXPLAINED = 0.9  # least share of the rows that a slip explains
_NEARLY_ALL = 0.98  # the same of a shifted column; lost motion of one step explains fewer where the axis turns
# Fewest angles; the share of the misfit that remains if they were written with minutes; and their decimals.
_FEWEST_ANGLES, _FAR_BETTER, _SIXTY, _DIGITS = 20, 0.1, 0.6, 8
_SHIFTS = (1, -1, 2, -2)
# Fewest rows of a copied stretch, its level, and rows of a recording that are compared.
_FEWEST_COPIED, _UNLIKELY, _MOST_COMPARED = 8, 1e-4, 2000
# Fewest readings that show a scatter; how near its ratio to the declared noise lies to that of another unit.
_FEWEST_SCATTERED, _OF_UNIT = 10, 1.9
# Median absolute value of differences, in standard deviations of a reading.
_FIRST_DIFFERENCE, _SECOND_DIFFERENCE = 0.954, 1.652


class RowSlipKind(StrEnum):
    """Sort of slip."""

    EXCHANGED = "exchanged"
    SHIFTED = "shifted"
    REVERSED = "reversed"
    UNIT = "unit"
    COPIED = "copied"
    STRAY = "stray"


@dataclass(frozen=True)
class AxisRowSlip:
    """Rows (in order of time) with a slip; ``name`` of the unit, or number of rows by which they are too far down."""

    kind: RowSlipKind
    rows: Index
    name: str = ""


def slip_of_rows(command: Array, reading: Array, ratio: float, units: Mapping[str, float]) -> AxisRowSlip | None:
    """Return the slip in some rows of an encoder, N finite commands and readings in order of time; None if all agree.

    ``ratio`` is the movement of the encoder over that of the command; ``units``: factor by name with which numbers in
    another unit are right. An offset that is the same in all later rows is a shifted zero, and no slip.
    """
    expected = ratio * command
    limit = _NEAR * float(np.ptp(expected))
    zero, near = _zero(reading - expected, limit)
    distant_rows = np.flatnonzero(~near)
    if near.mean() < _EXPLAINED and (shifted := _whole_shift(reading, expected, limit, _NEARLY_ALL)) is not None:
        return shifted
    if (back := _reversed_sweeps(reading - zero, expected, limit)) is not None:
        return AxisRowSlip(RowSlipKind.REVERSED, back)
    if near.mean() < _LEAST_SHARE:
        return _whole_shift(reading, expected, limit)
    if not len(distant_rows) or _is_zero_shift((reading - expected)[distant_rows], limit):
        return None
    off = reading - zero
    if 1 < len(distant_rows) <= _MOST and _are_exchanged(off[distant_rows], expected[distant_rows], limit):
        return AxisRowSlip(RowSlipKind.EXCHANGED, distant_rows)
    for shift in _SHIFTS:
        rows = distant_rows[(distant_rows + shift >= 0) & (distant_rows + shift < len(off))]
        if _explains(np.abs(off[rows + shift] - expected[rows]) <= limit):
            return AxisRowSlip(RowSlipKind.SHIFTED, distant_rows, str(shift))
    for name, factor in units.items():
        if _explains(np.abs(factor * reading[distant_rows] - zero - expected[distant_rows]) <= limit):
            return AxisRowSlip(RowSlipKind.UNIT, distant_rows, name)
    are_copies = len(distant_rows) >= _FEWEST and all(np.sum(reading == reading[row]) > 1 for row in distant_rows)
    return AxisRowSlip(RowSlipKind.COPIED if are_copies else RowSlipKind.STRAY, distant_rows)


def copied_stretch(command: Array, reading: Array) -> tuple[int, int, int] | None:
    """Return first row, first row of the copy, and length of the longest copied stretch of readings (N,); None if none
    is longer than chance explains.

    A copy agrees in every digit. Chance is the share of other rows of the same command (N,) and direction that repeat
    their reading. Where there are no such rows, it is that of rows of any command. Only the first rows of a long
    recording are compared.
    """
    command, reading = command[:_MOST_COMPARED], reading[:_MOST_COMPARED]
    equal = [reading[lag:] == reading[:-lag] for lag in range(1, len(reading))]
    length, start, lag = max(((*_longest_run(each), lag) for lag, each in enumerate(equal, 1)), default=(0, 0, 0))
    rows = slice(start, start + length)
    if length < _FEWEST_COPIED or min(len(np.unique(reading[rows])), len(np.unique(command[rows]))) < _FEWEST:
        return None
    sent = np.column_stack([command, np.sign(np.diff(command, prepend=command[0]))])
    pairs, again, anywhere = np.zeros((3, len(reading)))
    for other, is_equal in enumerate(equal, 1):
        if other != lag:
            alike = (sent[other:] == sent[:-other]).all(1)
            for side in (slice(other, None), slice(None, -other)):
                pairs[side] += alike
                again[side] += alike & is_equal
                anywhere[side] += is_equal
    of_all = (1.0 + np.sum(anywhere > 0.0)) / (1.0 + len(reading))
    chance = np.where(pairs > 0.0, (1.0 + again) / (1.0 + pairs), of_all)[rows]
    is_copy = np.sum(np.log(chance)) + 2.0 * np.log(len(reading)) < np.log(_UNLIKELY)
    return (start, start + lag, length) if is_copy else None


def _longest_run(equal: Mask) -> tuple[int, int]:
    """Length and first place of the longest run of True in (N,)."""
    ends = np.flatnonzero(np.diff(np.concatenate([[False], equal, [False]]).astype(np.int8)))
    if not len(ends):
        return 0, 0
    lengths = ends[1::2] - ends[::2]
    longest = int(np.argmax(lengths))
    return int(lengths[longest]), int(ends[2 * longest])


def other_order(command: Array, reading: Array) -> bool:
    """True if readings (N,) belong to the commands (N,) of other rows, as where one of two columns was sorted."""
    limit = _NEAR * float(np.ptp(command))
    if len(command) < _FEWEST_SCATTERED or not limit > 0.0:
        return False
    in_order = np.sort(reading) - np.sort(command)
    same_values = np.abs(in_order - np.median(in_order)) <= limit
    is_apart = all(_zero(reading - each, limit)[1].mean() < _LEAST_SHARE for each in (command, -command))
    return _explains(same_values) and is_apart and _whole_shift(reading, command, limit) is None


def unit_of_deviations(command: Array, deviation: Array, declared: float, units: Mapping[float, str]) -> str:
    """Return the unit in which deviations (N,) in order of time were written, or else their noise was declared; empty
    where their scatter has the declared size.

    ``units``: names by size. Second differences hold little of errors that change slowly. No axis scatters by thousands
    of times the noise of its instrument, and just by the ratio of two units. What the command (N,) explains, in
    proportion or at rows of equal command, is no scatter.
    """
    if not declared > 0.0 or len(deviation) < _FEWEST_SCATTERED:
        return ""
    design = np.column_stack([command, np.ones_like(command)])
    rest = deviation - design @ np.linalg.lstsq(design, deviation, rcond=None)[0]
    ratio, of_rest = (_scatter(values, 2, _SECOND_DIFFERENCE) / declared for values in (deviation, rest))
    of_repeats = _scatter_of_repeats(command, deviation) / declared
    return next(
        (
            name
            for size, name in units.items()
            if 1.0 / _OF_UNIT < ratio / size < _OF_UNIT and min(of_rest, of_repeats) * _OF_UNIT > size
        ),
        "",
    )


def _scatter(values: Array, order: int, median: float) -> float:
    """Standard deviation of values (N,) by the median of their differences of an order, of which ``median`` is that of
    one standard deviation."""
    return float(np.median(np.abs(np.diff(values, order)))) / median


def _scatter_of_repeats(command: Array, deviation: Array) -> float:
    """Standard deviation of deviations (N,) among rows of one command; infinite where too few are repeated."""
    order = np.argsort(command, kind="stable")
    again = np.diff(command[order]) == 0.0
    if again.sum() < _FEWEST_SCATTERED:
        return np.inf
    return float(np.median(np.abs(np.diff(deviation[order])[again]))) / _FIRST_DIFFERENCE


def sexagesimal(command: Array, reading: Array) -> tuple[bool, str]:
    """Return True and the unit's name if the commands (N,), deg, have minutes in place of decimals; False and the name
    if the readings have. The name is empty where neither has.

    Such decimals never reach 60, and as minutes they agree with the other column far better.
    """
    scatter = float(np.std(reading - command))
    if len(command) < _FEWEST_ANGLES or not scatter > 0.0:
        return False, ""
    left = {(False, ""): _FAR_BETTER * scatter}
    for of_command, angles, others in ((False, reading, command), (True, command, reading)):
        for name, read in _SEXAGESIMAL.items():
            if (found := read(angles)) is not None:
                left[of_command, name] = float(np.std(found - others))
    return min(left, key=lambda one: left[one])


def _of_minutes(angles: Array) -> Array | None:
    """Return decimal degrees of numbers D.MM with decimals of minutes; None where there are none such."""
    whole, minutes = np.divmod(np.round(np.abs(angles), _DIGITS), 1.0)
    return None if minutes.max() >= _SIXTY else np.sign(angles) * (whole + minutes / _SIXTY)


def _of_seconds(angles: Array) -> Array | None:
    """Return decimal degrees of numbers D.MMSS with decimals of seconds; None where there are none such."""
    minutes, seconds = np.divmod(np.round(np.abs(angles) * 100.0, _DIGITS), 1.0)
    whole, minutes = np.divmod(minutes, 100.0)
    if max(seconds.max(), minutes.max() / 100.0) >= _SIXTY:
        return None
    return np.sign(angles) * (whole + (minutes + seconds / _SIXTY) / 60.0)


_SEXAGESIMAL = {"degrees and minutes (D.MM)": _of_minutes, "degrees, minutes and seconds (D.MMSS)": _of_seconds}


def _zero(difference: Array, limit: float) -> tuple[float, Mask]:
    """Return the zero with which most rows agree, and these rows."""
    centres = difference[:: -(-len(difference) // _MOST)]
    counts = [int(np.sum(np.abs(difference - centre) <= limit)) for centre in centres]
    first = np.abs(difference - centres[int(np.argmax(counts))]) <= limit
    zero = float(np.median(difference[first]))
    return zero, np.abs(difference - zero) <= limit


def _reversed_sweeps(off: Array, expected: Array, limit: float) -> Index | None:
    """Return the rows (N,) of sweeps whose readings are in reverse order; None where these do not explain all that is
    far from its command. A sweep is a movement without a turn."""
    turns = np.flatnonzero(np.diff(np.sign(np.diff(expected))) != 0.0) + 1
    back, rows = off.copy(), list[int]()
    for first, last in pairwise([0, *turns.tolist(), len(off)]):
        # The row of a turn belongs to either sweep.
        for start, end in ((first, last), (first, min(last + 1, len(off))), (first + 1, min(last + 1, len(off)))):
            own, other = off[start:end] - expected[start:end], off[start:end][::-1] - expected[start:end]
            is_far = np.abs(own) > limit
            if is_far.sum() >= _FEWEST and np.abs(other).max() <= limit:
                back[start:end] = off[start:end][::-1]
                rows += (start + np.flatnonzero(is_far)).tolist()
                break
    if not rows or np.mean(np.abs(back - expected) <= limit) < _EXPLAINED:
        return None
    return np.unique(rows)


def _whole_shift(reading: Array, expected: Array, limit: float, least: float = _EXPLAINED) -> AxisRowSlip | None:
    """Return the slip of a column that is shifted as a whole; None where no shift brings a share ``least`` of it to its
    commands."""
    for shift in _SHIFTS:
        first, last = max(shift, 0), len(reading) + min(shift, 0)
        difference = reading[first:last] - expected[first - shift : last - shift]
        within = _zero(difference, limit)[1]
        if len(difference) > _FEWEST and float(within.mean()) >= least:
            return AxisRowSlip(RowSlipKind.SHIFTED, np.arange(len(reading)), str(shift))
    return None


def _is_zero_shift(difference: Array, limit: float) -> bool:
    """Return True where rows have an offset in common."""
    return len(difference) >= _FEWEST and float(np.ptp(difference)) <= 2.0 * limit


def _are_exchanged(reading: Array, expected: Array, limit: float) -> bool:
    """Return True where the readings of some rows are in each other's rows."""
    cost = np.abs(reading[None] - expected[:, None])
    columns = cheapest_columns(np.log1p((cost / limit) ** 2))
    is_shift = len(cost) > 2 and float(np.median(np.abs(columns - np.arange(len(cost))))) <= max(_SHIFTS)
    return bool((cost[np.arange(len(cost)), columns] <= limit).all()) and not is_shift


def _explains(within: Mask) -> bool:
    return len(within) >= _FEWEST and float(within.mean()) >= _EXPLAINED
