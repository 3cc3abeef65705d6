"""The normal equations of a network: blocks of images and points pose by pose, bordered by what all poses share.

Distances stand beside them as rows of their own: those whose error is small, or nothing at all, enter by multipliers,
which are as sound for a rigid bar as for a soft one (`truing.estimation.bundle.elimination`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.bundle.layout import Layout
from truing.estimation.bundle.network import Array, Network, State
from truing.estimation.bundle.projection import linearise, project
from truing.estimation.rotation import exp_so3


@dataclass(frozen=True)
class Observed:
    """What is adjusted, with its information: that of the rays (n, 2, 2) in px^-2, of known points (m, 3, 3) in m^-2
    and of the lengths of bars (K,) in m^-2, zero for those that are no unknowns; distances have their variance (q,) in
    m^2."""

    network: Network
    layout: Layout
    rays: Array
    known: Array
    bars: Array
    distance_variance: Array


@dataclass(frozen=True)
class Distances:
    """Distances at a state: unit vector (q, 3) from the first to the second point, misclosure (q,) in m: the bar's
    length less the distance."""

    direction: Array
    misclosure: Array


@dataclass(frozen=True)
class NormalEquations:
    """Blocks of images (i, 6, 6) and points (p, 3, 3), of both per pose (6 i, 3 p), of each with the common unknowns
    (i, 6, c) and (p, 3, c), of these (c, c); right sides likewise; the weighted sum of squares without distances."""

    images: Array
    points: Array
    couplings: tuple[Array, ...]
    image_common: Array
    point_common: Array
    common: Array
    image_side: Array
    point_side: Array
    common_side: Array
    distances: Distances
    chi2: float


@dataclass(frozen=True)
class Step:
    """Changes of all unknowns: images (i, 6) in the order (centre, theta), points (p, 3), common (c,), and the
    multipliers (q,) of the distances, 0 where they have none."""

    images: Array
    points: Array
    common: Array
    multipliers: Array


def observe(network: Network, layout: Layout, weights: Array, variance_factor: Array) -> Observed:
    """Return what is adjusted; weights (N,) in [0, 1] and factors of the covariances (N,) of all rays."""
    rows = layout.rays
    rays = np.linalg.inv(network.rays.cov_px2[rows]) * (weights[rows] / variance_factor[rows])[:, None, None]
    lengths = np.zeros(len(layout.bar))
    free = layout.bar >= 0
    lengths[free] = network.bars.sigma_m[free] ** -2
    known = np.asarray(np.linalg.inv(network.known.cov_m2[layout.known]), np.float64)
    return Observed(network, layout, rays, known, lengths, network.bars.repeat_sigma_m[layout.distances] ** 2)


def distances_at(observed: Observed, state: State) -> Distances:
    """Return the distances between the ends of bars."""
    layout, bars = observed.layout, observed.network.bars
    points = state.points[layout.points]
    between = points[layout.second] - points[layout.first]
    length = np.linalg.norm(between, axis=-1)
    return Distances(between / length[:, None], state.bar_length_m[bars.bar[layout.distances]] - length)


def sum_of_squares(observed: Observed, state: State) -> float:
    """Return the weighted sum of squares without distances; infinite where a point is not before its camera."""
    network, layout = observed.network, observed.layout
    rays = network.rays
    v = rays.xy_px[layout.rays] - project(network, state, rays.image[layout.rays], rays.point[layout.rays])
    total = np.einsum("ni,nij,nj", v, observed.rays, v) + _of_priors(observed, state)
    return float(total) if np.isfinite(total) else np.inf


def _of_priors(observed: Observed, state: State) -> float:
    """Return the weighted sum of squares of known points and lengths of bars."""
    known = _misclosure_of_known(observed, state)
    lengths = observed.network.bars.length_m - state.bar_length_m
    return float(np.einsum("mi,mij,mj", known, observed.known, known) + observed.bars @ lengths**2)


def _misclosure_of_known(observed: Observed, state: State) -> Array:
    """Return known coordinates less those of the state (m, 3)."""
    known, rows = observed.network.known, observed.layout.known
    return known.xyz_m[rows] - state.points[known.point[rows]]


def normal_equations(observed: Observed, state: State) -> NormalEquations:
    """Return the normal equations at a state."""
    network, layout = observed.network, observed.layout
    rays = network.rays
    image, point = rays.image[layout.rays], rays.point[layout.rays]
    at = linearise(network, state, image, point)
    v = rays.xy_px[layout.rays] - at.xy_px
    by_common = spread_interior(layout, network.image_camera[image], at.by_interior)
    of_image = np.einsum("nki,nkl->nil", at.by_image, observed.rays)
    of_point = np.einsum("nki,nkl->nil", at.by_point, observed.rays)
    of_common = np.einsum("nki,nkl->nil", by_common, observed.rays)
    i, p, c = len(layout.images), len(layout.points), len(layout.common)
    blocks = NormalEquations(
        _summed(i, layout.ray_image, of_image @ at.by_image),
        _summed(p, layout.ray_point, of_point @ at.by_point),
        _couplings(layout, of_image @ at.by_point),
        _summed(i, layout.ray_image, of_image @ by_common),
        _summed(p, layout.ray_point, of_point @ by_common),
        np.einsum("nik,nkj->ij", of_common, by_common) if c else np.zeros((0, 0)),
        _summed(i, layout.ray_image, np.einsum("nik,nk->ni", of_image, v)),
        _summed(p, layout.ray_point, np.einsum("nik,nk->ni", of_point, v)),
        np.einsum("nik,nk->i", of_common, v),
        distances_at(observed, state),
        float(np.einsum("ni,nij,nj", v, observed.rays, v)) + _of_priors(observed, state),
    )
    _add_priors(observed, state, blocks)
    return blocks


def spread_interior(layout: Layout, camera: NDArray[np.int64], by_interior: Array) -> Array:
    """Return derivatives (n, 2, c) by the common unknowns, of those (n, 2, 10) by the interior of each ray's camera."""
    spread = np.zeros((len(camera), 2, len(layout.common) + 1))  # what is fixed goes into the last column
    np.put_along_axis(spread, np.broadcast_to(layout.interior[camera][:, None], by_interior.shape), by_interior, -1)
    return spread[..., :-1]


