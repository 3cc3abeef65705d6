"""Calibration of a sensor: terms, estimators, matrix G_B in both directions, wrenches, and figures of merit.

``direct`` writes loads as terms of the signals, F = G_B V, as printed in the force-sensor paper (section 6.2).
``forward`` writes signals as terms of the loads, V = A F, which is what the sensor does, and inverts that. With as many
channels as loads and errors in both, the results are the same. With more channels than loads, only the second one is
determined in signal directions that no load reaches.

Force-sensor paper, section 6.2: eq. 33-37, Tables 4 and 5; every figure has the uncertainty that follows from the
matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.estimation.covariance import symmetric
from truing.estimation.least_squares.solver import SolverStatus

Powers = Literal["linear", "squares", "products"]
Estimator = Literal["least squares", "weighted", "errors in both"]
Direction = Literal["direct", "forward"]
Zero = Literal["none", "common", "case"]
_ROUNDS, _SETTLED = 30, 1e-10
STANDARD_GRAVITY = 9.80665  # m/s^2


@dataclass(frozen=True)
class Terms:
    """Terms in C inputs x and K covariates z: always x; z itself (``drift``), z x (``gain``), and powers of x.

    ``squares`` adds every x_c^2, ``products`` also every x_c x_d. The zero is not a term: see `CalibrationModel`.
    """

    inputs: tuple[str, ...]
    covariates: tuple[str, ...] = ()
    drift: bool = False
    gain: bool = False
    powers: Powers = "linear"

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the terms (P,)."""
        names = list(self.inputs)
        names += list(self.covariates) if self.drift else []
        names += [f"{z} {x}" for z in self.covariates for x in self.inputs] if self.gain else []
        first, second = self._pairs
        return (*names, *(_power(self.inputs[i], self.inputs[j]) for i, j in zip(first, second, strict=True)))

    @property
    def _pairs(self) -> tuple[NDArray, NDArray]:
        count = len(self.inputs)
        if self.powers == "products":
            return np.triu_indices(count)
        every = np.arange(count if self.powers == "squares" else 0)
        return every, every

    def at(self, x: NDArray, z: NDArray) -> NDArray:
        """Return the terms (N, P) at inputs (N, C) and covariates (N, K)."""
        first, second = self._pairs
        parts = [x]
        parts += [z] if self.drift else []
        parts += [(z[:, :, None] * x[:, None]).reshape(len(x), -1)] if self.gain else []
        return np.concatenate([*parts, x[:, first] * x[:, second]], axis=1)

    def by_inputs(self, x: NDArray, z: NDArray) -> NDArray:
        """Return the derivatives (N, P, C) of the terms by the inputs."""
        count = len(self.inputs)
        eye, (first, second) = np.eye(count), self._pairs
        parts = [np.broadcast_to(eye, (len(x), count, count))]
        parts += [np.zeros((len(x), z.shape[1], count))] if self.drift else []
        parts += [(z[:, :, None, None] * eye).reshape(len(x), -1, count)] if self.gain else []
        powers = x[:, first, None] * eye[second] + x[:, second, None] * eye[first]
        return np.concatenate([*parts, powers], axis=1)


def _power(first: str, second: str) -> str:
    return f"{first}^2" if first == second else f"{first} {second}"


@dataclass(frozen=True)
class CalibrationModel:
    """Terms, zeros, estimator and prior of a calibration.

    zero: none, one for all rows, or one for every load case. ridge, shrink: prior standard deviation of the
    contribution of an input itself, and of any other term, as a share of the response's rms; None for no prior.
    """

    estimator: Estimator = "least squares"
    direction: Direction = "direct"
    zero: Zero = "none"
    drift: bool = False
    gain: bool = False
    powers: Powers = "linear"
    ridge: float | None = None
    shrink: float | None = None

    @property
    def name(self) -> str:
        """The model in words."""
        parts = [self.estimator, self.direction, f"zero {self.zero}", self.powers]
        parts += [word for word, used in (("drift", self.drift), ("gain", self.gain)) if used]
        shares = ("ridge", self.ridge), ("shrink", self.shrink)
        parts += [f"{word} {share:g}" for word, share in shares if share is not None]
        return ", ".join(parts)


