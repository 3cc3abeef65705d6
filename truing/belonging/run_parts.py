"""Test for parts of a run whose loads, readings or signals have another unit or the opposite sign."""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.belonging.plausible_slips import RecordedColumn
from truing.belonging.relation import FORCE_UNITS, TORQUE_UNITS, RecordSlip, RelationState, RelationTest, SlipKind
from truing.belonging.responses import directions
from truing.belonging.slip_search import merged

_FEWEST = 4  # fewest rows on either side
_MOST = 400  # longer runs are only split by the sign of the loads
_MAIN = 0.3  # least range of a column for a test, as a share of its largest range
_FOLLOWS = 0.07  # largest scatter of a part about its own line, over its range
_BEYOND, _NEAR = 2.0, 1.4  # ratio of two slopes beyond any physical cause; tolerance factor of a slip's ratio
_MOST_LEFT = 0.2  # largest share of the misfit that may remain
_TIE, _AS_GOOD = 1.0 + 1e-6, 1.5  # ratios of misfits


@dataclass(frozen=True)
class RunPart:
    """Rows (N,) of a run that are right if multiplied by ``factor``: its loads, or its columns (indices) if there are
    any.

    ``first``: they are the first rows of the run; ``sign``: sign of their loads, 0 for successive rows. ``before``,
    ``after``: largest residual of a line through the run, over the range.
    """

    run: int
    rows: Index
    first: bool
    sign: int
    columns: tuple[int, ...]
    factor: float
    before: float
    after: float


def parts(load: Array, run: Index, value: Array, columns: Sequence[RecordedColumn], answers: Array) -> list[RunPart]:
    """Return the parts of runs in which one factor makes columns (N, K) follow loads (N, 6) as in the rest of the run.

    answers (K, 6): responses of the columns by all runs or a simulation, which decide which of two parts is wrong.
    """
    runs = [np.flatnonzero(run == number) for number in np.unique(run)]
    ranges = [np.nan_to_num(np.ptp(value[rows], axis=0)) for rows in runs]
    most = np.max(ranges, axis=0, initial=0.0)
    run_parts = []
    for rows, range_of_run in zip(runs, ranges, strict=True):
        direction = directions(load[rows])[0]
        main = np.flatnonzero((range_of_run > _MAIN * most) & (range_of_run > 0.0))
        if len(direction) == 1 and len(main):
            load_coordinate = load[rows] @ direction[0] / (direction[0] @ direction[0])
            line = _Line(load_coordinate, value[rows][:, main], int(run[rows[0]]), rows, tuple(main.tolist()))
            kinds = FORCE_UNITS if direction[0, :3].any() else (*TORQUE_UNITS, *FORCE_UNITS)
            best = line.best([columns[k] for k in line.places], kinds, answers[main] @ direction[0])
            run_parts += [] if best is None else [best]
    return run_parts


