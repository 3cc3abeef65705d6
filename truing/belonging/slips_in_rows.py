"""Slips in some rows or cells of a table of readings: reordered rows, inconsistent rows and cells, rounding."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask
from truing.belonging.assignment import cheapest_columns

_FEWEST, _FEWEST_APART = 4, 3  # fewest rows that agree, and that do not
_LEAST_SHARE = 0.2  # least share of all rows that agree; fewer may do so by chance
_NEAR = 0.3  # largest difference of misfits of rows that agree, as a share of the movement
_MOST_CENTRES = 200  # most rows around which a cluster is sought
_FAR = 10.0  # typical misfits of rows that agree, beyond which a row does not
_CLEARLY = 0.2  # share of the movement
_MOST_LEFT = 0.5  # share of the misfit below which a row is better with the slip undone
_LEFT = (3.0, 0.1)  # largest misfit of corrected rows, relative to rows that agree, and to their own misfit before
_EXPLAINED = 0.9  # least share of the disagreeing rows that a slip explains
_MOST_STRETCHES = 3
_SHIFTS = (1, -1, 2, -2, 3, -3)
_MOST_ROWS = 600  # most rows in the test of all exchanges; of longer tables, the rows that fit worst
_CLEAR = 50.0  # log likelihood by which an exchange of rows must win
_NEARLY = 1.5  # misfit of a simple shift over that of a free order, up to which the shift is preferred
_MOST_LEFT_OF_EXCHANGED = 0.2
_WORSE = 8.0  # typical misfits beyond which a row of a long table may belong to another pose
_STRAY = 12.0  # scatters of a leg's misfit beyond which a reading does not belong to its pose
_SIZEABLE = 0.1  # least stray error, over the leg's range; the diagnosis screens smaller gross errors
_FEW = 0.1  # share of all readings
_MEDIAN = 1.4826
_DIFFERENT = 4  # fewest different numbers of a column in a comparison
_FEWEST_STEPS, _OFF_GRID = 2, 1e-3  # fewest differences that define a step, and their tolerance in steps
_PER_NM, _COARSEST = 1e9, 7  # resolution of a file's lengths, 1/m, and the power of ten of the coarsest digit, 10 mm
_ABOVE_NOISE = 3.0  # error by rounding over declared noise
_ROUNDED = (0.5, 2.0)  # misfit over the error that the step of a column causes


@dataclass(frozen=True)
class Agreement:
    """Rows that agree within one offset (L,), m; distance (B,) of every row, its ``limit``, and the typical one."""

    offset: Array
    distance: Array
    limit: float
    typical: float

    @property
    def apart(self) -> Index:
        """Rows that do not agree."""
        return np.flatnonzero(self.distance > self.limit)


def agreement(readings: Array, required: Array, noise: float) -> Agreement | None:
    """Return the largest set of agreeing rows of readings and required (B, L) in m; None where all rows agree.

    Rows agree if their differences from the required readings are nearly equal.
    """
    misfit = readings - required
    moved = float(np.sqrt(np.mean((required - required.mean(axis=0)) ** 2)))
    near = max(_NEAR * moved, 3.0 * noise)
    centres = misfit[:: -(-len(misfit) // _MOST_CENTRES)]
    sizes = [int(np.sum(_distance(misfit, centre) < near)) for centre in centres]
    best = centres[int(np.argmax(sizes))]
    members = _distance(misfit, best) < near
    if members.sum() < max(_FEWEST, _LEAST_SHARE * len(misfit)):
        return None
    offset = np.median(misfit[members], axis=0)
    distance = _distance(misfit, offset)
    typical = max(float(np.median(distance[members])), noise)
    agreed = Agreement(offset, distance, max(_FAR * typical, _CLEARLY * moved), typical)
    return agreed if len(agreed.apart) >= _FEWEST_APART else None


def _distance(misfit: Array, offset: Array) -> Array:
    return np.asarray(np.sqrt(np.mean((misfit - offset) ** 2, axis=1)))


def slipped_rows(undone: Array, required: Array, agreed: Agreement) -> tuple[Mask, Mask] | None:
    """Return the rows (B,) that a slip concerns and those that it does not; None where it does not explain the rest.

    undone (B, L): all readings with the slip undone. Rows in which it makes no difference are in neither.
    """
    after = _distance(undone - required, agreed.offset)
    before = agreed.distance
    slipped, unslipped = after < _MOST_LEFT * before, before < _MOST_LEFT * after
    slipped &= before > _FAR * agreed.typical
    if slipped.sum() < _FEWEST_APART or not unslipped.any():
        return None
    least = max(_LEFT[0] * rms_of(before[unslipped & (before <= agreed.limit)]), _LEFT[1] * rms_of(before[slipped]))
    deviating = before > agreed.limit
    explained = np.mean((slipped & (after <= agreed.limit))[deviating])
    return (slipped, unslipped) if rms_of(after[slipped]) <= least and explained >= _EXPLAINED else None


def rms_of(values: Array) -> float:
    """Root mean square of values; 0 without any."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def row_places(
    slipped: Mask,
    unslipped: Mask,
    poses: Sequence[str],
    groups: Sequence[tuple[str, Sequence[str]]],
    noun: str = "pose ",
) -> list[str]:
    """Return the places of rows (B,) in words: a group, a few stretches, a regular pattern, or each by its name.

    groups: name of a column and its value in each row. ``noun``: before each name; empty where names have one.
    """
    named = [
        group for name, values in groups for group in _complete_groups(name, np.asarray(values), slipped, unslipped)
    ]
    stretches = _stretches(slipped, unslipped)
    if len(stretches) <= _MOST_STRETCHES:
        return [*named, *(_stretch(first, last, poses, noun) for first, last in stretches)]
    at = np.flatnonzero(slipped)
    step = int(np.gcd.reduce(np.diff(at)))
    if step > 1 and not unslipped[np.arange(at[0], at[-1] + 1, step)].any():
        return [*named, f"every {_NTH.get(step, f'{step}th')} {noun or 'one '}from {poses[at[0]]} to {poses[at[-1]]}"]
    return named or [_stretch(first, last, poses, noun) for first, last in stretches]