@dataclass(frozen=True)
class Calibration:
    """A fitted calibration: response = matrix terms + zeros.

    matrix (W, P); zeros (W, G), G = 0, 1 or one per case in sorted order; covariance (W (P + G), W (P + G)) of
    [matrix, zeros] row by row; residuals (N, W); noise (W, W): estimated covariance of one row's residual; chi_square
    and dof under declared noise (for plain least squares: of the residuals alone).
    """

    model: CalibrationModel
    terms: Terms
    response_names: tuple[str, ...]
    matrix: NDArray
    zeros: NDArray
    covariance: NDArray
    residuals: NDArray
    noise: NDArray
    chi_square: float
    dof: float
    status: SolverStatus = SolverStatus.CONVERGED

    @property
    def sigma(self) -> NDArray:
        """Standard deviation (W, P) of every entry of the matrix."""
        every = np.sqrt(np.diag(self.covariance)).reshape(len(self.matrix), -1)
        return every[:, : self.matrix.shape[1]]

    @property
    def noise_ratio(self) -> float:
        """Observed noise over the declared one; NaN if none was declared."""
        declared = self.model.estimator != "least squares" and self.dof > 0
        return float(np.sqrt(self.chi_square / self.dof)) if declared else float("nan")

    def columns(self, x: NDArray, z: NDArray) -> NDArray:
        """Return the columns (N, P + G) at inputs and covariates; without zeros of single cases."""
        terms = self.terms.at(x, z)
        zero = np.full((len(x), self.zeros.shape[1]), float(self.model.zero == "common"))
        return np.concatenate([terms, zero], axis=1)

    def predict(self, x: NDArray, z: NDArray) -> NDArray:
        """Return the response (N, W) at inputs (N, C), relative to the case's own zero if every case has one."""
        return self.columns(x, z) @ np.concatenate([self.matrix, self.zeros], axis=1).T


@dataclass(frozen=True)
class MatrixEstimate:
    """A matrix (W, C) and the covariance (W C, W C) of its entries, row by row."""

    value: NDArray
    covariance: NDArray

    @property
    def sigma(self) -> NDArray:
        """Standard deviation (W, C) of every entry."""
        return np.sqrt(np.diag(self.covariance)).reshape(self.value.shape)


def calibration_matrix(fit: Calibration, signal_cov: NDArray | None = None) -> MatrixEstimate:
    """Return G_B (W, C), N or N m per unit of signal, of the terms linear in signals or loads.

    A forward fit V = A F is inverted with least noise: ``G = (A^T S^-1 A)^-1 A^T S^-1``. S = signal_cov (C, C), by
    default the fit's own noise. Error propagation: ``dG = -G dA G + (A^T S^-1 A)^-1 dA^T S^-1 (1 - A G)``.
    """
    if fit.model.direction == "direct":
        return _inputs_part(fit)
    sensitivity = _inputs_part(fit)
    A = sensitivity.value
    white = np.linalg.inv(fit.noise if signal_cov is None else signal_cov)
    spread = np.linalg.inv(A.T @ white @ A)
    G = spread @ A.T @ white
    residual = white @ (np.eye(len(A)) - A @ G)
    # by dA[c, w]: -G[:, c] G[w, :] + spread[:, w] rest[c, :]
    change = -np.einsum("ic,wj->ijcw", G, G) + np.einsum("iw,cj->ijcw", spread, residual)
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
    """Wrenches (N, W) from signals, with the sources of their errors.

    own (N, W, W): covariance from the signals' errors, independent between rows. gain (N, W, R): derivative of a wrench
    by the fitted response; columns (N, Q) and coefficients (R Q, R Q): covariance of the calibration.
    """

    value: NDArray
    own: NDArray
    gain: NDArray
    columns: NDArray
    coefficients: NDArray

    @property
    def joint(self) -> NDArray:
        """Covariance (N, W, N, W) of all rows together due to the calibration."""
        by = np.einsum("nwr,nq->nwrq", self.gain, self.columns).reshape(*self.value.shape, -1)
        return np.einsum("nwc,cd,mvd->nwmv", by, self.coefficients, by, optimize=True)

    @property
    def covariance(self) -> NDArray:
        """Total covariance (N, W, W) of each row."""
        responses = self.gain.shape[2]
        blocks = self.coefficients.reshape(responses, self.columns.shape[1], responses, -1)
        of_response = np.einsum("np,ipjq,nq->nij", self.columns, blocks, self.columns, optimize=True)
        return self.own + self.gain @ of_response @ np.swapaxes(self.gain, 1, 2)


class UnreachedSignalsError(ValueError):
    """Signals that correspond to no load in a calibration from loads to signals."""


