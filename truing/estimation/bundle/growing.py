"""Orient all images from a few: resection and intersection in turn, with adjustments in between.

The adjustments use consistent rays only, bound the influence of gross errors, and free few elements of the interior.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.estimation.bundle.adjustment import Adjustment, adjust
from truing.estimation.bundle.camera import directions
from truing.estimation.bundle.determinable import UndeterminedNetworkError, determinable
from truing.estimation.bundle.network import Bars, KnownPoints, Network, NetworkState, PoseNetwork
from truing.estimation.bundle.orientation import FEWEST_POINTS, Bundle, Resection, intersect, resect

_SAME_ROUND_SHARE = 0.7  # images with this share of the best one's score are oriented in the same round
_LEAST_AGREEING = 0.5  # share of the points with coordinates that must agree
_CELLS = 4  # cells per side of the format, to assess the spread of points
_FIRST_TOLERANCE = 0.01  # first tolerance over the longer side: an uncalibrated lens distorts this much or more
_LEAST_TOLERANCE = 5e-4  # least final tolerance over the longer side
_TOLERANCE_SPREADS = 6.0  # final tolerance in multiples of the spread of agreeing rays
_FREE = ((3, ("c",)), (6, ("c", "A1")), (8, ("c", "x0", "y0", "A1", "A2", "B1", "B2")))  # from this many images on
_ROUNDS = 3  # of bounded influence
_WITHIN = 1e-2  # remaining sum of squares after the first of these rounds: far below the tolerance of agreement
_BOUND = 2.0  # spreads up to which a ray has full weight
_PLAUSIBLE_DISTANCE_RATIO = (0.4, 2.5)  # range of an adjusted principal distance relative to its start


@dataclass(frozen=True)
class Grown:
    """Images and points of one pose found so far.

    rays: with R and centre of their images (NaN if not oriented); cell (N,): cell of the format by number; given (P,
    3): coordinates known beforehand; X (P, 3): points (NaN if not placed); agrees (N,): rays within tolerance_px;
    interior (C, 10) in use; failed: per image that could not be oriented, the number of points with coordinates and how
    many agreed.
    """

    rays: Bundle
    cell: Index
    given: Array
    X: Array
    agrees: Mask
    tolerance_px: float
    interior: Array
    failed: dict[int, tuple[int, int]]

    @property
    def oriented(self) -> Mask:
        """Mask (I,) of oriented images."""
        return np.isfinite(self.rays.centre[:, 0])

    def with_images(self, oriented: dict[int, tuple[Array, Array]]) -> Grown:
        """Return a copy with some images oriented: (R, centre) by number."""
        R, centre = self.rays.R.copy(), self.rays.centre.copy()
        for i, (rotation, position) in oriented.items():
            R[i], centre[i] = rotation, position
        return replace(self, rays=replace(self.rays, R=R, centre=centre))


Refine = Callable[[Grown], Grown]


def grow(seed: Grown, rng: np.random.Generator, refine: Refine, max_images: int | None = None) -> Grown:
    """Return the pose with all images oriented that see enough points; stop after `max_images` images if given.

    Images with the most points with coordinates, spread over most of the format, come first. `refine` adjusts the
    current state whenever the number of images has grown by half.
    """
    grown, refined = seed, int(seed.oriented.sum())
    while max_images is None or grown.oriented.sum() < max_images:
        next_images = _next_images(grown)
        if not next_images:
            break
        resections = {i: _oriented(grown, i) for i in next_images}
        orientations = {
            i: (resection.R, resection.centre)
            for i, resection in resections.items()
            if isinstance(resection, Resection)
        }
        grown = replace(
            grown,
            failed=grown.failed
            | {i: failure for i, failure in resections.items() if not isinstance(failure, Resection)},
        )
        if orientations:
            grown = intersected(grown.with_images(orientations), rng)
        if grown.oriented.sum() >= max(3, 1.5 * refined):
            grown, refined = refine(grown), int(grown.oriented.sum())
    return refine(grown) if grown.oriented.sum() > refined else grown


def intersected(grown: Grown, rng: np.random.Generator) -> Grown:
    """Return the pose with all points that are given or on which rays of two oriented images agree."""
    X, inliers = intersect(grown.rays, grown.tolerance_px, rng)
    as_given = np.isnan(X[:, 0]) & np.isfinite(grown.given[:, 0])
    X = np.where(as_given[:, None], grown.given, X)
    return replace(
        grown, X=X, agrees=inliers | (as_given[grown.rays.point] & grown.rays.agreeing_rays(X, grown.tolerance_px))
    )


def _next_images(grown: Grown) -> list[int]:
    """Return the images to orient next: the best by number and spread of points with coordinates."""
    rays = grown.rays
    usable = np.isfinite(grown.X[rays.point, 0]) & np.isfinite(rays.direction[:, 0]) & ~grown.oriented[rays.image]
    count = np.bincount(rays.image[usable], minlength=len(rays.R))
    cells = np.unique(np.stack([rays.image[usable], grown.cell[usable]]), axis=1)[0]
    spread = np.bincount(cells, minlength=len(rays.R))
    tried_count = np.zeros(len(rays.R), int)
    tried_count[list(grown.failed)] = [count_at_failure for count_at_failure, _ in grown.failed.values()]
    score = np.where((count >= FEWEST_POINTS) & (count > tried_count), np.sqrt(count) * spread, 0.0)
    return [int(i) for i in np.flatnonzero((score > 0) & (score >= _SAME_ROUND_SHARE * score.max(initial=0.0)))]


def _oriented(grown: Grown, image: int) -> Resection | tuple[int, int]:
    """Return the orientation of an image, or else the number of its points with coordinates and how many agree."""
    rays = grown.rays
    ray_numbers = np.flatnonzero(
        (rays.image == image) & np.isfinite(grown.X[rays.point, 0]) & np.isfinite(rays.direction[:, 0])
    )
    resection = resect(
        rays.direction[ray_numbers],
        grown.X[rays.point[ray_numbers]],
        float(rays.scale_px[ray_numbers[0]]),
        grown.tolerance_px,
    )
    if resection is None:
        return len(ray_numbers), 0
    inlier_count = int(resection.agrees.sum())
    return resection if inlier_count >= _LEAST_AGREEING * len(ray_numbers) else (len(ray_numbers), inlier_count)


def format_cells(xy_px: Array, width_px: Array, height_px: Array, per_side: int = _CELLS) -> Index:
    """Return the cell (N,) of the format, by number, of image points xy_px (N, 2)."""
    xy = np.nan_to_num(xy_px)
    column = np.clip((xy[:, 0] + 0.5) / width_px * per_side, 0, per_side - 1).astype(int)
    row = np.clip((xy[:, 1] + 0.5) / height_px * per_side, 0, per_side - 1).astype(int)
    return row * per_side + column


def longer_sides(network: Network) -> Array:
    """Return the longer side (C,) in px of each camera's format."""
    return np.array([max(camera.width_px, camera.height_px) for camera in network.cameras], float)


