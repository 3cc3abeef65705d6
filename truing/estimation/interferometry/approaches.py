"""Plausibility of positioning tests: deviations that do not come from the axis (overflows, gross errors, copies,
jumps).

Deviations (P, 2, C): actual minus target position at P targets, in two directions, in C cycles, in any unit of length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.arrays import Array, Index, Mask

_BITS = range(8, 41)  # no encoder counts beyond 2^40; 2^7 steps may be a reversal
_ROUNDED = 1e-13  # relative to the positions: rounding of their numbers
_ON_GRID = 0.02  # of a step: closeness to whole steps of rounded decimals
_CLOSED = 0.02  # share of an overflow that may remain in the deviations after its correction
_FEWEST_TOGETHER = 5  # size of a group from which others can be separated
_MOST_GROSS = 0.1  # share of the approaches that are tested one after the other
_ALIKE = 0.25  # relative to the reversal: difference between the other cycles, if one is taken as exchanged
_CLEAR = 6.0
_PRIOR_PAIRS = 2.0  # weight of the rate over all targets, in pairs of series
_MOST_STEPS = 2e6  # approaches times candidate jump positions; above, every second or third position is tried
# Size of the larger group, and ratio from which a deviation equal to another target's distance is not the axis' own.
_OF_TARGETS = ((4, 1.0), (3, 10.0))


def resolution(position: Array) -> float:
    """Return the step of which all positions are whole multiples, apart from a common offset; 0 without a step."""
    steps = np.unique(np.diff(np.unique(position)))
    steps = steps[steps > _ROUNDED * float(np.abs(position).max(initial=0.0))]
    if not len(steps):
        return 0.0
    step = float(steps[0])
    for one in steps.tolist():  # each larger difference refines the step, so that the next one can be counted in it
        count = round(one / step)
        if abs(one / step - count) > _ON_GRID:
            return 0.0
        step = one / count
    return step


@dataclass(frozen=True)
class Overflow:
    """Deviations that differ by multiples of 2^bits steps: ``where`` (P, 2, C), and the jump in their unit."""

    bits: int
    jump: float
    where: Mask


def overflow(deviation: Array, step: float) -> Overflow | None:
    """Return the overflow of a counter with the given step; None if no overflow explains the deviations.

    A difference between the directions alone, of any size, is no overflow.
    """
    if step <= 0.0:
        return None
    # An element of the deviations, not a mean of two.
    middle = float(np.sort(deviation, axis=None)[(deviation.size - 1) // 2])
    for bits in reversed(_BITS):
        jump = step * 2.0**bits
        turns = np.round((deviation - middle) / jump)
        if not turns.any() or _by_direction_alone(turns):
            continue
        left = float(np.ptp(deviation - turns * jump))
        if left < _CLOSED * jump:
            return Overflow(bits, jump, turns != 0.0)
    return None


def _by_direction_alone(values: Array) -> bool:
    """True if values (P, 2, C) depend on the direction alone."""
    return bool((values == values[:1, :, :1]).all())


@dataclass(frozen=True)
class Gap:
    """Deviations in two separate groups: the gap, the wider group's range, and the smaller group (P, 2, C).

    ``weight``: reduction of the gap if whole targets are separate, since the axis itself may cause that.
    """

    size: float
    spread: float
    where: Mask
    weight: float = 1.0

    @property
    def ratio(self) -> float:
        """Weighted gap over the range of the wider group."""
        return self.size / self.spread / self.weight if self.spread > 0.0 else np.inf


def widest_gap(deviation: Array, floor: float = 0.0) -> Gap | None:
    """Return the widest gap between the sorted deviations, unless the two groups are the two directions.

    ``floor``: smallest spread of a group, such as the step of the readings. None for fewer than five deviations in the
    larger group.
    """
    level = np.sort(deviation, axis=None)
    steps = np.diff(level)
    at = int(np.argmax(steps))
    above = deviation > 0.5 * (level[at] + level[at + 1])
    few = above if above.sum() <= above.size / 2 else ~above
    if above.size - few.sum() < _FEWEST_TOGETHER or _by_direction_alone(few.astype(float)):
        return None
    weight = 1.0
    if np.array_equal(few, np.broadcast_to(few[:, :, :1], few.shape)):  # the same in every cycle
        complete = int((~few.any(axis=(1, 2))).sum())
        weight = next((least for count, least in _OF_TARGETS if complete >= count), np.inf)
    spread = max(float(level[at] - level[0]), float(level[-1] - level[at + 1]), floor)
    return Gap(float(steps[at]), spread, few, weight)


@dataclass(frozen=True)
class GrossErrors:
    """Approaches far from the others of their target and direction: ``where`` (P, 2, C), the worst one, its distance,
    the scatter of all others, and the p-value of the worst."""

    where: Mask
    worst: tuple[int, int, int]
    off: float
    scatter: float
    p_value: float


def gross_errors(deviation: Array, limit: float, floor: float = 0.0) -> GrossErrors:
    """Return the approaches whose distance from their group has a p-value below ``limit``.

    Deleted residuals over the scatter of all other approaches within their groups, by Student's distribution, times the
    number of approaches; the worst is removed and the test repeated. ``floor``: smallest scatter, such as the step of
    the readings.
    """
    out = np.zeros(deviation.shape, dtype=bool)
    first: tuple[tuple[int, int, int], float, float, float] | None = None
    for _ in range(max(1, int(_MOST_GROSS * deviation.size))):
        worst, off, scatter, p = _worst(deviation, out, floor)
        first = first or (worst, off, scatter, p)
        if p >= limit:
            break
        out[worst] = True
    assert first is not None
    if out.any():  # the scatter in the result is that of the approaches left at the end
        first = (first[0], first[1], _worst(deviation, out, floor)[2], first[3])
    return GrossErrors(out, *first)


def _worst(deviation: Array, out: Mask, floor: float) -> tuple[tuple[int, int, int], float, float, float]:
    """Return the worst approach not yet removed: its index, distance from its group, scatter of the others, p-value."""
    from scipy.special import stdtr

    count = (~out).sum(axis=-1, keepdims=True)
    mean = np.where(out, 0.0, deviation).sum(axis=-1, keepdims=True) / np.maximum(count, 1)
    assessed = ~out & (count > 1)
    residual = np.where(assessed, deviation - mean, 0.0)
    deleted = residual * count / np.maximum(count - 1, 1)
    freedom = float(assessed.sum() - (count > 1).sum()) - 1.0
    square = float(np.sum(residual**2))
    if freedom < 1.0:
        return (0, 0, 0), 0.0, floor, 1.0
    # without an approach, its group's sum of squares drops by its residual times its deleted residual
    scatter = np.sqrt(np.maximum(square - residual * deleted, 0.0) / freedom)
    scatter = np.maximum(scatter, max(floor, 1e-12 * float(np.abs(deviation).max(initial=1e-300))))
    t = np.where(assessed, np.abs(deleted) / (scatter * np.sqrt(count / np.maximum(count - 1, 1))), 0.0)
    a, b, c = (int(k) for k in np.unravel_index(int(np.argmax(t)), t.shape))
    p = min(1.0, 2.0 * float(stdtr(freedom, -t[a, b, c])) * int(assessed.sum()))
    return (a, b, c), float(deleted[a, b, c]), float(scatter[a, b, c]), p


def copied_series(position: Array) -> tuple[list[tuple[int, int]], float]:
    """Return pairs of series (P readings of one direction and cycle) that are equal in every digit; and the probability
    of one such pair by chance.

    position (P, 2, C); a series is numbered by direction times C plus cycle. The chance follows from how often readings
    of other pairs agree at each target, within and across directions: often, if readings have few digits.
    """
    series = position.reshape(len(position), -1).T
    i, j = np.triu_indices(len(series), 1)
    equal = series[i] == series[j]
    is_equal = equal.all(axis=1)
    across = (i < position.shape[-1]) != (j < position.shape[-1])
    chance = 0.0
    for side in (across, ~across):
        if (side & is_equal).any():
            chance = max(chance, int(side.sum()) * _equal_by_chance(equal[side & ~is_equal]))
    return [(int(a), int(b)) for a, b in zip(i[is_equal], j[is_equal], strict=True)], chance


def _equal_by_chance(equal: Mask) -> float:
    """Return the probability that all readings of a pair agree, from the agreement of others (N, P)."""
    pooled = (equal.sum() + 1.0) / (equal.size + 2.0)
    single = (equal.sum(axis=0) + _PRIOR_PAIRS * pooled) / (len(equal) + _PRIOR_PAIRS)
    return float(np.prod(single))


@dataclass(frozen=True)
class RowJump:
    """A jump between two approaches in the order of measurement: size, first approach after it, scatter on each side,
    and p-value."""

    size: float
    after: tuple[int, int, int]
    scatter: float
    p_value: float


def row_jump(deviation: Array, row_order: Index, floor: float = 0.0) -> RowJump | None:
    """Return the jump that best explains the differences between approaches of the same target and direction.

    deviation and row_order (P, 2, C): position of each in the order of measurement. ``floor``: smallest scatter, such
    as the step of the readings. None if there are too few approaches.
    """
    from scipy.special import fdtrc

    order = np.argsort(row_order, axis=None)
    cycles = deviation.shape[-1]
    tried = np.unique(
        np.linspace(0, order.size - 2, min(order.size - 1, int(_MOST_STEPS / order.size) + 50)).astype(int)
    )
    later = (np.arange(order.size)[:, None] > tried).astype(float)  # rows by position of the jump
    by_group = np.empty_like(later)
    by_group[order] = later
    by_group = by_group.reshape(-1, cycles, len(tried))
    steps = (by_group - by_group.mean(axis=1, keepdims=True)).reshape(order.size, -1)
    centred = (deviation - deviation.mean(axis=-1, keepdims=True)).ravel()
    norm = np.sum(steps**2, axis=0)
    slope = np.divide(centred @ steps, norm, out=np.zeros(len(norm)), where=norm > 1e-9)
    explained = slope**2 * norm
    at, freedom = int(np.argmax(explained)), order.size * (1.0 - 1.0 / cycles) - 2.0
    if freedom < 1.0:
        return None
    variance = max(
        float(centred @ centred - explained[at]) / freedom, floor**2, 1e-24 * float(centred @ centred), 1e-300
    )
    p = min(1.0, float(fdtrc(1.0, freedom, explained[at] / variance)) * len(norm))
    after = tuple(int(k) for k in np.unravel_index(int(order[tried[at] + 1]), deviation.shape))
    return RowJump(float(slope[at]), (after[0], after[1], after[2]), float(np.sqrt(variance)), p)


def turned_cycles(deviation: Array) -> list[int]:
    """Return the cycles whose reversal has the opposite sign of the others': forward and backward are exchanged.

    Of two cycles with opposite reversals the second is returned. None if reversals are not larger than their scatter.
    """
    reversal = deviation[:, 0] - deviation[:, 1]  # (P, C)
    cycles = reversal.shape[1]
    if len(reversal) < 2 or cycles < 2:
        return []
    of_cycle = reversal.mean(axis=0)
    usual = float(np.median(np.abs(of_cycle)))
    side = np.sign(of_cycle)
    turned = side != (np.sign(np.sum(side)) or side[0])
    sided = np.where(turned, -of_cycle, of_cycle)
    fits = np.abs(np.abs(sided) - usual) <= _ALIKE * usual
    straight = reversal * np.where(turned, -1.0, 1.0)
    residual = straight - straight.mean(axis=1, keepdims=True)
    noise = np.sqrt(np.sum(residual**2) / max(residual.size - len(residual), 1) / len(residual))
    if not turned.any() or not fits.all() or usual < _CLEAR * noise:
        return []
    return np.flatnonzero(turned).tolist()


@dataclass(frozen=True)
class CycleDrift:
    """Change of the deviations from the first cycle to the last; p-value of the cycles' means, and the share of their
    differences that a straight line explains."""

    walked: float
    p_value: float
    share: float


def cycle_drift(deviation: Array) -> CycleDrift | None:
    """Return the drift over the cycles of deviations (P, 2, C); None for fewer than four cycles."""
    from scipy.special import fdtrc

    cycles = deviation.shape[-1]
    if cycles < 4:
        return None
    residual = deviation - deviation.mean(axis=-1, keepdims=True)
    mean = residual.mean(axis=(0, 1))
    groups = deviation.shape[0] * 2
    scatter = residual - mean
    between, within = groups * float(np.sum(mean**2)), float(np.sum(scatter**2))
    freedom = (groups - 1.0) * (cycles - 1.0)
    at = np.arange(cycles) - 0.5 * (cycles - 1)
    slope = float(at @ mean / (at @ at))
    share = groups * slope**2 * float(at @ at) / between if between > 0.0 else 0.0
    ratio = between / (cycles - 1.0) / max(within / freedom, 1e-300)
    return CycleDrift(slope * (cycles - 1), float(fdtrc(cycles - 1.0, freedom, ratio)), share)
