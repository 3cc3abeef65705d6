"""Gross errors among rays: a robust start, then data snooping (Baarda 1968) until no ray fails its test.

The start bounds the influence of rays and rejects suspects. Both coordinates of a ray are tested together, since a
wrong code or a merged target corrupts both: T = v^T Q_vv^-1 v has two degrees of freedom, or one if the network checks
the ray in one direction only. Rejected rays are tested against their prediction by the other rays, and used again if
they pass.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.estimation.bundle.adjustment import Adjustment, adjust
from truing.estimation.bundle.camera import directions
from truing.estimation.bundle.datum import Datum
from truing.estimation.bundle.determinable import UndeterminedNetworkError, determinable
from truing.estimation.bundle.network import Network, NetworkState
from truing.estimation.bundle.orientation import Bundle, intersect
from truing.estimation.bundle.variance_components import GlobalTest, VarianceComponents, global_test, grouped, updated

_MOST_ROUNDS = 60
_WITHIN = 1e-6  # remaining sum of squares between rounds: no residual is off by more than 0.001 standard deviations
_STEADY = 1e-3  # relative change of the variance components at convergence
_RETURNS = 2  # how often a rejected ray may be used again
_LOOSE = 0.1  # standard deviation of a loosened bar, relative to its length: it gives a scale and hardly affects points
# Interior elements in the order in which they are held fixed: the least important first.
RELEASE_ORDER = ("A3", "C2", "C1", "B2", "B1", "A2", "A1", "y0", "x0", "c")
_CHECKED = 0.01  # share of an error that must appear in the residuals for a direction to count as tested
GROSS = "gross error: its test value is above the critical value"
ONE_OF_TWO = "one of two rays that do not meet: which is wrong is undetermined"
NO_IMAGE = "its image is not oriented"
NO_POINT = "its point has no coordinates"
BEHIND = "its point lies behind the camera"
NOT_PREDICTED = "rejected; too few other rays of its point or image remain to state its error"
SECOND_TARGET = "meets other rejected rays of its name in another place: a second target bears the name"
NOT_DETERMINED = "its point or its image keeps too few other rays"
_FEWEST_MEETING = 3  # rejected rays that meet elsewhere: two meet too easily by chance
_APART_TOLERANCES = 5.0  # tolerances from the adjusted point
_ROBUST_ROUNDS = 8
_BOUND = 2.5  # standard deviations up to which a ray has full weight in the robust start
_SUSPECT = 6.0  # standard deviations from which data snooping starts with the ray rejected
_MANY = 1 / 3  # share of suspects among a point's rays, above which it is intersected again


@dataclass(frozen=True)
class ScreenedNetwork:
    """A network adjusted without gross errors.

    used (N,): rays in the adjustment; untested: used rays whose errors no test could show, by number. alpha: level of
    one of the `tested` tests; family_level: probability that at least one of so many good rays is rejected; critical:
    critical value of T (two degrees of freedom). returned: number of rays rejected and used again. sigma0: test with
    the stated covariances, corrected for the squares that data snooping removes from good rays. covariance_factor
    multiplies the covariances of the adjustment: one if variance components give the scale. fixed_elements: elements
    (camera, name) that the network does not determine; they keep their start values. by_rays: adjustment in which
    several bars of a pose have little weight, so that contradicting bars do not bend the points."""

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
    covariance_factor: float
    fixed_elements: tuple[tuple[str, str], ...]
    by_rays: Adjustment


def adjust_robustly(
    network: Network,
    start: NetworkState,
    datum: Datum = "free",
    *,
    inliers: Mask | None = None,
    alpha: float = 0.001,
    with_components: bool = True,
) -> ScreenedNetwork:
    """Return the network adjusted with all rays that pass their test at level alpha.

    start: NaN for images and points without start values. inliers (N,): rays consistent with the start; others begin
    rejected. Without components the stated covariances of the rays are used (sigma0 = 1). Raises
    `UndeterminedNetworkError` if too little is left.
    """
    possible = possible_rays(network, start)
    fixed_elements: tuple[tuple[str, str], ...] = ()
    outliers = np.zeros(network.rays.count, bool) if inliers is None else ~inliers
    while True:
        try:
            screened = _screened(network, start, datum, possible, possible & ~outliers, alpha, with_components)
            return replace(screened, fixed_elements=fixed_elements)
        except UndeterminedNetworkError as error:
            network, possible, newly_fixed = relaxed(network, possible, error)
            fixed_elements = (*fixed_elements, *newly_fixed)


@dataclass(frozen=True)
class _ScreeningEnd:
    """State at the end of data snooping: adjustment of the used rays (N,), tests of all, and their noise components.

    ``active`` (N,): rays not rejected; ``returns`` (N,): how often each has returned; ``latest``: components estimated
    from this adjustment.
    """

    adjusted: Adjustment
    tests: RayTests
    components: VarianceComponents
    latest: VarianceComponents
    used: Mask
    active: Mask
    returns: Index
    rounds: int


def _screened(
    network: Network,
    start: NetworkState,
    datum: Datum,
    possible: Mask,
    active: Mask,
    alpha: float,
    with_components: bool,
) -> ScreenedNetwork:
    """Return the network adjusted with the possible rays (N,) that pass, starting from the active ones (N,)."""
    weak_bars_network = _with_loose_bars(network)
    screening = _screening_end(weak_bars_network, start, datum, possible, active, alpha, with_components)
    adjusted, tests, used = screening.adjusted, screening.tests, screening.used
    if weak_bars_network is not network:
        adjusted = adjust(network, adjusted.state, datum, used=used, variance_factor=screening.components.of_rays())
        tests = ray_tests(adjusted, screening.components)
    tested = int((used & (tests.freedom > 0)).sum())
    stated = adjust(network, adjusted.state, datum, used=used) if with_components else adjusted
    return ScreenedNetwork(
        adjustment=adjusted,
        used=used,
        rejected=rejected_rays(network, start, adjusted, screening.components, screening.active, tests),
        untested=np.flatnonzero(used & (tests.freedom == 0)),
        alpha=alpha,
        tested=tested,
        family_level=float(-np.expm1(tested * np.log1p(-alpha))),
        critical=-2 * float(np.log(alpha)),
        rounds=screening.rounds,
        returned=int(((screening.returns > 0) & used).sum()),
        components=replace(screening.latest, factor=screening.components.factor)
        if with_components
        else screening.components,
        tests=tests,
        fixed_elements=(),
        by_rays=screening.adjusted,
        covariance_factor=1.0 if with_components else adjusted.variance_factor / passing_share(alpha),
        sigma0=global_test(stated.chi2 / passing_share(alpha), stated.redundancy),
    )


def _screening_end(
    network: Network,
    start: NetworkState,
    datum: Datum,
    possible: Mask,
    active: Mask,
    alpha: float,
    with_components: bool,
) -> _ScreeningEnd:
    """Return the end of data snooping: rays fail and return in turn until all agree, or after `_MOST_ROUNDS`."""
    state, active, components = robust_start(network, start, datum, active)
    if not with_components:
        components = replace(components, factor=np.ones_like(components.factor), sigma=np.zeros_like(components.sigma))
    returns = np.zeros(network.rays.count, np.int64)
    rounds, decrease_tolerance = 1, 0.0
    while True:
        used = determinable(network, active, known=datum == "known").rays
        adjusted = adjust(
            network,
            state,
            datum,
            used=used,
            variance_factor=components.of_rays(),
            decrease_tolerance=decrease_tolerance,
        )
        state, tests = adjusted.state, ray_tests(adjusted, components)
        latest = updated(components, adjusted, tests.redundancy_blocks, passing_share(alpha))
        if with_components:
            tests = _rescaled(tests, components, latest)
        fails, passes = _verdicts(network, used, tests, alpha)
        passes &= possible & ~active & (returns < _RETURNS)
        converged = not with_components or bool(np.all(np.abs(latest.factor / components.factor - 1) < _STEADY))
        has_settled = converged and not fails.any() and not passes.any()
        if has_settled or rounds >= _MOST_ROUNDS:
            if adjusted.converged or not decrease_tolerance:
                return _ScreeningEnd(adjusted, tests, components, latest, used, active, returns, rounds)
            decrease_tolerance = 0.0  # what passes after one step is adjusted to the end, and tested once more
            continue
        rounds, decrease_tolerance = rounds + 1, _WITHIN
        components = latest if with_components else components
        returns += passes
        active = (active | passes) & ~fails


def _verdicts(network: Network, used: Mask, tests: RayTests, alpha: float) -> tuple[Mask, Mask]:
    """Return the used rays (N,) that fail, at most one of a point, and all rays (N,) that pass."""
    critical = tests.critical(alpha)
    with np.errstate(invalid="ignore"):
        fails, passes = used & (critical < tests.T), critical >= tests.T
    return _worst_failures(network, used, tests, fails), passes


def _with_loose_bars(network: Network) -> Network:
    """Return the network with little weight on the bars of a pose that has several. Contradicting bars would bend
    points until rays to their ends fail; rays are tested against rays alone."""
    bars = network.bars
    pose = network.point_pose[bars.first]
    if not len(pose) or np.bincount(pose).max() < 2:
        return network
    enlarged_sigma_m = np.maximum(bars.repeat_sigma_m, _LOOSE * bars.length_m[bars.bar])
    return replace(network, bars=replace(bars, repeat_sigma_m=enlarged_sigma_m))


def _rescaled(tests: RayTests, components: VarianceComponents, latest: VarianceComponents) -> RayTests:
    """Return the tests rescaled to the latest components, which are estimated from the same residuals."""
    ratio = latest.of_rays() / components.of_rays()
    scale = latest.redundancy[latest.component]
    return replace(tests, T=tests.T / ratio, w=tests.w / np.sqrt(ratio)[:, None], scale_redundancy=scale)


def _worst_failures(network: Network, used: Mask, tests: RayTests, fails: Mask) -> Mask:
    """Return the failing rays (N,) that fail by their own error. An error raises T of other rays by the square of their
    correlation: about (3 / n)^2 among n rays of an image, and (1.5 / n)^2 among those of a point. A T above four times
    that part of the worst one has its own cause."""
    T, own_failures = np.where(fails, tests.T, 0.0), fails
    for index, correlation_bound in ((network.rays.image, 6.0), (network.rays.point, 3.0)):
        largest_T = np.zeros(int(index.max(initial=0)) + 1)
        np.maximum.at(largest_T, index[fails], T[fails])
        count = np.maximum(np.bincount(index[used], minlength=len(largest_T)), 1)
        own_failures = own_failures & ((np.minimum(correlation_bound / count, 1.0) ** 2 * largest_T)[index] <= T)
    return own_failures


def relaxed(
    network: Network, candidates: Mask, error: UndeterminedNetworkError
) -> tuple[Network, Mask, tuple[tuple[str, str], ...]]:
    """Return the network with one undetermined interior element held fixed. Also: the rays (N,) without images and
    points in free directions, and the elements fixed now, (camera, element) or none.

    Raises the error again if neither helps.
    """
    free_elements = [(camera, name) for name in RELEASE_ORDER for camera, known in error.elements if known == name]
    if free_elements:
        camera, element = free_elements[0]
        cameras = tuple(
            replace(other_camera, free=tuple(name for name in other_camera.free if name != element))
            if other_camera.name == camera
            else other_camera
            for other_camera in network.cameras
        )
        return replace(network, cameras=cameras), candidates, (free_elements[0],)
    undetermined = np.isin(network.rays.image, error.images) | np.isin(network.rays.point, error.points)
    if not (candidates & undetermined).any():
        raise error
    return network, candidates & ~undetermined, ()


@dataclass(frozen=True)
class RayTests:
    """Test statistics per ray: T (N,) with degrees of freedom (N,) 0, 1 or 2; w (N, 2) of an error in one coordinate,
    redundancy numbers (N, 2), and Q_vv C^-1 (N, 2, 2); whether the ray is used (N,).

    Unused rays have the values that they would have if they were used. scale_redundancy (N,): redundancy from which the
    scale of a ray is estimated, None if it is stated.
    """

    T: Array
    freedom: Index
    w: Array
    redundancy: Array
    redundancy_blocks: Array
    used: Mask
    scale_redundancy: Array | None = None

    @cached_property
    def p_value(self) -> Array:
        """P-value (N,) of T, NaN without degrees of freedom."""
        return p_values(self.T, self.freedom, self.scale_redundancy, self.used)

    def critical(self, alpha: float) -> Array:
        """Return the critical value (N,) of T at level alpha, NaN without degrees of freedom."""
        return critical_values(alpha, self.freedom, self.scale_redundancy, self.used)


def passing_share(alpha: float) -> float:
    """Return the mean square of good rays that pass a test at level alpha, relative to that of all good rays: truncated
    chi-square of two degrees of freedom."""
    return (1 - alpha * (1 - np.log(alpha))) / (1 - alpha)


def ray_tests(adjusted: Adjustment, components: VarianceComponents) -> RayTests:
    """Return the tests of all rays of an adjustment with the components' variance factors."""
    C = adjusted.network.rays.cov_px2 * components.of_rays()[:, None, None]
    A, used, v = adjusted.covariance.computed_px2(), adjusted.used, adjusted.residuals_px
    is_finite = np.asarray(np.isfinite(A).all(axis=(1, 2)) & np.isfinite(v).all(axis=1))
    A, v = np.where(is_finite[:, None, None], A, 0.0), np.where(is_finite[:, None], v, 0.0)
    # Q_vv P of a used ray, else the same as it would be if the ray were used: (1 + A P)^-1 = C (C + A)^-1.
    P, R = _inverse(C), np.where(used[:, None, None], C - A, C + A)
    weight_redundancy = P @ R @ P
    S = np.where(used[:, None, None], weight_redundancy, _inverse(np.where(used[:, None, None], C, R)))
    blocks = np.where(used[:, None, None], R @ P, C @ S)
    with np.errstate(divide="ignore", invalid="ignore"):
        sigma = np.sqrt(np.maximum(S[:, [0, 1], [0, 1]], 0))
        w = (np.where(used[:, None, None], P, S) @ v[..., None])[..., 0] / sigma
    T, freedom = _two_directions(C, A, v, used)
    T[~is_finite], w[~is_finite], blocks[~is_finite], freedom[~is_finite] = np.nan, np.nan, np.nan, 0
    return RayTests(T, freedom, w, blocks[:, [0, 1], [0, 1]], blocks, used)


