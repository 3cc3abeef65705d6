"""Check of loads that were joined to signals of another file: are they those of the rows before or after?"""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index, TableRow
from truing.estimation.interferometry.recorded_steps import RecordedSteps
from truing.report.numbers import count_text, plain, quantity
from truing.stages.quality.check import FAIL, PASS, WARN, Check, not_evaluated

_SUBJECT = "signals"
_SHIFTS = (-3, -2, -1, 1, 2, 3)
_SPARE = 6  # least number of rows beyond the columns of the fit
_BETTER = 0.5  # of the scatter as joined: that of another order, which is clearly better
_AS_GOOD = 1.5  # times the scatter as joined: below that, another order cannot be distinguished from it


def joined_loads_check(steps: RecordedSteps, joined: pa.Table) -> Check:
    """Check that signals follow the loads of their own rows, and not of rows up to three before or after.

    value: scatter of signals about a linear fit to loads in the best other order, over that as joined.
    """
    (row,) = joined.to_pylist()
    missing = row["signal_rows"] - row["rows_matched"]
    used = np.isfinite(steps.signal).all(axis=1)
    ratios = _ratios(steps.load[used], steps.signal[used], steps.run[used])
    if not ratios:
        return not_evaluated(_SUBJECT, "loads-joined", _SUBJECT, "too few load steps to try the rows before and after")
    shift = min(ratios, key=lambda one: ratios[one])
    ratio = ratios[shift]
    words = f"{count_text(abs(shift), 'row')} {'later' if shift > 0 else 'earlier'}"
    text = f"{row['rows_matched']:,} of {count_text(row['signal_rows'], 'row')} of signals have loads."
    if ratio < _BETTER:
        text += f" Signals fit the loads {words} clearly better: the scatter is {plain(ratio)} times that as joined."
    elif ratio < _AS_GOOD:
        text += f" An offset was not tested: signals fit the loads {words} as well ({plain(ratio)} times the scatter)."
    else:
        text += f" Loads of other rows fit worse: {words}, the scatter is {plain(ratio)} times that as joined."
    verdict = FAIL if ratio < _BETTER else WARN if missing else PASS
    return Check("loads-joined", _SUBJECT, ratio, _BETTER, "1", verdict, text + _clocks(row))


def _clocks(row: TableRow) -> str:
    """Return the largest offset between the clocks that would change no choice of rows."""
    if row["joined_by"] != "time":
        return ""
    early, late = row.get("earlier_s"), row.get("later_s")
    spans = [
        f"{name} by {quantity(value, 's')}" for name, value in (("back", early), ("on", late)) if value is not None
    ]
    moved = f"; the rows are the same with the clock of the loads moved {' or '.join(spans)}" if spans else ""
    return f" Whether the two clocks agree is not tested beyond that{moved}."


def _ratios(load: Array, signal: Array, run: Index) -> dict[int, float]:
    """Return by shift the scatter about fits to the loads of shifted rows, over that to their own loads, on the same
    rows; no shifts that leave too few rows."""
    found = {}
    for shift in _SHIFTS:
        rows = np.arange(max(0, -shift), len(load) - max(0, shift))
        rows = rows[run[rows] == run[rows + shift]] if len(rows) else rows
        if len(rows) < load.shape[1] + 1 + _SPARE:
            continue
        scatter, scatter_shifted = (_scatter(load[rows + by], signal[rows]) for by in (0, shift))
        found[shift] = float(scatter_shifted / scatter) if scatter > 0.0 else float("inf")
    return found


def _scatter(load: Array, signal: Array) -> float:
    """Return the rms residual of a linear fit to loads and a zero, over channels of equal weight."""
    columns = np.column_stack([np.ones(len(load)), load / np.maximum(np.abs(load).max(axis=0), 1e-300)])
    left = signal - columns @ np.linalg.lstsq(columns, signal, rcond=None)[0]
    spread = signal.std(axis=0)
    return float(np.sqrt(np.mean((left / np.where(spread > 0.0, spread, 1.0)) ** 2)))
