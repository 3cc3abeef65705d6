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
from truing.estimation.bundle.determinable import UndeterminedNetworkError, determinable
from truing.estimation.bundle.intersection import Mask
from truing.estimation.bundle.network import Index, Network, State
from truing.estimation.bundle.ray_tests import RayTests, p_values, passing_share, ray_tests
from truing.estimation.bundle.rejected_rays import RejectedRays, rejected_rays
from truing.estimation.bundle.robust_start import possible_rays, robust_start
from truing.estimation.bundle.variance_components import GlobalTest, VarianceComponents, global_test, updated

_MOST_ROUNDS = 60
_SETTLED = 1e-3  # relative change of the variance components
_RETURNS = 2  # times that a ray may come back
_LOOSE = 0.1  # of its length: a distance that gives a scale and contradicts none
# In this order: what lenses have least of first, the principal distance last.
RELEASE_ORDER = ("A3", "C2", "C1", "B2", "B1", "A2", "A1", "y0", "x0", "c")


@dataclass(frozen=True)
class Snooped:
    """An adjusted network without gross errors: which rays (N,) were used, the rejected, those used whose errors no
    test could show (untested, by number); the level alpha of one test, how many were made, the probability family_level
    that at least one of so many good rays is rejected, the critical value of T (two degrees of freedom), rounds, how
    many rays came back, the variance components, the tests of all rays, and the test of sigma0 with the covariances as
    stated (the squares that data snooping cuts off good rays added). The adjustment's covariances are to be multiplied
    by covariance_factor: one where the components give the scale. held are elements (camera, name) of interiors that
    the network does not determine: they stay what they were at the start. by_rays is the adjustment in which several
    bars of a pose hardly hold, which bars that contradict each other do not bend."""

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
    held: tuple[tuple[str, str], ...]
    by_rays: Adjustment


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
    possible = possible_rays(network, start)
    held: tuple[tuple[str, str], ...] = ()
    doubtful = np.zeros(network.rays.count, bool) if agrees is None else ~agrees
    while True:
        try:
            found = _snooped(network, start, datum, possible, possible & ~doubtful, alpha, with_components)
            return replace(found, held=held)
        except UndeterminedNetworkError as error:
            network, possible, more = relaxed(network, possible, error)
            held = (*held, *more)


def _snooped(
    network: Network, start: State, datum: Datum, possible: Mask, active: Mask, alpha: float, with_components: bool
) -> Snooped:
    """Return the network adjusted with those of the possible rays (N,) that pass, beginning with the active ones
    (N,)."""
    known = datum == "known"
    whole, network = network, _with_loose_bars(network)
    state, active, components = robust_start(network, start, datum, active)
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
    by_rays = adjusted
    if network is not whole:
        network = whole
        adjusted = adjust(network, state, datum, used=used, variance_factor=components.of_rays())
        state, tests = adjusted.state, ray_tests(adjusted, components)
    tested = int((used & (tests.freedom > 0)).sum())
    stated = adjust(network, state, datum, used=used) if with_components else adjusted
    return Snooped(
        adjustment=adjusted,
        used=used,
        rejected=rejected_rays(network, start, adjusted, components, active, tests),
        untested=np.flatnonzero(used & (tests.freedom == 0)),
        alpha=alpha,
        tested=tested,
        family_level=float(-np.expm1(tested * np.log1p(-alpha))),
        critical=-2 * float(np.log(alpha)),
        rounds=rounds,
        returned=int(((returns > 0) & used).sum()),
        components=replace(latest, factor=components.factor) if with_components else components,
        tests=tests,
        held=(),
        by_rays=by_rays,
        covariance_factor=1.0 if with_components else adjusted.variance_factor / passing_share(alpha),
        sigma0=global_test(stated.chi2 / passing_share(alpha), stated.redundancy),
    )


def _with_loose_bars(network: Network) -> Network:
    """Return the network with distances that hardly hold, where a pose has several: bars that contradict each other
    would bend points until rays to their ends fail. What rays are good, rays tell."""
    bars = network.bars
    pose = network.point_pose[bars.first]
    if not len(pose) or np.bincount(pose).max() < 2:
        return network
    loose = np.maximum(bars.repeat_sigma_m, _LOOSE * bars.length_m[bars.bar])
    return replace(network, bars=replace(bars, repeat_sigma_m=loose))


def _rescaled(tests: RayTests, used: Mask, before: VarianceComponents, after: VarianceComponents) -> RayTests:
    """Return tests by the latest components."""
    ratio = after.of_rays() / before.of_rays()
    T = tests.T / ratio
    p_value = p_values(T, tests.freedom, after.redundancy[after.component], used)
    return replace(tests, T=T, p_value=p_value, w=tests.w / np.sqrt(ratio)[:, None])


def _settled(before: VarianceComponents, after: VarianceComponents) -> bool:
    return bool(np.all(np.abs(after.factor / before.factor - 1) < _SETTLED))


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


def relaxed(
    network: Network, possible: Mask, error: UndeterminedNetworkError
) -> tuple[Network, Mask, tuple[tuple[str, str], ...]]:
    """Return the network with one element held of those that it does not determine, the rays (N,) that can take part
    without images and points in free directions of their own, and what is held now: (camera, element) or nothing.

    Raises the error again where neither helps.
    """
    open_ = [(camera, name) for name in RELEASE_ORDER for camera, known in error.elements if known == name]
    if open_:
        return _holding(network, *open_[0]), possible, (open_[0],)
    loose = np.isin(network.rays.image, error.images) | np.isin(network.rays.point, error.points)
    if not (possible & loose).any():
        raise error
    return network, possible & ~loose, ()


def _holding(network: Network, camera: str, element: str) -> Network:
    cameras = tuple(
        replace(one, free=tuple(name for name in one.free if name != element)) if one.name == camera else one
        for one in network.cameras
    )
    return replace(network, cameras=cameras)
