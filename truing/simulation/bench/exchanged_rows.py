"""Rows of a table of calibration loads whose loads stand in each other's place, by what all signals say of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.recorded_steps import LOADS, RecordedSteps
from truing.estimation.sensor.exchanged_loads import exchanged_loads
from truing.estimation.sensor.load_table import load_table
from truing.simulation.bench.causes.rows_exchanged import RowsExchanged

# Different loads for each column that they are predicted from: fewer follow any signals.
_LOADS_PER_COLUMN = 2


def exchanged_rows(steps: RecordedSteps, rows: NDArray[np.bool_]) -> tuple[RowsExchanged, ...]:
    """The exchanges among some rows (B,), as causes; none where the loads are too few to tell."""
    rows = rows & np.isfinite(steps.signal).all(1) if steps.signal.size else np.zeros(len(rows), bool)
    load, signal = steps.load[rows], steps.signal[rows]
    columns = np.column_stack([signal, np.ones(len(signal))])
    if len(np.unique(load, axis=0)) <= _LOADS_PER_COLUMN * columns.shape[1]:
        return ()
    if np.linalg.matrix_rank(columns / np.sqrt(np.mean(columns**2, 0) + 1e-300)) < columns.shape[1]:
        return ()
    names = [(steps.runs[run], int(step)) for run, step in zip(steps.run[rows], steps.step[rows], strict=True)]
    return tuple(
        RowsExchanged((names[one.first], names[one.second]), tuple(LOADS[k] for k in one.components))
        for one in exchanged_loads(load_table(signal, load, steps.run[rows]))
    )


def put_right(steps: RecordedSteps, exchanges: Sequence[RowsExchanged]) -> RecordedSteps:
    """The steps with the loads of exchanged rows back in their place."""
    load = steps.load.copy()
    for one in exchanges:
        rows = [
            int(np.flatnonzero((steps.run == steps.runs.index(run)) & (steps.step == step))[0])
            for run, step in one.rows
        ]
        places = [LOADS.index(name) for name in one.components]
        load[np.ix_(rows, places)] = load[np.ix_(rows[::-1], places)]
    return replace(steps, load=load)