def _inverse(M: Array) -> Array:
    """Return the inverses (n, 2, 2) of symmetric matrices."""
    a, b, d = M[:, 0, 0], M[:, 0, 1], M[:, 1, 1]
    return np.stack([d, -b, -b, a], -1).reshape(-1, 2, 2) / (a * d - b * b)[:, None, None]


def _two_directions(C: Array, A: Array, v: Array, used: Mask) -> tuple[Array, Index]:
    """Return T (n,) and its degrees of freedom (n,). It sums over the two directions in which the covariances C of
    measured and A of computed image points (n, 2, 2) are both diagonal; v (n, 2): residuals."""
    l11 = np.sqrt(C[:, 0, 0])
    l21 = C[:, 1, 0] / l11
    l22 = np.sqrt(C[:, 1, 1] - l21 * l21)
    # M = L^-1 A L^-T and y = L^-1 v with the Cholesky factor L of C.
    xx = A[:, 0, 0] / (l11 * l11)
    xy = (A[:, 0, 1] / l11 - l21 * xx) / l22
    yy = (A[:, 1, 1] / l22 - l21 * (2 * xy + l21 * xx / l22)) / l22
    x = v[:, 0] / l11
    y = (v[:, 1] - l21 * x) / l22
    half_difference, mean = np.hypot((xx - yy) / 2, xy), (xx + yy) / 2
    mean_square, difference = x * x + y * y, (xx - yy) / 2 * (x * x - y * y) + 2 * xy * x * y
    difference = np.divide(difference, half_difference, out=np.zeros_like(half_difference), where=half_difference > 0)
    T, freedom = np.zeros(len(v)), np.zeros(len(v), np.int64)
    for eigenvalue, square in (
        (mean + half_difference, (mean_square + difference) / 2),
        (mean - half_difference, (mean_square - difference) / 2),
    ):
        redundancy = np.where(
            used, 1 - eigenvalue, 1 / (1 + np.maximum(eigenvalue, 0.0))
        )  # of the errors shows in the residuals
        is_tested = redundancy > _CHECKED
        T += np.where(is_tested, square * np.where(used, 1 / np.where(is_tested, redundancy, 1.0), redundancy), 0.0)
        freedom += is_tested
    return T, freedom


