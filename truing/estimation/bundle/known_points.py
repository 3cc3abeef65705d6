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
    inside = _consensus(points, covariance, known, known_cov)
    level, seen = LEVEL / count, set()
    while True:
        tested = _tested(points, covariance, known, known_cov, inside)
        seen.add(inside.tobytes())
        p_value = np.where(np.isfinite(tested.T), chdtrc(3, np.nan_to_num(tested.T)), np.nan)
        fails = inside & (p_value < level)
        back = ~inside & (p_value >= level)
        following = inside.copy()
        if back.any():
            following |= back
        elif fails.any() and inside.sum() > _LEAST_FIT:
            following[int(np.nanargmax(np.where(fails, tested.T, np.nan)))] = False
        if np.array_equal(following, inside) or following.tobytes() in seen:
            break
        inside = following
    overall = float(chdtrc(tested.freedom, tested.chi2)) if tested.freedom else 1.0
    resolved = (
        overall >= LEVEL
        and 2 * int(inside.sum()) > count
        and not _is_ambiguous(points, covariance, known, known_cov, inside)
    )
    inflation = 1.0
    if not resolved:  # of exactly three points none can be tested alone: report their misfit
        tested = _tested(points, covariance, known, known_cov, np.ones(count, bool))
        overall = float(chdtrc(tested.freedom, tested.chi2))
        p_value = np.where(np.isfinite(tested.T), chdtrc(3, np.nan_to_num(tested.T)), overall)
        inflation = max(tested.chi2 / max(tested.freedom, 1), 1.0)
    wrong, untold = ~inside & resolved, ~np.isfinite(tested.T) & (not resolved)
    off = np.where(untold[:, None], tested.misfit, tested.off)
    return KnownPointErrors(off, tested.sigma, tested.T, p_value, wrong, resolved, inflation)


def _is_ambiguous(points: Array, covariance: Array, known: Array, known_cov: Array, inside: Mask) -> bool:
    """True if the points fit as well if another point is left out instead. Example: if one of four corners of a square
    is off its plane, any of them may be the wrong one."""
    from scipy.special import chdtrc

    for wrong in np.flatnonzero(~inside).tolist():
        for other in np.flatnonzero(inside).tolist()[:_SWAPPED]:
            swapped = inside.copy()
            swapped[[wrong, other]] = True, False
            tested = _tested(points, covariance, known, known_cov, swapped)
            if tested.freedom and chdtrc(tested.freedom, tested.chi2) >= LEVEL:
                return True
    return False


def _consensus(points: Array, covariance: Array, known: Array, known_cov: Array) -> Mask:
    """Return the points (m,) that the best similarity through three of them fits, at least these three."""
    count = len(points)
    every = list(islice(combinations(range(count), 3), 20_000))
    triples = np.array(every)[np.unique(np.linspace(0, len(every) - 1, min(_TRIPLES, len(every))).round().astype(int))]
    fit = umeyama(points[triples], known[triples], with_scale=True)
    placed = fit.scale[:, None, None] * np.einsum("bij,nj->bni", fit.R, points) + fit.t[:, None]
    variance = np.einsum("nini->n", covariance.reshape(count, 3, count, 3)) + np.einsum("nii->n", known_cov)
    flat = np.linalg.svd(points[triples] - points[triples].mean(1, keepdims=True), compute_uv=False)
    usable = flat[:, 1] > 0.05 * np.linalg.norm(points - points.mean(0), axis=1).max()
    # Three points predict the others with their own noise, enlarged with distance.
    square = np.sum((placed - known) ** 2, -1) / (variance / 3.0)
    cost = np.where(usable[:, None], np.minimum(square, _FITTING_SQUARE * 4.0), np.inf).sum(1)
    best = int(np.argmin(cost))
    inside = square[best] <= _FITTING_SQUARE * 4.0
    inside[triples[best]] = True
    return inside


@dataclass(frozen=True)
class _Tested:
    """Results of the test, and misfit (m, 3): residuals of known points to the similarity."""

    misfit: Array
    off: Array
    sigma: Array
    T: Array
    chi2: float
    freedom: int


