"""Compliance of a loaded platform from readings: made ready, fitted, held against the simulated one, and its budget."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from truing.arrays import Array, Index, Mask
from truing.estimation.interferometry.recorded_steps import CHANNELS, LOADS, RecordedSteps
from truing.estimation.response import ResponseFit, birge, fit_response
from truing.estimation.uncertainty_budget import Budget, Source, beyond_declared, budget, linear_estimate

_LOST = 1e-9  # share of an entry in directions that the loads leave open, above which it is unknown
BY_LOADS = Source("applied loads, as declared", "B")
GEOMETRY = Source("geometry of the beams", "B")


@dataclass(frozen=True)
class Compliance:
    """K of ``displacement = zero of the run + K wrench``; m/N, rad/N, m/(N m), rad/(N m).

    entries (6, 6) and sigma (6, 6): NaN and infinite where unknown, zero and zero where the model holds an entry at
    zero; covariance (36, 36) row by row, zero beside what is unknown or held; known (6, 6), also where held. fit: the
    response fit that it comes from.
    """

    entries: Array
    sigma: Array
    covariance: Array
    known: Mask
    fit: ResponseFit


def fit_compliance(
    wrench: ArrayLike,
    displacement: ArrayLike,
    covariance: ArrayLike,
    run: Index,
    *,
    form: Literal["linear", "matrix"] = "matrix",
    zero_covariance: Array | None = None,
    beside: Array | None = None,
) -> Compliance:
    """Fit displacements (N, 6), NaN where unknown, of wrenches (N, 6) in N and N m; covariance (N, 6, 6).

    run (N,): which zero 0 .. G-1 a step counts from, free in every run or of zero_covariance (6, 6). A channel that was
    read alone is a displacement with five unknown components. beside (N, C), for the matrix alone: what every component
    may follow beside the load (``platform_poses.drift_columns``, a temperature), fitted with it. Entries that
    no run tells, or not from what is beside, are unknown.
    """
    u, y = np.asarray(wrench, float), np.asarray(displacement, float)
    if beside is not None:
        if form != "matrix":
            raise ValueError(f"beside: found the {form} model, expected the matrix model")
        u = np.column_stack([u, np.asarray(beside, float)])
    fit = fit_response(u, y, np.asarray(covariance, float), form=form, offset_cov=zero_covariance, group=run)
    determined = _determined(u, np.isfinite(y), run, form, zero_covariance is None)[:, :6]
    by_load = fit.free[:, :6]
    known = determined | ~by_load
    entries = np.zeros(fit.free.shape, bool)
    entries[:, :6] = determined & by_load
    whole = np.zeros((36, 36))
    at, of_fit = np.flatnonzero(entries[:, :6].ravel()), np.flatnonzero(entries[fit.free])
    whole[np.ix_(at, at)] = fit.covariance[np.ix_(of_fit, of_fit)]
    sigma = np.sqrt(np.diag(whole)).reshape(6, 6)
    return Compliance(
        np.where(known, fit.coefficients[:, :6], np.nan), np.where(known, sigma, np.inf), whole, known, fit
    )


def _determined(u: Array, seen: Mask, run: Index, form: str, free_zero: bool) -> Mask:
    """Which entries (6, D) the drives determine: of each component, by the steps in which it was seen."""
    weight = seen.T.astype(float)  # (6, N)
    moved = np.broadcast_to(u, (len(weight), *u.shape))
    if free_zero:
        member = (run[:, None] == np.arange(int(run.max(initial=-1)) + 1)).astype(float)  # (N, G)
        count = np.maximum(weight @ member, 1.0)
        mean = np.einsum("cn,ng,nd->cgd", weight, member, u) / count[..., None]
        moved = moved - np.einsum("ng,cgd->cnd", member, mean)
    moved = moved * weight[..., None]
    size = np.sqrt(np.sum(moved**2, axis=1))
    touched = size > _LOST * np.max(np.abs(u), axis=0, initial=0.0)
    if form == "linear":
        return np.eye(6, dtype=bool) & touched
    scaled = moved / np.where(touched, size, np.inf)[:, None, :]
    values, vectors = np.linalg.eigh(np.swapaxes(scaled, 1, 2) @ scaled)
    lost = np.einsum("cde,ce->cd", vectors**2, values < _LOST)
    return touched & (lost < np.sqrt(_LOST))


def left_out_runs(
    wrench: ArrayLike, displacement: ArrayLike, variance: ArrayLike, run: Index, form: str = "matrix"
) -> Array:
    """Return displacements (N, 6) less what all other runs predict, each run from a zero of its own.

    variance (N, 6). NaN where nothing was read, and where the other runs do not tell an entry that the run's loads ask
    for: such a run alone says what it says.
    """
    u, y, run = np.asarray(wrench, float), np.asarray(displacement, float), np.asarray(run)
    found = np.full(y.shape, np.nan)
    for k in range(y.shape[1]):
        rows = np.flatnonzero(np.isfinite(y[:, k]))
        drives = np.array([k]) if form == "linear" else np.arange(u.shape[1])
        found[rows, k] = _by_others(u[np.ix_(rows, drives)], y[rows, k], np.asarray(variance)[rows, k], run[rows])
    return found


def _by_others(u: Array, y: Array, variance: Array, run: Index) -> Array:
    """Residuals (N,) of each run against the fit to all others, drives (N, D) and responses less their run's mean."""
    runs, number = np.unique(run, return_inverse=True)
    member = (number[:, None] == np.arange(len(runs))) / variance[:, None]
    share = member / member.sum(0)
    own_u, own_y = u - (share.T @ u)[number], y - (share.T @ y)[number]
    normal = np.einsum("nr,nd,ne->rde", member, own_u, own_u, optimize=True)
    right = np.einsum("nr,nd,n->rd", member, own_u, own_y, optimize=True)
    rest, target = normal.sum(0) - normal, right.sum(0) - right
    size = np.sqrt(np.einsum("dd->d", normal.sum(0)))
    size = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(rest / np.outer(size, size))
    kept = values > _LOST
    inverse = np.einsum("rde,re,rfe->rdf", vectors, kept / np.where(kept, values, 1.0), vectors)
    entries = np.einsum("rdf,rf->rd", inverse, target / size) / size
    # what a run's loads ask for beyond the directions that the others have
    asked = own_u / size / np.maximum(np.linalg.norm(own_u / size, axis=1, keepdims=True), 1e-300)
    missed = np.einsum("nd,nde->ne", asked, np.where(kept[:, None, :], 0.0, vectors)[number])
    blind = np.zeros(len(runs), bool)
    np.logical_or.at(blind, number, np.sum(missed**2, axis=1) > np.sqrt(_LOST))
    return np.where(blind[number], np.nan, own_y - np.einsum("nd,nd->n", own_u, entries[number]))


