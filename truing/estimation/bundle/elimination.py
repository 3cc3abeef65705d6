"""One step of an adjustment: eliminate images or points of each pose, solve for the common unknowns, substitute back.

Of each pose the images or the points are eliminated, whichever leaves the smaller system. The eliminated blocks are
small and independent; the kept system is dense and decomposed by Cholesky. In a large pose, points are eliminated ray
by ray, and nothing is stored for images that do not see them. Ends of bars are always kept, since bars
couple points. A distance d with variance s^2 enters with a weight r, the smaller of its own information and one
comparable to that of the points. The rest of its information, with variance t = 1 / (1 / s^2 - r), enters by a
multiplier k:

    (N + r a a^T) x + a k = n + r a w,    a^T x - t k = w.

This is equivalent to the full information, and stable down to s = 0, where the distance is a constraint. Freedoms of
the datum are tied down by a term along nearby directions, which changes nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import as_strided
from scipy.linalg.lapack import dposv, dpotrf, dpotrs

from truing.arrays import Array, Index
from truing.estimation.bundle.datum import Freedom
from truing.estimation.bundle.eliminated_rows import DenseRows, RayRows, ReducedDense, ReducedRays, add_products
from truing.estimation.bundle.normal_equations import ArrayPool, EquationLayout, NormalEquations, Observed, UnknownsStep
from truing.estimation.bundle.row_blocks import PointRays, put_tied_rows

# Direct weight of a distance, at most this multiple of the information of its ends; a multiplier takes the rest.
_DIRECT = 100.0


@dataclass(frozen=True)
class Ties:
    """Distances of a pose as rows of equations.

    Points first and second (q,) within the pose, by_point (q, 3) of the second, by_common (q, c); misclosure w (q,) in
    m, weight r (q,) in m^-2, and the variance t (q,) in m^2 of the multipliers, infinite if none is needed.
    """

    first: Index
    second: Index
    by_point: Array
    by_common: Array
    misclosure: Array
    weight: Array
    variance: Array


@dataclass(frozen=True)
class PoseBlocks:
    """Equations of a pose, split into eliminated and kept unknowns.

    own (b, d, d): independent blocks to eliminate, with own_rows by the kept unknowns and own_sides (b d, c + 1):
    common unknowns and right side. kept (k, k): upper triangle of the kept system, with kept_sides (k, c + 1).
    eliminated_indices (b d,) and kept_indices (k,): places within the pose's unknowns, images before points. freedoms
    (k, f): directions near the freedoms; rows (q, k): distances."""

    own: Array
    own_rows: DenseRows | RayRows
    own_sides: Array
    kept: Array
    kept_sides: Array
    eliminated_indices: Index
    kept_indices: Index
    freedoms: Array
    rows: Array


def blocks_of(
    equations: NormalEquations,
    layout: EquationLayout,
    pose: int,
    near_freedoms: Freedom,
    ties: Ties,
    workspace: ArrayPool,
) -> PoseBlocks:
    """Return the equations of a pose, split into eliminated and kept unknowns."""
    i = slice(layout.image_start[pose], layout.image_start[pose + 1])
    p = slice(layout.point_start[pose], layout.point_start[pose + 1])
    if (rays := layout.rows.by_point[pose]) is not None:
        return _blocks_by_ray(equations, i, p, pose, rays, near_freedoms, ties, workspace)
    images, points, between = equations.images[i], equations.points[p], equations.between[pose]
    m, n = between.shape
    image_sides, point_sides = equations.image_sides[i].reshape(m, -1), equations.point_sides[p].reshape(n, -1)
    freedoms = np.concatenate(
        [near_freedoms.images.reshape(m, near_freedoms.count), near_freedoms.points.reshape(n, near_freedoms.count)]
    )
    tied_rows = _rows(ties, m, n)
    if n <= m:
        kept_indices, eliminated_indices = np.arange(m, m + n), np.arange(m)
        kept_block = workspace.take(("kept", pose), (n, n))
        _put_diagonal(points, kept_block)
        return PoseBlocks(
            *(images, DenseRows(between), image_sides, kept_block, point_sides),
            *(eliminated_indices, kept_indices, freedoms[kept_indices], tied_rows[:, kept_indices]),
        )
    is_end = np.zeros(len(points), bool)
    is_end[ties.first] = is_end[ties.second] = True
    end_rows, other_rows = np.repeat(is_end, 3), np.repeat(~is_end, 3)
    kept_indices, eliminated_indices = (
        np.concatenate([np.arange(m), m + np.flatnonzero(end_rows)]),
        m + np.flatnonzero(other_rows),
    )
    k = len(kept_indices)
    kept_block = workspace.take(("kept", pose), (k, k))
    _put_diagonal(images, kept_block[:m, :m])
    _put_diagonal(points[is_end], kept_block[m:, m:])
    kept_block[:m, m:] = between[:, end_rows]
    eliminated_by_kept = np.zeros((len(eliminated_indices), k))
    eliminated_by_kept[:, :m] = between[:, other_rows].T
    sides = np.concatenate([image_sides, point_sides[end_rows]])
    return PoseBlocks(
        *(points[~is_end], DenseRows(eliminated_by_kept), point_sides[other_rows], kept_block, sides),
        *(eliminated_indices, kept_indices, freedoms[kept_indices], tied_rows[:, kept_indices]),
    )


def _blocks_by_ray(
    equations: NormalEquations,
    i: slice,
    p: slice,
    pose: int,
    rays: PointRays,
    near_freedoms: Freedom,
    ties: Ties,
    workspace: ArrayPool,
) -> PoseBlocks:
    """Return the equations of a large pose, with points eliminated ray by ray; i, p: slots of its images and points."""
    images, points, between = equations.images[i], equations.points[p], equations.between[pose]
    m, k = 6 * rays.images, rays.kept
    kept_block = workspace.take(("kept", pose), (k, k))
    kept_block[:] = 0.0
    _put_diagonal(images, kept_block[:m, :m])
    _put_diagonal(points[rays.tied], kept_block[m:, m:])
    put_tied_rows(rays, between, kept_block)
    point_sides = equations.point_sides[p]
    width = point_sides.shape[-1]
    sides = np.concatenate([equations.image_sides[i].reshape(m, width), point_sides[rays.tied].reshape(k - m, width)])
    freedoms = (
        near_freedoms.images.reshape(m, near_freedoms.count),
        near_freedoms.points[rays.tied].reshape(k - m, near_freedoms.count),
    )
    renumbered = replace(
        ties, first=np.searchsorted(rays.tied, ties.first), second=np.searchsorted(rays.tied, ties.second)
    )
    return PoseBlocks(
        *(points[rays.loose], RayRows(between, rays), point_sides[rays.loose].reshape(-1, width), kept_block, sides),
        *(rays.eliminated_indices, rays.kept_indices, np.concatenate(freedoms), _rows(renumbered, m, k - m)),
    )


def _rows(ties: Ties, m: int, n: int) -> Array:
    """Return the rows (q, m + n) of distances over the unknowns of the pose."""
    rows = np.zeros((len(ties.first), m + n))
    row = np.arange(len(ties.first))[:, None]
    rows[row, m + 3 * ties.second[:, None] + np.arange(3)] += ties.by_point
    rows[row, m + 3 * ties.first[:, None] + np.arange(3)] -= ties.by_point
    return rows


def _put_diagonal(blocks: Array, matrix: Array) -> None:
    """Fill a matrix (b d, b d) with blocks (b, d, d) on its diagonal and zeros elsewhere."""
    b, d, _ = blocks.shape
    row, column = matrix.strides
    matrix[:] = 0.0
    as_strided(matrix, (b, d, d), (d * (row + column), row, column))[:] = blocks


class EliminatedPose:
    """Unknowns of a pose as a function of the common ones, x = x0 - x1 c, and the reduced equations for these."""

    def __init__(self, blocks: PoseBlocks, ties: Ties, damping: float, reduced: Array) -> None:
        """Eliminate; overwrites the kept system of the blocks. damping: relative increase of the diagonal; reduced:
        output for the reduced rows. Raises LinAlgError if a block has free directions."""
        self.blocks = blocks
        kept, k = blocks.kept, len(blocks.kept)
        self.kept_diagonal = np.diagonal(kept).copy()
        self.reduced: ReducedDense | ReducedRays
        eliminated = blocks.own_rows.eliminate(blocks.own, blocks.own_sides, damping, reduced)
        self.root, self.reduced, self.reduced_sides = eliminated
        kept.flat[:: k + 1] *= 1 + damping
        self.reduced.subtract_products(kept)
        weighted_rows = ties.weight[:, None] * blocks.rows
        add_products(kept, np.concatenate([np.sqrt(ties.weight)[:, None] * blocks.rows, _tied_freedoms(blocks)]), 1.0)
        tie_sides = np.concatenate([ties.by_common, ties.misclosure[:, None]], -1)
        sides = blocks.kept_sides - self.reduced.transposed_times(self.reduced_sides) + weighted_rows.T @ tie_sides
        # LAPACK is column-major: there the upper triangle is the lower one.
        self.factor, fault = dpotrf(kept.T, lower=1, clean=0, overwrite_a=1)
        if fault:
            raise np.linalg.LinAlgError("found reduced normal equations that are not positive definite")
        by_multiplier = np.isfinite(ties.variance)
        rows, pinned_sides = blocks.rows[by_multiplier], tie_sides[by_multiplier]
        solved = dpotrs(self.factor, np.concatenate([sides, rows.T], -1), lower=1)[0]
        width = sides.shape[1]
        self.by_rows = solved[:, width:]
        self.pinned = np.diag(ties.variance[by_multiplier]) + rows @ self.by_rows
        multipliers = np.linalg.solve(self.pinned, rows @ solved[:, :width] - pinned_sides)
        self.kept = solved[:, :width] - self.by_rows @ multipliers
        self.multipliers = np.zeros((len(ties.variance), width))
        self.multipliers[by_multiplier] = multipliers
        weighted_products = ties.by_common.T @ (ties.weight[:, None] * tie_sides)
        weighted_products -= self.reduced_sides[:, :-1].T @ self.reduced_sides
        self.common = weighted_products - sides[:, :-1].T @ self.kept - pinned_sides[:, :-1].T @ multipliers

    def back(self, common: Array) -> tuple[Array, Array]:
        """Return the changes of the pose's unknowns, images before points, and the multipliers (q,)."""
        step = np.append(-common, 1.0)
        kept_step = self.kept @ step
        b, d, _ = self.blocks.own.shape
        own_step = (self.reduced_sides @ step - self.reduced.times(kept_step)).reshape(b, d)
        x = np.empty(len(self.blocks.eliminated_indices) + len(kept_step))
        x[self.blocks.kept_indices] = kept_step
        x[self.blocks.eliminated_indices] = np.einsum("bji,bj->bi", self.root, own_step).ravel()
        return x, self.multipliers @ step


