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
from truing.estimation.bundle.orientation import FEWEST, Bundle, Resection, intersect, resect

_SAME_ROUND_SHARE = 0.7  # images with this share of the best one's score are oriented in the same round
_LEAST_AGREEING = 0.5  # share of the points with coordinates that must agree
_CELLS = 4  # cells per side of the format, to assess the spread of points
_FIRST_TOLERANCE = 0.01  # first tolerance over the longer side: an uncalibrated lens distorts this much or more
_LEAST_TOLERANCE = 5e-4  # least final tolerance over the longer side
_TOLERANCE_SPREADS = 6.0  # final tolerance in multiples of the spread of agreeing rays
_FREE = ((3, ("c",)), (6, ("c", "A1")), (8, ("c", "x0", "y0", "A1", "A2", "B1", "B2")))  # from so many images on
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
        for i, (turn, place) in oriented.items():
            R[i], centre[i] = turn, place
        return replace(self, rays=replace(self.rays, R=R, centre=centre))


Refine = Callable[[Grown], Grown]


def grow(seed: Grown, rng: np.random.Generator, refine: Refine, most: int | None = None) -> Grown:
    """Return the pose with all images oriented that see enough points; stop after `most` images if given.

    Images with the most points with coordinates, spread over most of the format, come first. `refine` adjusts the
    current state whenever the number of images has grown by half.
    """
    now, refined = seed, int(seed.oriented.sum())
    while most is None or now.oriented.sum() < most:
        waiting = _next_images(now)
        if not waiting:
            break
        tried = {i: _oriented(now, i) for i in waiting}
        good = {
            i: (resection.R, resection.centre) for i, resection in tried.items() if isinstance(resection, Resection)
        }
        now = replace(now, failed=now.failed | {i: t for i, t in tried.items() if not isinstance(t, Resection)})
        if good:
            now = intersected(now.with_images(good), rng)
        if now.oriented.sum() >= max(3, 1.5 * refined):
            now, refined = refine(now), int(now.oriented.sum())
    return refine(now) if now.oriented.sum() > refined else now


def intersected(now: Grown, rng: np.random.Generator) -> Grown:
    """Return the pose with all points that are given or on which rays of two oriented images agree."""
    X, agrees = intersect(now.rays, now.tolerance_px, rng)
    as_given = np.isnan(X[:, 0]) & np.isfinite(now.given[:, 0])
    X = np.where(as_given[:, None], now.given, X)
    return replace(now, X=X, agrees=agrees | (as_given[now.rays.point] & now.rays.agreeing_rays(X, now.tolerance_px)))


def _next_images(now: Grown) -> list[int]:
    """Return the images to orient next: the best by number and spread of points with coordinates."""
    rays = now.rays
    usable = np.isfinite(now.X[rays.point, 0]) & np.isfinite(rays.direction[:, 0]) & ~now.oriented[rays.image]
    count = np.bincount(rays.image[usable], minlength=len(rays.R))
    cells = np.unique(np.stack([rays.image[usable], now.cell[usable]]), axis=1)[0]
    spread = np.bincount(cells, minlength=len(rays.R))
    tried = np.zeros(len(rays.R), int)
    tried[list(now.failed)] = [seen for seen, _ in now.failed.values()]
    score = np.where((count >= FEWEST) & (count > tried), np.sqrt(count) * spread, 0.0)
    return [int(i) for i in np.flatnonzero((score > 0) & (score >= _SAME_ROUND_SHARE * score.max(initial=0.0)))]


def _oriented(now: Grown, image: int) -> Resection | tuple[int, int]:
    """Return the orientation of an image, or else the number of its points with coordinates and how many agree."""
    rays = now.rays
    here = np.flatnonzero((rays.image == image) & np.isfinite(now.X[rays.point, 0]) & np.isfinite(rays.direction[:, 0]))
    resection = resect(rays.direction[here], now.X[rays.point[here]], float(rays.scale_px[here[0]]), now.tolerance_px)
    if resection is None:
        return len(here), 0
    agreeing = int(resection.agrees.sum())
    return resection if agreeing >= _LEAST_AGREEING * len(here) else (len(here), agreeing)


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
    nothing = np.full((points, 3), np.nan)
    sight = Bundle(
        rays.image,
        rays.point,
        np.empty((rays.count, 2)),
        np.empty(rays.count),
        np.full((images, 3, 3), np.nan),
        np.full((images, 3), np.nan),
        points,
    )
    empty = Grown(
        rays=sight,
        cell=format_cells(rays.xy_px, size[:, 0], size[:, 1]),
        given=nothing,
        X=nothing,
        agrees=np.zeros(rays.count, bool),
        tolerance_px=_FIRST_TOLERANCE * _side(network),
        interior=interior,
        failed={},
    )
    return with_interior(network, empty, interior)


def _side(network: Network) -> float:
    """Return the longest side in px of a pose's images."""
    return float(longer_sides(network)[network.image_camera].max(initial=1.0))


def reopened(network: Network, now: Grown) -> Grown:
    """Return the pose with the first tolerance, so that rays rejected before the lens was known can agree."""
    wide = _FIRST_TOLERANCE * _side(network)
    return replace(now, tolerance_px=wide, agrees=now.rays.agreeing_rays(now.X, wide))