def _summed(count: int, slot: NDArray[np.int64], terms: Array) -> Array:
    """Return the sums (count, ...) of terms (n, ...) by slot."""
    total = np.zeros((count, *terms.shape[1:]))
    np.add.at(total, slot, terms)
    return total


def _couplings(layout: Layout, terms: Array) -> tuple[Array, ...]:
    """Return the blocks of images with points (6 i, 3 p) per pose, of terms (n, 6, 3) per ray."""
    per_pose, width, pose, start = coupling_places(layout)
    flat = np.zeros(start[-1])
    column = 3 * (layout.ray_point - layout.point_start[pose])
    row = 6 * (layout.ray_image - layout.image_start[pose])
    corner = start[pose] + row * width[pose] + column
    places = corner[:, None, None] + np.arange(6)[:, None] * width[pose][:, None, None] + np.arange(3)
    np.add.at(flat, places, terms)
    return tuple(flat[a:b].reshape(shape) for a, b, shape in zip(start[:-1], start[1:], per_pose, strict=True))


def coupling_places(layout: Layout) -> tuple[list[tuple[int, int]], NDArray, NDArray, NDArray]:
    """Return the shape and the width of every pose's coupling, the pose of every ray, and where couplings start."""
    images, points = 6 * np.diff(layout.image_start), 3 * np.diff(layout.point_start)
    start = np.concatenate([[0], np.cumsum(images * points)])
    pose = np.searchsorted(layout.image_start, layout.ray_image, side="right") - 1
    return list(zip(images.tolist(), points.tolist(), strict=True)), points, pose, start


def _add_priors(observed: Observed, state: State, blocks: NormalEquations) -> None:
    """Add known points and the lengths of bars."""
    layout = observed.layout
    np.add.at(blocks.points, layout.known_slot, observed.known)
    known = np.einsum("mij,mj->mi", observed.known, _misclosure_of_known(observed, state))
    np.add.at(blocks.point_side, layout.known_slot, known)
    free = np.flatnonzero(layout.bar >= 0)
    place = layout.bar[free]
    blocks.common[place, place] += observed.bars[free]
    misclosure = observed.network.bars.length_m[free] - state.bar_length_m[free]
    blocks.common_side[place] += observed.bars[free] * misclosure


def moved(layout: Layout, state: State, step: Step) -> State:
    """Return the state after a step."""
    R, centre, points = state.R.copy(), state.centre.copy(), state.points.copy()
    R[layout.images] = exp_so3(step.images[:, 3:]) @ R[layout.images]
    centre[layout.images] += step.images[:, :3]
    points[layout.points] += step.points
    interior, lengths = state.interior.copy(), state.bar_length_m.copy()
    free = layout.interior >= 0
    interior[free] += step.common[layout.interior[free]]
    bars = layout.bar >= 0
    lengths[bars] += step.common[layout.bar[bars]]
    return State(interior, R, centre, points, lengths)
