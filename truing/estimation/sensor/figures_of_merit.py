"""What a calibration matrix says of a sensor: leg forces, isotropy, sensitivities, and their distance from theory.

Force-sensor paper, section 6.2: eq. 33-37, Tables 4 and 5; every figure with the uncertainty that the matrix gives it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.estimation.covariance import symmetric
from truing.estimation.sensor.calibration_matrix import MatrixEstimate

STANDARD_GRAVITY = 9.80665  # m/s^2


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
