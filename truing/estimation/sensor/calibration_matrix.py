"""The calibration matrix G_B of a fit in either direction: wrenches by it, its figures of merit, and its budget.

Force-sensor paper, section 6.2: eq. 33-37, Tables 4 and 5; every figure with the uncertainty that the matrix gives it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.estimation.covariance import symmetric
from truing.estimation.sensor.calibration import Calibration
from truing.estimation.sensor.load_table import LoadTable, Recorded
from truing.estimation.uncertainty_budget import Source, linear_estimate

_ROUNDS, _SETTLED = 30, 1e-10
STANDARD_GRAVITY = 9.80665  # m/s^2
Array = NDArray[np.float64]
BY_LOADS = Source("applied loads, as declared", "B")
_BY_CHANCE = 0.01


@dataclass(frozen=True)
class MatrixEstimate:
    """A matrix (W, C) and the covariance (W C, W C) of its entries, row by row."""

    value: NDArray
    covariance: NDArray

    @property
    def sigma(self) -> NDArray:
        """Return the standard deviation (W, C) of every entry."""
        return np.sqrt(np.diag(self.covariance)).reshape(self.value.shape)


def calibration_matrix(fit: Calibration, signal_cov: NDArray | None = None) -> MatrixEstimate:
    """Return G_B (W, C), N or N m per unit of signal, of the terms in signals or loads alone.

    A forward fit V = A F is inverted with the least noise, ``G = (A^T S^-1 A)^-1 A^T S^-1``, S = signal_cov (C, C), by
    default the fit's own noise; its error follows by ``dG = -G dA G + (A^T S^-1 A)^-1 dA^T S^-1 (1 - A G)``.
    """
    if fit.model.direction == "direct":
        return _inputs_part(fit)
    sensitivity = _inputs_part(fit)
    A = sensitivity.value
    white = np.linalg.inv(fit.noise if signal_cov is None else signal_cov)
    spread = np.linalg.inv(A.T @ white @ A)
    G = spread @ A.T @ white
    rest = white @ (np.eye(len(A)) - A @ G)
    # by dA[c, w]: -G[:, c] G[w, :] + spread[:, w] rest[c, :]
    change = -np.einsum("ic,wj->ijcw", G, G) + np.einsum("iw,cj->ijcw", spread, rest)
    change = change.reshape(G.size, A.size)
    return MatrixEstimate(G, symmetric(change @ sensitivity.covariance @ change.T))


def _inputs_part(fit: Calibration) -> MatrixEstimate:
    """Return the coefficients of the inputs themselves."""
    width, count = len(fit.matrix), len(fit.terms.inputs)
    blocks = fit.covariance.reshape(width, -1, width, fit.covariance.shape[0] // width)
    part = blocks[:, :count, :, :count].reshape(width * count, -1)
    return MatrixEstimate(fit.matrix[:, :count], part)


@dataclass(frozen=True)
class Wrenches:
    """Wrenches (N, W) told by signals, and what their errors come from.

    own (N, W, W): covariance by the signals' errors, independent from row to row. gain (N, W, R): how an error of the
    fitted response moves a wrench; columns (N, Q) and coefficients (R Q, R Q): that of the calibration itself.
    """

    value: NDArray
    own: NDArray
    gain: NDArray
    columns: NDArray
    coefficients: NDArray

    @property
    def joint(self) -> NDArray:
        """Return the covariance (N, W, N, W) that the calibration's error gives all rows together."""
        by = np.einsum("nwr,nq->nwrq", self.gain, self.columns).reshape(*self.value.shape, -1)
        return np.einsum("nwc,cd,mvd->nwmv", by, self.coefficients, by, optimize=True)

    @property
    def covariance(self) -> NDArray:
        """Return the whole covariance (N, W, W) of each row."""
        responses = self.gain.shape[2]
        blocks = self.coefficients.reshape(responses, self.columns.shape[1], responses, -1)
        of_response = np.einsum("np,ipjq,nq->nij", self.columns, blocks, self.columns, optimize=True)
        return self.own + self.gain @ of_response @ np.swapaxes(self.gain, 1, 2)


class UnreachedSignalsError(ValueError):
    """Signals that a calibration from loads to signals gives at no load."""


