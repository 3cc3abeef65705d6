"""What may follow what on a bench, where no cause of the catalogue says so: columns of the steps, and what was before.

What a cause already does in the very same form (a channel in proportion to the load of its own axis, or to the time in
a run) is not told again: data could not tell the two apart.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.reading_state import (
    AIR,
    CHANNELS,
    IN_RUN,
    LOADS,
    MATERIAL,
    ORDER,
    TIME,
    LoadSteps,
)
from truing.simulation.causes.bench.of_readings import FEWEST, is_signal
from truing.simulation.causes.following import POLYNOMIAL, WAVES

# Before a load's name: one where that is smaller in size than at the step before; the largest size so far in the run;
# which way it changed last.
UNLOADING, SO_FAR, WAY = "unloading ", "largest so far ", "direction of "
# Functions of a load, of one and of two steps before; sine and cosine of a period.
MEMORY, PERIOD = "memory", "period"
REMEMBERED = 2
# A jump where a load is beyond a size, on either side by an amount of its own: between two levels, so many at most.
BEYOND, SIDES = "beyond", 2
_MOST_SIZES = 5
# A load with a factor, and with one that follows a column: nobody knows at which value of that the factor is one.
GAIN, FACTORS = "gain", 2
# What comes with a break in a run and fades.
REST = "rest"
_FADES, _MOST_FADES = 2.0, 8
SMOOTH = 3
_WAVES = 6
# What the catalogue has in proportion to a column already.
_NAMED_LINEAR = (IN_RUN, MATERIAL, AIR)
# Periods of time that are tried: from so many steps up to a part of the campaign, so many at most, this share of the
# campaign's own frequency apart.
_STEPS_PER_PERIOD, _PERIODS_AT_LEAST, _MOST_PERIODS, _APART = 2.5, 3.0, 300, 0.5
# Of a load: so many levels wherever a period begins, and so many periods in the range of loads. What is slower is a
# polynomial; through fewer levels some wave passes whatever they do.
_LEVELS_PER_PERIOD, _LOAD_PERIODS_AT_LEAST = 4, 2.0
# Loads nearer to each other than this share of their range are one level, applied again.
_ONE_LEVEL = 0.01

Follow = tuple[tuple[str, ...], str, int]


def followings(steps: LoadSteps, seen: NDArray, channel: str) -> Iterator[Follow]:
    """Yield columns, form and degree of what a channel, seen at steps (B,), may follow."""
    loads = [name for name, loaded in zip(LOADS, steps.loaded, strict=True) if loaded]
    own = LOADS[CHANNELS.index(channel)] if channel in CHANNELS else ""
    others = [name for name in _columns(steps, seen) if name not in LOADS]

    def levels(*columns: str) -> int:
        values = np.prod([values_of(steps, column)[seen] for column in columns], axis=0)
        return len(np.unique(np.round(values, 12)))

    for load in loads:
        first = 2 if load == own or is_signal(channel) else 1
        for degree in range(first, SMOOTH + 1):
            if levels(load) > degree:
                yield (load,), POLYNOMIAL, degree
        if load != own and levels(UNLOADING + load, load) > 1:
            yield (UNLOADING + load, load), POLYNOMIAL, 1
        if levels(UNLOADING + load) > 1:
            yield (UNLOADING + load,), POLYNOMIAL, 1
            yield (load,), MEMORY, REMEMBERED
        for told in (SO_FAR, WAY):
            if levels(told + load) > 1:
                yield (told + load,), POLYNOMIAL, 1
    for pair in combinations(loads, 2):
        if levels(*pair) > 1:
            yield pair, POLYNOMIAL, 1
    for column in others:
        if column not in _NAMED_LINEAR:
            yield (column,), POLYNOMIAL, 1
        if levels(column) > SMOOTH:
            yield (column,), POLYNOMIAL, SMOOTH
    timed = TIME if TIME in others else ORDER
    if timed in others:
        yield (timed,), WAVES, _WAVES
    for load in loads if not is_signal(channel) else ():
        for column in others:
            if levels(load) > 1:
                yield (load, column), GAIN, FACTORS


def _columns(steps: LoadSteps, seen: NDArray) -> list[str]:
    """Return the columns that vary while a channel is seen; the order only where there is no time."""
    found = [
        name
        for name, values in steps.covariates.items()
        if values.ndim == 1 and values.dtype.kind in "fiu" and np.isfinite(values).all() and np.ptp(values[seen]) > 0
    ]
    return [name for name in found if name != ORDER or TIME not in found]


def sizes_between(steps: LoadSteps, load: str, seen: NDArray) -> NDArray:
    """Return sizes of a load, N or N m, between those that were applied while a channel was seen (B,); none below the
    smallest, where it is the load itself that is there or not."""
    sizes = np.sort(np.abs(values_of(steps, load)[seen]))
    one_level = _ONE_LEVEL * sizes.max(initial=0.0)
    sizes = sizes[sizes > one_level]
    apart = np.flatnonzero(np.diff(sizes) > one_level)
    between = (sizes[apart] + sizes[apart + 1]) / 2.0
    chosen = np.linspace(0, max(len(between) - 1, 0), min(_MOST_SIZES, len(between))).round().astype(int)
    return np.asarray(between[chosen])


def fading_times(steps: LoadSteps, seen: NDArray) -> NDArray:
    """Return times, s, with which something may fade after a break while a channel was seen (B,): from a usual pause to
    the longest run; none where there was no break."""
    held = steps.held_s[steps.held_s > 0.0]
    if np.isfinite(steps.since_break_s[seen]).sum() < FEWEST:
        return np.zeros(0)
    shortest, longest = float(np.median(held)), steps.longest_s
    count = min(_MOST_FADES, 1 + int(np.ceil(np.log(longest / shortest) / np.log(_FADES))))
    return np.geomspace(shortest, longest, count)


def range_of(steps: LoadSteps, column: str) -> tuple[float, float]:
    """Return the centre and half the range of a column; of a load, zero and its largest."""
    if column.removeprefix(SO_FAR) in LOADS:
        return 0.0, float(steps.largest[LOADS.index(column.removeprefix(SO_FAR))])
    if column.startswith((UNLOADING, WAY)):
        return 0.0, 1.0
    values = values_of(steps, column)
    return float(values.max() + values.min()) / 2, (float(np.ptp(values)) / 2) or 1.0


def values_of(steps: LoadSteps, column: str) -> NDArray:
    """Return a column's values (B,)."""
    if column.startswith(UNLOADING):
        return steps.unloading[:, LOADS.index(column.removeprefix(UNLOADING))].astype(float)
    if column.startswith(SO_FAR):
        return steps.largest_so_far[:, LOADS.index(column.removeprefix(SO_FAR))]
    if column.startswith(WAY):
        return steps.direction[:, LOADS.index(column.removeprefix(WAY))]
    if column in LOADS:
        return steps.load[:, LOADS.index(column)]
    return np.asarray(steps.covariates[column], float)


