"""What runs begin with: a run counts from its own start, so without load it begins at zero but for two readings' noise.

A bench that was not set to zero before each run begins elsewhere, and so do coordinates.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stages.sensor.reading_arrays import RecordedSteps

Array = NDArray[np.float64]

_FAR = 6.0  # sigmas of a reading from zero at which a run cannot have begun, were it to count from its own start
_BY_CHANCE = 1e-4  # that the starts of a channel's runs scatter as they do
_MOST = 3.0  # sigmas that one start counts for: of one run alone nothing follows for the others


def start_rows(steps: RecordedSteps) -> NDArray[np.int64]:
    """(R, 6) the row of the first reading of each run and channel; -1 where it was taken under load, or none was."""
    found = np.full((len(steps.runs), 6), -1)
    empty = np.asarray(~steps.load.any(axis=1))
    for k in range(6):
        rows = np.flatnonzero(np.isfinite(steps.reading[:, k]))
        run, first = np.unique(steps.run[rows], return_index=True)
        found[run, k] = np.where(empty[rows[first]], rows[first], -1)
    return found


def at_starts(values: Array, rows: NDArray[np.int64]) -> Array:
    """Values (B, 6) of the rows (R, 6) that runs begin with; NaN where there is none."""
    return np.where(rows < 0, np.nan, values[rows, np.arange(6)])


def begun_far(start: Array, sigma: Array) -> NDArray[np.bool_]:
    """Which runs (R, 6) begin so far from zero that they cannot count from there; sigma (6,) or (R, 6) of a reading."""
    with np.errstate(invalid="ignore"):
        return np.abs(start) > _FAR * sigma


def starts_scatter(start: Array, sigma: Array) -> NDArray[np.bool_]:
    """Of which channels (6,) the starts of runs (R, 6) scatter more than the noise of readings (6,) lets them."""
    from scipy.special import chdtrc

    square = np.nan_to_num(np.minimum(0.5 * (start / sigma) ** 2, _MOST**2)).sum(axis=0)
    count = np.isfinite(start).sum(axis=0)
    return (count > 0) & (chdtrc(np.maximum(count, 1), square) < _BY_CHANCE)


def zero_spread(start: Array, sigma: Array) -> Array:
    """(R, 6) one standard deviation of where runs count from: a reading's noise (6,), and what their starts show more.

    Of a channel whose starts scatter more than noise, all runs are as uncertain as these; a run that begins far off by
    itself is as uncertain as it is off.
    """
    own = np.where(begun_far(start, sigma), np.abs(start), sigma)
    for k in np.flatnonzero(starts_scatter(start, sigma)):
        own[:, k] = np.maximum(own[:, k], np.sqrt(np.nanmean(start[:, k] ** 2)))
    return own