def p_values(T: Array, freedom: Index, redundancy: Array | None = None, used: Mask | None = None) -> Array:
    """Return the p-value (N,) of T, NaN without degrees of freedom.

    If the scale is estimated with a redundancy (N,), the contribution of a used ray to it is taken into account (Pope
    1976).
    """
    from scipy.special import betainc, betaincc, chdtrc

    f = np.maximum(freedom, 1)
    if redundancy is None or used is None:
        # The tail of two degrees of freedom is elementary; the few of one need a special function.
        p_value, is_single = np.exp(-T / 2), f == 1
        p_value[is_single] = chdtrc(1, T[is_single])
        return np.where(freedom > 0, p_value, np.nan)
    r = np.maximum(redundancy, f + 1.0)
    with np.errstate(divide="ignore"):
        log_inside = (r / 2 - 1) * np.log1p(-np.minimum(T / r, 1.0))
    p_value, is_single = np.exp(np.where(used, log_inside, -r / 2 * np.log1p(T / r))), f == 1
    r, T, used = r[is_single], T[is_single], used[is_single]
    inside = betaincc(0.5, (r - 1) / 2, np.clip(T / r, 0.0, 1.0))
    p_value[is_single] = np.where(used, inside, betainc(r / 2, 0.5, r / (r + T)))
    return np.where(freedom > 0, p_value, np.nan)