def _complete_groups(name: str, values: NDArray[np.str_], slipped: Mask, unslipped: Mask) -> list[str]:
    """Return the values of a column whose rows are exactly those that slipped."""
    names = list(dict.fromkeys(values[slipped].tolist()))
    inside = np.isin(values, names)
    return (
        []
        if (inside & unslipped).any() or not (~inside & unslipped).any()
        else [f"{name} {name_of_group}" for name_of_group in names]
    )


_NTH = {2: "second", 3: "third", 4: "fourth", 5: "fifth"}


def _stretches(slipped: Mask, unslipped: Mask) -> list[tuple[int, int]]:
    """Return first and last row of each stretch of slipped rows without right ones between them."""
    stretches: list[tuple[int, int]] = []
    for row in np.flatnonzero(slipped).tolist():
        if stretches and not unslipped[stretches[-1][1] : row].any():
            stretches[-1] = (stretches[-1][0], row)
        else:
            stretches.append((row, row))
    return stretches


def _stretch(first: int, last: int, poses: Sequence[str], noun: str) -> str:
    begin, end = f"{noun}{poses[first]}", f"{noun}{poses[last]}"
    if first == last:
        return begin
    if last == len(poses) - 1:
        return f"from {begin} on"
    return f"up to {end}" if first == 0 else f"from {begin} to {end}"


@dataclass(frozen=True)
class RowOrder:
    """Rows (B,) of the recorded readings that belong to each pose; -1 where none does.

    ``gain``: log likelihood over the recorded order, less the penalty for its choice. ``shift``: number of rows by
    which all rows are too far down, if they are shifted.
    """

    rows: Index
    gain: float
    shift: int = 0

    @property
    def moved(self) -> Index:
        """Poses whose readings are in another row."""
        return np.flatnonzero((self.rows != np.arange(len(self.rows))) & (self.rows >= 0))