def with_interior(network: Network, now: Grown, interior: Array) -> Grown:
    """Return the pose with ray directions from another interior."""
    camera = network.image_camera[now.rays.image]
    towards = directions(network.cameras, interior, camera, network.rays.xy_px)
    return replace(now, rays=replace(now.rays, direction=towards, scale_px=interior[camera, 0]), interior=interior)


def refined(network: Network, now: Grown) -> Grown:
    """Return the adjusted pose, alone in its network, with a tolerance narrowed to the spread of its rays."""
    state = NetworkState(now.interior, now.rays.R, now.rays.centre, now.X, np.empty(0))
    done = _adjusted(network, state, now.agrees)
    return now if done is None else refreshed_pose(network, now, done.state)


def refined_together(network: Network, poses: Sequence[PoseNetwork], grown_poses: Sequence[Grown]) -> list[Grown]:
    """Return all poses after one joint adjustment with common cameras, starting with the interior of the first pose."""
    used, state = np.zeros(network.rays.count, bool), joined_poses(network, poses, grown_poses)
    for pose, now in zip(poses, grown_poses, strict=True):
        used[pose.ray] = now.agrees
    done = _adjusted(network, state, used)
    state = state if done is None else done.state
    return [refreshed_pose(p.network, now, p.part_of(state)) for p, now in zip(poses, grown_poses, strict=True)]


def joined_poses(network: Network, poses: Sequence[PoseNetwork], grown_poses: Sequence[Grown]) -> NetworkState:
    """Return all poses as one state of the whole network."""
    images, points = len(network.image_pose), len(network.point_pose)
    R, centre, X = np.full((images, 3, 3), np.nan), np.full((images, 3), np.nan), np.full((points, 3), np.nan)
    for pose, now in zip(poses, grown_poses, strict=True):
        R[pose.image], centre[pose.image], X[pose.point] = now.rays.R, now.rays.centre, now.X
    return NetworkState(grown_poses[0].interior, R, centre, X, np.empty(0))


def refreshed_pose(network: Network, now: Grown, state: NetworkState) -> Grown:
    """Return the pose with the values of a state and with agreeing rays selected again."""
    interior = with_interior(network, now, state.interior)
    mine = now.oriented
    R, centre = now.rays.R.copy(), now.rays.centre.copy()
    R[mine], centre[mine] = state.R[mine], state.centre[mine]
    X = np.where(np.isfinite(now.X), state.points, np.nan)
    rays = replace(interior.rays, R=R, centre=centre)
    off = np.linalg.norm(rays.ray_distances(X)[0], axis=1)
    spread = 1.4826 * float(np.median(off[now.agrees])) / 1.1774 if now.agrees.any() else np.inf
    side = _side(network)
    tolerance = float(np.clip(_TOLERANCE_SPREADS * spread, _LEAST_TOLERANCE * side, now.tolerance_px))
    return replace(interior, rays=rays, X=X, tolerance_px=tolerance, agrees=rays.agreeing_rays(X, tolerance))


def _adjusted(network: Network, state: NetworkState, used: Mask) -> Adjustment | None:
    """Return the robust free adjustment of the used rays, or None if it fails."""
    bare = replace(network, bars=Bars.none(), known=KnownPoints.none())
    used = determinable(bare, used).rays
    images = np.unique(bare.rays.image[used])
    count = np.bincount(network.image_camera[images], minlength=len(network.cameras))
    for free in (count, np.zeros_like(count)):
        released = replace(bare, cameras=_released(network, free))
        try:
            with np.errstate(all="ignore"):  # a wrong start may diverge; such a result is discarded
                done = _bounded(released, state, used)
        except (UndeterminedNetworkError, np.linalg.LinAlgError):
            continue
        change = (done.state.interior[:, 0] / state.interior[:, 0])[count > 0]
        finite = np.isfinite(done.state.centre[images]).all() and np.isfinite(done.residuals_px[used]).all()
        if finite and ((change > _PLAUSIBLE_DISTANCE_RATIO[0]) & (change < _PLAUSIBLE_DISTANCE_RATIO[1])).all():
            return done
    return None


def _released(network: Network, images: Index) -> tuple:
    """Return the cameras with as many free interior elements as the number of images (C,) determines."""
    names = [next((names for least, names in reversed(_FREE) if n >= least), ()) for n in images]
    return tuple(
        replace(camera, free=tuple(name for name in wanted if name in camera.free))
        for camera, wanted in zip(network.cameras, names, strict=True)
    )


def _bounded(network: Network, state: NetworkState, used: Mask) -> Adjustment:
    """Return the adjustment with Huber weights beyond some spreads, after a few rounds."""
    weights = np.ones(len(used))
    for step in range(_ROUNDS):
        within = _WITHIN if step else 0.0
        done = adjust(network, state, "free", used=used, weights=weights, max_iterations=30, within=within)
        off = np.linalg.norm(done.residuals_px, axis=1)
        # Spread of one coordinate, from the median of a Rayleigh distribution.
        spread = np.median(off[used]) / 1.1774 + 1e-9
        with np.errstate(divide="ignore", invalid="ignore"):
            weights = np.where(used, np.minimum(1.0, _BOUND * spread / off), 1.0)
        weights, state = np.nan_to_num(weights, nan=1e-6), done.state
    return done
