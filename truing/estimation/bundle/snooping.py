"""Gross errors among rays: a robust start, then data snooping (Baarda 1968) until no ray fails its test.

Both coordinates of a ray are tested together, because a wrong code or a merged target spoils both and they are
correlated: T = v^T Q_vv^-1 v has two degrees of freedom; where the network checks a ray in one direction alone, T has
one. Rejected rays are tested on against what the others predict, and come back where they pass.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from truing.estimation.bundle.adjustment import Adjustment, adjust
from truing.estimation.bundle.datum import Datum
from truing.estimation.bundle.determinable import determinable
from truing.estimation.bundle.directions import directions
from truing.estimation.bundle.intersection import Bundle, Mask, intersect
from truing.estimation.bundle.network import Array, Index, Network, State
from truing.estimation.bundle.ray_tests import RayTests, p_values, passing_share, ray_tests
from truing.estimation.bundle.variance_components import (
    GlobalTest,
    VarianceComponents,
    global_test,
    grouped,
    updated,
)

GROSS = "gross error: its test value is above the critical value"
ONE_OF_TWO = "one of two rays that do not meet: which is wrong cannot be told"
NO_IMAGE = "its image is not oriented"
NO_POINT = "its point has no coordinates"
BEHIND = "its point lies behind the camera"
NOT_PREDICTED = "disagrees with the start, and too few other rays of its point or image are left to test it"
SECOND_TARGET = "meets other rejected rays of its name in another place: a second target bears the name"
NOT_DETERMINED = "its point or its image keeps too few other rays"
_ROBUST_ROUNDS = 8
_BOUND = 2.5  # standard deviations up to which a ray has full weight in the robust start
_SUSPECT = 6.0  # and from which on it begins data snooping as rejected
_SECOND = 3  # rejected rays that meet elsewhere: two meet too easily
_WITHIN = 6.0  # standard deviations, or one pixel, of each other, and
_APART = 5.0  # times as far from the point's own place
_MOST_ROUNDS = 60
_SETTLED = 1e-3  # relative change of the variance components
_RETURNS = 2  # times that a ray may come back


@dataclass(frozen=True)
class RejectedRays:
    """Rays left out: ray (R,) by number, w (R, 2), T (R,) and its p-value (R,), redundancy numbers (R, 2), estimated
    gross error (R, 2) in px, and the reason (R,). Numbers are NaN where the network predicts nothing for a ray."""

    ray: Index
    w: Array
    T: Array
    p_value: Array
    redundancy: Array
    gross_error_px: Array
    reason: tuple[str, ...]


@dataclass(frozen=True)
class Snooped:
    """An adjusted network without gross errors: which rays (N,) were used, the rejected, those used whose errors no
    test could show (untested, by number); the level alpha of one test, how many were made, the probability family_level
    that at least one of so many good rays is rejected, the critical value of T (two degrees of freedom), rounds, how
    many rays came back, the variance components, the tests of all rays, and the test of sigma0 with the covariances as
    stated (the squares that data snooping cuts off good rays added)."""

    adjustment: Adjustment
    used: Mask
    rejected: RejectedRays
    untested: Index
    alpha: float
    tested: int
    family_level: float
    critical: float
    rounds: int
    returned: int
    components: VarianceComponents
    tests: RayTests
    sigma0: GlobalTest


def adjust_robustly(
    network: Network,
    start: State,
    datum: Datum = "free",
    *,
    agrees: Mask | None = None,
    alpha: float = 0.001,
    with_components: bool = True,
) -> Snooped:
    """Return the network adjusted with all rays that pass their test at level alpha.

    start: NaN for images and points without start values; agrees (N,): rays that the start is sure of, others begin
    rejected. Without components the stated covariances of the rays are taken as they are (sigma0 = 1).
    Raises `UndeterminedNetworkError` where hardly anything is left.
    """
    possible, known = _possible(network, start), datum == "known"
    active = possible if agrees is None else possible & agrees
    state, active, components = _robust_start(network, start, datum, active)
    if not with_components:
        components = replace(components, factor=np.ones_like(components.factor), sigma=np.zeros_like(components.sigma))
    returns = np.zeros(network.rays.count, np.int64)
    rounds = 0
    while True:
        rounds += 1
        used = determinable(network, active, known=known).rays
        adjusted = adjust(network, state, datum, used=used, variance_factor=components.of_rays())
        state, tests = adjusted.state, ray_tests(adjusted, components)
        latest = updated(components, adjusted, tests.redundancy_blocks, passing_share(alpha))
        if with_components:
            tests = _rescaled(tests, used, components, latest)
        fails, passes = _worst_failures(network, used, tests, alpha), tests.p_value >= alpha
        passes &= possible & ~active & (returns < _RETURNS)
        settled = not with_components or _settled(components, latest)
        if rounds == _MOST_ROUNDS or (settled and not fails.any() and not passes.any()):
            break
        components = latest if with_components else components
        returns += passes
        active = (active | passes) & ~fails
    tested = int((used & (tests.freedom > 0)).sum())
    stated = adjust(network, state, datum, used=used) if with_components else adjusted
    return Snooped(
        adjustment=adjusted,
        used=used,
        rejected=_rejected(network, start, adjusted, active, tests),
        untested=np.flatnonzero(used & (tests.freedom == 0)),
        alpha=alpha,
        tested=tested,
        family_level=float(-np.expm1(tested * np.log1p(-alpha))),
        critical=-2 * float(np.log(alpha)),
        rounds=rounds,
        returned=int(((returns > 0) & used).sum()),
        components=replace(latest, factor=components.factor) if with_components else components,
        tests=tests,
        sigma0=global_test(stated.chi2 / passing_share(alpha), stated.redundancy),
    )


def _rescaled(tests: RayTests, used: Mask, before: VarianceComponents, after: VarianceComponents) -> RayTests:
    """Return tests by the latest components."""
    ratio = after.of_rays() / before.of_rays()
    T = tests.T / ratio
    p_value = p_values(T, tests.freedom, after.redundancy[after.component], used)
    return replace(tests, T=T, p_value=p_value, w=tests.w / np.sqrt(ratio)[:, None])


def _settled(before: VarianceComponents, after: VarianceComponents) -> bool:
    return bool(np.all(np.abs(after.factor / before.factor - 1) < _SETTLED))


def _possible(network: Network, start: State) -> Mask:
    """Return the rays (N,) whose image and point have start values, the point before the camera."""
    rays = network.rays
    u = np.einsum("nji,nj->ni", start.R[rays.image], start.points[rays.point] - start.centre[rays.image])
    with np.errstate(invalid="ignore"):
        return u[:, 2] > 0


def _robust_start(network: Network, start: State, datum: Datum, active: Mask) -> tuple[State, Mask, VarianceComponents]:
    """Return the state after adjustments with bounded influence, the rays that are no suspects, and the variance
    components by the median."""
    known = datum == "known"
    used = determinable(network, active, known=known).rays
    weights, state = np.ones(network.rays.count), start
    inverse = np.linalg.inv(network.rays.cov_px2)
    for step in range(_ROBUST_ROUNDS):
        adjusted = adjust(network, state, datum, used=used, weights=weights, max_iterations=3 if step else 30)
        v = adjusted.residuals_px
        off = np.sqrt(np.einsum("ni,nij,nj->n", v, inverse, v))
        if step == 0:
            each = np.full(network.rays.count, adjusted.redundancy / max(int(used.sum()), 1))
            components = grouped(network, used, each)
        components = _by_median(components, off, used, adjusted.redundancy)
        off = off / np.sqrt(components.of_rays())
        with np.errstate(divide="ignore", invalid="ignore"):
            bounded = np.minimum(1.0, _BOUND / off)
        latest = np.maximum(np.nan_to_num(bounded if step < 3 else bounded**3), 1e-9)
        change = np.abs(latest - weights)[used].max(initial=0.0)
        weights, state = latest, adjusted.state
        if change < 0.05:
            break
    return state, active & ~(off > _SUSPECT), components


def _by_median(components: VarianceComponents, off: Array, used: Mask, redundancy: int) -> VarianceComponents:
    """Return components whose factors make the median of normalised misses (N,) what it is for two normal errors."""
    factor = components.factor.copy()
    share = redundancy / (2.0 * max(int(used.sum()), 1))
    for g in range(len(factor)):
        own = off[used & (components.component == g)]
        if len(own):
            factor[g] = max(float(np.median(own)) ** 2 / (2 * np.log(2)) / share, 1e-4)
    return replace(components, factor=factor)


def _worst_failures(network: Network, used: Mask, tests: RayTests, alpha: float) -> Mask:
    """Return the rays that fail by themselves.

    An error raises T of other rays by the square of their correlation, about (3 / n)^2 among n rays of an image and
    (1.5 / n)^2 among those of a point: what is above four times that part of the worst does not come from it.
    """
    with np.errstate(invalid="ignore"):
        fails = used & (tests.p_value < alpha)
    T = np.where(fails, tests.T, 0.0)
    for index, part in ((network.rays.image, 6.0), (network.rays.point, 3.0)):
        most = np.zeros(int(index.max(initial=0)) + 1)
        np.maximum.at(most, index, T)
        many = np.maximum(np.bincount(index[used], minlength=len(most)), 1)
        fails &= (np.minimum(part / many, 1.0) ** 2 * most)[index] <= T
    return fails


def _elsewhere(adjusted: Adjustment, rejected: Mask) -> Mask:
    """Return the rejected rays (N,) of points on whose other place at least three of them agree."""
    network, state = adjusted.network, adjusted.state
    rays = network.rays
    spread = float(np.sqrt(np.median(np.einsum("nii->n", rays.cov_px2)) / 2 * max(adjusted.variance_factor, 1.0)))
    limit = max(_WITHIN * spread, 1.0)
    with np.errstate(invalid="ignore"):
        rejected = rejected & (np.linalg.norm(adjusted.residuals_px, axis=1) > _APART * limit)
    rejected &= np.bincount(rays.point[rejected], minlength=len(network.point_pose))[rays.point] >= _SECOND
    out, found = np.flatnonzero(rejected), np.zeros(rays.count, bool)
    if len(out):
        camera = network.image_camera[rays.image[out]]
        towards = directions(network.cameras, state.interior, camera, rays.xy_px[out])
        scale = state.interior[camera, 0]
        lines = Bundle(rays.image[out], rays.point[out], towards, scale, state.R, state.centre, len(network.point_pose))
        X, agrees = intersect(lines, limit, np.random.default_rng(0))
        found[out] = agrees & (np.bincount(rays.point[out], agrees, minlength=len(X)) >= _SECOND)[rays.point[out]]
    return found


def _rejected(network: Network, start: State, adjusted: Adjustment, active: Mask, tests: RayTests) -> RejectedRays:
    """Return all rays that take no part, with what the others say of them."""
    rays, used = network.rays, adjusted.used
    placed, oriented = np.isfinite(start.points[rays.point, 0]), np.isfinite(start.centre[rays.image, 0])
    on_point = np.bincount(rays.point[used], minlength=len(network.point_pose))[rays.point]
    of_point = np.bincount(rays.point[placed & oriented], minlength=len(network.point_pose))[rays.point]
    gone = np.bincount(rays.point[~active & placed & oriented], minlength=len(network.point_pose))[rays.point] > 0
    reason = np.where(active, NOT_DETERMINED, np.where(np.isnan(tests.T), NOT_PREDICTED, GROSS))
    reason = np.where((of_point == 2) & (on_point < 2) & gone, ONE_OF_TWO, reason)
    reason = np.where(_possible(network, start), reason, BEHIND)
    reason = np.where(_elsewhere(adjusted, ~used & ~active & placed & oriented), SECOND_TARGET, reason)
    reason = np.where(placed, reason, NO_POINT)
    reason = np.where(oriented, reason, NO_IMAGE)
    out = np.flatnonzero(~used)
    error = np.where(np.isfinite(tests.T)[:, None], adjusted.residuals_px, np.nan)
    return RejectedRays(
        out,
        tests.w[out],
        tests.T[out],
        tests.p_value[out],
        tests.redundancy[out],
        error[out],
        tuple(reason[out].tolist()),
    )
