"""Gross errors among rays: a robust start, then data snooping (Baarda 1968) until no ray fails its test.

The start bounds the influence of rays and rejects suspects. Rejected rays are tested against their prediction by the
other rays, and used again if they pass.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from truing.arrays import Index, Mask
from truing.estimation.bundle.adjustment import Adjustment, adjust
from truing.estimation.bundle.datum import Datum
from truing.estimation.bundle.determinable import UndeterminedNetworkError, determinable
from truing.estimation.bundle.network import Network, NetworkState
from truing.estimation.bundle.ray_tests import RayTests, passing_share, ray_tests
from truing.estimation.bundle.robust_start import STEP_WITHIN, meeting, robust_start, tolerance_px
from truing.estimation.bundle.variance_components import GlobalTest, VarianceComponents, global_test, updated_components

_MOST_ROUNDS = 60
_STEADY = 1e-3  # relative change of the variance components at convergence
_RETURNS = 2  # how often a rejected ray may be used again
_LOOSE = 0.1  # standard deviation of a loosened bar, relative to its length: it gives a scale and hardly affects points
# Interior elements in the order in which they are held fixed: the least important first.
RELEASE_ORDER = ("A3", "C2", "C1", "B2", "B1", "A2", "A1", "y0", "x0", "c")
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


@dataclass(frozen=True)
class ScreenedNetwork:
    """A network adjusted without gross errors.

    used (N,): rays in the adjustment; untested: used rays whose errors no test could show, by number. alpha: level of
    one of the `tested` tests; family_level: probability that any of that number of good rays is rejected; critical:
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
    rules = _Rules(start, datum, alpha, with_components)
    while True:
        try:
            screened = _screened(network, rules, possible, possible & ~outliers)
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


@dataclass(frozen=True)
class _Rules:
    """Start values and datum of all adjustments, level of each test of a ray, and whether variance components are
    estimated."""

    start: NetworkState
    datum: Datum
    alpha: float
    with_components: bool


def _screened(network: Network, rules: _Rules, possible: Mask, active: Mask) -> ScreenedNetwork:
    """Return the network adjusted with the possible rays (N,) that pass, starting from the active ones (N,)."""
    datum, alpha, with_components = rules.datum, rules.alpha, rules.with_components
    weak_bars_network = _with_loose_bars(network)
    screening = _screening_end(weak_bars_network, rules, possible, active)
    adjusted, tests, used = screening.adjusted, screening.tests, screening.used
    if weak_bars_network is not network:
        adjusted = adjust(network, adjusted.state, datum, used=used, variance_factor=screening.components.ray_factors())
        tests = ray_tests(adjusted, screening.components)
    tested = int((used & (tests.freedom > 0)).sum())
    stated = adjust(network, adjusted.state, datum, used=used) if with_components else adjusted
    return ScreenedNetwork(
        adjustment=adjusted,
        used=used,
        rejected=rejected_rays(network, rules.start, adjusted, screening.components, screening.active, tests),
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


def _screening_end(network: Network, rules: _Rules, possible: Mask, active: Mask) -> _ScreeningEnd:
    """Return the end of data snooping: rays fail and return in turn until all agree, or after `_MOST_ROUNDS`."""
    datum, alpha, with_components = rules.datum, rules.alpha, rules.with_components
    state, active, components = robust_start(network, rules.start, datum, active)
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
            variance_factor=components.ray_factors(),
            decrease_tolerance=decrease_tolerance,
        )
        state, tests = adjusted.state, ray_tests(adjusted, components)
        latest = updated_components(components, adjusted, tests.redundancy_blocks, passing_share(alpha))
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
        rounds, decrease_tolerance = rounds + 1, STEP_WITHIN
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
    ratio = latest.ray_factors() / components.ray_factors()
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