def wrenches(fit: Calibration, signals: NDArray, covariates: NDArray, signal_cov: NDArray) -> Wrenches:
    """Return the wrenches of signals (N, C) with error covariance signal_cov (C, C).

    A forward fit is inverted by Gauss-Newton steps from zero load; raises UnreachedSignalsError without convergence.
    """
    if fit.model.direction == "forward":
        return _inverted(fit, signals, covariates, signal_cov)
    slope = fit.matrix @ fit.terms.by_inputs(signals, covariates)
    value = fit.predict(signals, covariates)
    gain = np.broadcast_to(np.eye(value.shape[1]), (*value.shape, value.shape[1]))
    signal_part = slope @ signal_cov @ np.swapaxes(slope, 1, 2)
    return Wrenches(value, signal_part, gain, fit.columns(signals, covariates), fit.covariance)


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
        raise UnreachedSignalsError(f"found signals that no load produces, while inverting {fit.model.name!r}")
    signal_part = gain @ signal_cov @ np.swapaxes(gain, 1, 2)
    return Wrenches(loads, signal_part, gain, fit.columns(loads, covariates), fit.covariance)


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

    newton_per_mv: c, one for all cells or one per cell; amplification: k. relative_sigma: of one cell's sensitivity,
    independent between cells (the paper's 2.0 +- 0.01 mV/V), which scales its column.
    """
    factor = np.broadcast_to(amplification / np.asarray(newton_per_mv, float), matrix.value.shape)
    value = factor * matrix.value
    rows, cells = value.shape
    covariance = relative_sigma**2 * np.einsum("ic,jd,cd->icjd", value, value, np.eye(cells)).reshape(rows * cells, -1)
    return MatrixEstimate(value, np.outer(factor, factor) * matrix.covariance + covariance)


def condition_number(matrix: MatrixEstimate) -> Figures:
    """Return the 2-norm condition number (eq. 35) with its first-order uncertainty."""
    U, s, Vt = np.linalg.svd(matrix.value)
    ratio = s[0] / s[-1]
    last = len(s) - 1
    change = ratio * (np.outer(U[:, 0], Vt[0]) / s[0] - np.outer(U[:, last], Vt[last]) / s[-1])
    return _propagated(np.array([ratio]), change.reshape(1, -1), matrix)


def sensitivities(matrix: MatrixEstimate) -> Figures:
    """Return the column norms (W,) of J = G^+ (eq. 36, 37): 1 for forces, 1/m for torques.

    G (W, C) has C >= W channels; of more channels than loads J is the pseudo-inverse: the least channel forces.
    """
    J, change = _inverted_matrix(matrix.value)
    norm = np.linalg.norm(J, axis=0)
    by_entry = np.einsum("aj,ajib->jib", J / norm, change)
    return _propagated(norm, by_entry.reshape(len(norm), -1), matrix)


def angles_to_theory(theory: NDArray, matrix: MatrixEstimate) -> Figures:
    """Return the angle (W,), rad, between each column of J = G^+ and that of the theory's J (C, W).

    Column norms do not see a cell with the wrong sign or two exchanged cells; the angle does.
    """
    J, change = _inverted_matrix(matrix.value)
    measured, expected = np.linalg.norm(J, axis=0), theory / np.linalg.norm(theory, axis=0)
    cosine = np.clip(np.sum(J / measured * expected, axis=0), -1.0, 1.0)
    across = expected - cosine * J / measured
    size = np.linalg.norm(across, axis=0)
    across = np.divide(across, size, out=np.zeros_like(across), where=size > 0.0)
    by_entry = -np.einsum("aj,ajib->jib", across / measured, change)
    return _propagated(np.arccos(cosine), by_entry.reshape(len(measured), -1), matrix)


def _inverted_matrix(G: NDArray) -> tuple[NDArray, NDArray]:
    """Return J = G^+ (C, W) of G (W, C), which has full row rank; and its derivative (C, W, W, C) by the entries of
    G."""
    J = np.linalg.pinv(G)
    residual, spread = np.eye(G.shape[1]) - J @ G, J.T @ J  # the second: (G G^T)^-1
    change = -np.einsum("ai,bj->ajib", J, J) + np.einsum("ab,ij->ajib", residual, spread)
    return J, change


def per_length(matrix: MatrixEstimate, length_m: float) -> MatrixEstimate:
    """Return a matrix whose rows are three forces and three moments, with moments divided by a characteristic
    length."""
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
    """G_B': matrix from leg forces, computed with the stated sensitivity, to the wrench; and its model."""

    model: str
    estimate: MatrixEstimate
