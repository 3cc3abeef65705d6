"""Runs of loads that rise and fall: zeros of each channel, and differences between loading and unloading.

If a bench was not set to zero before a run, the run starts elsewhere; coordinates do so always.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from truing.arrays import Array, Index, Mask
from truing.estimation.interferometry.recorded_steps import RecordedSteps

_FAR_SIGMAS = 6.0  # sigmas of a reading from zero, above which a run does not count from its own start
_BY_CHANCE = 1e-4  # probability of the scatter of the starts of a channel's runs
_FEWEST = 6  # runs whose starts a column may explain
_MOST = 3.0  # sigmas that one start counts for, so that a single run does not decide for the others


def start_rows(steps: RecordedSteps) -> Index:
    """Return the row (R, 6) of the first reading of each run and channel; -1 if it was under load, or if there is
    none."""
    start = np.full((len(steps.runs), 6), -1)
    empty = np.asarray(~steps.load.any(axis=1))
    for k in range(6):
        rows = np.flatnonzero(np.isfinite(steps.reading[:, k]))
        run, first = np.unique(steps.run[rows], return_index=True)
        start[run, k] = np.where(empty[rows[first]], rows[first], -1)
    return start


def at_starts(values: Array, rows: Index) -> Array:
    """Return values (B, 6) at the first rows (R, 6) of runs; NaN without one."""
    return np.where(rows < 0, np.nan, values[rows, np.arange(6)])


def starts_far_from_zero(start: Array, sigma: Array) -> Mask:
    """Return the mask (R, 6) of runs that begin too far from zero to count from there; sigma (6,) or (R, 6) of a
    reading."""
    with np.errstate(invalid="ignore"):
        return np.abs(start) > _FAR_SIGMAS * sigma


@dataclass(frozen=True)
class RunZeros:
    """Unloaded starts of runs (R, 6), m and rad, NaN without one; mask of channels (6,) whose starts scatter more than
    noise; mask of single runs (R, 6) that begin far from zero."""

    start: Array
    scatter: Mask
    far: Mask

    @property
    def has_wrong_zero(self) -> Mask:
        """Mask (6,) of channels with a run that does not count from its own start."""
        return np.asarray(self.scatter | self.far.any(axis=0))

    def spread(self, sigma: Array) -> Array:
        """Return the standard deviation (R, 6) of the zeros of runs: a reading's noise (6,), and the excess scatter of
        starts.

        If the starts of a channel scatter, all its runs have this uncertainty; a single run far from zero has its own
        distance.
        """
        scatter = np.where(self.far, np.abs(self.start), sigma)
        for k in np.flatnonzero(self.scatter):
            scatter[:, k] = np.maximum(scatter[:, k], np.sqrt(np.nanmean(self.start[:, k] ** 2)))
        return scatter


def zeros_of_runs(steps: RecordedSteps, reading: Array, sigma: Array) -> RunZeros:
    """Return a test of the starts of runs among readings (B, 6), NaN to exclude one, against the noise (6,) of a
    reading.

    Starts that follow a recorded column other than time are not attributed to zero setting: the cause must be found.
    """
    rows = start_rows(steps)
    start = at_starts(reading, rows)
    scatter, far = np.zeros(6, dtype=bool), starts_far_from_zero(start, sigma)
    for k in range(6):
        there = np.flatnonzero(np.isfinite(start[:, k]))
        z = start[there, k] / (np.sqrt(2.0) * sigma[k])
        scatter[k] = _p_value(np.minimum(z**2, _MOST**2), len(z)) < _BY_CHANCE
        if (scatter[k] or far[:, k].any()) and _is_linear_in(z, steps, rows[there, k]):
            scatter[k] = far[:, k] = False
    return RunZeros(start, scatter, far)


def _p_value(squares: Array, freedom: int) -> float:
    """Return the probability of a sum of squares (N,) at least as large, for standard normals with some freedom."""
    from scipy.special import chdtrc

    return float(chdtrc(freedom, squares.sum())) if freedom > 0 else 1.0


def _is_linear_in(z: Array, steps: RecordedSteps, rows: Index) -> bool:
    """True if a line in a column of the steps' rows (N,) explains all but the expected scatter of z (N,)."""
    if len(z) < _FEWEST:
        return False
    for values in (column[rows] for column in steps.covariates.values()):
        if np.isfinite(values).all() and np.ptp(values) > 0.0:
            off = values - values.mean()
            residual = z - z.mean() - off * (off @ z) / (off @ off)
            if _p_value(residual**2, len(z) - 2) > _BY_CHANCE:
                return True
    return False