def remembered(steps: LoadSteps, load: str) -> NDArray:
    """Return a load (B, 2) over its largest, one and two steps before in the run; zero before its start."""
    share = steps.share[:, LOADS.index(load)]
    once = np.where(steps.rank >= 1, share[steps.before], 0.0)
    return np.stack([once, np.where(steps.rank >= REMEMBERED, share[steps.before[steps.before]], 0.0)], -1)


def periods_of(steps: LoadSteps, column: str) -> NDArray:
    """Return the periods (S,) of time, s, or of a load, N or N m, that a campaign tells apart."""
    values = values_of(steps, column)
    span = float(np.ptp(values)) if np.isfinite(values).all() else 0.0
    if not span > 0.0:
        return np.zeros(0)
    if column != TIME:
        return periods_of_levels(np.unique(np.round(values / (_ONE_LEVEL * span))) * (_ONE_LEVEL * span))
    held = steps.held_s[steps.held_s > 0.0]
    if not len(held):
        return np.zeros(0)
    fastest = 1.0 / (_STEPS_PER_PERIOD * float(np.median(held)))
    frequencies = np.arange(_PERIODS_AT_LEAST / span, fastest, _APART / span)
    return np.asarray(1.0 / frequencies[:_MOST_PERIODS])


def periods_of_levels(levels: NDArray) -> NDArray:
    """Return the periods (S,) that loads at these levels (L,), ascending, tell apart."""
    span, count = float(levels[-1] - levels[0]), len(levels)
    counted = np.arange(_LOAD_PERIODS_AT_LEAST, count / _LEVELS_PER_PERIOD, _APART)
    periods = span / counted[:_MOST_PERIODS]
    nearly = 0.5 * _ONE_LEVEL * span
    within = np.searchsorted(levels, levels + periods[:, None] - nearly) - np.arange(count)
    whole = levels + periods[:, None] <= levels[-1] + nearly
    return np.asarray(periods[np.all((within >= _LEVELS_PER_PERIOD) | ~whole, axis=1)])


def follows_of(columns: tuple[str, ...]) -> tuple[str, ...]:
    """Return the columns of the tables that these are made of."""
    plain = (column.removeprefix(UNLOADING).removeprefix(SO_FAR).removeprefix(WAY) for column in columns)
    return tuple(dict.fromkeys(TIME if column in (ORDER, IN_RUN) else column for column in plain))
