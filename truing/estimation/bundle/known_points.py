"""Test known points against the rays before they become the datum, so that a wrong known point rejects no ray.

A similarity fits the rays of a pose to its known points; it takes the seven freedoms that rays alone leave. The
residuals have the covariance of both. Each point is tested for its own shift (Baarda), starting from the largest set
that a similarity through three of them fits.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations, islice

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask
from truing.estimation.bundle.data_snooping import ScreenedNetwork
from truing.estimation.bundle.datum import movements
from truing.estimation.bundle.network import Network, NetworkState
from truing.estimation.rigid_poses.umeyama import umeyama

LEVEL = 1e-3  # probability that any point of a good pose is called wrong
_TRIPLES = 400
_FITTING_SQUARE = 16.3  # squared sigmas of three coordinates that one good point in a thousand exceeds
_LEAST_FIT = 3
_SWAPPED = 12  # most points tried in place of a wrong one: among many, the others decide
_TESTED = 0.01  # least share of a point's error that its residual shows
# Standard deviation of loosened known coordinates over their extent: they give a frame and contradict nothing.
_LOOSE = 0.1
_FEWEST = 3
_LEAST_WIDTH = 0.01  # relative to their extent: known points closer to one line give no frame


@dataclass(frozen=True)
class KnownPointErrors:
    """Errors of known points (m) against rays and the other points.

    off_m (m, 3): known minus estimated, with sigma_m (m, 3), T and p_value, NaN if not tested; wrong (m,). resolved:
    whether the other points agree with each other. If not, the wrong points cannot be identified, and inflation is the
    factor by which all covariances would have to grow.
    """

    off_m: Array
    sigma_m: Array
    T: Array
    p_value: Array
    wrong: Mask
    resolved: bool
    inflation: float


def known_point_errors(points: Array, covariance: Array, known: Array, known_cov: Array) -> KnownPointErrors:
    """Return the errors of the known points of one pose against its rays.

    points (m, 3) in m from rays, with covariance (3 m, 3 m); known (m, 3) in m with known_cov (m, 3, 3). At least three
    points, not on one line.
    """
    from scipy.special import chdtrc

    count = len(points)
    inliers = _consensus(points, covariance, known, known_cov)
    level, tried_sets = LEVEL / count, set()
    while True:
        tested = _tested(points, covariance, known, known_cov, inliers)
        tried_sets.add(inliers.tobytes())
        p_value = np.where(np.isfinite(tested.T), chdtrc(3, np.nan_to_num(tested.T)), np.nan)
        fails = inliers & (p_value < level)
        returning = ~inliers & (p_value >= level)
        next_inliers = inliers.copy()
        if returning.any():
            next_inliers |= returning
        elif fails.any() and inliers.sum() > _LEAST_FIT:
            next_inliers[int(np.nanargmax(np.where(fails, tested.T, np.nan)))] = False
        if np.array_equal(next_inliers, inliers) or next_inliers.tobytes() in tried_sets:
            break
        inliers = next_inliers
    overall = float(chdtrc(tested.freedom, tested.chi2)) if tested.freedom else 1.0
    resolved = (
        overall >= LEVEL
        and 2 * int(inliers.sum()) > count
        and not _is_ambiguous(points, covariance, known, known_cov, inliers)
    )
    inflation = 1.0
    if not resolved:  # of exactly three points none can be tested alone: report their misfit
        tested = _tested(points, covariance, known, known_cov, np.ones(count, bool))
        overall = float(chdtrc(tested.freedom, tested.chi2))
        p_value = np.where(np.isfinite(tested.T), chdtrc(3, np.nan_to_num(tested.T)), overall)
        inflation = max(tested.chi2 / max(tested.freedom, 1), 1.0)
    wrong, is_untested = ~inliers & resolved, ~np.isfinite(tested.T) & (not resolved)
    error = np.where(is_untested[:, None], tested.misfit, tested.off)
    return KnownPointErrors(error, tested.sigma, tested.T, p_value, wrong, resolved, inflation)


def _is_ambiguous(points: Array, covariance: Array, known: Array, known_cov: Array, inliers: Mask) -> bool:
    """True if the points fit equally well with another point left out.

    Example: if one of four corners of a square is off its plane, any of them may be the wrong one.
    """
    from scipy.special import chdtrc

    for outlier in np.flatnonzero(~inliers).tolist():
        for inlier in np.flatnonzero(inliers).tolist()[:_SWAPPED]:
            swapped = inliers.copy()
            swapped[[outlier, inlier]] = True, False
            tested = _tested(points, covariance, known, known_cov, swapped)
            if tested.freedom and chdtrc(tested.freedom, tested.chi2) >= LEVEL:
                return True
    return False


def _consensus(points: Array, covariance: Array, known: Array, known_cov: Array) -> Mask:
    """Return the points (m,) that the best similarity through three of them fits, at least these three."""
    count = len(points)
    all_triples = list(islice(combinations(range(count), 3), 20_000))
    triples = np.array(all_triples)[
        np.unique(np.linspace(0, len(all_triples) - 1, min(_TRIPLES, len(all_triples))).round().astype(int))
    ]
    fit = umeyama(points[triples], known[triples], with_scale=True)
    transformed = fit.scale[:, None, None] * np.einsum("bij,nj->bni", fit.R, points) + fit.t[:, None]
    variance = np.einsum("nini->n", covariance.reshape(count, 3, count, 3)) + np.einsum("nii->n", known_cov)
    singular_values = np.linalg.svd(points[triples] - points[triples].mean(1, keepdims=True), compute_uv=False)
    usable = singular_values[:, 1] > 0.05 * np.linalg.norm(points - points.mean(0), axis=1).max()
    # Three points predict the others with their own noise, enlarged with distance.
    normalised_square = np.sum((transformed - known) ** 2, -1) / (variance / 3.0)
    cost = np.where(usable[:, None], np.minimum(normalised_square, _FITTING_SQUARE * 4.0), np.inf).sum(1)
    best = int(np.argmin(cost))
    inliers = normalised_square[best] <= _FITTING_SQUARE * 4.0
    inliers[triples[best]] = True
    return inliers


@dataclass(frozen=True)
class _Tested:
    """Results of the test, and misfit (m, 3): residuals of known points to the similarity."""

    misfit: Array
    off: Array
    sigma: Array
    T: Array
    chi2: float
    freedom: int


def _tested(points: Array, covariance: Array, known: Array, known_cov: Array, inliers: Mask) -> _Tested:
    """Return the error of every known point, with a similarity fitted by covariance to the inliers (m,)."""
    count = len(points)
    fit = umeyama(points[inliers], known[inliers], with_scale=True)
    R, scale, shift = fit.R, float(fit.scale), fit.t
    rotation = np.kron(np.eye(count), scale * R)
    sigma = rotation @ covariance @ rotation.T
    for n in range(count):
        sigma[3 * n : 3 * n + 3, 3 * n : 3 * n + 3] += known_cov[n]
    transformed = scale * points @ R.T + shift
    A = [movements(transformed - transformed[inliers].mean(0)).reshape(3 * count, 7)]
    A += [np.eye(3 * count)[:, 3 * n : 3 * n + 3] for n in np.flatnonzero(~inliers).tolist()]
    design, P = np.concatenate(A, 1), np.linalg.inv(sigma)
    misclosure = (known - transformed).ravel()
    cofactor = np.linalg.inv(design.T @ P @ design)
    values = cofactor @ design.T @ P @ misclosure
    residual = misclosure - design @ values
    W = P - P @ design @ cofactor @ design.T @ P
    error, error_sigma, T = np.full((count, 3), np.nan), np.full((count, 3), np.nan), np.full(count, np.nan)
    for column, n in enumerate(np.flatnonzero(~inliers).tolist()):
        unknowns_of_point = slice(7 + 3 * column, 10 + 3 * column)
        error[n], block = values[unknowns_of_point], cofactor[unknowns_of_point, unknowns_of_point]
        error_sigma[n], T[n] = np.sqrt(np.diagonal(block)), error[n] @ np.linalg.solve(block, error[n])
    for n in np.flatnonzero(inliers).tolist():
        unknowns_of_point = slice(3 * n, 3 * n + 3)
        M = W[unknowns_of_point, unknowns_of_point]
        if np.linalg.eigvals(np.linalg.solve(P[unknowns_of_point, unknowns_of_point], M)).real.min() < _TESTED:
            continue
        block = np.linalg.inv(M)
        error[n] = block @ (P @ residual)[unknowns_of_point]
        error_sigma[n], T[n] = np.sqrt(np.diagonal(block)), error[n] @ M @ error[n]
    chi2, freedom = float(residual @ P @ residual), 3 * int(inliers.sum()) - 7
    return _Tested(known - transformed, error, error_sigma, T, chi2, max(freedom, 0))


@dataclass(frozen=True)
class KnownTested:
    """Known points (rows of network.known) that were tested, with the result, by pose number."""

    rows: Mapping[int, Index] = field(default_factory=dict)
    errors: Mapping[int, KnownPointErrors] = field(default_factory=dict)

    def consistent(self, network: Network) -> Network:
        """Return the network without wrong known points; if they cannot be identified, all are given larger
        covariances."""
        known = network.known
        is_consistent, cov = np.ones(len(known.point), bool), known.cov_m2.copy()
        for pose, rows in self.rows.items():
            is_consistent[rows[self.errors[pose].wrong]] = False
            cov[rows] *= self.errors[pose].inflation
        return replace(
            network,
            known=replace(
                known, point=known.point[is_consistent], xyz_m=known.xyz_m[is_consistent], cov_m2=cov[is_consistent]
            ),
        )


def with_weak_known_points(network: Network, state: NetworkState) -> Network:
    """Return the network with known points so weak that they give each pose a frame and hardly more."""
    known = network.known
    cov = known.cov_m2.copy()
    for rows in _rows_by_pose(network, state).values():
        xyz = known.xyz_m[rows]
        extent = np.sqrt(np.mean(np.sum((xyz - xyz.mean(0)) ** 2, -1)))
        cov[rows] += (_LOOSE * extent) ** 2 * np.eye(3)
    return replace(network, known=replace(known, cov_m2=cov))


def tested_known(network: Network, screened_network: ScreenedNetwork) -> KnownTested:
    """Return the test of the known points, from an adjustment with weak known points."""
    adjusted = screened_network.adjustment
    covariance, factor = (
        adjusted.covariance,
        screened_network.covariance_factor if np.isfinite(screened_network.covariance_factor) else 1.0,
    )
    tested: dict[int, Index] = {}
    errors: dict[int, KnownPointErrors] = {}
    ray_count = np.bincount(network.rays.point[adjusted.used], minlength=len(network.point_pose))
    for pose, rows in _rows_by_pose(network, adjusted.state).items():
        number = network.known.point[rows]
        rows = rows[ray_count[number] >= 2]
        if len(rows) < _FEWEST or _is_line(network.known.xyz_m[rows]):
            continue
        number = network.known.point[rows]
        index = np.searchsorted(covariance.point_numbers(pose), number)  # in ascending order
        cov = covariance.joint(pose, index) * factor
        known = network.known
        tested[pose] = rows
        errors[pose] = known_point_errors(adjusted.state.points[number], cov, known.xyz_m[rows], known.cov_m2[rows])
    return KnownTested(tested, errors)


def _is_line(xyz: NDArray[np.float64]) -> bool:
    singular_values = np.linalg.svd(xyz - xyz.mean(0), compute_uv=False)
    return bool(singular_values[1] < _LEAST_WIDTH * singular_values[0])


def _rows_by_pose(network: Network, state: NetworkState) -> dict[int, Index]:
    known = network.known
    pose, is_estimated = network.point_pose[known.point], np.isfinite(state.points[known.point, 0])
    return {int(number): np.flatnonzero((pose == number) & is_estimated) for number in np.unique(pose[is_estimated])}
