"""Detection of copied runs, parts of runs and columns: equal numbers that noise would make different."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index
from truing.belonging.chance_equality import ChanceEquality
from truing.belonging.plausible_slips import RecordedColumn
from truing.belonging.relation import RecordSlip, RelationState, RelationTest, SlipKind

FEWEST, SHARE = 8, 0.2  # fewest rows of a copy, and its least share of the shorter run
_CHANCE = 1e-9  # probability below which equal rows are a copy
_VALUES = 4  # fewest values compared at once: rows with fewer are combined with the following ones
RELATION = "copied-runs"
_FEWEST = 5  # fewest equal values
_EQUAL = 0.95  # share of two runs' values
_TELLING = 0.3  # largest probability of one equal value at which equal values are evidence
_DIGITS = 11  # digits of the largest value that are compared; more are rounding
_DIFFERENT = 5  # fewest different values


@dataclass(frozen=True)
class CopiedPart:
    """Two runs (from 0), the rows of the first that the second holds too (from 0 in the run), and their share of the
    shorter."""

    first: int
    second: int
    rows: Index
    share: float


def copied_parts(
    value: Array, rows: Sequence[Index], load: Array, chance: ChanceEquality
) -> tuple[list[CopiedPart], bool]:
    """Return the copied parts of all pairs of runs, and True if copies would be distinguishable from chance.

    value (N, K) in every digit, rows: those of each run, load (N, 6); chance: probability that two of their readings
    are equal.
    """
    length = _rows_per_comparison(value)
    number = _numbered(np.nan_to_num(value))
    keys = [_windows(ids, length) for ids in (number[run_rows] for run_rows in rows)]
    number = _numbered(np.concatenate(keys)) if len(keys) else np.zeros(0, np.int64)
    windows = np.split(number, np.cumsum([len(key) for key in keys])[:-1])
    loads = _numbered(load)
    copies = []
    pairs = list(_sharing(windows))
    for first, second in pairs:
        inside = [np.flatnonzero(np.isin(windows[a], windows[b])) for a, b in ((first, second), (second, first))]
        covered = [np.unique(start[:, None] + np.arange(length)) for start in inside]
        shorter = min(len(rows[first]), len(rows[second]))
        share = min(len(covered_rows) for covered_rows in covered) / shorter
        distinct = len(np.unique(windows[first][inside[0]]))
        if min(map(len, covered)) < FEWEST or distinct < FEWEST or share < SHARE:
            continue
        rows_of_part = [rows[run][run_rows] for run, run_rows in zip((first, second), covered, strict=True)]
        same = np.array_equal(np.unique(loads[rows_of_part[0]]), np.unique(loads[rows_of_part[1]]))
        under_equal = chance.under_equal_loads(first, second)
        equality_chance = under_equal if same else np.maximum(under_equal, chance.between(first, second))
        tries = len(rows[first]) * len(rows[second])
        if _chance(value[rows_of_part[0]], equality_chance, distinct // length, length, tries) < np.log(
            _CHANCE / len(pairs)
        ):
            copies.append(CopiedPart(first, second, covered[0], share))
    longest = max((len(run_rows) for run_rows in rows), default=0)
    informative = bool(len(value)) and _chance(value, chance.typical(), max(FEWEST // length, 1), length, longest**2)
    return copies, bool(informative and informative < np.log(_CHANCE))


def _rows_per_comparison(value: Array) -> int:
    """Return the number of successive rows that are compared at once."""
    seen = np.isfinite(value).sum(axis=1)
    typical = float(np.median(seen[seen > 0])) if seen.any() else 1.0
    return max(int(np.ceil(_VALUES / typical)), 1)


def _numbered(rows: NDArray) -> Index:
    """Return a number (N,) for each row, the same for equal rows (N, K)."""
    return np.asarray(np.unique(rows + 0, axis=0, return_inverse=True)[1].ravel(), np.int64)


def _windows(ids: Index, length: int) -> Index:
    """Return each row with those that follow it, (M, length)."""
    if len(ids) < length:
        return np.zeros((0, length), np.int64)
    return np.asarray(np.lib.stride_tricks.sliding_window_view(ids, length))


def _sharing(windows: Sequence[Index]) -> Iterator[tuple[int, int]]:
    """Yield pairs of runs that share enough different windows."""
    from scipy.sparse import csr_array

    window_ids = [np.unique(window) for window in windows]
    run = np.repeat(np.arange(len(window_ids)), [len(window) for window in window_ids])
    ids = np.concatenate(window_ids) if window_ids else np.zeros(0, np.int64)
    often = np.bincount(ids, minlength=1)[ids] > 1
    if not often.any():
        return
    occurrence = csr_array(
        (np.ones(int(often.sum())), (run[often], ids[often])), shape=(len(window_ids), int(ids.max()) + 1)
    )
    shared = (occurrence @ occurrence.T).tocoo()
    for first, second, count in zip(shared.row.tolist(), shared.col.tolist(), shared.data.tolist(), strict=True):
        if first < second and count >= FEWEST / 2:
            yield first, second


def _chance(value: Array, equality_chance: Array, count: int, length: int, tries: int) -> float:
    """Return the log probability that ``count`` windows of a pair of runs are equal by chance, among all
    possible ones."""
    from scipy.special import gammaln

    moving = np.array([bool(np.isfinite(column).all()) and len(np.unique(column)) > 2 for column in value.T])
    if value.shape[1] > 0 and not moving.any():
        return 0.0
    log_chance = length * float(np.log(equality_chance[moving]).sum()) + np.log(max(tries, 1))
    return float(count * log_chance - gammaln(count + 1)) if log_chance < 0.0 else 0.0


@dataclass(frozen=True)
class Values:
    """A table of values (N, K) whose runs are compared, and their noise (K,), NaN where not declared."""

    name: str
    value: Array
    noise: Array


def copied_runs(run: Index, runs: Sequence[str], load: Array, tables: Sequence[Values]) -> tuple[RelationTest, ...]:
    """Return the test of all pairs of runs under load (N, 6).

    Whole runs are compared row by row from their first rows, parts of them at any place.
    """
    copies, pairs, informative, parts_tell = dict[tuple[str, str], list[_Copy]](), 0, False, True
    rows = [np.flatnonzero(run == number) for number in range(len(runs))]
    for table in map(_rounded, tables):
        chance = ChanceEquality.of_runs(table.value, rows, load, table.noise)
        informative |= any(
            bool((chance.between(first, second) < _TELLING).any())
            for first, second in combinations(range(len(runs)), 2)
        )
        for first, second in _similar_runs(table.value, rows):
            chance_of_runs = chance.between(first, second)
            share, equality_chance = _equal(table.value[rows[first]], table.value[rows[second]], chance_of_runs)
            if share >= _EQUAL and equality_chance < _CHANCE:
                copies.setdefault((runs[first], runs[second]), []).append(_Copy(table.name, share))
        parts, tell = copied_parts(table.value, rows, load, chance)
        parts_tell &= tell
        for part in parts:
            known = copies.setdefault((runs[part.first], runs[part.second]), [])
            if all(copy.quantity != table.name for copy in known):
                known.append(_Copy(table.name, part.share, tuple((part.rows + 1).tolist())))
        pairs += len(runs) * (len(runs) - 1) // 2
    if copies:
        return tuple(_relation_tests(copies, pairs))
    if not pairs or not informative:
        return (RelationTest(RELATION, RelationState.NOT_TESTED, "coarse" if pairs else "one-run"),)
    return (RelationTest(RELATION, RelationState.OK, "no-copies" if parts_tell else "no-whole-copies", tried=pairs),)


def _rounded(table: Values) -> Values:
    """Return a table without the rounding errors of unit conversions."""
    most = np.nanmax(np.abs(table.value), axis=0, initial=1e-300)
    return replace(table, value=np.round(table.value / most, _DIGITS) * most)


@dataclass(frozen=True)
class _Copy:
    """A quantity of two runs, the share of equal values, and the equal rows of the first run (from 1),
    empty for all."""

    quantity: str
    share: float
    rows: tuple[int, ...] = ()


def _relation_tests(copies_of_pair: dict[tuple[str, str], list[_Copy]], pairs: int) -> Iterator[RelationTest]:
    for (first, second), copies in copies_of_pair.items():
        rows = () if any(not copy.rows for copy in copies) else max((copy.rows for copy in copies), key=len)
        slip = RecordSlip(SlipKind.COPIED, " and ".join(copy.quantity for copy in copies), (first, second), rows=rows)
        share = 100.0 * max(copy.share for copy in copies)
        yield RelationTest(
            RELATION, RelationState.FAILS, "copied", f"{first}, {second}", share, None, None, "%", (slip,), tried=pairs
        )


def _similar_runs(value: Array, rows: Sequence[Index]) -> Iterator[tuple[int, int]]:
    """Yield pairs of runs with at least one equal value in the same row."""
    for first in range(len(rows)):
        for second in range(first + 1, len(rows)):
            count = min(len(rows[first]), len(rows[second]))
            if count and np.any(value[rows[first][:count]] == value[rows[second][:count]]):
                yield first, second


def _equal(first: Array, second: Array, chance: Array) -> tuple[float, float]:
    """Return the share of equal values of two runs, and the probability of so many if each is equal by chance (K,)."""
    count = min(len(first), len(second))
    both = np.isfinite(first[:count]) & np.isfinite(second[:count])
    equal = (first[:count] == second[:count]) & both
    moving = np.array(
        [len(np.unique(column[there])) > 2 for column, there in zip(first[:count].T, both.T, strict=True)]
    )
    both, equal = both[:, moving], equal[:, moving]
    if equal.sum() < _FEWEST:
        return 0.0, 1.0
    return float(equal.sum() / both.sum()), float(np.exp(np.sum(equal * np.log(chance[moving]))))


def equal_columns(value: Array, columns: Sequence[RecordedColumn], relation: str, what: str) -> list[RelationTest]:
    """Return the columns (N, K) of one quantity that agree in every digit wherever one of them was recorded."""
    tests = []
    for first, column in enumerate(columns):
        for second in range(first + 1, len(columns)):
            value_first, other = value[:, first], value[:, second]
            same = column.quantity == columns[second].quantity and np.array_equal(value_first, other, equal_nan=True)
            if same and len(np.unique(value_first[np.isfinite(value_first)])) >= _DIFFERENT:
                names = (column.name, columns[second].name)
                slip = RecordSlip(SlipKind.COPIED, what, names)
                tests.append(
                    RelationTest(
                        relation,
                        RelationState.FAILS,
                        "copied",
                        ", ".join(names),
                        100.0,
                        None,
                        None,
                        "%",
                        (slip,),
                        tried=1,
                    )
                )
    return tests