def prepare(network: Network, interior: Array) -> Grown:
    """Return a pose, alone in its network, without any orientation yet."""
    rays, camera = network.rays, network.image_camera
    images, points = len(camera), len(network.point_pose)
    size = np.array([[c.width_px, c.height_px] for c in network.cameras], float)[camera[rays.image]]
    unknown_points = np.full((points, 3), np.nan)
    bundle = Bundle(
        rays.image,
        rays.point,
        np.empty((rays.count, 2)),
        np.empty(rays.count),
        np.full((images, 3, 3), np.nan),
        np.full((images, 3), np.nan),
        points,
    )
    empty = Grown(
        rays=bundle,
        cell=format_cells(rays.xy_px, size[:, 0], size[:, 1]),
        given=unknown_points,
        X=unknown_points,
        agrees=np.zeros(rays.count, bool),
        tolerance_px=_FIRST_TOLERANCE * _side(network),
        interior=interior,
        failed={},
    )
    return with_interior(network, empty, interior)


def _side(network: Network) -> float:
    """Return the longest side in px of a pose's images."""
    return float(longer_sides(network)[network.image_camera].max(initial=1.0))


def reopened(network: Network, grown: Grown) -> Grown:
    """Return the pose with the first tolerance, so that rays rejected before the lens was known can agree."""
    tolerance_px = _FIRST_TOLERANCE * _side(network)
    return replace(grown, tolerance_px=tolerance_px, agrees=grown.rays.agreeing_rays(grown.X, tolerance_px))


def with_interior(network: Network, grown: Grown, interior: Array) -> Grown:
    """Return the pose with ray directions from another interior."""
    camera = network.image_camera[grown.rays.image]
    towards = directions(network.cameras, interior, camera, network.rays.xy_px)
    return replace(grown, rays=replace(grown.rays, direction=towards, scale_px=interior[camera, 0]), interior=interior)


def refined(network: Network, grown: Grown) -> Grown:
    """Return the adjusted pose, alone in its network, with a tolerance narrowed to the spread of its rays."""
    state = NetworkState(grown.interior, grown.rays.R, grown.rays.centre, grown.X, np.empty(0))
    adjustment = _adjusted(network, state, grown.agrees)
    return grown if adjustment is None else refreshed_pose(network, grown, adjustment.state)