@dataclass(frozen=True)
class _Line:
    """A run along one direction: way (N,) and values (N, K) of the columns that respond clearly, with their indices
    (K).

    Also the run's number and its rows (N,).
    """

    way: Array
    value: Array
    run: int
    rows: Index
    places: tuple[int, ...]

    def best(self, columns: Sequence[RecordedColumn], units: Sequence[float], answers: Array) -> RunPart | None:
        """Return the part and the factor with the smallest residual; loads if they do as well as columns."""
        parts_of_halves = [
            part
            for second, sign in self._halves()
            for part in self._compare_halves(second, sign, columns, units, answers)
        ]
        if not parts_of_halves:
            return None
        least = min(part.after for part in parts_of_halves)
        loads = [part for part in parts_of_halves if not part.columns and part.after <= _AS_GOOD * least]
        near = loads or parts_of_halves
        least = min(candidate.after for candidate in near)
        return min(
            (candidate for candidate in near if candidate.after <= least * _TIE), key=lambda part: part.sign != 0
        )

    def _compare_halves(
        self, second: Mask, sign: int, columns: Sequence[RecordedColumn], units: Sequence[float], answers: Array
    ) -> Iterator[RunPart]:
        """Yield the correction of one of two parts: the one whose slopes differ more from the expected responses."""
        direction, first_slope, second_slope = self._slopes(second)
        if not direction.any() or not _differs_from_one(second_slope[direction] / first_slope[direction]).any():
            return
        index = np.flatnonzero(direction).tolist()
        reported = replace(self, value=self.value[:, direction], places=tuple(self.places[k] for k in index))
        first_slope, second_slope, answers = first_slope[direction], second_slope[direction], answers[direction]
        off = [
            np.sum(np.abs(_slope_deviation(slope, answers, np.minimum(np.abs(first_slope), np.abs(second_slope)))))
            for slope in (first_slope, second_slope)
        ]
        first = bool(off[0] > off[1])
        part, ratio = (~second, first_slope / second_slope) if first else (second, second_slope / first_slope)
        before = reported._line_residual(reported.way, reported.value)
        for mine, factor, after in reported._undone_slips(part, ratio, [columns[k] for k in index], units):
            part_columns = list(mine) if mine else slice(None)
            known = _is_known(answers, np.minimum(np.abs(first_slope), np.abs(second_slope)))[part_columns]
            if factor < 0.0 and not known.any() and (mine or len(known) < 2):
                continue  # a single column may answer both signs of a load alike
            if np.all(after[part_columns] < _MOST_LEFT * before[part_columns]):
                concerned = tuple(reported.places[k] for k in mine)
                left = float(before[part_columns].max()), float(after[part_columns].max())
                yield RunPart(self.run, self.rows[part], first, -sign if first else sign, concerned, factor, *left)

    def _halves(self) -> Iterator[tuple[Mask, int]]:
        """Yield the rows from each row on, and the rows with negative loads."""
        count = len(self.way)
        if count <= _MOST:
            for start in range(_FEWEST, count - _FEWEST + 1):
                yield np.arange(count) >= start, 0
        negative = self.way < 0.0
        if min(negative.sum(), (~negative).sum()) >= _FEWEST:
            yield negative, -1

    def _slopes(self, second: Mask) -> tuple[Mask, Array, Array]:
        """Return the columns (K,) that follow a line in both parts, and their slopes about a zero of each part."""
        follows, slopes = np.ones(self.value.shape[1], bool), []
        for rows in (~second, second):
            centred = self.way[rows] - self.way[rows].mean()
            value = self.value[rows] - self.value[rows].mean(axis=0)
            power = float(centred @ centred)
            slope = centred @ value / power if power > 0.0 else np.zeros(len(follows))
            left = np.sqrt(np.mean((value - centred[:, None] * slope) ** 2, axis=0))
            follows &= (slope != 0.0) & (left <= _FOLLOWS * np.ptp(value, axis=0))
            slopes.append(slope)
        return follows, slopes[0], slopes[1]

    def _undone_slips(
        self, part: Mask, ratio: Array, columns: Sequence[RecordedColumn], units: Sequence[float]
    ) -> Iterator[tuple[tuple[int, ...], float, Array]]:
        """Return columns (none: the loads), factor and residual (K,), where slopes differ by about that factor."""
        for factor in (-1.0, *units):
            if _is_unphysical_ratio(ratio, factor).all():
                corrected = np.where(part, factor, 1.0) * self.way
                yield (), factor, self._line_residual(corrected, self.value)
        for quantity in dict.fromkeys(column.quantity for column in columns):
            indices = [k for k, column in enumerate(columns) if column.quantity == quantity]
            first_column = columns[indices[0]]
            for factor in (-1.0, *first_column.factors):
                slipped = tuple(k for k in indices if _is_unphysical_ratio(ratio[k : k + 1], 1.0 / factor).all())
                others = np.isin(np.arange(len(columns)), slipped, invert=True)
                if slipped and not _differs_from_one(ratio[others]).any():
                    value = self.value.copy()
                    value[:, list(slipped)] *= np.where(part, factor, 1.0)[:, None]
                    yield slipped, factor, self._line_residual(self.way, value)

    @staticmethod
    def _line_residual(load_coordinate: Array, value: Array) -> Array:
        """Return the root mean square residual (K,) of lines through all rows, over the range."""
        about, centred = load_coordinate - load_coordinate.mean(), value - value.mean(axis=0)
        residual = centred - about[:, None] * (about @ centred / (about @ about))
        return np.asarray(np.sqrt(np.mean(residual**2, axis=0)) / np.ptp(centred, axis=0))


