"""Compliance of a loaded platform: fit to readings, comparison with the simulated one, and uncertainty budget."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from truing.arrays import Array, Index, Mask
from truing.estimation.interferometry.recorded_steps import CHANNELS, LOADS, RecordedSteps
from truing.estimation.matrix_comparison import joint_test
from truing.estimation.response import ResponseFit, birge, fit_response
from truing.estimation.uncertainty_budget import Budget, Source, beyond_declared, budget, linear_estimate

_LARGEST_OPEN_SHARE = 1e-9  # share of an entry along undetermined load directions, above which it is unknown
BY_LOADS = Source("applied loads, as declared", "B")
GEOMETRY = Source("geometry of the beams", "B")


@dataclass(frozen=True)
class Compliance:
    """Compliance matrix K of ``displacement = zero of the run + K wrench``; m/N, rad/N, m/(N m), rad/(N m).

    entries (6, 6) and sigma (6, 6): NaN and infinite if unknown, both zero if the model fixes an entry at zero;
    covariance (36, 36): row by row, zero for unknown or fixed entries; known (6, 6): includes fixed ones. fit:
    underlying response fit.
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
    """Return the compliance from displacements (N, 6), NaN if unknown, under wrenches (N, 6) in N and N m, with
    covariance (N, 6, 6).

    run (N,): index 0 .. G-1 of the zero of each step, free in every run or with zero_covariance (6, 6). A
    single-channel reading is a displacement with five unknown components. beside (N, C): further inputs of all
    components, fitted together with the load, for the matrix model only (``platform_poses.drift_columns``, a
    temperature). Entries that no run determines, or that these inputs imitate, are unknown.
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
    covariance_of_all = np.zeros((36, 36))
    at, of_fit = np.flatnonzero(entries[:, :6].ravel()), np.flatnonzero(entries[fit.free])
    covariance_of_all[np.ix_(at, at)] = fit.covariance[np.ix_(of_fit, of_fit)]
    sigma = np.sqrt(np.diag(covariance_of_all)).reshape(6, 6)
    return Compliance(
        np.where(known, fit.coefficients[:, :6], np.nan), np.where(known, sigma, np.inf), covariance_of_all, known, fit
    )


def _determined(u: Array, is_observed: Mask, run: Index, form: str, free_zero: bool) -> Mask:
    """Return the entries (6, D) that the drives determine: for each component, from the steps in which it was read."""
    weight = is_observed.T.astype(float)  # (6, N)
    moved = np.broadcast_to(u, (len(weight), *u.shape))
    if free_zero:
        member = (run[:, None] == np.arange(int(run.max(initial=-1)) + 1)).astype(float)  # (N, G)
        count = np.maximum(weight @ member, 1.0)
        mean = np.einsum("cn,ng,nd->cgd", weight, member, u) / count[..., None]
        moved = moved - np.einsum("ng,cgd->cnd", member, mean)
    moved = moved * weight[..., None]
    size = np.sqrt(np.sum(moved**2, axis=1))
    touched = size > _LARGEST_OPEN_SHARE * np.max(np.abs(u), axis=0, initial=0.0)
    if form == "linear":
        return np.eye(6, dtype=bool) & touched
    scaled = moved / np.where(touched, size, np.inf)[:, None, :]
    values, vectors = np.linalg.eigh(np.swapaxes(scaled, 1, 2) @ scaled)
    lost = np.einsum("cde,ce->cd", vectors**2, values < _LARGEST_OPEN_SHARE)
    return touched & (lost < np.sqrt(_LARGEST_OPEN_SHARE))


def left_out_runs(
    wrench: ArrayLike, displacement: ArrayLike, variance: ArrayLike, run: Index, form: str = "matrix"
) -> Array:
    """Return displacements (N, 6) minus the prediction from all other runs, each run with its own zero.

    variance (N, 6). NaN without a reading, and where the other runs do not determine an entry that the run's loads
    need.
    """
    u, y, run = np.asarray(wrench, float), np.asarray(displacement, float), np.asarray(run)
    residuals = np.full(y.shape, np.nan)
    for k in range(y.shape[1]):
        rows = np.flatnonzero(np.isfinite(y[:, k]))
        drives = np.array([k]) if form == "linear" else np.arange(u.shape[1])
        residuals[rows, k] = _predict_from_others(
            u[np.ix_(rows, drives)], y[rows, k], np.asarray(variance)[rows, k], run[rows]
        )
    return residuals


def _predict_from_others(u: Array, y: Array, variance: Array, run: Index) -> Array:
    """Return residuals (N,) of each run against the fit to all others; drives (N, D) and responses are relative to
    their run's mean."""
    runs, number = np.unique(run, return_inverse=True)
    member = (number[:, None] == np.arange(len(runs))) / variance[:, None]
    share = member / member.sum(0)
    own_u, own_y = u - (share.T @ u)[number], y - (share.T @ y)[number]
    normal = np.einsum("nr,nd,ne->rde", member, own_u, own_u, optimize=True)
    right = np.einsum("nr,nd,n->rd", member, own_u, own_y, optimize=True)
    normal_of_others, right_of_others = normal.sum(0) - normal, right.sum(0) - right
    size = np.sqrt(np.einsum("dd->d", normal.sum(0)))
    size = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(normal_of_others / np.outer(size, size))
    mask = values > _LARGEST_OPEN_SHARE
    inverse = np.einsum("rde,re,rfe->rdf", vectors, mask / np.where(mask, values, 1.0), vectors)
    entries = np.einsum("rdf,rf->rd", inverse, right_of_others / size) / size
    # load directions of the run that the others do not have
    asked = own_u / size / np.maximum(np.linalg.norm(own_u / size, axis=1, keepdims=True), 1e-300)
    missed = np.einsum("nd,nde->ne", asked, np.where(mask[:, None, :], 0.0, vectors)[number])
    blind = np.zeros(len(runs), bool)
    np.logical_or.at(blind, number, np.sum(missed**2, axis=1) > np.sqrt(_LARGEST_OPEN_SHARE))
    return np.where(blind[number], np.nan, own_y - np.einsum("nd,nd->n", own_u, entries[number]))