def _tied_freedoms(blocks: PoseBlocks) -> Array:
    """Return rows (f, k) that fix the freedoms, with the mean stiffness of the kept unknowns."""
    norm = np.linalg.norm(blocks.freedoms, axis=0)
    return np.sqrt(np.trace(blocks.kept) / max(len(blocks.kept), 1)) * (blocks.freedoms / norm).T


@dataclass(frozen=True)
class Reduced:
    """Eliminated poses, and the equations (c, c) and right side (c,) for the common unknowns.

    alone (c,): information of these if all else were known; weight (q,): direct weights of distances.
    """

    poses: tuple[EliminatedPose | None, ...]
    common: Array
    side: Array
    alone: Array
    weight: Array


def tie_weights(observed: Observed, equations: NormalEquations) -> Array:
    """Return the weights (q,) in m^-2 with which distances enter directly."""
    layout = observed.layout
    end_information = np.trace(equations.points[layout.first] + equations.points[layout.second], axis1=1, axis2=2) / 6
    with np.errstate(divide="ignore"):
        return np.minimum(1 / observed.distance_variance, _DIRECT * end_information)


def tie_variances(observed: Observed, weight: Array) -> Array:
    """Return the variances (q,) in m^2 of the multipliers, infinite if the direct weight is the full information."""
    with np.errstate(divide="ignore"):
        information = 1 / observed.distance_variance
        return np.where(information > weight, 1 / np.maximum(information - weight, 0), np.inf)


