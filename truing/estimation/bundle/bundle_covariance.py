"""Covariance of an adjusted network: marginal and joint, in the chosen datum.

Given the common unknowns c, the unknowns x_a of pose a have the covariance Q_a and the derivative G_a = dx_a/dc. With
the covariance S of c,

    cov(x_a) = Q_a + G_a S G_a^T,    cov(x_a, x_b) = G_a S G_b^T,    cov(x_a, c) = G_a S.

Everything is for sigma0 = 1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from truing.arrays import Array, Index
from truing.estimation.bundle.datum import Freedom, freedoms
from truing.estimation.bundle.determinable import UndeterminedNetworkError
from truing.estimation.bundle.elimination import EliminatedPose, Reduced, eliminate_poses, tie_variances, tie_weights
from truing.estimation.bundle.kernel_arguments import CameraArrays, PoseCovarianceArrays, PoseRays, StateArrays
from truing.estimation.bundle.network import NetworkState
from truing.estimation.bundle.normal_equations import (
    ArrayPool,
    EquationLayout,
    Observed,
    normal_equations,
)
from truing.estimation.bundle.pose_covariance import PoseCovariance, given_common
from truing.estimation.bundle.row_blocks import coordinates
from truing.estimation.one_thread import on_one_thread

_SINGULAR = 1e-12  # least share of an unknown's information that the others leave; below it there is only rounding
_LEAST_DAMPINGS = (1e-11, 1e-9, 1e-7)  # the first one that works gives a solution of a disconnected network


@dataclass(frozen=True)
class BundleCovariance:
    """Covariance of a network; images and points are numbered as in the network.

    Within a pose, adjusted items are in the order of `image_numbers` and `point_numbers`. names (c): common unknowns
    (camera, element) or ("bar", number), with their covariance (c, c). distance_redundancy (q,): redundancy numbers of
    the adjusted distances, 0 for a rigid bar.
    """

    observed: Observed
    state: NetworkState
    names: tuple[tuple[str, str | int], ...]
    common: Array
    poses: tuple[PoseCovariance | None, ...]
    distance_redundancy: Array

    @property
    def _layout(self) -> EquationLayout:
        return self.observed.layout

    def point_numbers(self, pose: int) -> Index:
        """Return the adjusted points of a pose, in the order of their covariance."""
        start = self._layout.point_start
        return self._layout.points[start[pose] : start[pose + 1]]

    def image_numbers(self, pose: int) -> Index:
        """Return the adjusted images of a pose, in the order of their covariance."""
        start = self._layout.image_start
        return self._layout.images[start[pose] : start[pose + 1]]

    def points(self, pose: int) -> Array:
        """Return the joint covariance (3 p, 3 p) in m^2 of all points of a pose."""
        return self.joint(pose, np.arange(len(self.point_numbers(pose))))

    def joint(self, pose: int, points: Index) -> Array:
        """Return the joint covariance (3 n, 3 n) in m^2 of some points of a pose (n,), by place in `point_numbers`."""
        pose_covariance = self._pose(pose)
        by_common = pose_covariance.points_by_common[coordinates(points)]
        return pose_covariance.joint(points) + by_common @ self.common @ by_common.T

    def combined(self, pose: int, rows: Array) -> Array:
        """Return the covariance (w, w) of linear combinations (w, 3 p) of the points of a pose."""
        pose_covariance = self._pose(pose)
        by_common = rows @ pose_covariance.points_by_common
        return pose_covariance.combined(rows) + by_common @ self.common @ by_common.T

    def points_given_common(self, pose: int) -> Array:
        """Return the covariance (3 p, 3 p) in m^2 of points without the part of the common unknowns."""
        pose_covariance = self._pose(pose)
        return pose_covariance.joint(np.arange(len(pose_covariance.points_by_common) // 3))

    def sensitivities(self, pose: int) -> Array:
        """Return the derivatives of the points of a pose by the common unknowns (3 p, c), m per unit of each."""
        return self._pose(pose).points_by_common

    def between(self, first: int, second: int) -> Array:
        """Return the covariance (3 p, 3 p') in m^2 between the points of two poses."""
        if first == second:
            return self.points(first)
        return self.sensitivities(first) @ self.common @ self.sensitivities(second).T

    def images(self, pose: int) -> Array:
        """Return the covariance (i, 6, 6) of each image of a pose: centre in m, then theta in rad."""
        pose_covariance = self._pose(pose)
        by_common = pose_covariance.images_by_common.reshape(len(pose_covariance.images), 6, len(self.common))
        return pose_covariance.images + by_common @ self.common @ by_common.transpose(0, 2, 1)

    def images_common(self, pose: int) -> Array:
        """Return the covariance (i, 6, c) between the images of a pose and the common unknowns."""
        pose_covariance = self._pose(pose)
        return (pose_covariance.images_by_common @ self.common).reshape(
            len(pose_covariance.images), 6, len(self.common)
        )

    def _pose(self, pose: int) -> PoseCovariance:
        pose_covariance = self.poses[pose]
        if pose_covariance is None:
            raise ValueError(f"found no used ray in pose {pose}, expected a pose with adjusted rays")
        return pose_covariance

    def point_blocks(self) -> Array:
        """Return the covariance (P, 3, 3) in m^2 of every point of the network, NaN for points that are not
        adjusted."""
        blocks = np.full((len(self.observed.network.point_pose), 3, 3), np.nan)
        for pose, pose_covariance in enumerate(self.poses):
            if pose_covariance is not None:
                numbers = self.point_numbers(pose)
                by_common = pose_covariance.points_by_common.reshape(len(numbers), 3, -1)
                blocks[numbers] = pose_covariance.blocks() + by_common @ self.common @ by_common.transpose(0, 2, 1)
        return blocks

    def computed_px2(self) -> Array:
        """Return the covariance (N, 2, 2) in px^2 of computed image points.

        It includes rays that were not used; NaN if their image or point is not adjusted. The residuals of used rays
        have the covariance Q_vv, which is that of the measurement minus this.
        """
        network, layout = self.observed.network, self._layout
        image_slot, point_slot = np.full(len(network.image_pose), -1), np.full(len(network.point_pose), -1)
        image_slot[layout.images], point_slot[layout.points] = (
            np.arange(len(layout.images)),
            np.arange(len(layout.points)),
        )
        i, p = image_slot[network.rays.image], point_slot[network.rays.point]
        pose_of_ray = network.image_pose[network.rays.image]
        is_adjusted = (i >= 0) & (p >= 0) & (pose_of_ray == network.point_pose[network.rays.point])
        covariance_px2 = np.full((len(i), 2, 2), np.nan)
        for pose, pose_covariance in enumerate(self.poses):
            rows = np.flatnonzero(is_adjusted & (pose_of_ray == pose))
            if pose_covariance is not None and len(rows):
                indices = i[rows] - layout.image_start[pose], p[rows] - layout.point_start[pose]
                covariance_px2[rows] = self._computed(pose_covariance, rows, *indices)
        return covariance_px2

    def _computed(self, pose_covariance: PoseCovariance, rows: Index, image: Index, point: Index) -> Array:
        """Return the covariance (n, 2, 2) of computed image points of one pose; these do not depend on the datum."""
        from truing.estimation.bundle.ray_kernels import computed_covariances

        network, state, for_rays = self.observed.network, self.state, pose_covariance.for_rays()
        rays = PoseRays(network.rays.image[rows], network.rays.point[rows], image, point)
        cameras = CameraArrays(network.image_camera, state.interior, *self.observed.formats)
        c, result = len(self.common), np.empty((len(rows), 2, 2))
        known = PoseCovarianceArrays(
            images=for_rays.images,
            points=for_rays.blocks(),
            cross=for_rays.with_points(image, point),
            images_by_common=for_rays.images_by_common.reshape(len(for_rays.images), 6, c),
            points_by_common=for_rays.points_by_common.reshape(len(for_rays.points_by_common) // 3, 3, c),
            common=self.common,
        )
        states = StateArrays(state.R, state.centre, state.points)
        computed_covariances(rays, cameras, states, self._layout.interior, known, result)
        return result

    def redundancy_numbers(self) -> Array:
        """Return the redundancy numbers (N, 2) of the rays' coordinates, the diagonal of Q_vv P; NaN for unused rays.

        Together with those of distances and priors they add up to the redundancy.
        """
        rows = self._layout.rays
        redundancy = np.full((self.observed.network.rays.count, 2), np.nan)
        redundancy[rows] = 1 - np.einsum("nij,nji->ni", self.computed_px2()[rows], self.observed.rays)
        return redundancy

    def distance_variances(self) -> tuple[Array, Array]:
        """Return the variance (q,) in m^2 of every adjusted distance between ends of bars, and that of the distance
        minus the length of its bar."""
        layout, bars = self._layout, self.observed.network.bars
        ends = self.state.points[layout.points]
        bar_vector = ends[layout.second] - ends[layout.first]
        direction = bar_vector / np.linalg.norm(bar_vector, axis=-1)[:, None]
        distance_variance, misclosure_variance = np.zeros(len(bar_vector)), np.zeros(len(bar_vector))
        for row, pose in enumerate(layout.distance_pose):
            pose_covariance, end_points = self._pose(int(pose)), np.array([layout.first[row], layout.second[row]])
            end_points -= layout.point_start[pose]
            gradient = np.concatenate([-direction[row], direction[row]])
            variance = gradient @ pose_covariance.joint(end_points) @ gradient
            by_common = gradient @ pose_covariance.points_by_common[coordinates(end_points)]
            distance_variance[row] = variance + by_common @ self.common @ by_common
            column = layout.bar[bars.bar[layout.distances[row]]]
            if column >= 0:
                by_common[column] -= 1.0
            misclosure_variance[row] = variance + by_common @ self.common @ by_common
        return distance_variance, misclosure_variance

    def prior_redundancy_numbers(self) -> tuple[Array, Array, Array]:
        """Return the redundancy numbers of distances (q,), of bar lengths (K,) (NaN if they are not unknowns) and of
        known coordinates (m, 3)."""
        layout, observed = self._layout, self.observed
        free = layout.bar >= 0
        bars = np.full(len(layout.bar), np.nan)
        bars[free] = 1 - observed.bars[free] * np.diagonal(self.common)[layout.bar[free]]
        known = self.point_blocks()[observed.network.known.point[layout.known]]
        return self.distance_redundancy, bars, 1 - np.einsum("mij,mji->mi", known, observed.known)


@on_one_thread
def covariance(
    observed: Observed, state: NetworkState, constraints: tuple[Array, ...], reduced: Reduced | None = None
) -> BundleCovariance:
    """Return the covariance of a network at its least sum of squares, in the datum of the constraints B (3 p, d)
    per pose.

    reduced: undamped equations at this state, if available. Raises `UndeterminedNetworkError` if the datum leaves
    directions free.
    """
    layout = observed.layout
    free = freedoms(layout, state)
    if reduced is None:
        workspace = ArrayPool()
        equations = normal_equations(observed, state, workspace)
        weight = tie_weights(observed, equations)
        try:
            reduced = eliminate_poses(observed, equations, free, weight, 0.0, workspace)
        except np.linalg.LinAlgError:
            _raise_with_free_items(observed, state, free)
            raise UndeterminedNetworkError("the network is disconnected: images and points can move freely") from None
    _check_pivots(layout, reduced)
    common = _inverse(layout, reduced)
    poses = tuple(
        None if reduced_pose is None else given_common(layout, pose, reduced_pose, free[pose], constraints[pose])
        for pose, reduced_pose in enumerate(reduced.poses)
    )
    draft = BundleCovariance(observed, state, layout.common, common, poses, np.empty(0))
    return replace(draft, distance_redundancy=_redundancy_of_distances(draft, reduced))


def _redundancy_of_distances(bundle_covariance: BundleCovariance, reduced: Reduced) -> Array:
    """Return the redundancy numbers (q,) of distances. The inverse has the block -q of a multiplier; so 1 - a Q a^T /
    s^2 = (1 + r t) t q - r t. This stays accurate for small s."""
    weight = reduced.weight
    observed = bundle_covariance.observed
    variance = tie_variances(observed, weight)
    _, misclosure = bundle_covariance.distance_variances()
    with np.errstate(divide="ignore", invalid="ignore"):
        numbers = 1 - misclosure / observed.distance_variance
    for pose, reduced_pose in enumerate(reduced.poses):
        rows = np.flatnonzero(bundle_covariance.observed.layout.distance_pose == pose)
        by_multiplier = np.isfinite(variance[rows])
        if reduced_pose is not None and by_multiplier.any():
            multiplier_by_common = reduced_pose.multipliers[by_multiplier, :-1]
            block = np.diagonal(
                np.linalg.inv(reduced_pose.pinned)
                - multiplier_by_common @ bundle_covariance.common @ multiplier_by_common.T
            )
            chosen = rows[by_multiplier]
            t = variance[chosen]
            numbers[chosen] = (1 + weight[chosen] * t) * t * block - weight[chosen] * t
    return numbers


def _raise_with_free_items(observed: Observed, state: NetworkState, free: tuple[Freedom, ...]) -> None:
    """Raise `UndeterminedNetworkError` with the freest images and points, found with the least damping that gives a
    solution."""
    workspace = ArrayPool()
    for damping in _LEAST_DAMPINGS:
        equations = normal_equations(observed, state, workspace)
        try:
            weight = tie_weights(observed, equations)
            reduced = eliminate_poses(observed, equations, free, weight, damping, workspace)
        except np.linalg.LinAlgError:
            continue
        least_pivots = [_pivots(pose)[0].min(initial=1.0) for pose in reduced.poses if pose is not None]
        _check_pivots(observed.layout, reduced, 10.0 * min(least_pivots, default=0.0))


def _check_pivots(layout: EquationLayout, reduced: Reduced, least: float = _SINGULAR) -> None:
    """Raise `UndeterminedNetworkError` with the images and points whose remaining share of information is below
    `least`."""
    free_images: list[int] = []
    free_points: list[int] = []
    for pose, reduced_pose in enumerate(reduced.poses):
        if reduced_pose is None:
            continue
        pivots, unknowns = _pivots(reduced_pose)
        undetermined = unknowns[pivots < least]
        images = 6 * int(layout.image_start[pose + 1] - layout.image_start[pose])
        free_images += layout.images[
            layout.image_start[pose] + np.unique(undetermined[undetermined < images] // 6)
        ].tolist()
        point_offsets = (undetermined[undetermined >= images] - images) // 3
        free_points += layout.points[layout.point_start[pose] + np.unique(point_offsets)].tolist()
    faults = [f"image {n}" for n in free_images] + [f"point {n}" for n in free_points]
    if faults:
        more = f" and {len(faults) - 20} more" if len(faults) > 20 else ""
        text = f"free directions are left, seen at {', '.join(faults[:20])}{more}"
        raise UndeterminedNetworkError(text, images=free_images, points=free_points)


def _pivots(eliminated_pose: EliminatedPose) -> tuple[Array, Index]:
    """Return each unknown's share of information that the earlier unknowns of its pose leave, and its place."""
    blocks = eliminated_pose.blocks
    pivot_of_points = np.diagonal(eliminated_pose.root, axis1=1, axis2=2) ** -2.0 / np.diagonal(
        blocks.own, axis1=1, axis2=2
    )
    pivot_of_kept = np.diagonal(eliminated_pose.factor) ** 2 / eliminated_pose.kept_diagonal
    return np.concatenate([pivot_of_points.ravel(), pivot_of_kept]), np.concatenate(
        [blocks.eliminated_indices, blocks.kept_indices]
    )


def _inverse(layout: EquationLayout, reduced: Reduced) -> Array:
    """Return the covariance of the common unknowns; the error names those that are not determined."""
    common = reduced.common
    if not len(common):
        return common
    scale = 1 / np.sqrt(reduced.alone)
    values, vectors = np.linalg.eigh(scale[:, None] * common * scale)
    if not values[0] > _SINGULAR:
        share = np.abs(vectors[:, 0])
        undetermined = [
            (a, str(b)) for (a, b), part in zip(layout.common, share, strict=True) if part > 0.1 * share.max()
        ]
        text = f"these images do not determine {', '.join(f'{a} {b}' for a, b in undetermined)}: hold one of them fixed"
        raise UndeterminedNetworkError(text, elements=undetermined)
    return scale[:, None] * (vectors / values) @ vectors.T * scale