def wrenches(fit: Calibration, signals: NDArray, covariates: NDArray, signal_cov: NDArray) -> Wrenches:
    """Return the wrenches that signals (N, C) with errors of covariance signal_cov (C, C) tell.

    A forward fit is inverted by Gauss-Newton steps from zero load; raises UnreachedSignalsError where they do not
    settle.
    """
    if fit.model.direction == "forward":
        return _inverted(fit, signals, covariates, signal_cov)
    slope = fit.matrix @ fit.terms.by_inputs(signals, covariates)
    value = fit.predict(signals, covariates)
    gain = np.broadcast_to(np.eye(value.shape[1]), (*value.shape, value.shape[1]))
    own = slope @ signal_cov @ np.swapaxes(slope, 1, 2)
    return Wrenches(value, own, gain, fit.columns(signals, covariates), fit.covariance)


def _inverted(fit: Calibration, signals: NDArray, covariates: NDArray, signal_cov: NDArray) -> Wrenches:
    white = np.linalg.inv(signal_cov)
    loads = np.zeros((len(signals), len(fit.terms.inputs)))
    for _ in range(_ROUNDS):
        slope = fit.matrix @ fit.terms.by_inputs(loads, covariates)
        weighted = np.swapaxes(slope, 1, 2) @ white
        gain = np.linalg.solve(weighted @ slope, weighted)
        step = np.einsum("nwc,nc->nw", gain, signals - fit.predict(loads, covariates))
        loads = loads + step
        if np.all(np.abs(step) <= _SETTLED * np.abs(loads).max(initial=0.0)):
            break
    else:
        raise UnreachedSignalsError(f"found signals that no load gives, inverting {fit.model.name!r}")
    own = gain @ signal_cov @ np.swapaxes(gain, 1, 2)
    return Wrenches(loads, own, gain, fit.columns(loads, covariates), fit.covariance)


@dataclass(frozen=True)
class Figures:
    """Figures (K,) with their standard deviations (K,)."""

    value: NDArray
    sigma: NDArray


def newton_per_millivolt(
    capacity_kg: float, sensitivity_mv_per_v: float, supply_v: float, gravity: float = STANDARD_GRAVITY
) -> float:
    """Return the load that changes a cell's output by 1 mV: 980 N with the paper's 2 t, 2 mV/V, 10 V and g = 9.8."""
    return capacity_kg * gravity / (sensitivity_mv_per_v * supply_v)


def leg_force_matrix(
    matrix: MatrixEstimate, newton_per_mv: ArrayLike, amplification: float, relative_sigma: float = 0.0
) -> MatrixEstimate:
    """Return G_B' = (k / c) G_B, from leg forces (N) to the wrench (eq. 33, 34).

    newton_per_mv: c, one for all cells or of each; amplification: k. relative_sigma: of one cell's sensitivity,
    independent from cell to cell (the paper's 2.0 +- 0.01 mV/V), which scales its column.
    """
    factor = np.broadcast_to(amplification / np.asarray(newton_per_mv, float), matrix.value.shape)
    value = factor * matrix.value
    rows, cells = value.shape
    own = relative_sigma**2 * np.einsum("ic,jd,cd->icjd", value, value, np.eye(cells)).reshape(rows * cells, -1)
    return MatrixEstimate(value, np.outer(factor, factor) * matrix.covariance + own)


def condition_number(matrix: MatrixEstimate) -> Figures:
    """Return the 2-norm condition number (eq. 35), its uncertainty to first order."""
    U, s, Vt = np.linalg.svd(matrix.value)
    ratio = s[0] / s[-1]
    last = len(s) - 1
    change = ratio * (np.outer(U[:, 0], Vt[0]) / s[0] - np.outer(U[:, last], Vt[last]) / s[-1])
    return _propagated(np.array([ratio]), change.reshape(1, -1), matrix)


def sensitivities(matrix: MatrixEstimate) -> Figures:
    """Return the column norms (W,) of J = G^-1 of a square G (eq. 36, 37): 1 for forces, 1/m for torques."""
    J = np.linalg.inv(matrix.value)
    norm = np.linalg.norm(J, axis=0)
    # J_j changes by -J dG J_j, so |J_j| by -(J^T J_j)_a dG_ab J_bj / |J_j|
    change = -np.einsum("aj,bj->jab", J.T @ J, J) / norm[:, None, None]
    return _propagated(norm, change.reshape(len(norm), -1), matrix)


def per_length(matrix: MatrixEstimate, length_m: float) -> MatrixEstimate:
    """Return a matrix whose rows are three forces and three moments, the moments over a characteristic length."""
    scale = np.repeat([1.0, 1.0 / length_m], 3)[:, None]
    spread = np.broadcast_to(scale, matrix.value.shape)
    return MatrixEstimate(scale * matrix.value, np.outer(spread, spread) * matrix.covariance)


