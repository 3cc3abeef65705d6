"""Cause: loads of a calibration table in each other's rows; detection of such rows from all signals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.recorded_steps import LOADS, RecordedSteps
from truing.estimation.sensor.exchanged_loads import exchanged_loads
from truing.estimation.sensor.load_table import load_table
from truing.simulation.bench.causes.reading_causes import BenchScene, ReadingCause, is_signal
from truing.simulation.bench.load_steps import LoadSteps, ReadingState
from truing.simulation.bench.six_upur.loading import AXES
from truing.simulation.bench.six_upur.uncertain_sensor import UncertainSensor
from truing.simulation.cause import Parameter, ReportedParameter, Step

Row = tuple[int | str, int | str]


@dataclass(frozen=True)
class RowsExchanged(ReadingCause):
    """The loads of two ``rows``, (run, step) each, are exchanged, in ``components`` of the six."""

    rows: tuple[Row, ...] = ()
    components: tuple[str, ...] = ()

    id = "rows-exchanged"
    step = Step.DRIVE
    is_persistent = False

    @property
    def subject(self) -> str:
        """The run, or both runs."""
        runs = dict.fromkeys(str(run) for run, _ in self.rows)
        return f"run {' '.join(runs)}" if runs else ""

    def candidates(self, scene: BenchScene) -> Sequence[RowsExchanged]:
        """Return none: exchanged rows are found in the table before any fit."""
        return ()

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return none: the cause is discrete."""
        return ()

    def slopes(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return an empty derivative."""
        return np.zeros((*state.wrench.shape, 0))

    def moved(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return the applied loads minus the recorded ones."""
        shift = np.zeros_like(state.wrench)
        indices = [_row_index(state.steps, row) for row in self.rows]
        if len(indices) == 2 and None not in indices:
            columns = [AXES.index(name) for name in self.components]
            load = state.steps.load[np.ix_(indices, columns)]  # type: ignore[arg-type]
            shift[np.ix_(indices, columns)] = load[::-1] - load  # type: ignore[arg-type]
        return shift

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the rows, as run/step, and the components, as text."""
        rows = " ".join(f"{run}/{step}" for run, step in self.rows)
        return (
            ReportedParameter("rows", rows, None, ""),
            ReportedParameter("components", " ".join(self.components), None, ""),
        )


@dataclass(frozen=True)
class SignalsExchanged(RowsExchanged):
    """Only the signals of two rows are exchanged: the loads agree with the readings of displacements."""

    step = Step.INSTRUMENT

    def slopes(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return an empty derivative."""
        return np.zeros((*state.readings.shape, 0))

    def moved(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return the change of the signals by the exchange."""
        return self._exchanged(state, state.readings) - state.readings

    def passed_on(self, slopes: NDArray, state: ReadingState, values: NDArray) -> NDArray:
        """Return changes of the readings, with those of the signals exchanged."""
        return self._exchanged(state, slopes)

    def _exchanged(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return values (B, K, ...) with the signals of the two rows exchanged."""
        exchanged = np.array(values)
        indices = [_row_index(state.steps, row) for row in self.rows]
        if len(indices) == 2 and None not in indices:
            signal = np.array([is_signal(name) for name in state.steps.channels])
            exchanged[np.ix_(indices, signal)] = values[np.ix_(indices[::-1], signal)]  # type: ignore[arg-type]
        return exchanged


def _row_index(steps: LoadSteps, row: Row) -> int | None:
    """Return the index of a row among the load steps; None if it is absent."""
    indices = np.flatnonzero((steps.run == row[0]) & (steps.step == row[1]))
    return int(indices[0]) if len(indices) else None


# Least number of distinct loads per regressor: with fewer, any signals would fit.
_LOADS_PER_COLUMN = 2
_NORMAL_MEDIAN = 0.6745


def exchanged_rows(steps: RecordedSteps, rows: NDArray[np.bool_]) -> tuple[RowsExchanged, ...]:
    """Return the exchanges among some rows (B,), as causes; none if there are too few loads to detect them."""
    rows = rows & np.isfinite(steps.signal).all(1) if steps.signal.size else np.zeros(len(rows), bool)
    load, signal = steps.load[rows], steps.signal[rows]
    columns = np.column_stack([signal, np.ones(len(signal))])
    if len(np.unique(load, axis=0)) <= _LOADS_PER_COLUMN * columns.shape[1]:
        return ()
    if np.linalg.matrix_rank(columns / np.sqrt(np.mean(columns**2, 0) + 1e-300)) < columns.shape[1]:
        return ()
    names = [(steps.runs[run], int(step)) for run, step in zip(steps.run[rows], steps.step[rows], strict=True)]
    return tuple(
        RowsExchanged(
            (names[exchanged_load.first], names[exchanged_load.second]),
            tuple(LOADS[k] for k in exchanged_load.components),
        )
        for exchanged_load in exchanged_loads(load_table(signal, load, steps.run[rows]))
    )


def with_corrected_loads(steps: RecordedSteps, exchanges: Sequence[RowsExchanged]) -> RecordedSteps:
    """Return the steps with the loads of exchanged rows restored."""
    load = steps.load.copy()
    for exchange in exchanges:
        rows = [
            int(np.flatnonzero((steps.run == steps.runs.index(run)) & (steps.step == step))[0])
            for run, step in exchange.rows
        ]
        indices = [LOADS.index(name) for name in exchange.components]
        load[np.ix_(rows, indices)] = load[np.ix_(rows[::-1], indices)]
    return replace(steps, load=load)


def confirmed_by_readings(
    exchanged: tuple[RowsExchanged, ...], steps: RecordedSteps, sensor: UncertainSensor
) -> tuple[RowsExchanged, ...]:
    """Return the exchanges; as `SignalsExchanged` if the readings of displacements agree with the recorded loads."""
    plain = np.zeros(sensor.geometry_size), np.zeros(sensor.stiffness_size)
    compliance = sensor.at(*plain).compliance
    return tuple(
        exchange
        if _agrees_with_exchange(exchange, steps, compliance)
        else SignalsExchanged(exchange.rows, exchange.components)
        for exchange in exchanged
    )


def _agrees_with_exchange(exchange: RowsExchanged, steps: RecordedSteps, compliance: NDArray) -> bool:
    """True if readings agree better with the exchanged loads; also if there are no readings."""
    names: list[Row] = [(steps.runs[run], int(step)) for run, step in zip(steps.run, steps.step, strict=True)]
    rows = [names.index(row) for row in exchange.rows]
    motion_as_recorded, motion_exchanged = (
        loads[rows] @ compliance.T for loads in (steps.load, with_corrected_loads(steps, (exchange,)).load)
    )
    size = np.maximum(np.abs(motion_as_recorded), np.abs(motion_exchanged)).max(0)
    misses = [
        (steps.reading[rows] - expected) / np.where(size > 0.0, size, 1.0)
        for expected in (motion_as_recorded, motion_exchanged)
    ]
    return bool(np.nansum(misses[1] ** 2) <= np.nansum(misses[0] ** 2))


def scatter_of_signals(steps: RecordedSteps, rows: NDArray[np.bool_], exchanged: tuple[RowsExchanged, ...]) -> NDArray:
    """Return the scatter (S,), V, of signals about a linear response to the loads with a zero in each run.

    Rows with exchanged loads are omitted; NaN if there are too few rows.
    """
    wrong = {row for exchange in exchanged for row in exchange.rows}
    is_right = np.array(
        [(steps.runs[run], int(step)) not in wrong for run, step in zip(steps.run, steps.step, strict=True)]
    )
    rows = rows & is_right & np.isfinite(steps.signal).all(1)
    if not rows.any():
        return np.full(steps.signal.shape[1], np.nan)
    zero = steps.run[rows, None] == np.unique(steps.run[rows])
    columns = np.hstack([steps.load[rows], zero])
    values, _, rank, _ = np.linalg.lstsq(columns, steps.signal[rows], rcond=None)
    freedom = int(rows.sum()) - int(rank)
    if freedom <= 0:
        return np.full(steps.signal.shape[1], np.nan)
    left = np.abs(steps.signal[rows] - columns @ values)
    spread = np.median(left, 0) / _NORMAL_MEDIAN * np.sqrt(rows.sum() / freedom)
    return np.where(spread > 0.0, spread, np.nan)
