"""Readings under load, ready for a compliance to be fitted: gross errors and drifts taken out."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.compliance import (
    Compliance,
    fit_compliance,
)
from truing.estimation.interferometry.recorded_steps import RecordedSteps
from truing.estimation.response import ResponseFit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Loaded:
    """Readings (B, 6), NaN where there is none or it was kept out; variance (B, 6); drifts taken out of how many.

    spread (6, 6): one sigma of the compliance's entries that the geometry of beams leaves open. by_loads (6,): the part
    of the variance that stems from errors of the loads.
    """

    steps: RecordedSteps
    reading: Array
    variance: Array
    drifts: int
    spread: Array
    by_loads: Array = field(default_factory=lambda: np.zeros(6))

    @property
    def fitted(self) -> NDArray[np.bool_]:
        """Which steps (B,) models may be fitted to."""
        return ~self.steps.held_out


def fitted_compliance(loaded: Loaded, form: str) -> Compliance:
    rows = loaded.fitted
    cov = np.where(np.eye(6, dtype=bool), loaded.variance[rows][:, None, :], 0.0)
    return fit_compliance(
        loaded.steps.load[rows], loaded.reading[rows], cov, loaded.steps.run[rows], form=form  # type: ignore[arg-type]
    )  # fmt: skip


@dataclass(frozen=True)
class KeptReadings:
    """Which readings (B, 6) were not rejected, their sigma; what geometry adds to them, and one sigma of that; SI."""

    kept: NDArray[np.bool_]
    sigma: Array
    added: Array
    added_sigma: Array


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


def from_own_zero(residual: Array, run: NDArray[np.int64]) -> Array:
    """Return residuals (N, 6) less the mean of their own run, which no model can predict."""
    left = np.array(residual)
    for one in np.unique(run):
        rows = run == one
        count = np.maximum(np.isfinite(left[rows]).sum(0), 1)
        left[rows] -= np.nansum(left[rows], axis=0) / count
    return left


def r_squared(nothing: ResponseFit, fit: ResponseFit, k: int) -> float:
    """Return the share of the variation of one component, about its zero per run, that the loads explain."""
    before, after = nothing.residuals[:, k], fit.residuals[:, k]
    total = float(np.nansum(before**2))
    return float(1.0 - np.nansum(after**2) / total) if total > 0.0 else float("nan")