def critical_values(alpha: float, freedom: Index, redundancy: Array | None, used: Mask) -> Array:
    """Return the T (N,) whose p-value by `p_values` is alpha, NaN without degrees of freedom."""
    from scipy.special import betainccinv, betaincinv, chdtri

    if redundancy is None:
        return np.array([np.nan, *chdtri([1, 2], alpha)])[freedom]
    levels, level_index = np.unique(redundancy, return_inverse=True)
    r_single, r_double = np.maximum(levels, 2.0), np.maximum(levels, 3.0)
    no_freedom = np.full((2, len(levels)), np.nan)  # of used rays, then of the others
    single = (
        r_single * betainccinv(0.5, (r_single - 1) / 2, alpha),
        r_single * (1 / betaincinv(r_single / 2, 0.5, alpha) - 1),
    )
    double = (
        -r_double * np.expm1(2 / (r_double - 2) * np.log(alpha)),
        r_double * np.expm1(-2 / r_double * np.log(alpha)),
    )
    return np.stack([no_freedom, single, double])[freedom, np.where(used, 0, 1), level_index]


@dataclass(frozen=True)
class RejectedRays:
    """Rejected rays (R,) by number, with the reason (R,)."""

    ray: Index
    reason: tuple[str, ...]


def _meeting_elsewhere(adjusted: Adjustment, components: VarianceComponents, rejected: Mask) -> Mask:
    """Return the rejected rays (N,) of points for which at least three rejected rays meet in another place."""
    network, state = adjusted.network, adjusted.state
    rays = network.rays
    limit = max(float(np.median(tolerance_px(network, np.arange(rays.count), components))), 1.0)
    with np.errstate(invalid="ignore"):
        rejected = rejected & (np.linalg.norm(adjusted.residuals_px, axis=1) > _APART_TOLERANCES * limit)
    rejected &= np.bincount(rays.point[rejected], minlength=len(network.point_pose))[rays.point] >= _FEWEST_MEETING
    rejected_numbers, meets_elsewhere = np.flatnonzero(rejected), np.zeros(rays.count, bool)
    if len(rejected_numbers):
        X, is_inlier = meeting(network, state, rejected_numbers, np.array([limit]))
        meets_elsewhere[rejected_numbers] = (
            is_inlier
            & (np.bincount(rays.point[rejected_numbers], is_inlier, minlength=len(X)) >= _FEWEST_MEETING)[
                rays.point[rejected_numbers]
            ]
        )
    return meets_elsewhere


