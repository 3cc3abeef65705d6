"""Covariance of one pose given the common unknowns: of all its points jointly, or of some of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.linalg.lapack import dpotri

from truing.arrays import Array, Index
from truing.estimation.bundle.covariance_datum import Datum
from truing.estimation.bundle.datum import Freedom
from truing.estimation.bundle.eliminated_rows import ReducedRays
from truing.estimation.bundle.elimination import EliminatedPose
from truing.estimation.bundle.normal_equations import EquationLayout
from truing.estimation.bundle.ray_covariance import by_rays
from truing.estimation.bundle.row_blocks import coordinates


class PoseCovariance(Protocol):
    """Covariance of one pose given the common unknowns.

    Each image (i, 6, 6) in the order (centre, theta); derivatives of points (3 p, c) and images (6 i, c) by the common
    unknowns. Points are in m^2.
    """

    @property
    def images(self) -> Array:
        """Covariance (i, 6, 6) of each image, given the common unknowns."""
        ...

    @property
    def points_by_common(self) -> Array:
        """Derivative (3 p, c) of the points by the common unknowns."""
        ...

    @property
    def images_by_common(self) -> Array:
        """Derivative (6 i, c) of the images by the common unknowns."""
        ...

    def for_rays(self) -> PoseCovariance:
        """Return the covariance in any datum, for quantities that do not depend on it."""

    def joint(self, points: Index) -> Array:
        """Return the joint covariance (3 n, 3 n) of points (n,) by number in the pose."""

    def blocks(self) -> Array:
        """Return the covariance (p, 3, 3) of each point."""

    def with_points(self, image: Index, point: Index) -> Array:
        """Return the covariance (n, 6, 3) of images (n,) with points (n,) by number in the pose."""

    def combined(self, rows: Array) -> Array:
        """Return the covariance (w, w) of linear combinations (w, 3 p) of all points."""


@dataclass(frozen=True)
class DensePoseCovariance:
    """`PoseCovariance` with the joint covariance of all points (3 p, 3 p), and of images with points (6 i, 3 p)."""

    points: Array
    image_points: Array
    images: Array
    points_by_common: Array
    images_by_common: Array

    def for_rays(self) -> DensePoseCovariance:
        """Return the same covariance."""
        return self

    def joint(self, points: Index) -> Array:
        """Return the joint covariance (3 n, 3 n) of points (n,)."""
        if 3 * len(points) == len(self.points) and bool((np.diff(points) == 1).all()):
            return self.points
        rows = coordinates(points)
        return self.points[np.ix_(rows, rows)]

    def blocks(self) -> Array:
        """Return the covariance (p, 3, 3) of each point."""
        each = np.arange(len(self.points) // 3)
        return self.points.reshape(len(each), 3, len(each), 3)[each, :, each, :]

    def with_points(self, image: Index, point: Index) -> Array:
        """Return the covariance (n, 6, 3) of images (n,) with points (n,)."""
        m, n = len(self.images), len(self.points) // 3
        return self.image_points.reshape(m, 6, n, 3)[image, :, point, :]

    def combined(self, rows: Array) -> Array:
        """Return the covariance (w, w) of linear combinations (w, 3 p) of all points."""
        return np.asarray(rows @ self.points @ rows.T)


def kept_covariance(eliminated_pose: EliminatedPose) -> Array:
    """Return the covariance (k, k) of the kept unknowns given the common ones."""
    from truing.estimation.bundle.kernels import mirror

    covariance = np.asarray(dpotri(eliminated_pose.factor, lower=1)[0].T)
    mirror(covariance)
    if len(eliminated_pose.pinned):
        covariance -= eliminated_pose.by_rows @ np.linalg.solve(eliminated_pose.pinned, eliminated_pose.by_rows.T)
    return covariance


def given_common(
    layout: EquationLayout, pose: int, eliminated_pose: EliminatedPose, free: Freedom, constraints: Array
) -> PoseCovariance:
    """Return the covariance of a pose given the common unknowns, in the datum of the conditions `constraints`."""
    if isinstance(eliminated_pose.reduced, ReducedRays):
        return by_rays(
            eliminated_pose,
            eliminated_pose.reduced,
            kept_covariance(eliminated_pose),
            free,
            Datum.of(free, constraints),
        )
    blocks, reduced = eliminated_pose.blocks, eliminated_pose.reduced.array
    b, d, _ = blocks.own.shape
    k = len(blocks.kept_indices)
    covariance = kept_covariance(eliminated_pose)
    kept_by_common = -eliminated_pose.kept[:, :-1]
    if d == 6:
        datum = Datum.of(free, constraints)
        covariance, kept_by_common = datum.points(covariance), datum.by_common(kept_by_common)
    turned = -eliminated_pose.root.transpose(0, 2, 1)
    follow = (turned @ reduced.reshape(b, d, k)).reshape(b * d, k)
    own_by_common = eliminated_pose.reduced_sides[:, :-1] + reduced @ kept_by_common
    c = own_by_common.shape[1]
    own_by_common = (turned @ own_by_common.reshape(b, d, c)).reshape(b * d, c)
    cross = follow @ covariance
    alone = turned @ eliminated_pose.root
    if d == 6:
        images = cross.reshape(b, 6, k) @ follow.reshape(b, 6, k).transpose(0, 2, 1) - alone
        return DensePoseCovariance(covariance, cross, images, kept_by_common, own_by_common)
    eliminated_covariance = cross @ follow.T
    eliminated_covariance.reshape(b, 3, b, 3)[np.arange(b), :, np.arange(b), :] -= alone
    by_common = np.empty((len(eliminated_covariance) + k, own_by_common.shape[1]))
    by_common[blocks.kept_indices], by_common[blocks.eliminated_indices] = kept_by_common, own_by_common
    return _in_datum(
        _ordered(layout, pose, eliminated_pose, covariance, cross, eliminated_covariance, by_common),
        free,
        Datum.of(free, constraints),
    )


def _ordered(
    layout: EquationLayout,
    pose: int,
    eliminated_pose: EliminatedPose,
    kept: Array,
    cross: Array,
    eliminated: Array,
    by_common: Array,
) -> DensePoseCovariance:
    """Return the covariance of a pose with its points sorted, if the points were eliminated."""
    m = 6 * int(layout.image_start[pose + 1] - layout.image_start[pose])
    n = len(by_common) - m
    loose, tied = eliminated_pose.blocks.eliminated_indices - m, eliminated_pose.blocks.kept_indices[m:] - m
    points, image_points = np.empty((n, n)), np.empty((m, n))
    points[np.ix_(loose, loose)] = eliminated
    points[np.ix_(tied, tied)] = kept[m:, m:]
    points[np.ix_(loose, tied)] = cross[:, m:]
    points[np.ix_(tied, loose)] = cross[:, m:].T
    image_points[:, loose] = cross[:, :m].T
    image_points[:, tied] = kept[:m, m:]
    each = np.arange(m // 6)
    images = kept[:m, :m].reshape(m // 6, 6, m // 6, 6)[each, :, each, :]
    return DensePoseCovariance(points, image_points, images, by_common[m:], by_common[:m])


def _in_datum(pose_covariance: DensePoseCovariance, free: Freedom, datum: Datum) -> DensePoseCovariance:
    """Return the covariance of a pose in the datum: images move with their own part of the freedoms."""
    of_images = free.images.reshape(len(pose_covariance.image_points), free.count)
    across = datum.back @ pose_covariance.image_points.T
    drawn = datum.back @ pose_covariance.points
    spread = drawn @ datum.back.T
    image_points = pose_covariance.image_points - of_images @ drawn
    image_points -= (across.T - of_images @ spread) @ datum.freedoms.T
    image_points[:, datum.certain] = 0.0
    mixed = np.einsum("nia,anj->nij", free.images, across.reshape(free.count, len(free.images), 6))
    images = (
        pose_covariance.images
        - mixed
        - mixed.transpose(0, 2, 1)
        + free.images @ spread @ free.images.transpose(0, 2, 1)
    )
    return DensePoseCovariance(
        datum.points(pose_covariance.points),
        image_points,
        images,
        datum.by_common(pose_covariance.points_by_common),
        pose_covariance.images_by_common - of_images @ (datum.back @ pose_covariance.points_by_common),
    )
