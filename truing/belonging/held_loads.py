"""Test of signals at held loads: do all runs follow one linear response, or were some recorded otherwise?

A run at a constant load shows no response of its own. Its signals, less one zero that all runs share, must follow
the response that most runs have in common.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.belonging.plausible_slips import RecordedColumn
from truing.belonging.relation import FORCE_UNITS, TORQUE_UNITS, RecordSlip, RelationState, RelationTest, SlipKind
from truing.belonging.signal_tests import SignalSteps
from truing.belonging.slips_in_rows import Agreement, rms_of, row_places, slipped_rows
from truing.estimation.interferometry.recorded_steps import LOADS

_WINDOWS, _LENGTHS = 8, (0.5, 0.35)  # stretches of loads that a response is fitted to, and their share of all
_TRIMMED = 0.4  # share of the loads that must agree with the best response
_FAR, _LEAST = 5.0, 0.05  # typical misfits, and share of a signal's range, beyond which a load does not agree
_FEWEST_APART = 3
_CHANCE = 1e-6  # probability below which equal values at different loads are no coincidence
_BEYOND = 0.9  # share of the loads that lead beyond the end of a clipped signal's range
_LINEAR = 0.02  # typical misfit, over the range, of a sensor whose response is linear
_TIMES = 3  # loads over unknowns of one signal
_SHIFTS = (1, -1)
_CLEARLY = 0.2  # of the misfit, that a shift of all loads may leave
_NEARLY_ALL = 0.9  # share of the loads that agree after a shift of all of them


def against_one_response(steps: SignalSteps, columns: Sequence[RecordedColumn], relation: str) -> RelationTest | None:
    """Return the test of held loads by the linear response that most have in common; None where loads are too few, or
    where their signals follow no linear response."""
    holds = _holds(steps)
    if (frozen := _frozen(holds, columns)) is not None:
        return RelationTest(relation, RelationState.FAILS, "frozen", slips=(frozen,), unit="%")
    fit = _most_common(holds)
    if fit is None:
        return None
    if (shifted := _shifted(holds, fit, relation)) is not None:
        return shifted
    if fit.typical > _LINEAR:
        return None
    distance = fit.distance(holds.load, holds.signal)
    near = distance <= fit.limit
    agreed = Agreement(np.zeros(len(columns)), distance, fit.limit, fit.typical)
    tested = RelationTest(
        relation,
        RelationState.OK,
        "agrees",
        misfit=100.0 * rms_of(distance),
        limit=100.0 * fit.limit,
        unit="%",
    )
    if len(agreed.apart) < _FEWEST_APART:
        return replace(tested, misfit=100.0 * rms_of(distance[near]))
    candidates: list[tuple[float, RecordSlip]] = []
    tried = 0
    for slip, other in _otherwise(holds, columns):
        tried += 1
        undone = fit.misfit(other.load, other.signal)
        rows = slipped_rows(undone, np.zeros_like(undone), agreed)
        if rows is not None:
            after = fit.distance(other.load, other.signal)
            is_of_all = slip.kind is SlipKind.ROWS_SHIFTED and np.mean(after <= fit.limit) > _NEARLY_ALL
            where = () if is_of_all else row_places(*rows, holds.names, (), "")
            left = rms_of(after[rows[0]])
            candidates.append((left, replace(slip, subjects=(*slip.subjects, *where))))
    if not candidates:
        return None
    left, slip = min(candidates, key=lambda candidate: candidate[0])
    return replace(
        tested, state=RelationState.FAILS, reason="slip", slips=(slip,), misfit_explained=100.0 * left, tried=tried
    )


@dataclass(frozen=True)
class _Holds:
    """Mean signals (H, S), V, of held loads (H, 6), N and N m, with the name of each: its run, or its first step if a
    run holds several loads."""

    load: Array
    signal: Array
    names: Sequence[str]


def _holds(steps: SignalSteps) -> _Holds:
    """Return the stretches of constant load of each run, without incomplete signals."""
    indices = np.flatnonzero(np.isfinite(steps.value).all(axis=1))
    load, run, value = steps.load[indices], steps.run[indices], steps.value[indices]
    new = np.append(True, (np.diff(load, axis=0) != 0.0).any(axis=1) | (np.diff(run) != 0))[: len(indices)]
    first = np.flatnonzero(new)
    count = np.diff(np.append(first, len(indices)))
    mean = np.add.reduceat(value, first, axis=0) / count[:, None] if len(first) else value
    return _Holds(load[first], mean, _names(steps, indices[first]))


def _names(steps: SignalSteps, first: Index) -> list[str]:
    """Return the name of each held load by its first row (H,): its run, or its step if a run holds several."""
    runs = steps.run[first].tolist()
    if steps.step is None or len(set(runs)) == len(runs):
        return [steps.runs[number] for number in runs]
    of_step = [f"step {step}" for step in steps.step[first].tolist()]
    is_single = len(set(runs)) == 1
    return [step if is_single else f"{steps.runs[run]} {step}" for run, step in zip(runs, of_step, strict=True)]


@dataclass(frozen=True)
class _LinearResponse:
    """Coefficients (7, S) of a linear response with its zero, by loads over ``size`` (6,); signals' ranges (S,), V.

    ``typical``: rms misfit, over the ranges, of the loads that agree best; ``limit``: of a load that agrees.
    """

    coefficients: Array
    size: Array
    span: Array
    typical: float = 0.0

    @property
    def limit(self) -> float:
        return max(_FAR * self.typical, _LEAST)

    def misfit(self, load: Array, signal: Array) -> Array:
        """Return signals less expected ones (H, S), over the signals' ranges."""
        return np.asarray((signal - _design(load, self.size) @ self.coefficients) / self.span)

    def distance(self, load: Array, signal: Array) -> Array:
        """Return the rms misfit (H,) of each load."""
        return np.asarray(np.sqrt(np.mean(self.misfit(load, signal) ** 2, axis=1)))