@dataclass(frozen=True)
class ComplianceComparison:
    """A measured compliance compared with the simulated one.

    difference (6, 6) and z (6, 6): NaN if unknown or fixed; chi_square and dof of all entries together, p_value of
    their being equal; ratio (6, 6): measured over simulated.
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
    """Return the comparison with a simulated compliance (6, 6), with covariance (36, 36) row by row, or exact."""
    model = np.asarray(simulated, float)
    total = measured.covariance + (0.0 if simulated_covariance is None else np.asarray(simulated_covariance, float))
    assessed = measured.known & measured.fit.free[:, :6]
    difference = np.where(assessed, measured.entries - model, np.nan)
    spread = np.sqrt(np.diag(total)).reshape(6, 6)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.where(assessed & (spread > 0.0), difference / spread, np.nan)
        ratio = np.where(assessed, measured.entries / model, np.nan)
    at = np.flatnonzero(np.isfinite(z))
    test = joint_test(difference.ravel()[at], total[np.ix_(at, at)])
    return ComplianceComparison(difference, z, ratio, test.chi_square, test.dof, test.p_value)


@dataclass(frozen=True)
class Loaded:
    """Readings (B, 6), NaN if missing or excluded, with variance (B, 6), and the number of drifts removed.

    spread (6, 6): standard deviation of the compliance's entries due to the uncertain geometry of beams. by_loads (6,):
    part of the variance due to errors of the loads.
    """

    steps: RecordedSteps
    reading: Array
    variance: Array
    drifts: int
    spread: Array
    by_loads: Array = field(default_factory=lambda: np.zeros(6))

    @property
    def fitted(self) -> Mask:
        """Mask (B,) of steps that models are fitted to."""
        return ~self.steps.held_out

    @property
    def data(self) -> tuple[Array, Array, Array, Index]:
        """Loads (N, 6), readings (N, 6), covariance (N, 6, 6) and runs (N,) of these steps."""
        rows = self.fitted
        covariance = np.where(np.eye(6, dtype=bool), self.variance[rows][:, None, :], 0.0)
        return self.steps.load[rows], self.reading[rows], covariance, self.steps.run[rows]


def fitted_compliance(loaded: Loaded, form: Literal["linear", "matrix"]) -> Compliance:
    """Return the compliance of a model with a free zero in every run."""
    return fit_compliance(*loaded.data, form=form)


def reference_fits(loaded: Loaded, simulated: Array | None) -> dict[str, ResponseFit]:
    """Return the fits of only a zero per run: without any load effect (none), and without the simulated one (6, 6) if
    given.

    Their residuals are the scatter that a model has to explain.
    """
    load, reading, covariance, run = loaded.data
    fits = {"none": fit_response(load, reading, covariance, form="none", group=run)}
    if simulated is not None:
        fits["simulated"] = fit_response(load, reading - load @ simulated.T, covariance, form="none", group=run)
    return fits


@dataclass(frozen=True)
class AcceptedReadings:
    """Accepted readings (B, 6) with sigma, the correction for beam geometry, and its standard deviation; SI."""

    kept: Mask
    sigma: Array
    added: Array
    added_sigma: Array


def geometry_spread(load: Array, added_sigma: Array) -> Array:
    """Return the standard deviation (6, 6) of a compliance's entries due to the uncertain geometry of beams, SI.

    added_sigma (B, 6): of readings under loads (B, 6); it is proportional to the load, so more readings do not reduce
    it.
    """
    squares = np.linalg.lstsq(load**2, added_sigma**2, rcond=None)[0]
    return np.sqrt(np.maximum(squares.T, 0.0))


def with_spread(compliance: Compliance, spread: Array) -> Compliance:
    """Return a compliance with standard deviations of at least a spread (6, 6)."""
    free_spread = np.where(compliance.known & np.isfinite(compliance.sigma) & compliance.fit.free[:, :6], spread, 0.0)
    covariance = compliance.covariance + np.diag(free_spread.ravel() ** 2)
    return replace(compliance, sigma=np.hypot(compliance.sigma, free_spread), covariance=covariance)


def from_own_zero(residual: Array, run: Index) -> Array:
    """Return residuals (N, 6) minus the mean of their run, which no model can predict."""
    left = np.array(residual)
    for number in np.unique(run):
        rows = run == number
        count = np.maximum(np.isfinite(left[rows]).sum(0), 1)
        left[rows] -= np.nansum(left[rows], axis=0) / count
    return left


def r_squared(nothing: ResponseFit, fit: ResponseFit, k: int) -> float:
    """Return the share of one component's variation about its zero per run that the loads explain."""
    before, after = nothing.residuals[:, k], fit.residuals[:, k]
    total = float(np.nansum(before**2))
    return float(1.0 - np.nansum(after**2) / total) if total > 0.0 else float("nan")


