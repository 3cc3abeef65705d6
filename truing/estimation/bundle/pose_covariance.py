"""The covariance of one pose given the common unknowns, from its elimination, brought into the datum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dgemm
from scipy.linalg.lapack import dpotri

from truing.estimation.bundle.datum import Freedom, into_datum
from truing.estimation.bundle.elimination import EliminatedPose
from truing.estimation.bundle.layout import Layout
from truing.estimation.bundle.network import Array


@dataclass(frozen=True)
class PoseCovariance:
    """Given the common unknowns: covariance of a pose's points (3 p, 3 p) in m^2, of its images with its points
    (6 i, 3 p), of each image (i, 6, 6) in the order (centre, theta), and how points (3 p, c) and images (6 i, c) follow
    the common unknowns."""

    points: Array
    image_points: Array
    images: Array
    points_by_common: Array
    images_by_common: Array


def given_common(layout: Layout, pose: int, one: EliminatedPose, free: Freedom, held: Array) -> PoseCovariance:
    """Return the covariance of a pose given the common unknowns, in the datum of the conditions held."""
    from truing.estimation.bundle.elimination_kernel import mirror

    blocks = one.blocks
    b, d, _ = blocks.own.shape
    k = len(blocks.kept_places)
    kept = dpotri(one.factor, lower=1)[0].T
    mirror(kept)
    if len(one.pinned):
        kept -= one.by_rows @ np.linalg.solve(one.pinned, one.by_rows.T)
    kept_by_common = -one.kept[:, :-1]
    if d == 6:
        datum = _Datum.of(free, held)
        kept, kept_by_common = datum.points(kept), datum.followed(kept_by_common)
    turned = -one.root.transpose(0, 2, 1)
    follow = (turned @ one.reduced.reshape(b, d, k)).reshape(b * d, k)
    own_by_common = one.reduced_sides[:, :-1] + one.reduced @ kept_by_common
    c = own_by_common.shape[1]
    own_by_common = (turned @ own_by_common.reshape(b, d, c)).reshape(b * d, c)
    cross = follow @ kept
    alone = turned @ one.root
    if d == 6:
        images = cross.reshape(b, 6, k) @ follow.reshape(b, 6, k).transpose(0, 2, 1) - alone
        return PoseCovariance(kept, cross, images, kept_by_common, own_by_common)
    own = cross @ follow.T
    own.reshape(b, 3, b, 3)[np.arange(b), :, np.arange(b), :] -= alone
    by_common = np.empty((len(own) + k, own_by_common.shape[1]))
    by_common[blocks.kept_places], by_common[blocks.own_places] = kept_by_common, own_by_common
    return _in_datum(_ordered(layout, pose, one, kept, cross, own, by_common), free, _Datum.of(free, held))


def _ordered(
    layout: Layout, pose: int, one: EliminatedPose, kept: Array, cross: Array, own: Array, by_common: Array
) -> PoseCovariance:
    """Return the covariance of a pose whose points were eliminated, all points in their order."""
    m = 6 * int(layout.image_start[pose + 1] - layout.image_start[pose])
    n = len(by_common) - m
    loose, tied = one.blocks.own_places - m, one.blocks.kept_places[m:] - m
    points, image_points = np.empty((n, n)), np.empty((m, n))
    points[np.ix_(loose, loose)] = own
    points[np.ix_(tied, tied)] = kept[m:, m:]
    points[np.ix_(loose, tied)] = cross[:, m:]
    points[np.ix_(tied, loose)] = cross[:, m:].T
    image_points[:, loose] = cross[:, :m].T
    image_points[:, tied] = kept[:m, m:]
    each = np.arange(m // 6)
    images = kept[:m, :m].reshape(m // 6, 6, m // 6, 6)[each, :, each, :]
    return PoseCovariance(points, image_points, images, by_common[m:], by_common[:m])


@dataclass(frozen=True)
class _Datum:
    """How points pass into a datum: S = 1 - G F with the freedoms G (3 p, d) and F (d, 3 p); certain (3 p,) are the
    coordinates that have no error in it."""

    freedoms: Array
    back: Array
    certain: NDArray[np.bool_]

    @classmethod
    def of(cls, free: Freedom, held: Array) -> _Datum:
        """Return the datum of conditions B (3 p, d)."""
        # A condition on one coordinate by itself holds it.
        return cls(free.points.reshape(held.shape), into_datum(free, held), np.any(held == 1.0, axis=1))

    def points(self, covariance: Array) -> Array:
        """Return the covariance (3 p, 3 p) of points in the datum, in place of that before."""
        drawn = self.back @ covariance
        drawn -= (drawn @ self.back.T / 2) @ self.freedoms.T
        # The transpose, which is the same, stands column by column.
        taken = np.hstack([self.freedoms, drawn.T]), np.hstack([drawn.T, self.freedoms])
        found = dgemm(-1.0, *taken, 1.0, covariance.T, trans_b=1, overwrite_c=1).T
        found[self.certain] = found[:, self.certain] = 0.0
        return found

    def followed(self, by_common: Array) -> Array:
        """Return how points (3 p, c) follow the common unknowns in the datum."""
        found = by_common - self.freedoms @ (self.back @ by_common)
        found[self.certain] = 0.0
        return found


def _in_datum(one: PoseCovariance, free: Freedom, datum: _Datum) -> PoseCovariance:
    """Return the covariance of a pose in the datum: images take part by their own freedoms."""
    of_images = free.images.reshape(len(one.image_points), free.count)
    across = datum.back @ one.image_points.T
    drawn = datum.back @ one.points
    spread = drawn @ datum.back.T
    image_points = one.image_points - of_images @ drawn
    image_points -= (across.T - of_images @ spread) @ datum.freedoms.T
    image_points[:, datum.certain] = 0.0
    mixed = np.einsum("nia,anj->nij", free.images, across.reshape(free.count, len(free.images), 6))
    images = one.images - mixed - mixed.transpose(0, 2, 1) + free.images @ spread @ free.images.transpose(0, 2, 1)
    return PoseCovariance(
        datum.points(one.points),
        image_points,
        images,
        datum.followed(one.points_by_common),
        one.images_by_common - of_images @ (datum.back @ one.points_by_common),
    )