def _most_common(holds: _Holds) -> _LinearResponse | None:
    """Return the response with the smallest misfit of those loads that agree best with it."""
    count = len(holds.load)
    size = np.maximum(np.abs(holds.load).max(axis=0, initial=0.0), 1e-300)
    rank = int(np.linalg.matrix_rank(_design(holds.load, size))) if count else 0
    if count < _TIMES * (rank + 1) / _TRIMMED:
        return None
    retained = max(int(_TRIMMED * count), 2 * rank)
    fitted = (_fitted(holds, size, window, rank) for window in _windows(count))
    responses = [
        response for start in fitted if start is not None for response in _settled(holds, size, start, rank, retained)
    ]
    return min(responses, key=lambda candidate: candidate.typical, default=None)


def _windows(count: int) -> Iterator[Mask]:
    yield np.ones(count, bool)
    for share, start in product(_LENGTHS, np.linspace(0.0, 1.0, _WINDOWS)):
        first = int(start * (1.0 - share) * count)
        window = np.zeros(count, bool)
        window[first : first + int(share * count)] = True
        yield window


def _fitted(holds: _Holds, size: Array, rows: Mask, rank: int) -> _LinearResponse | None:
    """Return the least squares response of some loads; None where these determine less than all loads do."""
    design = _design(holds.load[rows], size)
    if rows.sum() < 2 * rank or np.linalg.matrix_rank(design) < rank:
        return None
    span = np.ptp(holds.signal, axis=0)
    span[span == 0.0] = np.inf
    return _LinearResponse(np.asarray(np.linalg.lstsq(design, holds.signal[rows], rcond=None)[0], float), size, span)


def _settled(holds: _Holds, size: Array, start: _LinearResponse, rank: int, retained: int) -> Iterator[_LinearResponse]:
    """Yield the response of the ``retained`` loads that agree best, found again from those of the last one."""
    response: _LinearResponse | None = start
    for _ in range(3):
        if response is None:
            return
        best = np.zeros(len(holds.load), bool)
        best[np.argsort(response.distance(holds.load, holds.signal))[:retained]] = True
        response = _fitted(holds, size, best, rank)
    if response is not None:
        yield replace(response, typical=rms_of(response.distance(holds.load, holds.signal)[best]))


def _design(load: Array, size: Array) -> Array:
    return np.column_stack([load / size, np.ones(len(load))])


def _shifted(holds: _Holds, recorded: _LinearResponse, relation: str) -> RelationTest | None:
    """Return the test with all loads some rows too far up or down, if so they follow one response far better."""
    others = {shift: _most_common(replace(holds, load=np.roll(holds.load, -shift, axis=0))) for shift in _SHIFTS}
    left = {shift: other.typical for shift, other in others.items() if other is not None}
    best = min(left, key=lambda shift: left[shift], default=None)
    if best is None or left[best] > _CLEARLY * recorded.typical or recorded.typical < _LEAST:
        return None
    slip = RecordSlip(SlipKind.ROWS_SHIFTED, "loads", shift=best)
    before, after = 100.0 * recorded.typical, 100.0 * left[best]
    return RelationTest(
        relation, RelationState.FAILS, "rows", misfit=before, misfit_explained=after, unit="%", slips=(slip,)
    )