@dataclass(frozen=True)
class ComplianceComparison:
    """A measured compliance less the simulated one.

    difference (6, 6) and z (6, 6), NaN where unknown or held; chi_square and dof of all entries together, p_value of
    the two being the same; ratio (6, 6) measured over simulated.
    """

    difference: Array
    z: Array
    ratio: Array
    chi_square: float
    dof: int
    p_value: float


def compare(
    measured: Compliance, simulated: ArrayLike, simulated_covariance: ArrayLike | None = None
) -> ComplianceComparison:
    """Compare entry by entry with a simulated compliance (6, 6), its covariance (36, 36) row by row, or none of it."""
    from scipy.special import chdtrc

    model = np.asarray(simulated, float)
    total = measured.covariance + (0.0 if simulated_covariance is None else np.asarray(simulated_covariance, float))
    assessed = measured.known & measured.fit.free[:, :6]
    difference = np.where(assessed, measured.entries - model, np.nan)
    spread = np.sqrt(np.diag(total)).reshape(6, 6)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.where(assessed & (spread > 0.0), difference / spread, np.nan)
        ratio = np.where(assessed, measured.entries / model, np.nan)
    at = np.flatnonzero(np.isfinite(z))
    scale = spread.ravel()[at]
    correlation = total[np.ix_(at, at)] / np.outer(scale, scale)
    standard = z.ravel()[at]
    chi_square = float(standard @ np.linalg.pinv(correlation, hermitian=True, rcond=1e-12) @ standard)
    rank = int(np.linalg.matrix_rank(correlation, hermitian=True, tol=1e-12 * max(len(at), 1))) if len(at) else 0
    return ComplianceComparison(
        difference, z, ratio, chi_square, rank, float(chdtrc(rank, chi_square)) if rank else float("nan")
    )


@dataclass(frozen=True)
class AxisCurve:
    """What a figure of load against displacement along the same axis needs, step by step (M,).

    load in N or N m; measured, its sigma, and simulated with its sigma in m or rad, from the zero of the run; branch
    as ``load_run.branches`` has it. Not a number where the component was not measured.
    """

    load: Array
    measured: Array
    sigma: Array
    simulated: Array
    simulated_sigma: Array

    @property
    def largest(self) -> float:
        """The measured value farthest on the positive side; NaN where none was measured."""
        return float(np.max(self.measured, where=np.isfinite(self.measured), initial=-np.inf))

    @property
    def smallest(self) -> float:
        """The measured value farthest on the negative side."""
        return float(np.min(self.measured, where=np.isfinite(self.measured), initial=np.inf))