def branches(load: ArrayLike) -> Index:
    """Return the branch of steps (N,) in the order of measurement: 1 for increasing load or a change of its sign, -1
    for decreasing load. A held load keeps the branch before; 0 until the load first changes.

    Of several loads at once (N, A), in comparable units, the largest decides; its sign is that of their direction.
    """
    load = np.asarray(load, float)
    load = load[:, None] if load.ndim == 1 else load
    before = np.concatenate([np.zeros((1, load.shape[1])), load[:-1]])
    size, size_before = (np.abs(values).max(axis=1, initial=0.0) for values in (load, before))
    grew = np.where(np.sum(load * before, axis=1) < 0.0, 1.0, np.sign(size - size_before))
    last = np.maximum.accumulate(np.where(grew != 0.0, np.arange(len(load)), -1))
    return np.where(last >= 0, grew[np.maximum(last, 0)], 0.0).astype(np.int64)


@dataclass(frozen=True)
class BranchGap:
    """Difference between readings at decreasing and increasing load, at loads (M,) met on both branches."""

    load: Array
    gap: Array
    sigma: Array


def branch_gap(load: ArrayLike, reading: ArrayLike, sigma: float) -> BranchGap:
    """Return the gap between the branches, positive away from zero; equal loads of a branch are averaged.

    It includes drift, unless that was removed first.
    """
    load, reading = np.asarray(load, float), np.asarray(reading, float)
    is_observed = np.isfinite(reading)
    levels, at = np.unique(load, return_inverse=True)
    branch = branches(load)
    means, counts = [], []
    for side in (-1, 1):
        count = np.bincount(at, is_observed & (branch == side), minlength=len(levels))
        total = np.bincount(at, np.where(is_observed & (branch == side), reading, 0.0), minlength=len(levels))
        means.append(total / np.maximum(count, 1.0))
        counts.append(count)
    met = (counts[0] > 0.0) & (counts[1] > 0.0) & (levels != 0.0)
    spread = sigma * np.sqrt(1.0 / np.maximum(counts[0], 1.0) + 1.0 / np.maximum(counts[1], 1.0))
    return BranchGap(levels[met], (np.sign(levels) * (means[0] - means[1]))[met], spread[met])


def widest_gaps(load: Array, run: Index, reading: Array, sigma: Array) -> dict[tuple[int, int], tuple[float, float]]:
    """Return the widest mean gap and its p-value by axis of load and channel, over the runs that load this axis alone.

    load, reading and sigma (B, 6), SI, NaN if missing; run (B,) counts from 0.
    """
    loaded = np.stack([np.any(load[run == r] != 0.0, axis=0) for r in range(int(run.max(initial=-1)) + 1)])
    result = {}
    for axis in range(load.shape[1]):
        alone = [run == r for r in np.flatnonzero(loaded[:, axis] & (loaded.sum(1) == 1))]
        for k in range(reading.shape[1]):
            gaps = [_gap_of_run(load[rows, axis], reading[rows, k], sigma[rows, k]) for rows in alone]
            if met := [gap for gap in gaps if len(gap.load)]:
                result[axis, k] = _widest(met)
    return result


def _gap_of_run(load: Array, reading: Array, sigma: Array) -> BranchGap:
    is_observed = np.isfinite(reading)
    return branch_gap(load, reading, float(np.sqrt(np.mean(sigma[is_observed] ** 2))) if is_observed.any() else 1.0)


def _widest(met: Sequence[BranchGap]) -> tuple[float, float]:
    from scipy.special import chdtrc

    load, gap, sigma = (np.concatenate([getattr(curve, name) for curve in met]) for name in ("load", "gap", "sigma"))
    _, at = np.unique(load, return_inverse=True)
    mean = np.bincount(at, gap / sigma**2) / np.bincount(at, sigma**-2.0)
    return float(mean[np.argmax(np.abs(mean))]), float(chdtrc(len(gap), np.sum((gap / sigma) ** 2)))
