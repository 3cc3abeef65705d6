"""Readings that were kept, step by step, with what the declared geometry of their beams adds to them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stages.common.point_arrays import number_column
from stages.common.reading_arrays import CHANNELS, READING_SI, RecordedSteps
from truing.estimation.interferometry.compliance import Compliance

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]


@dataclass(frozen=True)
class KeptReadings:
    """Which readings (B, 6) were not rejected, their sigma; what geometry adds to them, and one sigma of that; SI."""

    kept: NDArray[np.bool_]
    sigma: Array
    added: Array
    added_sigma: Array


def kept_readings(residuals: pa.Table, steps: RecordedSteps) -> KeptReadings:
    """What reading_residuals says of the readings of load steps; a reading whose geometry is unknown is not kept."""
    place = {key: row for row, key in enumerate(zip((steps.runs[r] for r in steps.run), steps.step, strict=True))}
    keys = zip(residuals.column("run").to_pylist(), residuals.column("step").to_pylist(), strict=True)
    row = np.array([place[key] for key in keys], dtype=np.int64)
    k = np.array([CHANNELS.index(name) for name in residuals.column("channel").to_pylist()], dtype=np.int64)
    found = np.zeros((3, *steps.reading.shape))
    found[0] = 1.0
    for n, name in enumerate(("sigma", "geometry", "geometry_sigma")):
        if name in residuals.column_names:
            found[n, row, k] = number_column(residuals, name) * READING_SI[k]
    kept = np.isfinite(steps.reading) & np.isfinite(found[1])
    kept[row, k] &= ~np.asarray(residuals.column("rejected").to_pylist(), dtype=bool)
    return KeptReadings(kept, found[0], found[1], np.nan_to_num(found[2]))


def geometry_spread(load: Array, added_sigma: Array) -> Array:
    """One sigma (6, 6) of a compliance's entries by what the geometry of beams leaves open, SI.

    added_sigma (B, 6) of readings under loads (B, 6): it goes with the load, so no number of readings makes it less.
    """
    squares = np.linalg.lstsq(load**2, added_sigma**2, rcond=None)[0]
    return np.sqrt(np.maximum(squares.T, 0.0))


def with_spread(found: Compliance, spread: Array) -> Compliance:
    """A compliance whose entries are known to no better than a spread (6, 6)."""
    own = np.where(found.known & np.isfinite(found.sigma) & found.fit.free[:, :6], spread, 0.0)
    covariance = found.covariance + np.diag(own.ravel() ** 2)
    return replace(found, sigma=np.hypot(found.sigma, own), covariance=covariance)
