"""Rows of a run that hold the very numbers of rows of another run, at whatever place."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.belonging.chance_equality import ChanceEquality

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FEWEST, SHARE = 8, 0.2  # rows, and part of the shorter run, from which a copy is told
_CHANCE = 1e-9  # of so many equal rows
_VALUES = 4  # that are compared at once: rows with fewer are taken with those that follow


@dataclass(frozen=True)
class CopiedPart:
    """Two runs (from 0), the rows of the first that stand in the second (from 0 within the run), and their share of the
    shorter run."""

    first: int
    second: int
    rows: Index
    share: float


def copied_parts(
    value: Array, rows: Sequence[Index], load: Array, chance: ChanceEquality
) -> tuple[list[CopiedPart], bool]:
    """Return the copied parts of all pairs of runs, and whether any could be told from chance.

    value (N, K) in every digit, rows: those of each run, load (N, 6); chance: that two of their readings are equal.
    """
    length = _together(value)
    number = _numbered(np.nan_to_num(value))
    keys = [_windows(ids, length) for ids in (number[own] for own in rows)]
    number = _numbered(np.concatenate(keys)) if len(keys) else np.zeros(0, np.int64)
    windows = np.split(number, np.cumsum([len(one) for one in keys])[:-1])
    loads = _numbered(load)
    found = []
    pairs = list(_sharing(windows))
    for first, second in pairs:
        inside = [np.flatnonzero(np.isin(windows[a], windows[b])) for a, b in ((first, second), (second, first))]
        covered = [np.unique(own[:, None] + np.arange(length)) for own in inside]
        shorter = min(len(rows[first]), len(rows[second]))
        share = min(len(own) for own in covered) / shorter
        distinct = len(np.unique(windows[first][inside[0]]))
        if min(map(len, covered)) < FEWEST or distinct < FEWEST or share < SHARE:
            continue
        there = [rows[run][own] for run, own in zip((first, second), covered, strict=True)]
        same = np.array_equal(np.unique(loads[there[0]]), np.unique(loads[there[1]]))
        under_equal = chance.under_equal_loads(first, second)
        likely = under_equal if same else np.maximum(under_equal, chance.between(first, second))
        tries = len(rows[first]) * len(rows[second])
        if _chance(value[there[0]], likely, distinct // length, length, tries) < np.log(_CHANCE / len(pairs)):
            found.append(CopiedPart(first, second, covered[0], share))
    longest = max((len(own) for own in rows), default=0)
    telling = bool(len(value)) and _chance(value, chance.typical(), max(FEWEST // length, 1), length, longest**2)
    return found, bool(telling and telling < np.log(_CHANCE))


def _together(value: Array) -> int:
    """How many rows that follow each other are compared at once."""
    seen = np.isfinite(value).sum(axis=1)
    typical = float(np.median(seen[seen > 0])) if seen.any() else 1.0
    return max(int(np.ceil(_VALUES / typical)), 1)


def _numbered(rows: NDArray) -> Index:
    """The same number (N,) for equal rows (N, K)."""
    return np.asarray(np.unique(rows + 0, axis=0, return_inverse=True)[1].ravel(), np.int64)


def _windows(ids: Index, length: int) -> Index:
    """Each row with those that follow it (M, length)."""
    if len(ids) < length:
        return np.zeros((0, length), np.int64)
    return np.asarray(np.lib.stride_tricks.sliding_window_view(ids, length))


def _sharing(windows: Sequence[Index]) -> Iterator[tuple[int, int]]:
    """Pairs of runs that share enough different windows."""
    from scipy.sparse import csr_array

    own = [np.unique(one) for one in windows]
    run = np.repeat(np.arange(len(own)), [len(one) for one in own])
    ids = np.concatenate(own) if own else np.zeros(0, np.int64)
    often = np.bincount(ids, minlength=1)[ids] > 1
    if not often.any():
        return
    held = csr_array((np.ones(int(often.sum())), (run[often], ids[often])), shape=(len(own), int(ids.max()) + 1))
    shared = (held @ held.T).tocoo()
    for first, second, count in zip(shared.row.tolist(), shared.col.tolist(), shared.data.tolist(), strict=True):
        if first < second and count >= FEWEST / 2:
            yield first, second


def _chance(value: Array, likely: Array, count: int, length: int, tries: int) -> float:
    """Logarithm of the probability that so many windows of a pair of runs are equal, of all that could be."""
    from scipy.special import gammaln

    moving = np.array([bool(np.isfinite(own).all()) and len(np.unique(own)) > 2 for own in value.T])
    if value.shape[1] > 0 and not moving.any():
        return 0.0
    each = length * float(np.log(likely[moving]).sum()) + np.log(max(tries, 1))
    return float(count * each - gammaln(count + 1)) if each < 0.0 else 0.0