def _tested(points: Array, covariance: Array, known: Array, known_cov: Array, inside: Mask) -> _Tested:
    """Return the error of every known point, with a similarity fitted by covariance to those inside (m,)."""
    count = len(points)
    fit = umeyama(points[inside], known[inside], with_scale=True)
    R, scale, shift = fit.R, float(fit.scale), fit.t
    turned = np.kron(np.eye(count), scale * R)
    sigma = turned @ covariance @ turned.T
    for n in range(count):
        sigma[3 * n : 3 * n + 3, 3 * n : 3 * n + 3] += known_cov[n]
    placed = scale * points @ R.T + shift
    A = [movements(placed - placed[inside].mean(0)).reshape(3 * count, 7)]
    A += [np.eye(3 * count)[:, 3 * n : 3 * n + 3] for n in np.flatnonzero(~inside).tolist()]
    design, P = np.concatenate(A, 1), np.linalg.inv(sigma)
    apart = (known - placed).ravel()
    cofactor = np.linalg.inv(design.T @ P @ design)
    values = cofactor @ design.T @ P @ apart
    left = apart - design @ values
    W = P - P @ design @ cofactor @ design.T @ P
    off, spread, T = np.full((count, 3), np.nan), np.full((count, 3), np.nan), np.full(count, np.nan)
    for place, n in enumerate(np.flatnonzero(~inside).tolist()):
        unknowns_of_point = slice(7 + 3 * place, 10 + 3 * place)
        off[n], block = values[unknowns_of_point], cofactor[unknowns_of_point, unknowns_of_point]
        spread[n], T[n] = np.sqrt(np.diagonal(block)), off[n] @ np.linalg.solve(block, off[n])
    for n in np.flatnonzero(inside).tolist():
        unknowns_of_point = slice(3 * n, 3 * n + 3)
        M = W[unknowns_of_point, unknowns_of_point]
        if np.linalg.eigvals(np.linalg.solve(P[unknowns_of_point, unknowns_of_point], M)).real.min() < _TESTED:
            continue
        block = np.linalg.inv(M)
        off[n] = block @ (P @ left)[unknowns_of_point]
        spread[n], T[n] = np.sqrt(np.diagonal(block)), off[n] @ M @ off[n]
    chi2, freedom = float(left @ P @ left), 3 * int(inside.sum()) - 7
    return _Tested(known - placed, off, spread, T, chi2, max(freedom, 0))


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


def tested_known(network: Network, loose: ScreenedNetwork) -> KnownTested:
    """Return the test of the known points, from an adjustment with weak known points."""
    adjusted = loose.adjustment
    covariance, factor = adjusted.covariance, loose.covariance_factor if np.isfinite(loose.covariance_factor) else 1.0
    tested: dict[int, Index] = {}
    errors: dict[int, KnownPointErrors] = {}
    seen = np.bincount(network.rays.point[adjusted.used], minlength=len(network.point_pose))
    for pose, rows in _rows_by_pose(network, adjusted.state).items():
        number = network.known.point[rows]
        rows = rows[seen[number] >= 2]
        if len(rows) < _FEWEST or _is_line(network.known.xyz_m[rows]):
            continue
        number = network.known.point[rows]
        place = np.searchsorted(covariance.point_numbers(pose), number)  # in ascending order
        cov = covariance.joint(pose, place) * factor
        known = network.known
        tested[pose] = rows
        errors[pose] = known_point_errors(adjusted.state.points[number], cov, known.xyz_m[rows], known.cov_m2[rows])
    return KnownTested(tested, errors)


def _is_line(xyz: NDArray[np.float64]) -> bool:
    sizes = np.linalg.svd(xyz - xyz.mean(0), compute_uv=False)
    return bool(sizes[1] < _LEAST_WIDTH * sizes[0])


def _rows_by_pose(network: Network, state: NetworkState) -> dict[int, Index]:
    known = network.known
    pose, there = network.point_pose[known.point], np.isfinite(state.points[known.point, 0])
    return {int(number): np.flatnonzero((pose == number) & there) for number in np.unique(pose[there])}