def _frozen(holds: _Holds, columns: Sequence[RecordedColumn]) -> RecordSlip | None:
    """Return the signal that has one value, in every digit, at successive loads that move it at other times.

    One that stays at an end of its range, beyond which these loads would lead, is clipped and not frozen.
    """
    for column, signal in zip(columns, holds.signal.T, strict=True):
        ends = np.flatnonzero(np.concatenate([[True], np.diff(signal) != 0.0, [True]]))
        length = np.diff(ends)
        at = int(np.argmax(length)) if len(length) else 0
        is_constant = np.zeros(len(signal), bool)
        is_constant[ends[at] : ends[at] + (length[at] if len(length) else 0)] = True
        _, often = np.unique(signal[~is_constant], return_counts=True)
        alike = (1 + often.max(initial=0)) / (1 + np.sum(~is_constant))  # chance that another load gives the same value
        kinds = len(np.unique(holds.load[is_constant], axis=0))
        if kinds < _FEWEST_APART or alike ** (kinds - 1) > _CHANCE or _is_clipped(holds, signal, is_constant):
            continue
        return RecordSlip(
            SlipKind.FROZEN, column.quantity, (column.name, *row_places(is_constant, ~is_constant, holds.names, (), ""))
        )
    return None


def _is_clipped(holds: _Holds, column: Array, is_constant: Mask) -> bool:
    """True if the others' linear response puts most loads of the rows ``is_constant`` beyond that end of the range."""
    size = np.maximum(np.abs(holds.load).max(axis=0), 1e-300)
    design, level = _design(holds.load, size), column[is_constant][0]
    expected = design[is_constant] @ np.linalg.lstsq(design[~is_constant], column[~is_constant], rcond=None)[0]
    beyond = expected > level if level >= column.max() else expected < level
    return bool(level in (column.min(), column.max()) and np.mean(beyond) > _BEYOND)


def _otherwise(holds: _Holds, columns: Sequence[RecordedColumn]) -> Iterator[tuple[RecordSlip, _Holds]]:
    """Yield slips with the loads and signals without them."""
    for k, column in enumerate(columns):
        signal = holds.signal.copy()
        signal[:, k] *= -1.0
        yield RecordSlip(SlipKind.SIGN, column.quantity, (column.name,)), replace(holds, signal=signal)
    for i, j in combinations(range(len(columns)), 2):
        signal = holds.signal.copy()
        signal[:, [i, j]] = holds.signal[:, [j, i]]
        slip = RecordSlip(SlipKind.COLUMNS, "columns", (columns[i].name, columns[j].name))
        yield slip, replace(holds, signal=signal)
    for factor in (1e3, 1e-3):
        slip = RecordSlip(SlipKind.UNIT, "signal", (), factor)
        yield slip, replace(holds, signal=factor * holds.signal)
    forces, torques = np.arange(6) < 3, np.arange(6) >= 3
    changed = [(SlipKind.UNIT, "load", forces | torques, factor) for factor in FORCE_UNITS]
    changed += [(SlipKind.UNIT, "force", forces, factor) for factor in FORCE_UNITS]
    changed += [(SlipKind.UNIT, "torque", torques, factor) for factor in TORQUE_UNITS]
    for name, axes in (("load", forces | torques), ("force", forces), ("torque", torques)):
        changed.append((SlipKind.SIGN, name, axes, -1.0))
    for kind, name, axes, factor in changed:
        slip = RecordSlip(kind, name, (), factor if kind is SlipKind.UNIT else 1.0)
        yield slip, replace(holds, load=holds.load * np.where(axes, factor, 1.0))
    for i, j in (*combinations(range(3), 2), *combinations(range(3, 6), 2)):
        load = holds.load.copy()
        load[:, [i, j]] = holds.load[:, [j, i]]
        yield RecordSlip(SlipKind.COLUMNS, "load axes", (LOADS[i], LOADS[j])), replace(holds, load=load)
    for k in range(6):
        slip = RecordSlip(SlipKind.SIGN, "force" if forces[k] else "torque", (LOADS[k],))
        yield slip, replace(holds, load=holds.load * np.where(np.arange(6) == k, -1.0, 1.0))
    for shift in _SHIFTS:
        slip = RecordSlip(SlipKind.ROWS_SHIFTED, "loads", shift=shift)
        yield slip, replace(holds, load=np.roll(holds.load, -shift, axis=0))
