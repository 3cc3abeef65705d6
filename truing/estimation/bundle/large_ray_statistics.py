"""Information of the rays of large poses about shared numbers, by elimination ray by ray.

The shared numbers take the place of the common unknowns in the elimination of a pose
(`truing.estimation.bundle.elimination`): what it leaves of their equations is their information and score.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from truing.arrays import Array, Index
from truing.estimation.bundle.datum import Freedom
from truing.estimation.bundle.eliminated_rows import ReducedRays
from truing.estimation.bundle.elimination import EliminatedPose, Ties, blocks_of
from truing.estimation.bundle.network import LinearisedRays, NetworkState
from truing.estimation.bundle.normal_equations import (
    ArrayPool,
    Distances,
    NormalEquations,
    Observed,
    normal_equations,
)
from truing.estimation.bundle.orientation import sums
from truing.estimation.bundle.ray_covariance import unknowns_by_common

_BATCH = 50_000  # rays whose products with the shared numbers are in memory together


@dataclass(frozen=True)
class SharedSides:
    """Equations with the shared numbers (T) in the place of the common unknowns; of each pose (S, T, T + 1): products
    of the numbers' derivatives with each other and with the residuals."""

    equations: NormalEquations
    whole: Array


def shared_sides(
    observed: Observed, state: NetworkState, linearised: LinearisedRays, residuals: Array, by_numbers: Array
) -> SharedSides:
    """Return the equations; rays at the state, their residuals (n, 2) in px and derivatives (n, 2, T)."""
    layout, width = observed.layout, by_numbers.shape[-1] + 1
    equations = normal_equations(observed, state, ArrayPool())
    images, points = np.zeros((len(layout.images), 6, width)), equations.point_sides[..., -1:]
    # Known points add to the right side only; the part of the rays is replaced.
    points = np.concatenate(
        [np.zeros((len(points), 3, width - 1)), points - _statistics_of_rays(observed, linearised, residuals)], -1
    )
    sides = np.zeros((layout.poses, width - 1, width))
    pose = np.searchsorted(layout.image_start, layout.ray_image, side="right") - 1
    for first in range(0, len(layout.rays), _BATCH):
        batch = slice(first, first + _BATCH)
        numbers_and_residuals = np.concatenate([by_numbers[batch], residuals[batch][..., None]], -1)
        weighted = observed.rays[batch] @ numbers_and_residuals
        images += sums(layout.ray_image[batch], linearised.by_image[batch].transpose(0, 2, 1) @ weighted, len(images))
        points += sums(layout.ray_point[batch], linearised.by_point[batch].transpose(0, 2, 1) @ weighted, len(points))
        for number in np.unique(pose[batch]):
            in_pose = pose[batch] == number
            sides[number] += np.tensordot(
                numbers_and_residuals[in_pose, :, :-1], weighted[in_pose], axes=([0, 1], [0, 1])
            )
    return SharedSides(replace(equations, image_sides=images, point_sides=points), sides)


def _statistics_of_rays(observed: Observed, linearised: LinearisedRays, residuals: Array) -> Array:
    """Return the right side (p, 3, 1) of the points that the rays alone give."""
    weighted = linearised.by_point.transpose(0, 2, 1) @ observed.rays @ residuals[..., None]
    return sums(observed.layout.ray_point, weighted, len(observed.layout.points))


def information_of_pose(
    sides: SharedSides, observed: Observed, pose: int, free: Freedom, ties: Ties
) -> tuple[Array, Array, Array]:
    """Return information (T, T), score (T,) and derivatives of the points (p, 3, T) of a large pose, before the datum;
    ties: its distances by the shared numbers."""
    blocks = blocks_of(sides.equations, observed.layout, pose, free, ties, ArrayPool())
    eliminated_pose = EliminatedPose(blocks, ties, 0.0, np.empty(blocks.own_rows.shape))
    assert isinstance(eliminated_pose.reduced, ReducedRays)
    reduced = sides.whole[pose] + eliminated_pose.common
    points_by_numbers = unknowns_by_common(eliminated_pose, eliminated_pose.reduced)[6 * len(free.images) :]
    return (reduced[:, :-1] + reduced[:, :-1].T) / 2, reduced[:, -1], points_by_numbers.reshape(len(free.points), 3, -1)


def distances_as_ties(
    observed: Observed,
    pose: int,
    distances: Distances,
    by_numbers: Array,
    points: Array,
    rigid: float,
) -> Ties:
    """Return the distances of a pose as rows by the shared numbers (q, T).

    points (p, 3, 3): blocks of the pose's points; rigid: most information of a distance relative to that of its ends.
    """
    layout = observed.layout
    rows: Index = np.flatnonzero(layout.distance_pose == pose)
    first, second = (ends[rows] - layout.point_start[pose] for ends in (layout.first, layout.second))
    diagonal = np.einsum("pii->pi", points).copy()
    weight = np.empty(len(rows))
    for n, row in enumerate(rows):
        ends = [first[n], second[n]]
        weight_limit = rigid * float(np.sum(diagonal[ends])) / diagonal[ends].size
        weight[n] = min(1 / max(float(observed.distance_variance[row]), 1e-300), weight_limit)
        diagonal[ends] += weight[n] * distances.direction[row] ** 2
    misclosure, no_multiplier = distances.misclosure[rows], np.full(len(rows), np.inf)
    return Ties(first, second, distances.direction[rows], by_numbers[rows], misclosure, weight, no_multiplier)