def best_order(readings: Array, required: Array, noise: float) -> RowOrder:
    """Return the order of rows under which readings (B, L) match the required ones (B, L) best, both in m.

    The mean of each leg does not depend on the order and is removed. ``noise`` is the least standard deviation of a
    row.
    """
    shifted = [_shifted(readings, required, noise, shift) for shift in _SHIFTS if 3 * abs(shift) < len(readings)]
    simple = max(shifted, key=lambda order: order.gain, default=None)
    free = _exchanged(readings, required, noise)
    if simple is not None and simple.gain > _CLEAR:
        left, least = (_median_misfit(order, readings, required) for order in (simple, free))
        if left <= _NEARLY * least:
            return simple
    return free if free.gain > _CLEAR else RowOrder(np.arange(len(readings)), 0.0)


def _median_misfit(order: RowOrder, readings: Array, required: Array) -> float:
    """Return the median misfit, m, of an order, about the median of each leg."""
    is_placed = order.rows >= 0
    misfit = readings[order.rows[is_placed]] - required[is_placed]
    return float(np.median(np.abs(misfit - np.median(misfit, axis=0))))


def _minus_mean(values: Array, rows: Index) -> Array:
    return values[rows] - np.mean(values[rows], axis=0)


def _log_likelihood(misfit: Array, noise: float) -> float:
    """Return the log likelihood of misfits (N, L) with one free noise level per leg, at least ``noise``."""
    level = np.maximum(np.sqrt(np.mean(misfit**2, axis=0)), noise)
    return float(-np.sum(len(misfit) * np.log(level)) - 0.5 * np.sum((misfit / level) ** 2))


def _shifted(readings: Array, required: Array, noise: float, shift: int) -> RowOrder:
    """Return readings that are ``shift`` rows too far down, in the rows that overlap."""
    count = len(readings)
    poses = np.arange(max(0, -shift), count - max(0, shift))
    rows = np.full(count, -1, np.int64)
    rows[poses] = poses + shift
    likelihood = _log_likelihood(_minus_mean(readings, poses) - _minus_mean(required, poses), noise)
    moved = _log_likelihood(_minus_mean(readings, poses + shift) - _minus_mean(required, poses), noise)
    return RowOrder(rows, moved - likelihood - np.log(len(_SHIFTS)), shift)


def _exchanged(readings: Array, required: Array, noise: float) -> RowOrder:
    """Return the assignment of rows to poses with the smallest squares, with only those exchanges that clearly pay."""
    every = np.arange(len(readings))
    offset, level = np.mean(readings - required, axis=0), np.maximum(np.std(required, axis=0), noise)
    suspects = (
        every if len(every) <= _MOST_ROWS else _worst(readings - required - np.median(readings - required, axis=0))
    )
    for _ in range(2):  # the second time with the noise level and the zero after the first assignment
        between = (readings[suspects] - offset)[None] - required[suspects][:, None]
        cost = np.sum(np.log1p((between / level) ** 2), axis=2)  # bounded growth: one wild leg decides nothing
        rows = cheapest_columns(cost)
        residual = readings[suspects[rows]] - required[suspects]
        if len(suspects) == len(every):
            offset = np.median(residual, axis=0)
            level = np.maximum(1.4826 * np.median(np.abs(residual - offset), axis=0), noise)
    order = every.copy()
    order[suspects] = suspects[rows]
    paid = 0.0
    index_of = {int(row): at for at, row in enumerate(suspects)}
    for cycle in _cycles(order):
        at = np.array([index_of[pose] for pose in cycle])
        now = np.array([index_of[int(order[pose])] for pose in cycle])
        gain = 0.5 * float(np.sum(cost[at, at] - cost[at, now])) * readings.shape[1]
        gain -= len(cycle) * np.log(len(every))
        if gain > _CLEAR and _consistent(between[at, now], between[at, at]):
            paid += gain
        else:
            order[cycle] = cycle
    return RowOrder(order, paid)