def axis_curve(
    axis: int,
    wrench: ArrayLike,
    displacement: ArrayLike,
    covariance: ArrayLike,
    simulated: ArrayLike,
    simulated_covariance: ArrayLike | None = None,
) -> AxisCurve:
    """Return the curve of one axis (0 .. 5) over the steps whose load is along that axis alone, or none.

    Arguments as ``fit_compliance`` and ``compare`` take them.
    """
    u, y, cov = np.asarray(wrench, float), np.asarray(displacement, float), np.asarray(covariance, float)
    alone = (np.delete(u, axis, axis=1) == 0.0).all(1) & np.isfinite(y[:, axis])
    u = u[alone]
    entry = 7 * axis
    spread = 0.0 if simulated_covariance is None else float(np.sqrt(np.asarray(simulated_covariance)[entry, entry]))
    model = float(np.asarray(simulated, float)[axis, axis])
    return AxisCurve(
        u[:, axis], y[alone, axis], np.sqrt(cov[alone, axis, axis]), model * u[:, axis], spread * np.abs(u[:, axis])
    )


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
    def fitted(self) -> Mask:
        """Which steps (B,) models may be fitted to."""
        return ~self.steps.held_out

    @property
    def data(self) -> tuple[Array, Array, Array, Index]:
        """Loads (N, 6), readings (N, 6), their covariance (N, 6, 6) and runs (N,) of these steps."""
        rows = self.fitted
        covariance = np.where(np.eye(6, dtype=bool), self.variance[rows][:, None, :], 0.0)
        return self.steps.load[rows], self.reading[rows], covariance, self.steps.run[rows]


def fitted_compliance(loaded: Loaded, form: Literal["linear", "matrix"]) -> Compliance:
    """The compliance of a model, its zeros free in every run."""
    return fit_compliance(*loaded.data, form=form)


def reference_fits(loaded: Loaded, simulated: Array | None) -> dict[str, ResponseFit]:
    """What readings scatter without any load's effect (none), and without the simulated one (6, 6) where there is one:
    a zero for every run is all that is fitted."""
    load, reading, covariance, run = loaded.data
    fits = {"none": fit_response(load, reading, covariance, form="none", group=run)}
    if simulated is not None:
        fits["simulated"] = fit_response(load, reading - load @ simulated.T, covariance, form="none", group=run)
    return fits


@dataclass(frozen=True)
class AcceptedReadings:
    """Which readings (B, 6) were not rejected, their sigma; what geometry adds to them, and one sigma of that; SI."""

    kept: Mask
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


def from_own_zero(residual: Array, run: Index) -> Array:
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


def compliance_budgets(loaded: Loaded, declared: bool) -> list[Budget] | None:
    """Return the budget of the entries (6,) of each of the six components; None where the readings leave some open.

    declared: whether the noise of readings was declared, and not found from their scatter. By the model in which every
    load may act on every component. Raises LinAlgError where a component is not determined by its own readings.
    """
    one = fitted_compliance(loaded, "matrix")
    if not one.known.all():
        return None
    ratio, dof = birge(one.fit), float(one.fit.dof)
    readings = Source("noise of the readings", "B") if declared else Source("noise of the readings", "A", dof)
    beyond = Source("scatter of the readings beyond that", "A", dof)
    rows = loaded.fitted
    found = []
    for k in range(len(CHANNELS)):
        own = rows & np.isfinite(loaded.reading[:, k])
        run = np.unique(loaded.steps.run[own], return_inverse=True)[1]
        columns = np.concatenate([loaded.steps.load[own], np.eye(run.max() + 1)[run]], 1)
        loads = np.full(own.sum(), loaded.by_loads[k])
        noise = {readings: loaded.variance[own, k] - loads, BY_LOADS: loads}
        sized = {source: ratio**2 * variance[:, None, None] for source, variance in noise.items()}
        parts = linear_estimate(columns[:, None], sized)
        total = np.zeros_like(parts[readings])
        for source in noise if ratio > 1.0 else ():
            split = beyond_declared({source: parts[source]}, source, ratio, beyond)
            parts[source], total = split[source], total + split[beyond]
        found.append(budget({**parts, beyond: total}, np.eye(len(LOADS), columns.shape[1])))
    return found


def budget_of_entries(found: list[Budget], loaded: Loaded, places: list[tuple[int, int]]) -> Budget:
    """Return the budgets of some entries (response, load) together, the geometry's part with them."""
    sources = tuple(dict.fromkeys(source for one in found for source in one.sources))
    table = np.zeros((len(sources), len(places)))
    for n, (i, j) in enumerate(places):
        for source, own in zip(found[i].sources, found[i].contributions, strict=True):
            table[sources.index(source), n] = own[j]
    return Budget(sources, table).with_source(GEOMETRY, np.array([loaded.spread[place] for place in places])).filled()
