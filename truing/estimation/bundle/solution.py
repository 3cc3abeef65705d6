"""One step of an adjustment: every pose eliminated, the common unknowns solved, the poses by back substitution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dposv

from truing.estimation.bundle.datum import Freedom
from truing.estimation.bundle.elimination import EliminatedPose, Ties, blocks_of
from truing.estimation.bundle.layout import Layout
from truing.estimation.bundle.network import Array
from truing.estimation.bundle.normal_equations import NormalEquations, Observed, Step
from truing.estimation.bundle.workspace import Workspace

# A distance's own information enters directly up to so many times that of its ends; the rest by a multiplier.
_DIRECT = 100.0


@dataclass(frozen=True)
class Reduced:
    """The poses, eliminated, and the equations (c, c) and right side (c,) left for the common unknowns; the information
    (c,) of these before, if all else were known, and the direct weights (q,) of distances."""

    poses: tuple[EliminatedPose | None, ...]
    common: Array
    side: Array
    alone: Array
    weight: Array


def tie_weights(observed: Observed, equations: NormalEquations) -> Array:
    """Return the weights (q,) in m^-2 with which distances enter directly."""
    layout = observed.layout
    of_ends = np.trace(equations.points[layout.first] + equations.points[layout.second], axis1=1, axis2=2) / 6
    with np.errstate(divide="ignore"):
        return np.minimum(1 / observed.distance_variance, _DIRECT * of_ends)


def tie_variances(observed: Observed, weight: Array) -> Array:
    """Return the variances (q,) in m^2 left to multipliers, infinite where the direct weight is all of it."""
    with np.errstate(divide="ignore"):
        information = 1 / observed.distance_variance
        return np.where(information > weight, 1 / np.maximum(information - weight, 0), np.inf)


def ties_of(observed: Observed, equations: NormalEquations, weight: Array, pose: int) -> Ties:
    """Return the distances of a pose as rows; weight (q,) of all."""
    layout, distances = observed.layout, equations.distances
    rows = np.flatnonzero(layout.distance_pose == pose)
    by_common = np.zeros((len(rows), len(layout.common)))
    place = layout.bar[observed.network.bars.bar[layout.distances[rows]]]
    by_common[place >= 0, place[place >= 0]] = -1.0
    start = layout.point_start[pose]
    return Ties(
        layout.first[rows] - start,
        layout.second[rows] - start,
        distances.direction[rows],
        by_common,
        distances.misclosure[rows],
        weight[rows],
        tie_variances(observed, weight)[rows],
    )


def eliminate_poses(
    observed: Observed,
    equations: NormalEquations,
    near: tuple[Freedom, ...],
    weight: Array,
    damping: float,
    workspace: Workspace,
) -> Reduced:
    """Return the normal equations with all poses eliminated, which hold until the next ones in the same workspace;
    near are the freedoms of a state that is not far from that of the equations. Raises LinAlgError where they are
    singular."""
    layout = observed.layout
    common = equations.common.copy()
    each = np.arange(len(common))
    common[each, each] *= 1 + damping
    poses: list[EliminatedPose | None] = []
    for pose in range(layout.poses):
        if layout.image_start[pose] == layout.image_start[pose + 1]:
            poses.append(None)
            continue
        ties = ties_of(observed, equations, weight, pose)
        blocks = blocks_of(equations, layout, pose, near[pose], ties, workspace)
        eliminated = EliminatedPose(blocks, ties, damping, workspace.take(("reduced", pose), blocks.own_rows.shape))
        common += eliminated.common
        poses.append(eliminated)
    alone = np.diagonal(equations.common)
    return Reduced(tuple(poses), common[:, :-1], common[:, -1], alone, weight)


def solve(layout: Layout, reduced: Reduced) -> Step:
    """Return the step; raises LinAlgError where the common unknowns are not determined."""
    scale = 1 / np.sqrt(np.diagonal(reduced.common))
    common = np.zeros(0)
    if len(scale):
        _, common, fault = dposv(scale[:, None] * reduced.common * scale, scale * reduced.side)
        if fault:
            raise np.linalg.LinAlgError("the common unknowns are not determined")
        common = scale * common
    images, points = np.zeros((len(layout.images), 6)), np.zeros((len(layout.points), 3))
    multipliers = np.zeros(len(layout.distances))
    for pose, eliminated in enumerate(reduced.poses):
        if eliminated is None:
            continue
        x, multipliers[layout.distance_pose == pose] = eliminated.back(common)
        own = slice(layout.image_start[pose], layout.image_start[pose + 1])
        m = 6 * (own.stop - own.start)
        images[own] = x[:m].reshape(-1, 6)
        points[layout.point_start[pose] : layout.point_start[pose + 1]] = x[m:].reshape(-1, 3)
    return Step(images, points, common, multipliers)