def relative_errors(theory: NDArray, measured: Figures) -> Figures:
    """Return |theory - measured| / measured (K,): the paper's Type 1 error with J' as theory, Type 2 with J."""
    value = np.abs(theory - measured.value) / measured.value
    return Figures(value, np.abs(theory) / measured.value**2 * measured.sigma)


def _propagated(value: NDArray, change: NDArray, matrix: MatrixEstimate) -> Figures:
    cov = symmetric(change @ matrix.covariance @ change.T)
    return Figures(value, np.sqrt(np.diag(cov)))


@dataclass(frozen=True)
class LegMatrix:
    """G_B': what leg forces, told by the signals' stated sensitivity, make of a wrench; and the model it is from."""

    model: str
    estimate: MatrixEstimate


@dataclass(frozen=True)
class Calibrated:
    """The chosen calibration, its table, and the covariance of its coefficients by source; and from case to case."""

    found: Recorded
    table: LoadTable
    fit: Calibration
    parts: dict[Source, Array]
    by_case: MatrixEstimate
    signals: Source

    @property
    def cases(self) -> Source:
        """What one load case differs by from another, beyond the noise."""
        return Source("differences between load cases beyond that", "A", float(len(self.table.cases) - 1))

    def beyond_chance(self, by_case: Array, told: Array) -> Array:
        """Standard uncertainties (N,) that load cases show beyond what the budget has; zero within chance."""
        from scipy.special import chdtri

        freedom = len(self.table.cases) - 1
        limit = chdtri(freedom, _BY_CHANCE / len(told)) / freedom if freedom > 0 else np.inf
        return np.sqrt(np.where(by_case > limit * told, by_case - told, 0.0))


def coefficient_parts(fit: Calibration, table: LoadTable, signals: Source) -> dict[Source, Array]:
    """Return the covariance of all coefficients, row by row, that each source gives; signals: the source of their
    noise."""
    from scipy.special import chdtrc

    model, direct = fit.model, fit.model.direction == "direct"
    dof = fit.dof * (1.0 if model.estimator == "least squares" else 1.0 / len(fit.matrix))
    if model.estimator == "least squares" or model.ridge is not None or model.shrink is not None:
        return {Source("scatter of the loads about the calibration", "A", max(dof, 1.0)): fit.covariance}
    x, own = (table.signals, table.load_cov) if direct else (table.loads, table.signal_cov)
    columns = fit.columns(x, table.covariates)
    of_own, of_other = (BY_LOADS, signals) if direct else (signals, BY_LOADS)
    if model.estimator == "weighted":
        parts = {of_own: fit.covariance}
        other = table.load_cov if not direct else None  # what a direct fit's signals err by is in none of its weights
        if other is not None and np.any(other):
            slope = fit.matrix[:, : len(fit.terms.inputs)]
            parts[of_other] = np.kron(slope @ other @ slope.T, np.linalg.inv(columns.T @ columns))
    else:
        slope = fit.matrix @ fit.terms.by_inputs(x, table.covariates)
        other = table.signal_cov if direct else table.load_cov
        assert own is not None, "errors in both need a covariance of either"
        assert other is not None
        jacobian = np.einsum("wi,nq->nwiq", np.eye(len(fit.matrix)), columns).reshape(len(x), len(fit.matrix), -1)
        rows = np.zeros((len(x), 1, 1))
        parts = linear_estimate(jacobian, {of_own: rows + own, of_other: slope @ other @ np.swapaxes(slope, 1, 2)})
        whole = sum(parts.values(), np.zeros(()))
        size = np.sqrt(np.diag(fit.covariance) / np.diag(whole))  # the fit settles deviations, and is linear there
        parts = {source: part * np.outer(size, size) for source, part in parts.items()}
    if fit.dof > 0 and chdtrc(fit.dof, fit.chi_square) < _BY_CHANCE:
        beyond = Source("scatter of the calibration beyond that", "A", fit.dof)
        parts[beyond] = (fit.noise_ratio**2 - 1.0) * sum(parts.values(), np.zeros(()))
    return parts


def matrix_parts(made: Calibrated) -> dict[Source, Array]:
    """Return the covariance of the entries of G_B, row by row, that each source gives."""
    return {
        source: calibration_matrix(replace(made.fit, covariance=part), made.table.signal_cov).covariance
        for source, part in made.parts.items()
    }
