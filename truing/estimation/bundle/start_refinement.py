"""Adjustments between the steps of a start: rays that agree, gross errors bounded, few elements of the interior
free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from truing.estimation.bundle.adjustment import Adjustment, adjust
from truing.estimation.bundle.determinable import UndeterminedNetworkError, determinable
from truing.estimation.bundle.directions import directions
from truing.estimation.bundle.growing import Grown, format_cells
from truing.estimation.bundle.intersection import Bundle, Mask
from truing.estimation.bundle.network import Array, Bars, Index, KnownPoints, Network, State
from truing.estimation.bundle.pose_networks import PoseNetwork

_WIDE_PER_SIDE = 0.01  # tolerance at first, over the longer side: a lens not calibrated yet bends so much and more
_NARROW_PER_SIDE = 5e-4  # and at last, or
_SPREADS = 6.0  # times the spread of what agrees
_FREE = ((3, ("c",)), (6, ("c", "A1")), (8, ("c", "x0", "y0", "A1", "A2", "B1", "B2")))  # from so many images on
_ROUNDS = 3  # of bounded influence
_BOUND = 2.0  # spreads up to which a ray has full weight
_PLAUSIBLE = (0.4, 2.5)  # range of an adjusted principal distance over that before


def longer_sides(network: Network) -> Array:
    """Return the longer side (C,) in px of every camera's format."""
    return np.array([max(camera.width_px, camera.height_px) for camera in network.cameras], float)


def prepare(network: Network, interior: Array) -> Grown:
    """Return a pose, alone in its network, of which nothing is oriented yet."""
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
        tolerance_px=_WIDE_PER_SIDE * _side(network),
        interior=interior,
        failed={},
    )
    return with_interior(network, empty, interior)


def _side(network: Network) -> float:
    """Return the longest side in px of a pose's images."""
    return float(longer_sides(network)[network.image_camera].max(initial=1.0))


def reopened(network: Network, now: Grown) -> Grown:
    """Return the pose with the tolerance it began with: what a lens not known yet bent too far may agree after all."""
    wide = _WIDE_PER_SIDE * _side(network)
    return replace(now, tolerance_px=wide, agrees=now.rays.agree(now.X, wide))


def with_interior(network: Network, now: Grown, interior: Array) -> Grown:
    """Return the pose with its rays directed as another interior says."""
    camera = network.image_camera[now.rays.image]
    towards = directions(network.cameras, interior, camera, network.rays.xy_px)
    return replace(now, rays=replace(now.rays, direction=towards, scale_px=interior[camera, 0]), interior=interior)


def refined(network: Network, now: Grown) -> Grown:
    """Return the pose, alone in its network, adjusted, with the tolerance narrowed to what the rays show."""
    state = State(now.interior, now.rays.R, now.rays.centre, now.X, np.empty(0))
    done = _adjusted(network, state, now.agrees)
    return now if done is None else taken_over(network, now, done.state)


def refined_together(network: Network, poses: Sequence[PoseNetwork], found: Sequence[Grown]) -> list[Grown]:
    """Return all poses after one adjustment with their cameras in common; they start with the interior of the first."""
    used, state = np.zeros(network.rays.count, bool), joined(network, poses, found)
    for pose, now in zip(poses, found, strict=True):
        used[pose.ray] = now.agrees
    done = _adjusted(network, state, used)
    state = state if done is None else done.state
    return [taken_over(p.network, now, p.part_of(state)) for p, now in zip(poses, found, strict=True)]


def joined(network: Network, poses: Sequence[PoseNetwork], found: Sequence[Grown]) -> State:
    """Return all poses as one state of the whole network."""
    images, points = len(network.image_pose), len(network.point_pose)
    R, centre, X = np.full((images, 3, 3), np.nan), np.full((images, 3), np.nan), np.full((points, 3), np.nan)
    for pose, now in zip(poses, found, strict=True):
        R[pose.image], centre[pose.image], X[pose.point] = now.rays.R, now.rays.centre, now.X
    return State(found[0].interior, R, centre, X, np.empty(0))


def taken_over(network: Network, now: Grown, state: State) -> Grown:
    """Return the pose with the values of a state, which rays agree with them judged anew."""
    own = with_interior(network, now, state.interior)
    mine = now.oriented
    R, centre = now.rays.R.copy(), now.rays.centre.copy()
    R[mine], centre[mine] = state.R[mine], state.centre[mine]
    X = np.where(np.isfinite(now.X), state.points, np.nan)
    rays = replace(own.rays, R=R, centre=centre)
    off = np.linalg.norm(rays.misses(X)[0], axis=1)
    spread = 1.4826 * float(np.median(off[now.agrees])) / 1.1774 if now.agrees.any() else np.inf
    side = _side(network)
    tolerance = float(np.clip(_SPREADS * spread, _NARROW_PER_SIDE * side, now.tolerance_px))
    return replace(own, rays=rays, X=X, tolerance_px=tolerance, agrees=rays.agree(X, tolerance))


def _adjusted(network: Network, state: State, used: Mask) -> Adjustment | None:
    """Return the free adjustment of the rays used, influence bounded; None where it cannot be done."""
    bare = replace(network, bars=Bars.none(), known=KnownPoints.none())
    used = determinable(bare, used).rays
    images = np.unique(bare.rays.image[used])
    count = np.bincount(network.image_camera[images], minlength=len(network.cameras))
    for free in (count, np.zeros_like(count)):
        released = replace(bare, cameras=_released(network, free))
        try:
            with np.errstate(all="ignore"):  # a false beginning may lead anywhere, and is not taken over
                done = _bounded(released, state, used)
        except (UndeterminedNetworkError, np.linalg.LinAlgError):
            continue
        change = (done.state.interior[:, 0] / state.interior[:, 0])[count > 0]
        finite = np.isfinite(done.state.centre[images]).all() and np.isfinite(done.residuals_px[used]).all()
        if finite and ((change > _PLAUSIBLE[0]) & (change < _PLAUSIBLE[1])).all():
            return done
    return None


def _released(network: Network, images: Index) -> tuple:
    """Return the cameras with as much of their interior free as so many images (C,) determine."""
    names = [next((names for least, names in reversed(_FREE) if n >= least), ()) for n in images]
    return tuple(
        replace(camera, free=tuple(name for name in wanted if name in camera.free))
        for camera, wanted in zip(network.cameras, names, strict=True)
    )


def _bounded(network: Network, state: State, used: Mask) -> Adjustment:
    """Adjust with weights that fall off beyond some spreads (Huber), a few rounds."""
    weights = np.ones(len(used))
    for _ in range(_ROUNDS):
        done = adjust(network, state, "free", used=used, weights=weights, max_iterations=30)
        off = np.linalg.norm(done.residuals_px, axis=1)
        spread = np.median(off[used]) / 1.1774 + 1e-9  # of one coordinate: the median of a Rayleigh distribution
        with np.errstate(divide="ignore", invalid="ignore"):
            weights = np.where(used, np.minimum(1.0, _BOUND * spread / off), 1.0)
        weights, state = np.nan_to_num(weights, nan=1e-6), done.state
    return done