def ties_of(observed: Observed, equations: NormalEquations, weight: Array, pose: int) -> Ties:
    """Return the distances of a pose as rows; weight (q,) of all."""
    layout, distances = observed.layout, equations.distances
    rows = np.flatnonzero(layout.distance_pose == pose)
    by_common = np.zeros((len(rows), len(layout.common)))
    column = layout.bar[observed.network.bars.bar[layout.distances[rows]]]
    by_common[column >= 0, column[column >= 0]] = -1.0
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
    near_freedoms: tuple[Freedom, ...],
    weight: Array,
    damping: float,
    workspace: ArrayPool,
) -> Reduced:
    """Return the normal equations with all poses eliminated; valid until the next call with the same workspace.

    near_freedoms: freedoms at a state close to that of the equations. Raises LinAlgError if the equations are singular.
    """
    layout = observed.layout
    common = equations.common.copy()
    diagonal = np.arange(len(common))
    common[diagonal, diagonal] *= 1 + damping
    poses: list[EliminatedPose | None] = []
    for pose in range(layout.poses):
        if layout.image_start[pose] == layout.image_start[pose + 1]:
            poses.append(None)
            continue
        ties = ties_of(observed, equations, weight, pose)
        blocks = blocks_of(equations, layout, pose, near_freedoms[pose], ties, workspace)
        eliminated = EliminatedPose(blocks, ties, damping, workspace.take(("reduced", pose), blocks.own_rows.shape))
        common += eliminated.common
        poses.append(eliminated)
    information = np.diagonal(equations.common)
    return Reduced(tuple(poses), common[:, :-1], common[:, -1], information, weight)


def solve(layout: EquationLayout, reduced: Reduced) -> UnknownsStep:
    """Return the step; raises LinAlgError if the common unknowns are not determined."""
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
        images_of_pose = slice(layout.image_start[pose], layout.image_start[pose + 1])
        m = 6 * (images_of_pose.stop - images_of_pose.start)
        images[images_of_pose] = x[:m].reshape(-1, 6)
        points[layout.point_start[pose] : layout.point_start[pose + 1]] = x[m:].reshape(-1, 3)
    return UnknownsStep(images, points, common, multipliers)
