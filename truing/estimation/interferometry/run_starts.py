"""What runs begin with: a run counts from its own start, so without load it begins at zero but for two readings' noise.

A bench that was not set to zero before each run begins elsewhere, and so do coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.recorded_steps import RecordedSteps

Array = NDArray[np.float64]

_FAR = 6.0  # sigmas of a reading from zero at which a run cannot have begun, were it to count from its own start
_BY_CHANCE = 1e-4  # that the starts of a channel's runs scatter as they do
_FEWEST = 6  # runs whose starts a column may explain
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


@dataclass(frozen=True)
class Zeros:
    """Where runs (R, 6) begin without load, m and rad, NaN where they do not; of which channels (6,) these scatter more
    than noise lets them; and which runs (R, 6) begin far off by themselves."""

    start: Array
    scatter: NDArray[np.bool_]
    far: NDArray[np.bool_]

    @property
    def wrong(self) -> NDArray[np.bool_]:
        """Channels (6,) with a run that cannot count from its own start."""
        return np.asarray(self.scatter | self.far.any(axis=0))

    def spread(self, sigma: Array) -> Array:
        """(R, 6) one standard deviation of where runs count from: a reading's noise (6,), and what starts show more.

        Of a channel whose starts scatter, all runs are as uncertain as these; a run far off by itself as it is off.
        """
        own = np.where(self.far, np.abs(self.start), sigma)
        for k in np.flatnonzero(self.scatter):
            own[:, k] = np.maximum(own[:, k], np.sqrt(np.nanmean(self.start[:, k] ** 2)))
        return own


def zeros_of_runs(steps: RecordedSteps, reading: Array, sigma: Array) -> Zeros:
    """Hold the starts of runs among readings (B, 6), NaN to leave one out, against the noise (6,) of a reading.

    Starts that follow a recorded column, time apart, are no matter of setting zeros: what moved them is to be found.
    """
    rows = start_rows(steps)
    start = at_starts(reading, rows)
    scatter, far = np.zeros(6, dtype=bool), begun_far(start, sigma)
    for k in range(6):
        there = np.flatnonzero(np.isfinite(start[:, k]))
        z = start[there, k] / (np.sqrt(2.0) * sigma[k])
        scatter[k] = _by_chance(np.minimum(z**2, _MOST**2), len(z)) < _BY_CHANCE
        if (scatter[k] or far[:, k].any()) and _follows(z, steps, rows[there, k]):
            scatter[k] = far[:, k] = False
    return Zeros(start, scatter, far)


def _by_chance(squares: Array, freedom: int) -> float:
    """The chance of squares (N,) of standard normals as large, so many of them free."""
    from scipy.special import chdtrc

    return float(chdtrc(freedom, squares.sum())) if freedom > 0 else 1.0


def _follows(z: Array, steps: RecordedSteps, rows: NDArray[np.int64]) -> bool:
    """Whether a straight line in a column of the steps' rows (N,) leaves no more than chance of so many sigmas (N,)."""
    if len(z) < _FEWEST:
        return False
    for values in (column[rows] for column in steps.covariates.values()):
        if np.isfinite(values).all() and np.ptp(values) > 0.0:
            off = values - values.mean()
            left = z - z.mean() - off * (off @ z) / (off @ off)
            if _by_chance(left**2, len(z) - 2) > _BY_CHANCE:
                return True
    return False
