"""Runs that hold the very numbers of another run, which noise makes no two runs do."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from truing.belonging.chance_equality import ChanceEquality
from truing.belonging.copied_parts import copied_parts
from truing.belonging.relation import Slip, SlipKind, State, Tested

Array = NDArray[np.float64]
Index = NDArray[np.int64]

RELATION = "copied-runs"
_FEWEST = 5  # values that have to be equal
_CHANCE = 1e-9  # of so many equal values
_EQUAL = 0.95  # share of two runs' values
_TELLING = 0.3  # probability of one equal value below which equal values tell anything
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
        chance = ChanceEquality.of_runs(table.value, rows, load, table.noise)
        telling |= any(
            bool((chance.between(first, second) < _TELLING).any())
            for first, second in combinations(range(len(runs)), 2)
        )
        for first, second in _alike(table.value, rows):
            each = chance.between(first, second)
            share, likely = _equal(table.value[rows[first]], table.value[rows[second]], each)
            if share >= _EQUAL and likely < _CHANCE:
                found.setdefault((runs[first], runs[second]), []).append(_Copy(table.name, share))
        parts, tell = copied_parts(table.value, rows, load, chance)
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
