"""Adjust a named network: start values, robust adjustment, circles without a code, eccentricity."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.estimation.bundle.adjustment import Adjustment
from truing.estimation.bundle.data_snooping import ScreenedNetwork, adjust_robustly
from truing.estimation.bundle.datum import Datum
from truing.estimation.bundle.determinable import UndeterminedNetworkError
from truing.estimation.bundle.eccentricity import facing, network_eccentricity
from truing.estimation.bundle.known_points import KnownTested, tested_known, with_weak_known_points
from truing.estimation.bundle.network import ImagePoints, NamedNetwork, Names, Network, NetworkState, Pose
from truing.estimation.bundle.start_values import Start, find_start
from truing.estimation.bundle.uncoded_matching import Circles, OrientedImages, match_uncoded

_FEWEST_KNOWN = 4  # three known points may fit anywhere
_MISMATCH = 0.01  # tolerance relative to the extent of a pose's known points
_BEYOND_SIGMA = 10.0
_MANY_MISMATCHES = 0.25  # share of known points elsewhere; fewer are single gross errors
_SEARCH_MARGIN = (
    0.5  # margin around the coded points in which circles without a code are searched, relative to their extent
)


@dataclass(frozen=True)
class KnownPointMismatch:
    """A pose with many known points away from the intersection of their rays; furthest: the worst point and its
    distance in m."""

    pose: Pose
    elsewhere: int
    known: int
    furthest: str
    off_m: float


class KnownPointMismatchError(ValueError):
    """Known points belong to another object, frame or naming than the rays."""

    def __init__(self, poses: Sequence[KnownPointMismatch]) -> None:
        super().__init__(f"known points of {len(poses)} poses lie elsewhere than their rays meet")
        self.poses = tuple(poses)


@dataclass(frozen=True)
class Choices:
    """Options of an adjustment: datum, level of the ray tests, whether the noise of cameras and target kinds is
    estimated; whether eccentricities are corrected, and the radii of circles by point name ("": all others)."""

    datum: Datum
    false_alarm: float
    variance_components: bool
    eccentricity: bool
    radius_m: Mapping[str, float]

    def radii(self, points: Names) -> Array:
        """Return the radii (P,) in m of points by name, NaN if unknown."""
        otherwise = self.radius_m.get("", np.nan)
        return np.array([self.radius_m.get(name, otherwise) for name in points], dtype=float)


@dataclass(frozen=True)
class AdjustedNetwork:
    """Adjusted network with names and the last robust adjustment.

    eccentricity (N, 2) in px subtracted from each ray; unused rows (M,) of image_points with the reason (M,); start
    values of the named points; ratio of apparent to stated width of circles (P,), NaN if either is unknown; tests of
    the known points.
    """

    named: NamedNetwork
    screened: ScreenedNetwork
    eccentricity_px: Array
    unmatched: Index
    unmatched_reason: Names
    start: Start
    width_over_stated: Array
    known: KnownTested = field(default_factory=KnownTested)

    @property
    def adjustment(self) -> Adjustment:
        """The last adjustment."""
        return self.screened.adjustment


def adjust_network(
    named: NamedNetwork,
    table: ImagePoints,
    interior: Array,
    choices: Choices,
    progress: Callable[[int, int, str], None],
) -> AdjustedNetwork:
    """Return the adjusted network of all rays, including circles without a code.

    interior (C, 10): start values, NaN for an unknown principal distance. progress: steps done, total steps, next step.
    Raises UndeterminedNetworkError, and KnownPointMismatchError if the datum is of another object.
    """
    progress(0, 4, "start values")
    start = find_start(named.network, interior, named.markers)
    if choices.datum == "known" and (elsewhere := known_elsewhere(named, start.state)):
        raise KnownPointMismatchError(elsewhere)
    progress(1, 4, f"adjusting {named.network.rays.count:,} rays")
    known, agrees, state = KnownTested(), start.ray_agrees, start.state
    if choices.datum == "known":
        known, agrees, state = _against_known(named.network, start, choices)
        named = replace(named, network=known.consistent(named.network))
    screened_network = _robustly(named.network, state, choices, agrees)
    progress(2, 4, "matching circles without code")
    network_used, state, unmatched, reason = _with_circles(named, table, screened_network)
    if len(network_used.points) > len(named.points):
        agrees = np.concatenate(
            [screened_network.used, np.ones(network_used.network.rays.count - len(screened_network.used), bool)]
        )
        screened_network = _robustly(network_used.network, state, choices, agrees)
    off, radii = np.zeros((network_used.network.rays.count, 2)), choices.radii(network_used.points)
    seen_radii = np.full(len(radii), np.nan)
    if choices.eccentricity:
        off, seen_radii = eccentricities(
            network_used, table, screened_network.adjustment.state, screened_network.used, radii
        )
    if off.any():
        progress(3, 4, "centres of circles")
        centres = replace(network_used.network.rays, xy_px=network_used.network.rays.xy_px - off)
        network_used = replace(network_used, network=replace(network_used.network, rays=centres))
        screened_network = _robustly(
            network_used.network, screened_network.adjustment.state, choices, screened_network.used
        )
    return AdjustedNetwork(network_used, screened_network, off, unmatched, reason, start, seen_radii / radii, known)


def known_elsewhere(named: NamedNetwork, state: NetworkState) -> list[KnownPointMismatch]:
    """Return the poses with many known points away from the intersection of their rays.

    Rays locate points to far less than a hundredth of the object, so these coordinates belong to another object, frame
    or naming.
    """
    known, known_point_mismatches = named.network.known, []
    pose = named.network.point_pose[known.point]
    for number, name in enumerate(named.poses):
        index = np.flatnonzero((pose == number) & np.isfinite(state.points[known.point, 0]))
        if len(index) < _FEWEST_KNOWN:
            continue
        xyz = known.xyz_m[index]
        extent = float(np.sqrt(((xyz - xyz.mean(axis=0)) ** 2).sum(axis=1).mean()))
        off = np.linalg.norm(state.points[known.point[index]] - xyz, axis=1)
        sigma = np.sqrt(np.einsum("nii->n", known.cov_m2[index]))
        elsewhere = off > np.maximum(_MISMATCH * extent, _BEYOND_SIGMA * sigma)
        if elsewhere.mean() > _MANY_MISMATCHES:
            worst = int(np.argmax(off))
            furthest = str(named.points[known.point[index[worst]]])
            known_point_mismatches.append(
                KnownPointMismatch(name, int(elsewhere.sum()), len(index), furthest, float(off[worst]))
            )
    return known_point_mismatches


def _against_known(network: Network, start: Start, choices: Choices) -> tuple[KnownTested, Mask, NetworkState]:
    """Return the test of weak known points, the rays that agree with each other, and the state."""
    try:
        screened = _robustly(with_weak_known_points(network, start.state), start.state, choices, start.ray_agrees)
    except UndeterminedNetworkError:  # for example single photographs, which only known points orient
        return KnownTested(), start.ray_agrees, start.state
    known_tested = tested_known(network, screened)
    state, points = screened.adjustment.state, start.state.points
    state = replace(state, points=np.where(np.isfinite(points), state.points, points))
    return known_tested, screened.used if known_tested.rows else start.ray_agrees, state


def _robustly(network: Network, state: NetworkState, choices: Choices, inliers: Mask) -> ScreenedNetwork:
    return adjust_robustly(
        network,
        state,
        choices.datum,
        inliers=inliers,
        alpha=choices.false_alarm,
        with_components=choices.variance_components,
    )


def _with_circles(
    named: NamedNetwork, table: ImagePoints, screened_network: ScreenedNetwork
) -> tuple[NamedNetwork, NetworkState, Index, Names]:
    """Return the network with points from circles without a code, its state, and the rows without a point with the
    reason."""
    adjusted, network_used = screened_network.adjustment, named
    state = adjusted.state
    nameless = np.flatnonzero(table.point == "")
    reason = np.full(len(nameless), "", dtype=object)
    coordinates = [state.points]
    for pose in range(len(named.poses)):
        in_pose = np.flatnonzero(table.pose[nameless] == pose)
        if not len(in_pose):
            continue
        rows, (images, local) = nameless[in_pose], _oriented(screened_network, pose)
        matched = match_uncoded(Circles(local[table.image[rows]], table.xy_px[rows], table.cov_px2[rows]), images)
        reason[in_pose] = matched.reason
        is_matched = matched.point >= 0
        names = np.array([f"circle-{number + 1}" for number in range(len(matched.xyz_m))], dtype=object)
        coordinates.append(matched.xyz_m)
        good_rows = rows[is_matched]
        network_used = network_used.with_rays(
            table.image[good_rows], matched.point[is_matched], good_rows, table, names
        )
    is_unmatched = reason != ""
    points = np.concatenate(coordinates)
    state = replace(state, points=points)
    return network_used, state, nameless[is_unmatched], reason[is_unmatched]


def _oriented(screened_network: ScreenedNetwork, pose: int) -> tuple[OrientedImages, Index]:
    """Return the oriented images of a pose with their covariance, and their numbers in the network."""
    adjusted = screened_network.adjustment
    network, state, covariance = adjusted.network, adjusted.state, adjusted.covariance
    images_of_pose = np.flatnonzero(network.image_pose == pose)
    local = np.full(len(network.image_pose), -1, np.int64)
    local[images_of_pose] = np.arange(len(images_of_pose))
    cov, centre = np.full((len(images_of_pose), 6, 6), np.nan), np.full((len(images_of_pose), 3), np.nan)
    adjusted_images = covariance.image_numbers(pose)
    if len(adjusted_images):
        cov[local[adjusted_images]] = covariance.images(pose)
        centre[local[adjusted_images]] = state.centre[adjusted_images]
    points = state.points[covariance.point_numbers(pose)] if len(adjusted_images) else np.zeros((0, 3))
    box = _box(points)
    R = np.where(np.isfinite(centre)[:, :1, None], state.R[images_of_pose], np.eye(3))
    images = OrientedImages(
        network.cameras, state.interior, network.image_camera[images_of_pose], R, centre, np.nan_to_num(cov), box
    )
    return images, local


def _box(points: Array) -> Array:
    """Return the box (2, 3) in which circles without a code are searched: around the points (p, 3) with a margin."""
    if not len(points):
        return np.zeros((2, 3))
    low, high = points.min(axis=0), points.max(axis=0)
    margin = _SEARCH_MARGIN * float(np.linalg.norm(high - low))
    return np.array([low - margin, high + margin])


def eccentricities(
    named: NamedNetwork, table: ImagePoints, state: NetworkState, used: Mask, radius_m: Array
) -> tuple[Array, Array]:
    """Return the eccentricities (N, 2) in px of all rays, and the radii (P,) in m from the ellipses (NaN without).

    0 if no ellipse was measured, or if the ellipses of the point leave two normals. used (N,): rays with reliable
    ellipses; radius_m (P,): stated radii of circles, NaN if unknown.
    """
    rays = named.network.rays
    axes = np.where(used[:, None], table.semi_axes_px[named.row], np.nan)
    if not np.isfinite(axes).all(axis=1).any():
        return np.zeros((rays.count, 2)), np.full(len(state.points), np.nan)
    sigma = np.sqrt(np.einsum("nii->n", rays.cov_px2) / 2)
    eccentricity = facing(named.network, state, rays.image, rays.point, axes, table.angle_rad[named.row], sigma)
    radius = np.where(np.isfinite(radius_m), radius_m, eccentricity.radius_m)
    offset_px = network_eccentricity(named.network, state, rays.image, rays.point, eccentricity.normal, radius)
    no_ellipse = np.isnan(table.semi_axes_px[named.row]).any(axis=1, keepdims=True)
    return np.where(no_ellipse | ~np.isfinite(offset_px), 0.0, offset_px), eccentricity.radius_m
