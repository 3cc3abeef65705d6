"""Start of data snooping: adjustments that bound the influence of rays, and points on which most rays agree."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.estimation.bundle.adjustment import adjust
from truing.estimation.bundle.camera import directions
from truing.estimation.bundle.datum import Datum
from truing.estimation.bundle.determinable import determinable
from truing.estimation.bundle.network import Network, NetworkState
from truing.estimation.bundle.orientation import Bundle, intersect
from truing.estimation.bundle.variance_components import VarianceComponents, initial_components

STEP_WITHIN = 1e-6  # remaining sum of squares between rounds: no residual is off by more than 0.001 standard deviations
_ROBUST_ROUNDS = 8
_BOUND = 2.5  # standard deviations up to which a ray has full weight in the robust start
_SUSPECT = 6.0  # standard deviations from which data snooping starts with the ray rejected
_MANY = 1 / 3  # share of suspects among a point's rays, above which it is intersected again


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
        adjust_from = partial(adjust, max_iterations=3, decrease_tolerance=STEP_WITHIN) if step else adjust
        adjusted = adjust_from(network, state, datum, used=used, weights=weights)
        v = adjusted.residuals_px
        residual_length = np.sqrt(np.einsum("ni,nij,nj->n", v, inverse, v))
        if step == 0:
            redundancy = np.full(network.rays.count, adjusted.redundancy / max(int(used.sum()), 1))
            components = initial_components(network, used, redundancy)
        components = _by_median(components, residual_length, used, adjusted.redundancy)
        residual_length = residual_length / np.sqrt(components.ray_factors())
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
    variance = np.einsum("nii->n", network.rays.cov_px2[rays]) / 2 * components.ray_factors()[rays]
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
