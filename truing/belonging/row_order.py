"""Test of the order of rows in each run: do values follow the loads as recorded, shifted, or reversed?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from truing.arrays import Array, Index
from truing.belonging.evidence import log_evidence, physics
from truing.belonging.relation import RecordSlip, SlipKind
from truing.belonging.responses import directions

_SHIFTS = (1, -1, 2, -2)
_FREE, _SIZEABLE, _SMALL = 10.0, 0.3, 0.1  # prior widths, of a column's range: response; its causes; play and drift
_FLOOR = 1e-3  # least noise, relative to a column's range
_PACES = (2.0, 8.0)  # time constants of creep, in steps
_MUCH = 15.0  # log evidence
_MOST_RUNS = 0.7
_FEWEST = 7
_SINGLE = 2  # most rows of a run that may deviate by themselves
_MOST_LEFT = 0.1  # largest residual of rows in their right order, as a share of a column's range
_ALIKE = 0.98
_DISORDERED, _ORDERED = 0.05, 0.2  # least misfit of all rows, over the ranges; share of it that another order may leave
_ROWS_PER_UNKNOWN = 2
_CLEAR = 0.2  # least range of a column in a run for a test, as a share of its largest range


@dataclass(frozen=True)
class RowSlip:
    """Rows recorded in another order: the slip, and the rms residual before and after, in per cent of the columns'
    range."""

    slip: RecordSlip
    before: float
    after: float


@dataclass(frozen=True)
class _Order:
    """A possible order of rows: shifted by a number of rows, or reversed (shift 0)."""

    shift: int

    def rows(self, count: int) -> tuple[Index, Index]:
        """Return the rows of the values, and those of the loads that belong to them."""
        every = np.arange(count)
        if self.shift == 0:
            return every, every[::-1]
        values = every[self.shift :] if self.shift > 0 else every[: self.shift]
        return values, values - self.shift

    def slip(self, quantity: str, runs: tuple[str, ...]) -> RecordSlip:
        """Return the slip of this order."""
        if self.shift == 0:
            return RecordSlip(SlipKind.REVERSED, quantity, runs)
        return RecordSlip(SlipKind.ROWS_SHIFTED, quantity, runs, shift=self.shift)


_ORDERS = (*(_Order(shift) for shift in _SHIFTS), _Order(0))


@dataclass(frozen=True)
class _Tried:
    """One order of one run: gain in log evidence over the recorded order, and the residual sums of squares of both."""

    run: int
    order: _Order
    gain: float
    before: float
    after: float


def row_slips(
    load: Array, run: Index, time_s: Array, value: Array, runs: Sequence[str], quantity: str
) -> tuple[list[RowSlip], int]:
    """Return the runs whose columns (N, K) follow loads (N, 6) in another order of rows, and the number of tests."""
    numbers = np.unique(run).tolist()
    ranges = (
        np.array([_range(value[run == number]) for number in numbers])
        .reshape(len(numbers), -1)
        .max(axis=0, initial=0.0)
    )
    tried = [
        trial
        for number in numbers
        for trial in _try_orders_of_run(
            number, load[run == number], time_s[run == number], value[run == number], ranges
        )
    ]
    return list(_row_slips(tried, runs, quantity)), len(tried)


def order_of_all_rows(load: Array, run: Index, value: Array, quantity: str) -> RowSlip | None:
    """Return the order of rows in which columns (N, K) of all runs follow one linear response to loads (N, 6).

    Runs with loads along many axes have too few rows for a response of their own. None where loads explain the columns
    as recorded, or in no order.
    """
    size = np.abs(load).max(axis=0, initial=0.0)
    scaled = load[:, size > 0.0] / size[size > 0.0]
    as_recorded = _misfit_of_response(scaled, run, value, None)
    if as_recorded is None or as_recorded < _DISORDERED:
        return None
    left = [(_misfit_of_response(scaled, run, value, order), order) for order in _ORDERS]
    best = min(((after, order) for after, order in left if after is not None), key=lambda one: one[0], default=None)
    if best is None or best[0] > _ORDERED * as_recorded:
        return None
    return RowSlip(best[1].slip(quantity, ()), 100.0 * as_recorded, 100.0 * best[0])


def _misfit_of_response(load: Array, run: Index, value: Array, order: _Order | None) -> float | None:
    """Return the rms residual of columns (N, K), over their ranges, from a common response and a zero of each run.

    None where rows are too few.
    """
    every = [np.flatnonzero(run == number) for number in np.unique(run)]
    pairs = [(rows, rows) if order is None else tuple(rows[k] for k in order.rows(len(rows))) for rows in every]
    of_values, of_loads = (np.concatenate(part) for part in zip(*pairs, strict=True))
    squares, degrees = 0.0, 0
    for column in value[of_values].T:
        seen = np.isfinite(column)
        span = float(np.ptp(column[seen])) if seen.any() else 0.0
        if span == 0.0:
            continue
        there = run[of_values][seen]
        design, answer = _less_zeros(load[of_loads][seen], there), _less_zeros(column[seen, None] / span, there)[:, 0]
        unknowns = int(np.linalg.matrix_rank(design)) + len(np.unique(there))
        if len(answer) > _ROWS_PER_UNKNOWN * unknowns:
            squares += float(np.sum((answer - design @ np.linalg.lstsq(design, answer, rcond=None)[0]) ** 2))
            degrees += len(answer) - unknowns
    return float(np.sqrt(squares / degrees)) if degrees else None


def _less_zeros(values: Array, run: Index) -> Array:
    """Return values (N, K) less their mean in each run."""
    _, at, count = np.unique(run, return_inverse=True, return_counts=True)
    totals = np.zeros((len(count), values.shape[1]))
    np.add.at(totals, np.ravel(at), values)
    return np.asarray(values - (totals / count[:, None])[np.ravel(at)])


def _row_slips(tried: Sequence[_Tried], runs: Sequence[str], quantity: str) -> Iterator[RowSlip]:
    limit = _MUCH + np.log(max(len(tried), 1))
    for order in _ORDERS:
        slips_of_order = [one for one in tried if one.order == order]
        informative = [one for one in slips_of_order if abs(one.gain) > _MUCH]
        better = [one for one in informative if one.gain > 0.0]
        if len(better) > 1 and len(better) >= _MOST_RUNS * len(informative) and _halves(better):
            yield RowSlip(order.slip(quantity, ()), *_rms_percent(better))
            return
    clear = [one for one in tried if one.gain > limit and _halves([one])]
    best: dict[int, _Tried] = {}
    for trial in clear:
        if trial.run not in best or trial.gain > best[trial.run].gain:
            best[trial.run] = trial
    for order in _ORDERS:
        if same := [one for one in best.values() if one.order == order]:
            yield RowSlip(order.slip(quantity, tuple(runs[one.run] for one in same)), *_rms_percent(same))


def _halves(tried: Sequence[_Tried]) -> bool:
    before, after = _rms_percent(tried)
    return after < min(0.5 * before, 100.0 * _MOST_LEFT)


def _rms_percent(tried: Sequence[_Tried]) -> tuple[float, float]:
    return tuple(  # type: ignore[return-value]
        100.0 * float(np.sqrt(np.mean([getattr(trial, name) for trial in tried]))) for name in ("before", "after")
    )


def can_reverse(load: Array, run: Index) -> tuple[bool, bool]:
    """Return if every run has the same loads backwards, and if it has the same with opposite signs."""
    even, odd = True, True
    for number in np.unique(run):
        loads = load[run == number]
        size = max(float(np.abs(loads).max(initial=0.0)), 1e-300)
        even &= bool(np.abs(loads - loads[::-1]).max(initial=0.0) <= (1.0 - _ALIKE) * size)
        odd &= bool(np.abs(loads + loads[::-1]).max(initial=0.0) <= (1.0 - _ALIKE) * size)
    return even, odd


def _range(value: Array) -> Array:
    """Return the range of each column (N, K), (K,), 0 where values are missing."""
    return np.nan_to_num(np.ptp(value, axis=0))


def _try_orders_of_run(number: int, load: Array, time_s: Array, value: Array, ranges: Array) -> Iterator[_Tried]:
    """Return the tested orders of one run, by the columns that respond; ranges (K,): the largest of a run in the
    campaign."""
    columns = (ranges > 0.0) & (_range(value) > _CLEAR * ranges)
    load_coordinates = directions(load)[1]
    if (
        not columns.any()
        or not load_coordinates.shape[1]
        or len(load) < max(_FEWEST, 3 * load_coordinates.shape[1] + 4)
    ):
        return
    scaled = value[:, columns]
    scaled = ((scaled - scaled.mean(axis=0)) / ranges[columns]).T
    causes = _causes(load_coordinates, time_s)
    for order in _ORDERS:
        values, loads = order.rows(len(load))
        part = scaled[:, values]
        as_is = _with_single_rows(part, causes[values])
        gains = log_evidence(part, physics(causes[loads]), _FLOOR) - log_evidence(part, physics(as_is), _FLOOR)
        before, after = (float(np.mean(_regression_residual(part, known) ** 2)) for known in (as_is, causes[loads]))
        yield _Tried(number, order, float(gains.sum()), before, after)


def _regression_residual(value: Array, columns: Array) -> Array:
    """Return the residuals (N, K) of values (K, N) after a fit of columns (N, P) with unit prior width."""
    ridge = columns.T @ columns + _FLOOR * np.eye(columns.shape[1])
    return np.asarray(value.T - columns @ np.linalg.solve(ridge, columns.T @ value.T))


def _with_single_rows(value: Array, columns: Array) -> Array:
    """Return the columns with free values for the rows that deviate most: two exchanged rows are no other order."""
    for _ in range(_SINGLE):
        worst = int(np.sum(_regression_residual(value, columns) ** 2, axis=1).argmax())
        columns = np.column_stack([columns, np.arange(len(columns)) == worst])
    return columns


def _causes(load_coordinates: Array, time_s: Array) -> Array:
    """Return columns (N, P) that a run may follow, scaled by their prior widths: loads, their history and time."""
    size = np.abs(load_coordinates)
    back = np.vstack([np.zeros_like(size[:1]), np.diff(size, axis=0) < 0.0])
    span = max(float(np.ptp(time_s)), 1e-300)
    return np.column_stack(
        [
            _FREE * np.ones(len(load_coordinates)),
            _FREE * load_coordinates,
            _SIZEABLE * size,
            _SIZEABLE * load_coordinates * size**2,
            _SIZEABLE * back * load_coordinates,
            _SIZEABLE * back * load_coordinates * size,
            _SMALL * np.sign(load_coordinates),
            *(_SIZEABLE * _minus_shifted(load_coordinates, pace) for pace in _PACES),
            _SMALL * (time_s - time_s[0]) / span,
        ]
    )


def _minus_shifted(load_coordinates: Array, pace: float) -> Array:
    """Return loads (N, D) minus the same with a lag of some steps."""
    out, state = np.zeros_like(load_coordinates), load_coordinates[0].copy()
    for n in range(len(load_coordinates)):
        state = state + (load_coordinates[n] - state) * (1.0 - np.exp(-1.0 / pace))
        out[n] = load_coordinates[n] - state
    return out
