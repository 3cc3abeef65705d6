"""Runs that hold the very numbers of another run, which noise makes no two runs do."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.belonging.copied_parts import copied_parts
from truing.belonging.relation import Slip, SlipKind, State, Tested

Array = NDArray[np.float64]
Index = NDArray[np.int64]

RELATION = "copied-runs"
_FEWEST = 5  # values that have to be equal
_CHANCE = 1e-9  # of so many equal values
_EQUAL = 0.95  # share of two runs' values
_TELLING = 0.3  # probability of one equal value below which equal values tell anything
_DISTINCT = 0.3  # share of values that occur once: with fewer, a converter is coarser than the noise
_PLACES = 10  # decimal places that are looked for
_DIGITS = 11  # of the largest value: more are rounding


@dataclass(frozen=True)
class Values:
    """A table of values (N, K) whose runs are compared, and how they scatter (K,), NaN where nobody says."""

    name: str
    value: Array
    noise: Array


def copied_runs(run: Index, runs: Sequence[str], load: Array, tables: Sequence[Values]) -> tuple[Tested, ...]:
    """Return the test of all pairs of runs, load (N, 6) too.

    Whole runs are compared row by row from the first of both, parts of them wherever they stand.
    """
    found, pairs, telling, parts_tell = dict[tuple[str, str], list[_Copy]](), 0, False, True
    rows = [np.flatnonzero(run == one) for one in range(len(runs))]
    for table in map(_rounded, tables):
        alike, other = _chance(table.value, table.noise)
        telling |= bool((other < _TELLING).any())
        for first, second in _alike(table.value, rows):
            chance = alike if _same(load[rows[first]], load[rows[second]]) else other
            share, likely = _equal(table.value[rows[first]], table.value[rows[second]], chance)
            if share >= _EQUAL and likely < _CHANCE:
                found.setdefault((runs[first], runs[second]), []).append(_Copy(table.name, share))
        parts, tell = copied_parts(table.value, rows, load, alike, other)
        parts_tell &= tell
        for part in parts:
            known = found.setdefault((runs[part.first], runs[part.second]), [])
            if all(one.quantity != table.name for one in known):
                known.append(_Copy(table.name, part.share, tuple((part.rows + 1).tolist())))
        pairs += len(runs) * (len(runs) - 1) // 2
    if found:
        return tuple(_told(found, pairs))
    if not pairs or not telling:
        return (Tested(RELATION, State.NOT_TESTED, "coarse" if pairs else "one-run"),)
    return (Tested(RELATION, State.OK, "no-copies" if parts_tell else "no-whole-copies", tried=pairs),)


def _rounded(table: Values) -> Values:
    """A table without what turning units back and forth leaves in its last digits."""
    most = np.nanmax(np.abs(table.value), axis=0, initial=1e-300)
    return replace(table, value=np.round(table.value / most, _DIGITS) * most)


@dataclass(frozen=True)
class _Copy:
    """A quantity of two runs, the share of it that is the same, and which rows of the first (from 1): none for all."""

    quantity: str
    share: float
    rows: tuple[int, ...] = ()


def _told(found: dict[tuple[str, str], list[_Copy]], pairs: int) -> Iterator[Tested]:
    for (first, second), copies in found.items():
        rows = () if any(not one.rows for one in copies) else max((one.rows for one in copies), key=len)
        slip = Slip(SlipKind.COPIED, " and ".join(one.quantity for one in copies), (first, second), rows=rows)
        share = 100.0 * max(one.share for one in copies)
        yield Tested(
            RELATION, State.FAILS, "copied", f"{first}, {second}", share, None, None, "%", (slip,), tried=pairs
        )


def _alike(value: Array, rows: Sequence[Index]) -> Iterator[tuple[int, int]]:
    """Pairs of runs that share their values at one of a few steps at least."""
    for first in range(len(rows)):
        for second in range(first + 1, len(rows)):
            count = min(len(rows[first]), len(rows[second]))
            if count and np.any(value[rows[first][:count]] == value[rows[second][:count]]):
                yield first, second


def _equal(first: Array, second: Array, chance: Array) -> tuple[float, float]:
    """Share of equal values of two runs, and how likely so many are where each is equal by chance (K,)."""
    count = min(len(first), len(second))
    both = np.isfinite(first[:count]) & np.isfinite(second[:count])
    equal = (first[:count] == second[:count]) & both
    moving = np.array([len(np.unique(own[there])) > 2 for own, there in zip(first[:count].T, both.T, strict=True)])
    both, equal = both[:, moving], equal[:, moving]
    if equal.sum() < _FEWEST:
        return 0.0, 1.0
    return float(equal.sum() / both.sum()), float(np.exp(np.sum(equal * np.log(chance[moving]))))


def _same(first: Array, second: Array) -> bool:
    count = min(len(first), len(second))
    return bool(np.array_equal(first[:count], second[:count]))


def _chance(value: Array, noise: Array) -> tuple[Array, Array]:
    """The probability (K,) that two readings are equal, under the same load and under another: resolution over noise,
    1 where it is unknown, and resolution over range."""
    alike, other = np.ones((2, value.shape[1]))
    for column, sigma in enumerate(noise):
        own = value[np.isfinite(value[:, column]), column]
        step, span = _resolution(own), float(np.ptp(own)) if len(own) else 0.0
        if span > 0.0:
            other[column] = min(10.0 * step / span, 1.0)
            if np.isfinite(sigma) and sigma > 0.0:
                alike[column] = min(step / (2.0 * np.sqrt(np.pi) * sigma), 1.0)
    return alike, other


def _resolution(value: Array) -> float:
    """The step of values (N,): a decimal place where they hardly repeat, else the smallest difference of two."""
    levels = np.unique(value)
    if len(levels) < 2:
        return 0.0
    least = float(np.diff(levels).min())
    if len(levels) < _DISTINCT * len(value):
        return least
    size = float(np.abs(levels).max())
    for place in range(_PLACES):
        if np.allclose(np.round(levels, place), levels, rtol=0.0, atol=10.0**-_DIGITS * size):
            return min(least, 10.0**-place)
    return least