def _worst(misfit: Array) -> Index:
    level = np.maximum(1.4826 * np.median(np.abs(misfit), axis=0), 1e-300)
    size = np.sqrt(np.mean((misfit / level) ** 2, axis=1))
    order = np.argsort(-size)[:_MOST_ROWS]
    return np.sort(order[size[order] > _WORSE])


def _consistent(after: Array, before: Array) -> bool:
    """Return True if exchanged rows (N, L) keep at most a fifth of their misfit, unlike any exchange of random rows."""
    return bool(np.mean(after**2) < _MOST_LEFT_OF_EXCHANGED**2 * np.mean(before**2))


def _cycles(order: Index) -> list[list[int]]:
    """Return the cycles of a permutation that move anything."""
    left, cycles = set(np.flatnonzero(order != np.arange(len(order))).tolist()), []
    while left:
        cycle, at = [], min(left)
        while at in left:
            left.remove(at)
            cycle.append(at)
            at = int(order[at])
        cycles.append(cycle)
    return cycles


def stray_readings(readings: Array, required: Array, noise: float) -> Index:
    """Return rows and columns (N, 2) of the few readings (B, L) far from the required ones (B, L), m."""
    misfit = readings - required
    misfit = misfit - np.median(misfit, axis=0)
    scatter = np.maximum(_MEDIAN * np.median(np.abs(misfit), axis=0), noise)
    limit = np.maximum(_STRAY * scatter, _SIZEABLE * np.ptp(required, axis=0))
    strays = np.argwhere(np.abs(misfit) > limit)
    return strays if len(strays) <= max(_FEW * misfit.size, 1.0) else strays[:0]


def copied_columns(readings: Array) -> list[tuple[int, int]]:
    """Return pairs of columns of readings (B, L) that are equal in every row."""
    return [
        (i, j)
        for i in range(readings.shape[1])
        for j in range(i + 1, readings.shape[1])
        if np.array_equal(readings[:, i], readings[:, j]) and len(np.unique(readings[:, i])) >= _DIFFERENT
    ]


def written_step(values: Array) -> float:
    """Return the step, in the unit of the values, of which all differences are multiples; 0 for none."""
    steps = np.diff(np.unique(values.round(12)))
    steps = steps[steps > 1e-12]
    if len(steps) < _FEWEST_STEPS:
        return 0.0
    counted = steps / steps.min()
    return float(steps.min()) if np.abs(counted - counted.round()).max() < _OFF_GRID else 0.0


def rounding(values: Array, misfit: float, noise: float) -> float | None:
    """Return the step, m, of numbers whose rounding error exceeds the declared noise and explains the rms misfit.

    None also where the misfit is far smaller: a drive may be commanded to round numbers, and reach them. Numbers of a
    few levels have the levels' step; the last digit written is tried as well.
    """
    for step in (written_step(values), last_digit(values)):
        error = step / np.sqrt(12.0)
        if error > _ABOVE_NOISE * noise and misfit > _ROUNDED[0] * error:
            return step
    return None


def last_digit(values: Array) -> float:
    """Return the largest power of ten, m, of which all values are multiples; 0 for none down to a nanometre."""
    counted = np.round(values[np.isfinite(values)] * _PER_NM)
    if not len(counted) or np.abs(values[np.isfinite(values)] * _PER_NM - counted).max() > _OFF_GRID:
        return 0.0
    powers = 10.0 ** np.arange(_COARSEST, -1, -1)
    return float(next((power for power in powers if not np.any(counted % power)), 0.0) / _PER_NM)


def rounded_to(readings: Array, misfit: float, noise: float) -> float | None:
    """Return the step, m, in which readings were recorded, if it explains the rms misfit; else None."""
    step = written_step(readings)
    error = step / np.sqrt(12.0)
    low, high = _ROUNDED
    return step if error > 10.0 * noise and low * error < misfit < high * error else None
