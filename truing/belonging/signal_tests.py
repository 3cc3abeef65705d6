"""Tests of a sensor's signals against its loads: by its geometry, its declared sensitivity, and between runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.belonging.plausible_slips import (
    RecordedColumn,
    exchanges_by_axis,
    exchanges_from_a_run,
    slips_of_all_loads,
    slips_of_columns,
    slips_of_run_loads,
)
from truing.belonging.relation import RecordSlip, RelationState, RelationTest, SlipKind
from truing.belonging.responses import Responses, responses
from truing.belonging.silent_columns import are_silent, silent_columns, silent_test
from truing.belonging.slip_search import ExpectedResponse, Explained, SlipCandidate, clear_responses, explain, hidden

_MOST_LEVERAGE = 0.6  # largest leverage of a response confirmed by the others; two others of its kind give 0.5
_ROUNDS = 30
_CLOSE = 1e-3  # deviation, relative to a typical response, below which the weight of a response is constant
_OPEN = 1e-6
_CROSS_ALIKE, _MAIN_ALIKE, _LINEAR_ALIKE = (
    0.03,
    0.07,
    0.05,
)  # runs of the same loads answer alike, but for drift, creep and warmth
RELATION = "signals-against-loads"
_OWN_GAIN, _DECLARED = 0.3, 0.1  # relative prior width of a signal's gain: unknown, and where one is declared
_MOST_SILENT = 0.2  # share of the responses that may be missing without doubt about the others
_MATCHES = 1.5  # prior widths by which main responses miss, beyond which signals are not those of the legs
_MAIN = 0.3
_NO_BETTER = 1.0  # misfit over what is expected: an expectation of nothing would do as well
_ABOVE_TYPICAL = 1.5  # the largest responses over the typical one of all legs


def typical(measured: Responses, count: int) -> tuple[ExpectedResponse, Mask]:
    """Return the response of columns (count) by most runs, and True for responses (C,) confirmed by two other runs."""
    of_load = 1.0 / np.maximum(np.abs(measured.direction).max(axis=0, initial=0.0), 1e-300)
    share = measured.direction * of_load
    matrix, vouched = np.zeros((count, 6)), np.zeros(len(measured), bool)
    for column in range(count):
        of_this_column = measured.column == column
        if of_this_column.any():
            matrix[column] = _least_absolute(share[of_this_column], measured.size[of_this_column])
            vouched[of_this_column] = _is_confirmed(share[of_this_column], measured.run[of_this_column])
    of_column = np.maximum(np.abs(matrix).max(axis=1), 1e-300)
    expected = ExpectedResponse(
        matrix * of_load,
        of_column,
        np.where(of_load < 1e200, of_load, 0.0),
        cross=_CROSS_ALIKE,
        main=_MAIN_ALIKE,
        linear=_LINEAR_ALIKE,
    )
    return expected, vouched


def _least_absolute(share: Array, size: Array) -> Array:
    """Coefficients (6,) of least absolute deviations of sizes (C,) by shares (C, 6), by reweighting."""
    weight = np.ones(len(size))
    floor = _CLOSE * max(float(np.median(np.abs(size))), 1e-300)
    coefficients: Array = np.zeros(6)
    for _ in range(_ROUNDS):
        coefficients = np.asarray(np.linalg.lstsq(weight[:, None] * share, weight * size, rcond=_OPEN)[0])
        weight = 1.0 / np.sqrt(np.maximum(np.abs(size - share @ coefficients), floor))
    return coefficients


def _is_confirmed(share: Array, run: Index) -> Mask:
    """Return True for responses that the other runs determine at least twice."""
    out = np.zeros(len(share), bool)
    for number in np.unique(run):
        in_run, others = run == number, share[run != number]
        if len(others):
            size, right = np.linalg.svd(others, full_matrices=False)[1:]
            is_large = size > _OPEN * max(size[0], 1.0)
            along = share[in_run] @ right[is_large].T
            leverage = np.sum((along / size[is_large]) ** 2, axis=1)
            outside = np.sum(share[in_run] ** 2, axis=1) - np.sum(along**2, axis=1)
            out[in_run] = (leverage <= _MOST_LEVERAGE) & (outside <= _OPEN)
    return out


@dataclass(frozen=True)
class SignalSteps:
    """Load steps with signals: load (N, 6) in N and N m, run (N,) from 0, signal (N, S) in V, and names of runs.

    ``tared``: signals are zero at no load, instead of a separate zero in each run. ``step``: numbers (N,) of the steps.
    """

    load: Array
    run: Index
    value: Array
    runs: Sequence[str]
    tared: bool = False
    step: Index | None = None


def against_geometry(
    steps: SignalSteps, columns: Sequence[RecordedColumn], legs: Array, gain: Array | None
) -> RelationTest | None:
    """Return the test of signals against the forces (6, 6) along the legs, N and N m to N; None if they are not leg
    forces.

    gain (S,): declared, V/N; without it, only differences between legs and between axes can be tested.
    """
    every = responses(steps.load, steps.run, steps.value, has_zero=not steps.tared)
    measured = clear_responses(every, len(columns))
    if not len(measured) or len(columns) != len(legs):
        return None
    best: RelationTest | None = None
    for expected in _responses_by_legs(measured, legs, gain):
        explained, unseen = _explained(measured, expected, steps, columns, gain)
        silent = are_silent(measured, expected)
        rest = measured.subset(~silent)
        if silent.mean() <= _MOST_SILENT and _rms_deviation(explained.misses[~silent], rest, expected) <= _MATCHES:
            tested = _tested(explained, RELATION, unseen)
            if not tested.slips:
                slips = silent_columns(every, rest, expected, columns, steps.runs)
                return silent_test(RELATION, slips) if slips else tested
            if not _reverses_most(tested, steps) and (best is None or _named_count(tested) < _named_count(best)):
                best = tested
    return (
        best
        if best is None or gain is not None
        else replace(best, rivals=(*best.rivals, *_reciprocal_alternatives(best)))
    )


def misfit_of_legs(steps: SignalSteps, columns: Sequence[RecordedColumn], legs: Array, gain: Array | None) -> float:
    """Return the rms misfit of signals by forces (6, 6) along the legs over their rms response; zero without responses.

    Where no gain (S,) is declared, each signal has the one, of either sign, that fits it best.
    """
    measured = _clear_responses(steps, len(columns))
    if not len(measured):
        return 0.0
    norm = np.linalg.norm(measured.direction * np.sqrt(np.mean(legs**2, axis=0)), axis=1)
    size, force = measured.size / norm, np.sum(legs[measured.column] * measured.direction, axis=1) / norm
    missed = np.zeros(len(size))
    for k in range(len(legs)):
        mine = measured.column == k
        if mine.any():
            fitted = float(size[mine] @ force[mine] / max(force[mine] @ force[mine], 1e-300))
            scale = max(float(np.sqrt(np.mean(size[mine] ** 2))), 1e-300)
            missed[mine] = (size[mine] - (fitted if gain is None else gain[k]) * force[mine]) / scale
    return float(np.sqrt(np.mean(missed**2)))


def _named_count(tested: RelationTest) -> int:
    """Return the number of columns and runs that slips name: the simpler of two explanations names fewer."""
    return sum(len(slip.subjects) for slip in tested.slips)


def _reverses_most(tested: RelationTest, steps: SignalSteps) -> bool:
    """Return True if most runs would have the opposite sign; then the others are wrong, and signals count the other
    way."""
    most = 0.5 * len(np.unique(steps.run))
    return any(slip.kind == SlipKind.SIGN and len(set(slip.subjects) & set(steps.runs)) > most for slip in tested.slips)


def _explained(
    measured: Responses,
    expected: ExpectedResponse,
    steps: SignalSteps,
    columns: Sequence[RecordedColumn],
    gain: Array | None,
) -> tuple[Explained, tuple[RecordSlip, ...]]:
    """Return the slips that explain the responses, and the slips that would not show."""
    each = [*slips_of_run_loads(measured, steps.runs, expected), *exchanges_from_a_run(measured, columns, steps.runs)]
    overall = [*slips_of_all_loads(measured), *slips_of_columns(measured, columns, steps.runs, expected, of_all=True)]
    if gain is None:
        overall = [trial for trial in overall if not _is_of_all(trial, columns)]
    broad = [trial for trial in overall if not trial.slip.subjects]
    explained = explain(measured, expected, [*each, *(trial for trial in overall if trial.slip.subjects)], broad)
    if explained.slips:
        return explained, ()
    unseen = [trial for trial in overall if not any(name in steps.runs for name in trial.slip.subjects)]
    return explained, (*_blind(gain), *hidden(measured, expected, unseen))


def _reciprocal_alternatives(tested: RelationTest) -> tuple[RecordSlip, ...]:
    """Return the alternatives to torques (or forces) in another unit: the other quantity in the reciprocal unit."""
    other = {"torque": "force", "force": "torque"}
    return tuple(
        replace(slip, quantity=other[slip.quantity], factor=1.0 / slip.factor)
        for slip in tested.slips
        if slip.kind == SlipKind.UNIT and slip.quantity in other and not slip.subjects
    )


def against_each_other(steps: SignalSteps, columns: Sequence[RecordedColumn], relation: str) -> RelationTest:
    """Return the test of columns against the loads of each run, by comparison with the other runs."""
    measured = _clear_responses(steps, len(columns))
    expected, vouched = typical(measured, len(columns))
    measured = measured.subset(vouched) if len(measured) else measured
    alone = tuple(steps.runs[run] for run in np.unique(steps.run).tolist() if not np.any(measured.run == run))
    unseen = (*_slips_of_all_runs(columns), *_slips_of_single_runs(columns, alone))
    if not len(measured):
        return RelationTest(relation, RelationState.NOT_TESTED, "no-repeats", hidden=unseen)
    candidates = [
        *slips_of_run_loads(measured, steps.runs, expected),
        *slips_of_columns(measured, columns, steps.runs, expected, of_all=False),
    ]
    explained = explain(measured, expected, candidates)
    of_one_quantity = len({column.quantity for column in columns}) == 1  # so that any two may be exchanged
    exchanges = [*exchanges_by_axis(measured, columns)] if of_one_quantity else []
    return _tested(explained, relation, (*unseen, *hidden(measured, expected, exchanges)))


def responses_of(steps: SignalSteps, columns: int) -> Array:
    """Return the responses of columns to loads, (S, 6), by most runs."""
    measured = _clear_responses(steps, columns)
    return typical(measured, columns)[0].matrix if len(measured) else np.zeros((columns, 6))


def _clear_responses(steps: SignalSteps, count: int) -> Responses:
    return clear_responses(responses(steps.load, steps.run, steps.value, has_zero=not steps.tared), count)


def _tested(explained: Explained, relation: str, unseen: Sequence[RecordSlip]) -> RelationTest:
    state, reason = (
        (RelationState.OK, "agrees") if explained.before <= _NO_BETTER else (RelationState.ATTENTION, "departs")
    )
    return explained.tested(relation, state, reason, unseen)


def _responses_by_legs(measured: Responses, legs: Array, gain: Array | None) -> Iterator[ExpectedResponse]:
    """Yield the expected response of signals with the declared gain, or with one gain common to all of them. The sign
    is positive for tension, negative, or separate for each signal."""
    of_load = np.sqrt(np.mean(legs**2, axis=0))
    if gain is not None:
        yield ExpectedResponse(legs * gain[:, None], _ABOVE_TYPICAL * np.abs(gain), of_load, _DECLARED)
        return
    force = np.sum(legs[measured.column] * measured.direction, axis=1)
    main = np.abs(force) > _MAIN * np.linalg.norm(measured.direction * of_load, axis=1)
    pushed = main & ~measured.direction[:, 3:].any(axis=1)
    by = pushed if pushed.any() else main
    common = float(np.median(np.abs(measured.size[by] / force[by]))) if by.any() else 1.0
    wired = [
        np.sign(measured.size[mine] @ force[mine]) or 1.0 for mine in (measured.column == k for k in range(len(legs)))
    ]
    of_column = np.full(len(legs), _ABOVE_TYPICAL * common)
    for signs in (np.ones(len(legs)), -np.ones(len(legs)), np.array(wired)):
        yield ExpectedResponse(common * legs * signs[:, None], of_column, of_load, _OWN_GAIN)


def _rms_deviation(missed: Array, measured: Responses, expected: ExpectedResponse) -> float:
    """Return the root mean square deviation of main responses."""
    wanted = np.abs(expected.expected(measured.column, measured.direction))
    main = wanted > _MAIN * expected.possible(measured.column, measured.direction)
    return float(np.sqrt(np.mean(missed[main] ** 2))) if main.any() else np.inf


def _is_of_all(candidate: SlipCandidate, columns: Sequence[RecordedColumn]) -> bool:
    """Return True if a slip changes the gain of all signals or of one; without a declared gain this
    cannot be tested."""
    slip, names = candidate.slip, {column.name for column in columns}
    if slip.kind == SlipKind.COLUMNS or slip.quantity not in ("load", "signal"):
        return False
    return names.issuperset(slip.subjects)


def _slips_of_single_runs(columns: Sequence[RecordedColumn], alone: tuple[str, ...]) -> tuple[RecordSlip, ...]:
    """Return the slips that cannot show in runs without confirmation by two others."""
    kinds = (SlipKind.UNIT, SlipKind.SIGN, SlipKind.FROZEN) if alone else ()
    return tuple(
        RecordSlip(kind, of, alone) for of in dict.fromkeys(column.quantity for column in columns) for kind in kinds
    )


def _blind(gain: Array | None) -> tuple[RecordSlip, ...]:
    if gain is not None:
        return ()
    return (RecordSlip(SlipKind.UNIT, "load"), RecordSlip(SlipKind.UNIT, "signal"), RecordSlip(SlipKind.SIGN, "signal"))


def _slips_of_all_runs(columns: Sequence[RecordedColumn]) -> tuple[RecordSlip, ...]:
    """Return the slips that equal runs cannot show: the same one in all of them."""
    quantities = dict.fromkeys(("load", *(column.quantity for column in columns)))
    units = tuple(RecordSlip(SlipKind.UNIT, quantity, ("all runs",)) for quantity in quantities)
    signs = tuple(RecordSlip(SlipKind.SIGN, quantity, ("all runs",)) for quantity in quantities)
    return (*units, *signs, RecordSlip(SlipKind.COLUMNS, "columns", ("any two in all runs",)))