def rejected_rays(
    network: Network,
    start: NetworkState,
    adjusted: Adjustment,
    components: VarianceComponents,
    active: Mask,
    tests: RayTests,
) -> RejectedRays:
    """Return all unused rays with the reason."""
    rays, used = network.rays, adjusted.used
    has_point, has_image = np.isfinite(start.points[rays.point, 0]), np.isfinite(start.centre[rays.image, 0])
    used_count = np.bincount(rays.point[used], minlength=len(network.point_pose))[rays.point]
    observed_count = np.bincount(rays.point[has_point & has_image], minlength=len(network.point_pose))[rays.point]
    has_rejected = (
        np.bincount(rays.point[~active & has_point & has_image], minlength=len(network.point_pose))[rays.point] > 0
    )
    reason = np.where(active, NOT_DETERMINED, np.where(np.isnan(tests.T), NOT_PREDICTED, GROSS))
    reason = np.where((observed_count == 2) & (used_count < 2) & has_rejected, ONE_OF_TWO, reason)
    reason = np.where(possible_rays(network, start), reason, BEHIND)
    reason = np.where(
        _meeting_elsewhere(adjusted, components, ~used & ~active & has_point & has_image), SECOND_TARGET, reason
    )
    reason = np.where(has_point, reason, NO_POINT)
    reason = np.where(has_image, reason, NO_IMAGE)
    unused = np.flatnonzero(~used)
    return RejectedRays(unused, tuple(reason[unused].tolist()))


