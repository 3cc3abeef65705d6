"""Comparison of a measured matrix with a simulated one: entry by entry, together, and apart from a common factor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.arrays import Array, Mask

_ROUNDING = 1e-12  # of a correlation matrix' eigenvalues, per row
_LEAST_OF_A_PLANE = 4  # attachments: a plane through three explains any shift of theirs
_STEPS, _SETTLED = 50, 1e-12


@dataclass(frozen=True)
class JointTest:
    """Chi-square of all differences together, their number of independent combinations, and its p-value (NaN for
    none)."""

    chi_square: float
    dof: int
    p_value: float


def joint_test(difference: Array, covariance: Array) -> JointTest:
    """Return the test of differences (n,) with covariance (n, n), which may be singular, against zero."""
    from scipy.special import chdtrc

    at = np.flatnonzero(np.diag(covariance) > 0.0)
    inverse, rank = _inverse(covariance[np.ix_(at, at)])
    chi_square = float(difference[at] @ inverse @ difference[at])
    return JointTest(chi_square, rank, float(chdtrc(rank, chi_square)) if rank else float("nan"))


def _inverse(covariance: Array) -> tuple[Array, int]:
    """Return the pseudo-inverse and the rank of a covariance without zeros on its diagonal."""
    if not len(covariance):
        return covariance, 0
    scale = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    mask = values > _ROUNDING * len(values)
    unscaled = vectors[:, mask] / scale[:, None]
    return np.asarray((unscaled / values[mask]) @ unscaled.T), int(mask.sum())


@dataclass(frozen=True)
class MatrixComparison:
    """A measured matrix minus a simulated one.

    difference and sigma (L, D): NaN in rows that were not determined; together: test of all entries; factor: measured
    over simulated for all entries alike, factor_sigma; scaled: test of what this factor leaves; without_plane: test of
    the differences apart from a motion of all attachments in a common plane per drive, None for fewer than four.
    measured, simulated, measured_sigma and simulated_sigma (L, D): the compared entries.
    """

    measured: Array
    measured_sigma: Array
    simulated: Array
    simulated_sigma: Array
    difference: Array
    sigma: Array
    together: JointTest
    factor: float
    factor_sigma: float
    scaled: JointTest
    without_plane: JointTest | None


def compare_matrices(
    measured: Array,
    covariance: Array,
    simulated: Array,
    simulated_sigma: Array,
    determined: Mask,
    points: Array,
) -> MatrixComparison:
    """Return the comparison of K (L, D) with covariance (LD, LD), row by row, and a simulated K with sigma (L, D).

    determined (L,): rows of K to compare; points (L, 2): of the attachments, in any unit.
    """
    rows, width = np.flatnonzero(determined), measured.shape[1]
    at = (rows[:, None] * width + np.arange(width)).ravel()
    flat, model = measured[rows].ravel(), simulated[rows].ravel()
    of_own, of_model = covariance[np.ix_(at, at)], np.diag(simulated_sigma[rows].ravel() ** 2)
    bent = np.kron(_apart_from_a_plane(points[rows]), np.eye(width))
    total, difference = of_own + of_model, flat - model
    factor, factor_sigma = _common_factor(flat, of_own, model, of_model)
    scaled = joint_test(flat - factor * model, of_own + factor**2 * of_model) if np.isfinite(factor) else _NO_TEST
    if scaled.dof > 1:
        scaled = _with_dof(scaled, scaled.dof - 1)
    free = joint_test(bent @ difference, bent @ total @ bent.T) if len(rows) >= _LEAST_OF_A_PLANE else None

    def spread(values: Array) -> Array:
        spreads = np.full(measured.shape, np.nan)
        spreads[rows] = values.reshape(len(rows), width)
        return spreads

    sizes = (np.sqrt(np.maximum(np.diag(of), 0.0)) for of in (of_own, of_model, total))
    own_sigma, model_sigma, sigma = (spread(size) for size in sizes)
    return MatrixComparison(
        *(spread(flat), own_sigma, spread(model), model_sigma, spread(difference), sigma),
        *(joint_test(difference, total), factor, factor_sigma, scaled, free),
    )


_NO_TEST = JointTest(float("nan"), 0, float("nan"))


def _with_dof(test: JointTest, dof: int) -> JointTest:
    from scipy.special import chdtrc

    return JointTest(test.chi_square, dof, float(chdtrc(dof, test.chi_square)))


def _apart_from_a_plane(points: Array) -> Array:
    """Return the projection (L, L) that takes lift and tilt of the plane of points (L, 2) out of shifts."""
    plane = np.column_stack([np.ones(len(points)), points[:, :2] - points[:, :2].mean(axis=0)])
    basis, size, _ = np.linalg.svd(plane, full_matrices=False)
    basis = basis[:, size > 1e-9 * size[:1]]
    return np.asarray(np.eye(len(points)) - basis @ basis.T)


def _common_factor(measured: Array, measured_cov: Array, model: Array, model_cov: Array) -> tuple[float, float]:
    """Return the generalised least-squares factor of measured over model, and its sigma; NaN for a model of zeros."""
    factor, sigma = 1.0, float("nan")
    if not model.any():
        return float("nan"), sigma
    for _ in range(_STEPS):
        total = measured_cov + factor**2 * model_cov
        at = np.flatnonzero(np.diag(total) > 0.0)
        inverse, _ = _inverse(total[np.ix_(at, at)])
        normal = float(model[at] @ inverse @ model[at])
        if not normal > 0.0:
            return float("nan"), float("nan")
        before, factor, sigma = factor, float(model[at] @ inverse @ measured[at]) / normal, normal**-0.5
        if abs(factor - before) <= _SETTLED * max(1.0, abs(factor)):
            break
    return factor, sigma


def slopes_of_shifts(moved: Array, shifted: Array, noise: Array | None) -> tuple[Array, Array]:
    """Return K and sigma (L, D) of shifts (N, L) = K moved (N, D), without offset, in one unit of length.

    noise (N,): standard deviation of each row; None: sigma follows from what K leaves, zero for as many rows as drives.
    """
    weight = np.ones(len(moved)) if noise is None else 1.0 / noise
    coefficients = np.linalg.lstsq(moved * weight[:, None], shifted * weight[:, None], rcond=None)[0].T
    inverse = np.linalg.inv((moved * weight[:, None] ** 2).T @ moved)
    size = np.sqrt(np.diag(inverse))
    spare = len(moved) - moved.shape[1]
    if noise is not None:
        scatter = np.ones(len(coefficients))
    elif spare:
        scatter = np.sqrt(((shifted - moved @ coefficients.T) ** 2).sum(axis=0) / spare)
    else:
        scatter = np.zeros(len(coefficients))
    return np.asarray(coefficients), np.outer(scatter, size)
