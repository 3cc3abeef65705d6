"""A robust start of data snooping: bounded influence, then suspects put aside."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from truing.estimation.bundle.adjustment import adjust
from truing.estimation.bundle.datum import Datum
from truing.estimation.bundle.determinable import determinable
from truing.estimation.bundle.directions import directions
from truing.estimation.bundle.intersection import Bundle, Mask, intersect
from truing.estimation.bundle.network import Array, Index, Network, State
from truing.estimation.bundle.variance_components import VarianceComponents, grouped

_ROBUST_ROUNDS = 8
_BOUND = 2.5  # standard deviations up to which a ray has full weight in the robust start
_SUSPECT = 6.0  # and from which on it begins data snooping as rejected
_MANY = 1 / 3  # of a point's rays are suspects: it is intersected anew


def possible_rays(network: Network, start: State) -> Mask:
    """Return the rays (N,) whose image and point have start values, the point before the camera."""
    rays = network.rays
    u = np.einsum("nji,nj->ni", start.R[rays.image], start.points[rays.point] - start.centre[rays.image])
    with np.errstate(invalid="ignore"):
        return u[:, 2] > 0


def robust_start(network: Network, start: State, datum: Datum, active: Mask) -> tuple[State, Mask, VarianceComponents]:
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
    return *_reseated(network, state, active, off > _SUSPECT, components), components


def _reseated(
    network: Network, state: State, active: Mask, suspect: Mask, components: VarianceComponents
) -> tuple[State, Mask]:
    """Return the state and the active rays less suspects; points with many suspects are intersected anew by what most
    of their rays agree on, for least squares, bounded or not, may have left all of them in between."""
    rays, count = network.rays, len(network.point_pose)
    many = np.bincount(rays.point[active & suspect], minlength=count) > _MANY * np.bincount(
        rays.point[active], minlength=count
    )
    again = np.flatnonzero(active & many[rays.point])
    active, points = active & ~suspect, state.points.copy()
    if len(again):
        X, agrees = meeting(network, state, again, tolerance_px(network, again, components))
        found = np.isfinite(X[:, 0])
        points[found] = X[found]
        active[again] = np.where(found[rays.point[again]], agrees, active[again])
    return replace(state, points=points), active


def tolerance_px(network: Network, rays: Index, components: VarianceComponents) -> Array:
    """Return from which miss (n,) in px on rays are suspects."""
    variance = np.einsum("nii->n", network.rays.cov_px2[rays]) / 2 * components.of_rays()[rays]
    return _SUSPECT * np.sqrt(variance)


def meeting(network: Network, state: State, rays: Index, tolerance_px: Array) -> tuple[Array, Mask]:
    """Return the places (P, 3) on which most of some rays (n,) of each point agree, and which do (n,)."""
    chosen = network.rays
    image, point, xy = chosen.image[rays], chosen.point[rays], chosen.xy_px[rays]
    camera = network.image_camera[image]
    towards = directions(network.cameras, state.interior, camera, xy)
    lines = Bundle(
        image, point, towards, state.interior[camera, 0], state.R, state.centre, len(network.point_pose)
    )  # fmt: skip
    return intersect(lines, float(np.median(tolerance_px)), np.random.default_rng(0))


def _by_median(components: VarianceComponents, off: Array, used: Mask, redundancy: int) -> VarianceComponents:
    """Return components whose factors make the median of normalised misses (N,) what it is for two normal errors."""
    if redundancy <= 0:  # nothing tells of it
        return components
    factor = components.factor.copy()
    share = redundancy / (2.0 * max(int(used.sum()), 1))
    for g in range(len(factor)):
        own = off[used & (components.component == g)]
        if len(own):
            factor[g] = max(float(np.median(own)) ** 2 / (2 * np.log(2)) / share, 1e-4)
    return replace(components, factor=factor)