def possible_rays(network: Network, start: NetworkState) -> Mask:
    """Return the rays (N,) whose image and point have start values, the point before the camera."""
    rays = network.rays
    u = np.einsum("nji,nj->ni", start.R[rays.image], start.points[rays.point] - start.centre[rays.image])
    with np.errstate(invalid="ignore"):
        return u[:, 2] > 0


def robust_start(
    network: Network, start: NetworkState, datum: Datum, active: Mask
) -> tuple[NetworkState, Mask, VarianceComponents]:
    """Return the state after adjustments with bounded influence, the rays that are not suspects, and the variance
    components from medians."""
    known = datum == "known"
    used = determinable(network, active, known=known).rays
    weights, state = np.ones(network.rays.count), start
    inverse = np.linalg.inv(network.rays.cov_px2)
    for step in range(_ROBUST_ROUNDS):
        adjust_from = partial(adjust, max_iterations=3, decrease_tolerance=_WITHIN) if step else adjust
        adjusted = adjust_from(network, state, datum, used=used, weights=weights)
        v = adjusted.residuals_px
        residual_length = np.sqrt(np.einsum("ni,nij,nj->n", v, inverse, v))
        if step == 0:
            redundancy = np.full(network.rays.count, adjusted.redundancy / max(int(used.sum()), 1))
            components = grouped(network, used, redundancy)
        components = _by_median(components, residual_length, used, adjusted.redundancy)
        residual_length = residual_length / np.sqrt(components.of_rays())
        with np.errstate(divide="ignore", invalid="ignore"):
            bounded = np.minimum(1.0, _BOUND / residual_length)
        latest = np.maximum(np.nan_to_num(bounded if step < 3 else bounded**3), 1e-9)
        change = np.abs(latest - weights)[used].max(initial=0.0)
        weights, state = latest, adjusted.state
        if change < 0.05:
            break
    return *_intersected_again(network, state, active, residual_length > _SUSPECT, components), components


def _intersected_again(
    network: Network, state: NetworkState, active: Mask, suspect: Mask, components: VarianceComponents
) -> tuple[NetworkState, Mask]:
    """Return the state and the active rays without suspects. Points with many suspects are intersected again from a
    majority of their rays: least squares, even bounded, may place such a point between two groups of rays."""
    rays, count = network.rays, len(network.point_pose)
    is_suspect_point = np.bincount(rays.point[active & suspect], minlength=count) > _MANY * np.bincount(
        rays.point[active], minlength=count
    )
    reintersected = np.flatnonzero(active & is_suspect_point[rays.point])
    active, points = active & ~suspect, state.points.copy()
    if len(reintersected):
        X, is_inlier = meeting(network, state, reintersected, tolerance_px(network, reintersected, components))
        is_placed = np.isfinite(X[:, 0])
        points[is_placed] = X[is_placed]
        active[reintersected] = np.where(is_placed[rays.point[reintersected]], is_inlier, active[reintersected])
    return replace(state, points=points), active


def tolerance_px(network: Network, rays: Index, components: VarianceComponents) -> Array:
    """Return the residual size (n,) in px above which rays are suspects."""
    variance = np.einsum("nii->n", network.rays.cov_px2[rays]) / 2 * components.of_rays()[rays]
    return _SUSPECT * np.sqrt(variance)


def meeting(network: Network, state: NetworkState, rays: Index, tolerance_px: Array) -> tuple[Array, Mask]:
    """Return the points (P, 3) on which most of the given rays (n,) agree, and which rays agree (n,)."""
    chosen = network.rays
    image, point, xy = chosen.image[rays], chosen.point[rays], chosen.xy_px[rays]
    camera = network.image_camera[image]
    towards = directions(network.cameras, state.interior, camera, xy)
    lines = Bundle(
        image, point, towards, state.interior[camera, 0], state.R, state.centre, len(network.point_pose)
    )  # fmt: skip
    return intersect(lines, float(np.median(tolerance_px)), np.random.default_rng(0))


def _by_median(
    components: VarianceComponents, residual_length: Array, used: Mask, redundancy: int
) -> VarianceComponents:
    """Return components whose factors give the median of normalised residual lengths (N,) that two normal errors
    have."""
    if redundancy <= 0:  # no redundancy: the residuals do not show the noise
        return components
    factor = components.factor.copy()
    share = redundancy / (2.0 * max(int(used.sum()), 1))
    for g in range(len(factor)):
        group_lengths = residual_length[used & (components.component == g)]
        if len(group_lengths):
            factor[g] = max(float(np.median(group_lengths)) ** 2 / (2 * np.log(2)) / share, 1e-4)
    return replace(components, factor=factor)
