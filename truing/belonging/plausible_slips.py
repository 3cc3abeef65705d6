"""Candidate slips for responses: units, signs and exchanges of loads and of recorded columns."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, pairwise

import numpy as np

from truing.arrays import Mask
from truing.belonging.relation import FORCE_UNITS, TORQUE_UNITS, RecordSlip, SlipKind
from truing.belonging.responses import Responses
from truing.belonging.slip_search import (
    CLEARLY,
    ColumnReading,
    ExpectedResponse,
    SlipCandidate,
    as_recorded,
    misses_read,
)
from truing.estimation.interferometry.recorded_steps import LOADS

_FORCES, _TORQUES = np.arange(6) < 3, np.arange(6) >= 3


@dataclass(frozen=True)
class RecordedColumn:
    """A recorded column: name, quantity, factors to other units, and the size of a fringe in its unit if it may be
    counted."""

    name: str
    quantity: str
    factors: tuple[float, ...]
    fringes: tuple[float, ...] = ()
    unit_si: float = 1.0


Undo = Callable[[ColumnReading], ColumnReading]


def _loads(concerns: Mask, axes: Mask, factor: float) -> Undo:
    """Return loads (C, 6) of some responses multiplied by a factor along some axes."""
    factors = np.where(concerns[:, None] & axes, factor, 1.0)
    return lambda read: replace(read, direction=read.direction * factors)


def _values(concerns: Mask, factor: float) -> Undo:
    """Return recorded values of some responses multiplied by a factor."""
    factors = np.where(concerns, factor, 1.0)
    return lambda read: replace(read, factor=read.factor * factors)


def _exchange_columns(concerns: Mask, pair: tuple[int, int], factor: float) -> Undo:
    """Return the exchange of two columns; ``factor``: unit of the second over that of the first."""

    def undo(read: ColumnReading) -> ColumnReading:
        first, second = (concerns & (read.column == one) for one in pair)
        column = np.where(first, pair[1], np.where(second, pair[0], read.column))
        factors = np.where(first, factor, np.where(second, 1.0 / factor, 1.0))
        return replace(read, column=column, factor=read.factor * factors)

    return undo


def _exchange_axes(concerns: Mask, pair: tuple[int, int]) -> Undo:
    """Return the exchange of the loads of two axes."""
    order = np.arange(6)
    order[list(pair)] = pair[::-1]
    return lambda read: replace(read, direction=np.where(concerns[:, None], read.direction[:, order], read.direction))


def slips_of_all_loads(responses: Responses) -> Iterator[SlipCandidate]:
    """Yield slips of the loads of all runs: all loads, forces, torques, one axis, or two axes exchanged."""
    loaded = responses.direction != 0.0
    everything, every_axis = np.ones(len(responses), bool), np.ones(6, bool)
    for factor in FORCE_UNITS:
        yield SlipCandidate(_unit("load", factor), everything, _loads(everything, every_axis, factor))
    yield SlipCandidate(RecordSlip(SlipKind.SIGN, "load"), everything, _loads(everything, every_axis, -1.0))
    for quantity, axes, factors in (("force", _FORCES, FORCE_UNITS), ("torque", _TORQUES, TORQUE_UNITS)):
        concerned = (loaded & axes).any(axis=1)
        for factor in factors:
            yield SlipCandidate(_unit(quantity, factor), concerned, _loads(concerned, axes, factor), 1.0)
        yield SlipCandidate(RecordSlip(SlipKind.SIGN, quantity), concerned, _loads(concerned, axes, -1.0), 1.0)
    for axis in np.flatnonzero(loaded.any(axis=0)).tolist():
        axes, concerned = np.arange(6) == axis, loaded[:, axis]
        quantity = "force" if axis < 3 else "torque"
        for factor in FORCE_UNITS if axis < 3 else TORQUE_UNITS:
            slip = _unit(quantity, factor, LOADS[axis])
            yield SlipCandidate(slip, concerned, _loads(concerned, axes, factor), np.log(6.0))
        slip = RecordSlip(SlipKind.SIGN, quantity, (LOADS[axis],))
        yield SlipCandidate(slip, concerned, _loads(concerned, axes, -1.0), np.log(6.0))
    for pair in combinations(range(6), 2):
        concerned = loaded[:, list(pair)].any(axis=1)
        slip = RecordSlip(SlipKind.COLUMNS, "load axes", (LOADS[pair[0]], LOADS[pair[1]]))
        yield SlipCandidate(slip, concerned, _exchange_axes(concerned, pair), np.log(15.0))


def slips_of_run_loads(
    responses: Responses, runs: Sequence[str], expected: ExpectedResponse
) -> Iterator[SlipCandidate]:
    """Yield slips of the loads of single runs, and of all runs that the same slip explains."""
    numbers = np.unique(responses.run)
    every_axis, many = np.ones(6, bool), np.log(max(len(numbers), 1))
    torque = np.array([not np.any(responses.direction[responses.run == number][:, :3]) for number in numbers])
    for factor in dict.fromkeys((-1.0, *FORCE_UNITS, *TORQUE_UNITS)):
        allowed = numbers[torque] if factor not in (-1.0, *FORCE_UNITS) else numbers
        alone = [
            SlipCandidate(_factor_slip("load", factor, [runs[number]]), mine, _loads(mine, every_axis, factor), many)
            for number in allowed.tolist()
            if (mine := responses.run == number).any()
        ]
        yield from alone
        yield from _slip_of_all_runs(
            responses, expected, alone, partial(_loads, axes=every_axis, factor=factor), len(numbers)
        )
    yield from _exchanged_labels(responses, runs)


def _exchanged_labels(responses: Responses, runs: Sequence[str]) -> Iterator[SlipCandidate]:
    """Yield exchanged axes of runs with one axis each, or of one run alone."""
    numbers = np.unique(responses.run).tolist()
    mine = {number: responses.run == number for number in numbers}
    axes = {number: np.flatnonzero(responses.direction[mine[number]].any(axis=0)) for number in numbers}
    single = {number: int(axes[number][0]) for number in numbers if len(axes[number]) == 1}
    many = np.log(max(len(numbers), 1))
    for one, axis in single.items():
        for other in range(6):
            if other != axis:
                slip = RecordSlip(
                    SlipKind.MISLABELLED, f"load axis {LOADS[axis]} in place of {LOADS[other]}", (runs[one],)
                )
                yield SlipCandidate(slip, mine[one], _exchange_axes(mine[one], (axis, other)), many + np.log(15.0))
        for other, its in single.items():
            if other > one and its != axis:
                both = mine[one] | mine[other]
                slip = RecordSlip(SlipKind.PARTS_EXCHANGED, "load axes", (runs[one], runs[other]))
                yield SlipCandidate(slip, both, _exchange_axes(both, (axis, its)), 2.0 * many)


def slips_of_columns(
    responses: Responses,
    columns: Sequence[RecordedColumn],
    runs: Sequence[str],
    expected: ExpectedResponse,
    *,
    of_all: bool,
) -> Iterator[SlipCandidate]:
    """Yield slips of recorded columns: of a quantity or a column, in all runs (of_all) or in single runs, and
    exchanges."""
    many = np.log(max(len(np.unique(responses.run)), 1))
    if of_all:
        for quantity in dict.fromkeys(column.quantity for column in columns):
            indices = [k for k, column in enumerate(columns) if column.quantity == quantity]
            chosen = _ColumnSet(columns, indices, ())
            yield from _column_slips(chosen, (), np.isin(responses.column, indices), 0.0)
        for k, column in enumerate(columns):
            chosen = _ColumnSet(columns, [k], (column.name,))
            yield from _column_slips(chosen, chosen.names, responses.column == k, np.log(len(columns)))
        yield from _columns_exchanged(responses, columns, np.ones(len(responses), bool), (), 2.0 * np.log(len(columns)))
        if len({column.quantity for column in columns}) == 1:
            yield from exchanges_by_axis(responses, columns)
    for number in np.unique(responses.run).tolist():
        concerned = responses.run == number
        yield from _columns_exchanged(responses, columns, concerned, (runs[number],), many + 2.0 * np.log(len(columns)))
    for quantity in dict.fromkeys(column.quantity for column in columns):
        indices = [k for k, column in enumerate(columns) if column.quantity == quantity]
        if len(indices) > 1:
            yield from _slips_within_runs(responses, _ColumnSet(columns, indices, ()), runs, expected, many)
        for k in indices:
            extra = np.log(len(columns))
            chosen = _ColumnSet(columns, [k], (columns[k].name,))
            yield from _slips_within_runs(responses, chosen, runs, expected, many + extra)


def exchanges_from_a_run(
    responses: Responses, columns: Sequence[RecordedColumn], runs: Sequence[str]
) -> Iterator[SlipCandidate]:
    """Yield exchanges of two columns from some run on, and up to it."""
    numbers = np.unique(responses.run).tolist()
    penalty = np.log(2.0 * max(len(numbers), 1)) + 2.0 * np.log(len(columns))
    for before, start in pairwise(numbers):
        later = responses.run >= start
        yield from _columns_exchanged(responses, columns, later, (f"from {runs[start]} on",), penalty)
        yield from _columns_exchanged(responses, columns, ~later, (f"up to {runs[before]}",), penalty)


def exchanges_by_axis(responses: Responses, columns: Sequence[RecordedColumn]) -> Iterator[SlipCandidate]:
    """Yield exchanges of two columns in all runs of one load axis."""
    for axis in range(6):
        concerned, penalty = _along_one_axis(responses, axis), np.log(6.0) + 2.0 * np.log(len(columns))
        if concerned.any():
            yield from _columns_exchanged(responses, columns, concerned, (f"all runs of {LOADS[axis]}",), penalty)


@dataclass(frozen=True)
class _ColumnSet:
    """Columns at ``indices`` among the recorded ones, which slip together, and the names that the slip states."""

    columns: Sequence[RecordedColumn]
    indices: Sequence[int]
    names: tuple[str, ...]


def _slips_within_runs(
    responses: Responses, chosen: _ColumnSet, runs: Sequence[str], expected: ExpectedResponse, penalty: float
) -> Iterator[SlipCandidate]:
    """Yield one slip of some columns in single runs, and in all runs that it explains."""
    by_slip: dict[tuple[SlipKind, float], list[SlipCandidate]] = {}
    numbers = np.unique(responses.run).tolist()
    for number in numbers:
        concerned = (responses.run == number) & np.isin(responses.column, chosen.indices)
        if len(np.unique(responses.column[concerned])) >= min(len(chosen.indices), 2):
            for candidate in _column_slips(chosen, (*chosen.names, runs[number]), concerned, penalty):
                by_slip.setdefault((candidate.slip.kind, candidate.slip.factor), []).append(candidate)
    for (kind, factor), alone in by_slip.items():
        yield from alone
        value = -1.0 if kind == SlipKind.SIGN else factor
        yield from _slip_of_all_runs(responses, expected, alone, partial(_values, factor=value), len(numbers))


def _column_slips(
    chosen: _ColumnSet, subjects: tuple[str, ...], concerned: Mask, penalty: float
) -> Iterator[SlipCandidate]:
    first_column = chosen.columns[chosen.indices[0]]
    for factor in first_column.factors:
        slip = RecordSlip(SlipKind.UNIT, first_column.quantity, subjects, factor)
        yield SlipCandidate(slip, concerned, _values(concerned, factor), penalty)
    for factor in first_column.fringes:
        slip = RecordSlip(SlipKind.FRINGES, first_column.quantity, subjects, factor)
        yield SlipCandidate(slip, concerned, _values(concerned, factor), penalty + 1.0)
    yield SlipCandidate(
        RecordSlip(SlipKind.SIGN, first_column.quantity, subjects), concerned, _values(concerned, -1.0), penalty
    )


def _columns_exchanged(
    responses: Responses, columns: Sequence[RecordedColumn], concerned: Mask, where: tuple[str, ...], penalty: float
) -> Iterator[SlipCandidate]:
    there = np.unique(responses.column[concerned])
    for first, second in combinations(range(len(columns)), 2):
        if first in there and second in there:
            factor = columns[second].unit_si / columns[first].unit_si
            slip = RecordSlip(SlipKind.COLUMNS, "columns", (columns[first].name, columns[second].name, *where))
            concerns = concerned & np.isin(responses.column, [first, second])
            yield SlipCandidate(slip, concerns, _exchange_columns(concerns, (first, second), factor), penalty)


def _slip_of_all_runs(
    responses: Responses,
    expected: ExpectedResponse,
    alone: Sequence[SlipCandidate],
    undo: Callable[[Mask], Undo],
    runs: int,
) -> Iterator[SlipCandidate]:
    """Return one slip in all runs in which it at least halves the misfit."""
    read = as_recorded(responses)
    before = misses_read(responses, expected, read)
    if not alone or np.max(np.abs(before), initial=0.0) < 1.0:
        return
    every = np.logical_or.reduce([candidate.concerns for candidate in alone])
    after = misses_read(responses, expected, undo(every)(read))
    gaining = [
        candidate
        for candidate in alone
        if np.max(np.abs(before[candidate.concerns])) > CLEARLY
        and np.sum(after[candidate.concerns] ** 2) < 0.25 * np.sum(before[candidate.concerns] ** 2)
    ]
    if 1 < len(gaining) <= runs:
        from scipy.special import gammaln

        concerned = np.logical_or.reduce([candidate.concerns for candidate in gaining])
        subjects = tuple(dict.fromkeys(name for candidate in gaining for name in candidate.slip.subjects))
        some = float(gammaln(runs + 1) - gammaln(len(gaining) + 1) - gammaln(runs - len(gaining) + 1))
        yield SlipCandidate(
            replace(gaining[0].slip, subjects=subjects),
            concerned,
            undo(concerned),
            some + alone[0].penalty - float(np.log(runs)),
        )


def _along_one_axis(responses: Responses, axis: int) -> Mask:
    """Return True for responses (C,) to loads along one axis alone."""
    return np.asarray((responses.direction[:, axis] != 0.0) & (np.count_nonzero(responses.direction, axis=1) == 1))


def _factor_slip(quantity: str, factor: float, runs: Sequence[str]) -> RecordSlip:
    if factor == -1.0:
        return RecordSlip(SlipKind.SIGN, quantity, tuple(runs))
    return _unit(quantity, factor, *runs)


def _unit(quantity: str, factor: float, *subjects: str) -> RecordSlip:
    return RecordSlip(SlipKind.UNIT, quantity, subjects, factor)