def refined_together(network: Network, poses: Sequence[PoseNetwork], grown_poses: Sequence[Grown]) -> list[Grown]:
    """Return all poses after one joint adjustment with common cameras, starting with the interior of the first pose."""
    used, state = np.zeros(network.rays.count, bool), joined_poses(network, poses, grown_poses)
    for pose, grown in zip(poses, grown_poses, strict=True):
        used[pose.ray] = grown.agrees
    adjustment = _adjusted(network, state, used)
    state = state if adjustment is None else adjustment.state
    return [refreshed_pose(p.network, grown, p.part_of(state)) for p, grown in zip(poses, grown_poses, strict=True)]


def joined_poses(network: Network, poses: Sequence[PoseNetwork], grown_poses: Sequence[Grown]) -> NetworkState:
    """Return all poses as one state of the whole network."""
    images, points = len(network.image_pose), len(network.point_pose)
    R, centre, X = np.full((images, 3, 3), np.nan), np.full((images, 3), np.nan), np.full((points, 3), np.nan)
    for pose, grown in zip(poses, grown_poses, strict=True):
        R[pose.image], centre[pose.image], X[pose.point] = grown.rays.R, grown.rays.centre, grown.X
    return NetworkState(grown_poses[0].interior, R, centre, X, np.empty(0))


def refreshed_pose(network: Network, grown: Grown, state: NetworkState) -> Grown:
    """Return the pose with the values of a state and with agreeing rays selected again."""
    with_new_interior = with_interior(network, grown, state.interior)
    oriented = grown.oriented
    R, centre = grown.rays.R.copy(), grown.rays.centre.copy()
    R[oriented], centre[oriented] = state.R[oriented], state.centre[oriented]
    X = np.where(np.isfinite(grown.X), state.points, np.nan)
    rays = replace(with_new_interior.rays, R=R, centre=centre)
    residual_px = np.linalg.norm(rays.ray_distances(X)[0], axis=1)
    sigma_px = 1.4826 * float(np.median(residual_px[grown.agrees])) / 1.1774 if grown.agrees.any() else np.inf
    side = _side(network)
    tolerance = float(np.clip(_TOLERANCE_SPREADS * sigma_px, _LEAST_TOLERANCE * side, grown.tolerance_px))
    return replace(with_new_interior, rays=rays, X=X, tolerance_px=tolerance, agrees=rays.agreeing_rays(X, tolerance))


def _adjusted(network: Network, state: NetworkState, used: Mask) -> Adjustment | None:
    """Return the robust free adjustment of the used rays, or None if it fails."""
    rays_only = replace(network, bars=Bars.none(), known=KnownPoints.none())
    used = determinable(rays_only, used).rays
    images = np.unique(rays_only.rays.image[used])
    count = np.bincount(network.image_camera[images], minlength=len(network.cameras))
    for free in (count, np.zeros_like(count)):
        released = replace(rays_only, cameras=_released(network, free))
        try:
            with np.errstate(all="ignore"):  # a wrong start may diverge; such a result is discarded
                adjustment = _bounded(released, state, used)
        except (UndeterminedNetworkError, np.linalg.LinAlgError):
            continue
        distance_ratio = (adjustment.state.interior[:, 0] / state.interior[:, 0])[count > 0]
        is_finite = (
            np.isfinite(adjustment.state.centre[images]).all() and np.isfinite(adjustment.residuals_px[used]).all()
        )
        if (
            is_finite
            and (
                (distance_ratio > _PLAUSIBLE_DISTANCE_RATIO[0]) & (distance_ratio < _PLAUSIBLE_DISTANCE_RATIO[1])
            ).all()
        ):
            return adjustment
    return None


def _released(network: Network, images: Index) -> tuple:
    """Return the cameras with as many free interior elements as the number of images (C,) determines."""
    names = [next((names for min_images, names in reversed(_FREE) if n >= min_images), ()) for n in images]
    return tuple(
        replace(camera, free=tuple(name for name in free_names if name in camera.free))
        for camera, free_names in zip(network.cameras, names, strict=True)
    )


def _bounded(network: Network, state: NetworkState, used: Mask) -> Adjustment:
    """Return the adjustment with Huber weights beyond some spreads, after a few rounds."""
    weights = np.ones(len(used))
    for step in range(_ROUNDS):
        decrease_tolerance = _WITHIN if step else 0.0
        adjustment = adjust(
            network, state, "free", used=used, weights=weights, max_iterations=30, decrease_tolerance=decrease_tolerance
        )
        residual_px = np.linalg.norm(adjustment.residuals_px, axis=1)
        # Spread of one coordinate, from the median of a Rayleigh distribution.
        sigma_px = np.median(residual_px[used]) / 1.1774 + 1e-9
        with np.errstate(divide="ignore", invalid="ignore"):
            weights = np.where(used, np.minimum(1.0, _BOUND * sigma_px / residual_px), 1.0)
        weights, state = np.nan_to_num(weights, nan=1e-6), adjustment.state
    return adjustment
