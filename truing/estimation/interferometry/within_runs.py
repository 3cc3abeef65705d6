"""Least squares of readings whose runs have a zero and a drift each: these are taken out run by run, not solved for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

_OPEN = 1e-9  # share of the largest eigenvalue that is no zero
_LOST = 1e-6


@dataclass(frozen=True)
class RunFrame:
    """Rows (N,) of runs that follow each other: where each run starts (R,), and how far along it each row is (N,),
    from -1/2 to 1/2 in time."""

    starts: Index
    run: Index
    way: Array

    def sums(self, values: Array) -> Array:
        """Sums over each run (R, ...) of values (N, ...)."""
        return np.add.reduceat(values, self.starts, axis=0)


@dataclass(frozen=True)
class WithinRuns:
    """Residuals (N,), their freedom, and each run's drift (R,) over its duration with its standard deviation, which is
    infinite where it cannot be told from what all runs share; NaN where a run has no duration."""

    residual: Array
    dof: int
    drift: Array
    drift_sigma: Array


def run_frame(run: Index, time_s: Array) -> RunFrame:
    """The frame of rows whose run (N,) counts up from 0, in the order of time."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(run)) + 1])
    ends = np.concatenate([starts[1:], [len(run)]]) - 1
    length = (time_s[ends] - time_s[starts])[run]
    way = np.where(length > 0.0, (time_s - time_s[starts][run]) / np.where(length > 0.0, length, 1.0) - 0.5, 0.0)
    return RunFrame(starts, run, way)


def fit_within_runs(frame: RunFrame, shared: Array, reading: Array, noise: Array, kept: Mask) -> WithinRuns:
    """Fit readings (N,) by a zero and a drift of each run and columns (N, P) that all runs share; noise (N,).

    Columns that the others make up are left out of the fit.
    """
    weight = kept / noise**2
    mass = frame.sums(weight)
    middle = frame.sums(weight * frame.way) / np.where(mass > 0.0, mass, 1.0)
    way = frame.way - middle[frame.run]
    spread = frame.sums(weight * way**2)
    moving = spread > _OPEN * np.maximum(mass, np.finfo(float).tiny)
    safe_mass, safe_spread = np.where(mass > 0.0, mass, 1.0), np.where(moving, spread, 1.0)

    def about(values: Array) -> tuple[Array, Array]:
        """Values (N, ...) less their zero and drift in each run, and that drift (R, ...)."""
        tall = (slice(None),) + (None,) * (values.ndim - 1)
        zero = frame.sums(weight[tall] * values) / safe_mass[tall]
        drift = np.where(moving[tall], frame.sums((weight * way)[tall] * values) / safe_spread[tall], 0.0)
        return values - zero[frame.run] - way[tall] * drift[frame.run], drift

    columns, drift_of_columns = about(shared)
    left, drift = about(reading)
    root = np.sqrt(weight)
    size = np.linalg.norm(root[:, None] * shared, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    white = root[:, None] * columns / size
    values, vectors = np.linalg.eigh(white.T @ white)
    good = values > _OPEN * max(float(values.max(initial=0.0)), 1.0)
    inverse = (vectors[:, good] / values[good]) @ vectors[:, good].T
    theta = inverse @ (white.T @ (root * left))
    along = drift_of_columns / size
    variance = 1.0 / safe_spread + np.einsum("rp,pq,rq->r", along, inverse, along)
    lost = np.abs(along @ vectors[:, ~good]).max(axis=1, initial=0.0) > _LOST * np.abs(along).max(initial=0.0)
    sigma = np.where(moving, np.where(lost, np.inf, np.sqrt(variance)), np.nan)
    freedom = int(kept.sum() - good.sum() - np.sum(mass > 0.0) - moving.sum())
    drifts = np.where(moving, drift - along @ theta, np.nan)
    return WithinRuns(left - columns @ (theta / size), freedom, drifts, sigma)
