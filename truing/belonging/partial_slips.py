"""Slips in a part of a table: single readings, copied columns, rounded numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_STRAY = 12.0  # scatters of a leg's misfit, from which a reading is none of its pose
_SIZEABLE = 0.1  # of the leg's range: smaller ones are left to the diagnosis, which leaves out gross errors
_FEW = 0.1  # of all readings
_MEDIAN = 1.4826
_FEWEST = 4  # different numbers that a column needs to be compared
_FEWEST_STEPS, _OFF_GRID = 2, 1e-3  # differences that tell a step, and what they are off by, of a step
_ABOVE_NOISE = 3.0  # error by rounding over declared noise
_ROUNDED = (0.5, 2.0)  # misfit over the error that the step of a column makes


def stray_readings(readings: Array, asked: Array, noise: float) -> Index:
    """Return rows and columns (N, 2) of the few readings (B, L) far from those that their poses ask for (B, L), m."""
    misfit = readings - asked
    misfit = misfit - np.median(misfit, axis=0)
    scatter = np.maximum(_MEDIAN * np.median(np.abs(misfit), axis=0), noise)
    limit = np.maximum(_STRAY * scatter, _SIZEABLE * np.ptp(asked, axis=0))
    found = np.argwhere(np.abs(misfit) > limit)
    return found if len(found) <= max(_FEW * misfit.size, 1.0) else found[:0]


def copied_columns(readings: Array) -> list[tuple[int, int]]:
    """Return pairs of columns of readings (B, L) that are the same in every row."""
    return [
        (i, j)
        for i in range(readings.shape[1])
        for j in range(i + 1, readings.shape[1])
        if np.array_equal(readings[:, i], readings[:, j]) and len(np.unique(readings[:, i])) >= _FEWEST
    ]


def written_step(values: Array) -> float:
    """Return the step, in the unit of the values, that all differences of the numbers are multiples of; 0 for none."""
    steps = np.diff(np.unique(values.round(12)))
    steps = steps[steps > 1e-12]
    if len(steps) < _FEWEST_STEPS:
        return 0.0
    counted = steps / steps.min()
    return float(steps.min()) if np.abs(counted - counted.round()).max() < _OFF_GRID else 0.0


def rounding(values: Array, misfit: float, noise: float) -> float | None:
    """Return the step, m, of numbers whose rounding errs by more than the declared noise and makes the rms misfit.

    None also where the misfit is far smaller: a drive may be sent to round numbers, and reach them.
    """
    step = written_step(values)
    error = step / np.sqrt(12.0)
    return step if error > _ABOVE_NOISE * noise and misfit > _ROUNDED[0] * error else None


def rounded_to(readings: Array, misfit: float, noise: float) -> float | None:
    """Return the step, m, in which readings were written down, where it makes the rms misfit; else None."""
    step = written_step(readings)
    error = step / np.sqrt(12.0)
    low, high = _ROUNDED
    return step if error > 10.0 * noise and low * error < misfit < high * error else None