def compliance_budgets(loaded: Loaded, declared: bool) -> list[Budget] | None:
    """Return the uncertainty budget of the entries (6,) of each of the six components; None if readings do not
    determine all.

    declared: whether the noise of readings was declared, not estimated from their scatter. In the model every load may
    act on every component. Raises LinAlgError if a component is not determined by its own readings.
    """
    compliance = fitted_compliance(loaded, "matrix")
    if not compliance.known.all():
        return None
    ratio, dof = birge(compliance.fit), float(compliance.fit.dof)
    readings = Source("noise of the readings", "B") if declared else Source("noise of the readings", "A", dof)
    beyond = Source("scatter of the readings beyond that", "A", dof)
    rows = loaded.fitted
    budgets = []
    for k in range(len(CHANNELS)):
        mask = rows & np.isfinite(loaded.reading[:, k])
        run = np.unique(loaded.steps.run[mask], return_inverse=True)[1]
        columns = np.concatenate([loaded.steps.load[mask], np.eye(run.max() + 1)[run]], 1)
        loads = np.full(mask.sum(), loaded.by_loads[k])
        noise = {readings: loaded.variance[mask, k] - loads, BY_LOADS: loads}
        sized = {source: ratio**2 * variance[:, None, None] for source, variance in noise.items()}
        parts = linear_estimate(columns[:, None], sized)
        total = np.zeros_like(parts[readings])
        for source in noise if ratio > 1.0 else ():
            split = beyond_declared({source: parts[source]}, source, ratio, beyond)
            parts[source], total = split[source], total + split[beyond]
        budgets.append(budget({**parts, beyond: total}, np.eye(len(LOADS), columns.shape[1])))
    return budgets


def budget_of_entries(budgets: list[Budget], loaded: Loaded, entries: list[tuple[int, int]]) -> Budget:
    """Return the joint budget of some entries (response, load), including the part of beam geometry."""
    sources = tuple(dict.fromkeys(source for budget in budgets for source in budget.sources))
    table = np.zeros((len(sources), len(entries)))
    for n, (i, j) in enumerate(entries):
        for source, contribution in zip(budgets[i].sources, budgets[i].contributions, strict=True):
            table[sources.index(source), n] = contribution[j]
    return Budget(sources, table).with_source(GEOMETRY, np.array([loaded.spread[entry] for entry in entries])).filled()
