"""Covariance of a large pose: every point alone, and any of them jointly, without the joint covariance of all.

Given the common unknowns, the kept unknowns (images, and ends of distances) have the covariance K. A point that was
eliminated with block N and rays W is x = x0 - N^-1 W^T k. Its rays have the entries f = -N^-1 W^T:

    cov(x_p, x_q) = [p = q] N_p^-1 + f_p K f_q^T,    cov(k, x_p) = K f_p^T.

A kept point has the entry 1 at its own place. The datum is S = 1 - G F as in `Datum`. C is the covariance of all
points before the datum; D = F C and E = D F^T. In the datum, the covariance is C - G D - D^T G^T + G E G^T. Nothing is
neglected.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from truing.arrays import Array, Index
from truing.estimation.bundle.covariance_datum import Datum
from truing.estimation.bundle.datum import Freedom
from truing.estimation.bundle.eliminated_rows import Entries, ReducedRays
from truing.estimation.bundle.elimination import EliminatedPose
from truing.estimation.bundle.row_blocks import PointRays, coordinates

_ENTRY = 6  # width of an entry


@dataclass(frozen=True)
class RayPoseCovariance:
    """`PoseCovariance` of a large pose.

    kept (k, k): covariance of the kept unknowns, padded by zeros to the width of an entry; entries of all points (p,),
    own (p, 3, 3): N^-1, zero for kept points; datum, and movements of images (i, 6, d) and points (p, 3, d) by its
    freedoms; derivatives of points (3 p, c) and images (6 i, c) by the common unknowns before the datum.
    """

    kept: Array
    entries: Entries
    own: Array
    datum: Datum
    moved_images: Array
    moved_points: Array
    points_before: Array
    images_before: Array
    before_datum: RayPoseCovariance | None = None

    def for_rays(self) -> RayPoseCovariance:
        """Return the covariance before the datum, for quantities that do not depend on it."""
        return self.before_datum or self

    @cached_property
    def across(self) -> Array:
        """F C (d, k) of the kept unknowns."""
        projection = self.datum.back.reshape(-1, len(self.own), 3)
        return np.asarray(self.kept @ self.entries.transposed_times(projection.transpose(1, 2, 0))).T

    @cached_property
    def drawn(self) -> Array:
        """D = F C (d, 3 p) of the points."""
        projection = self.datum.back.reshape(-1, len(self.own), 3)
        covariance = np.einsum("dpi,pij->pjd", projection, self.own) + self.entries.times(self.across.T)
        return covariance.reshape(3 * len(self.own), len(projection)).T

    @cached_property
    def spread(self) -> Array:
        """E = D F^T (d, d)."""
        return np.asarray(self.drawn @ self.datum.back.T)

    @cached_property
    def points_by_common(self) -> Array:
        """Derivatives (3 p, c) of the points by the common unknowns, in the datum."""
        return self.datum.by_common(self.points_before)

    @cached_property
    def images_by_common(self) -> Array:
        """Derivatives (6 i, c) of the images by the common unknowns, in the datum."""
        movements = self.moved_images.reshape(len(self.images_before), -1)
        return self.images_before - movements @ (self.datum.back @ self.points_before)

    @cached_property
    def images(self) -> Array:
        """Covariance (i, 6, 6) of each image."""
        i, movements = len(self.moved_images), self.moved_images
        diagonal = np.arange(i)
        before_datum = self.kept[: 6 * i, : 6 * i].reshape(i, 6, i, 6)[diagonal, :, diagonal, :]
        mixed = np.einsum("nia,anj->nij", movements, self.across[:, : 6 * i].reshape(-1, i, 6))
        quadratic = movements @ self.spread @ movements.transpose(0, 2, 1)
        return np.asarray(before_datum - mixed - mixed.transpose(0, 2, 1) + quadratic)

    def joint(self, points: Index) -> Array:
        """Return the joint covariance (3 n, 3 n) of points (n,)."""
        coordinates_of_points, n = coordinates(points), len(points)
        rows = self.entries.dense(points)
        covariance = rows @ self.kept @ rows.T
        each = np.arange(n)
        covariance.reshape(n, 3, n, 3)[each, :, each, :] += self.own[points]
        movements, drawn = self.datum.freedoms[coordinates_of_points], self.drawn[:, coordinates_of_points]
        shift = movements @ (drawn - self.spread @ movements.T / 2)
        covariance -= shift + shift.T
        fixed = self.datum.certain[coordinates_of_points]
        covariance[fixed] = covariance[:, fixed] = 0.0
        return covariance

    @cached_property
    def _blocks(self) -> Array:
        from truing.estimation.bundle.ray_kernels import point_covariances

        blocks, entries = self.own.copy(), self.entries
        narrow, wide = entries.narrow_and_wide(len(self.moved_images))
        point_covariances(entries.arrays, narrow, self.kept, blocks)
        for points in entries.batches(wide):
            rows = entries.dense(points)
            shape = len(points), 3, entries.kept
            blocks[points] += (rows @ self.kept).reshape(shape) @ rows.reshape(shape).transpose(0, 2, 1)
        movements = self.moved_points
        drawn = self.drawn.reshape(-1, len(blocks), 3).transpose(1, 0, 2)
        shift = movements @ (drawn - self.spread @ movements.transpose(0, 2, 1) / 2)
        blocks -= shift + shift.transpose(0, 2, 1)
        fixed = self.datum.certain.reshape(-1, 3)
        blocks[np.broadcast_to(fixed[:, :, None] | fixed[:, None], blocks.shape)] = 0.0
        return blocks

    def blocks(self) -> Array:
        """Return the covariance (p, 3, 3) of each point."""
        return self._blocks

    def with_points(self, image: Index, point: Index) -> Array:
        """Return the covariance (n, 6, 3) of images (n,) with points (n,)."""
        covariance = self._by_kept(image, point)
        if not self.datum.freedoms.shape[1]:
            return covariance
        point_movements, image_movements, i = self.moved_points[point], self.moved_images[image], len(self.moved_images)
        across = self.across[:, : 6 * i].reshape(-1, i, 6).transpose(1, 2, 0)[image]
        covariance -= image_movements @ self.drawn.reshape(-1, len(self.own), 3).transpose(1, 0, 2)[point]
        covariance -= (across - image_movements @ self.spread) @ point_movements.transpose(0, 2, 1)
        fixed = self.datum.certain.reshape(-1, 3)[point]
        covariance[np.broadcast_to(fixed[:, None], covariance.shape)] = 0.0
        return covariance

    def _by_kept(self, image: Index, point: Index) -> Array:
        """Return the covariance (n, 6, 3) of images with points before the datum."""
        from truing.estimation.bundle.ray_kernels import image_covariances

        covariance, entries, i = np.empty((len(image), 6, 3)), self.entries, len(self.moved_images)
        wide = entries.narrow_and_wide(i)[1]
        is_wide = np.zeros(len(self.own), bool)
        is_wide[wide] = True
        image_covariances(entries.arrays, point, image, np.flatnonzero(~is_wide[point]), self.kept, covariance)
        order = np.flatnonzero(is_wide[point])
        order = order[np.argsort(point[order], kind="stable")]
        for points in entries.batches(wide):
            low, high = np.searchsorted(point[order], [points[0], points[-1] + 1])
            rows_in_range, index = order[low:high], np.searchsorted(points, point[order[low:high]])
            by_images = (entries.dense(points) @ self.kept[:, : 6 * i]).reshape(-1, 3, i, 6)
            covariance[rows_in_range] = by_images[index, :, image[rows_in_range]].transpose(0, 2, 1)
        return covariance

    def combined(self, rows: Array) -> Array:
        """Return the covariance (w, w) of linear combinations (w, 3 p) of all points."""
        free = np.where(self.datum.certain, 0.0, rows)
        free = free - (free @ self.datum.freedoms) @ self.datum.back
        by_point = free.reshape(len(rows), len(self.own), 3)
        by_kept = self.entries.transposed_times(by_point.transpose(1, 2, 0))
        covariance = np.einsum("wpi,pij,vpj->wv", by_point, self.own, by_point, optimize=True)
        return np.asarray(by_kept.T @ self.kept @ by_kept + covariance)


def by_rays(
    eliminated_pose: EliminatedPose, reduced: ReducedRays, kept: Array, free: Freedom, datum: Datum
) -> RayPoseCovariance:
    """Return the covariance of a pose whose points were eliminated ray by ray; kept (k, k): that of its kept unknowns
    given the common ones."""
    rays = eliminated_pose.blocks.own_rows.rays  # type: ignore[union-attr]
    negative_root_transposed = -eliminated_pose.root.transpose(0, 2, 1)
    entries, point_blocks = _all_points(rays, negative_root_transposed, eliminated_pose.root, reduced)
    k, i, p, d = rays.kept, rays.images, len(point_blocks), free.count
    padded = np.zeros((entries.kept, entries.kept))
    padded[:k, :k] = kept
    by_common = unknowns_by_common(eliminated_pose, reduced)
    arguments = padded, entries, point_blocks
    sides = by_common[6 * i :], by_common[: 6 * i]
    # Before the datum, the freedoms are held by the ties of the elimination.
    none = Datum(np.zeros((3 * p, 0)), np.zeros((0, 3 * p)), np.zeros(3 * p, bool))
    before = RayPoseCovariance(*arguments, none, np.zeros((i, 6, 0)), np.zeros((p, 3, 0)), *sides)
    return RayPoseCovariance(*arguments, datum, free.images, free.points, *sides, before) if d else before


def _all_points(
    rays: PointRays, negative_root_transposed: Array, root: Array, reduced: ReducedRays
) -> tuple[Entries, Array]:
    """Return the entries of all points, eliminated and kept, and their own covariance (p, 3, 3)."""
    n, count = len(rays.rays), len(rays.loose) + len(rays.tied)
    point = np.repeat(np.arange(len(rays.loose)), np.diff(rays.first))
    entries_of_tied = np.zeros((len(rays.tied), 3, _ENTRY))
    entries_of_tied[:, :, :3] = np.eye(3)
    start, stop, own_blocks = np.empty(count, np.int64), np.empty(count, np.int64), np.zeros((count, 3, 3))
    start[rays.loose], stop[rays.loose] = rays.first[:-1], rays.first[1:]
    start[rays.tied] = n + np.arange(len(rays.tied))
    stop[rays.tied] = start[rays.tied] + 1
    own_blocks[rays.loose] = -negative_root_transposed @ root
    blocks = np.concatenate([negative_root_transposed[point] @ reduced.entries.blocks, entries_of_tied])
    column = np.concatenate([rays.image_place, 6 * rays.images + 3 * np.arange(len(rays.tied))])
    return Entries(blocks, column, start, stop, rays.kept + _ENTRY), own_blocks


def unknowns_by_common(eliminated_pose: EliminatedPose, reduced: ReducedRays) -> Array:
    """Return the derivatives (6 i + 3 p, c) of images and points by the common unknowns, before the datum."""
    negative_root_transposed, kept_by_common = -eliminated_pose.root.transpose(0, 2, 1), -eliminated_pose.kept[:, :-1]
    by_own = eliminated_pose.reduced_sides[:, :-1] + reduced.times(kept_by_common)
    derivative = np.empty((len(by_own) + len(kept_by_common), by_own.shape[1]))
    derivative[eliminated_pose.blocks.kept_indices] = kept_by_common
    derivative[eliminated_pose.blocks.eliminated_indices] = (
        negative_root_transposed @ by_own.reshape(len(negative_root_transposed), 3, by_own.shape[1])
    ).reshape(by_own.shape)
    return derivative