def _differs_from_one(ratio: Array) -> Mask:
    return np.asarray((ratio < 1.0 / _BEYOND) | (ratio > _BEYOND))


def _is_unphysical_ratio(ratio: Array, factor: float) -> Mask:
    """Return True if ratios of slopes (K,) are near a factor that no physical cause has."""
    large = factor < 0.0 or max(factor, 1.0 / factor) > _BEYOND * _NEAR
    near = (ratio / factor > 1.0 / _NEAR) & (ratio / factor < _NEAR)
    return near if large else np.zeros(len(ratio), bool)


def _is_known(answers: Array, least: Array) -> Mask:
    return np.isfinite(answers) & (np.abs(answers) > _MAIN * least)


def _slope_deviation(slope: Array, answers: Array, least: Array) -> Array:
    """Return the deviation of slopes (K,) from the expected responses; 0 where these are unknown or small."""
    known = _is_known(answers, least)
    size = np.where(known, np.abs(answers), 1.0)
    return np.where(known, np.arcsinh(slope / size / 0.1) - np.arcsinh(np.sign(answers) / 0.1), 0.0)


def of_parts(
    run_parts: Sequence[RunPart],
    step: Index,
    runs: Sequence[str],
    columns: Sequence[RecordedColumn],
    first: int,
    relation: str,
) -> Iterator[RelationTest]:
    """Yield one failed test of a relation for parts that concern its columns (indices from first) or their loads."""
    parts_of_columns = [part for part in run_parts if part_concerns(part, range(first, first + len(columns)))]
    if parts_of_columns:
        slips = merged([_slip(trial, step, runs, columns, first) for trial in parts_of_columns])
        before, after = (
            100.0 * max(getattr(trial, name) for trial in parts_of_columns) for name in ("before", "after")
        )
        subject = (
            ", ".join(dict.fromkeys(runs[trial.run] for trial in parts_of_columns))
            if len(parts_of_columns) <= 3
            else ""
        )
        sizes = (before, after, None, "% of the range")
        yield RelationTest(relation, RelationState.FAILS, "slip", subject, *sizes, slips, tried=len(parts_of_columns))


def part_concerns(part: RunPart, columns: Container[int]) -> bool:
    """Return True if a part concerns the loads or some of these columns."""
    return not part.columns or any(column in columns for column in part.columns)


def _slip(part: RunPart, step: Index, runs: Sequence[str], columns: Sequence[RecordedColumn], first: int) -> RecordSlip:
    part_columns = [columns[index - first] for index in part.columns]
    quantity = part_columns[0].quantity if part_columns else "load"
    every = len(part_columns) == sum(column.quantity == quantity for column in columns)
    names = () if every and len(part_columns) > 1 else tuple(column.name for column in part_columns)
    kind = SlipKind.SIGN if part.factor == -1.0 else SlipKind.UNIT
    slip = RecordSlip(kind, quantity, (*names, _part_words(part, step, runs)))
    return slip if kind == SlipKind.SIGN else replace(slip, factor=part.factor)


def _part_words(part: RunPart, step: Index, runs: Sequence[str]) -> str:
    """Return the run and its part in words."""
    run, step = runs[part.run], step[part.rows]
    if part.sign:
        return f"{run} at {'negative' if part.sign < 0 else 'positive'} loads"
    return f"{run} up to step {step[-1]}" if part.first else f"{run} from step {step[0]} on"
