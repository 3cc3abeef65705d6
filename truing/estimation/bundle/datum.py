"""Datum of a pose: freedoms that the rays leave, and transformations of coordinates and covariances between datums.

Rays alone leave a pose seven freedoms: three shifts, three rotations and the scale. A bar fixes the scale; known points
fix their part. Conditions B^T (p - p0) = 0 on the points fix the rest: inner constraints (B are the freedoms, free
network) or a minimal set of fixed coordinates. S = 1 - G (B^T G)^-1 B^T transforms any solution into that datum (Baarda
1973; Luhmann et al., section 4.4.3); residuals and distances do not change.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import qr

from truing.arrays import Array, Index
from truing.estimation.bundle.network import NetworkState
from truing.estimation.bundle.normal_equations import EquationLayout
from truing.estimation.rotation import put_rigid_motions

Datum = Literal["free", "minimal", "known"]

_SQUARED = 1e-8  # relative to the size: the next Newton step would be rounding
_LEAST_MOVEMENT = 1e-6  # share of a freedom's movement of all points; if known points move less, it remains


@dataclass(frozen=True)
class Freedom:
    """Freedoms that the observations of a pose leave: movements of its images (i, 6, d) and points (p, 3, d).

    The movements of points are orthonormal. mixture (7, d) combines them from shifts, rotations and scale about the
    middle (3,) of the points, in m per size in m.
    """

    images: Array
    points: Array
    mixture: Array
    middle: Array
    size: float

    @property
    def count(self) -> int:
        """Number of freedoms: the defect of the datum."""
        return self.points.shape[-1]


def freedoms(layout: EquationLayout, state: NetworkState) -> tuple[Freedom, ...]:
    """Return the freedoms that the observations leave each pose: bars fix the scale, known points more."""
    points, centres = state.points[layout.points], state.centre[layout.images]
    middle, size = _middles(points, layout.point_start)
    pose_of_point, pose_of_image = _pose_numbers(layout.point_start), _pose_numbers(layout.image_start)
    points = (points - middle[pose_of_point]) / size[pose_of_point, None]
    centres = (centres - middle[pose_of_image]) / size[pose_of_image, None]
    point_movements, image_movements = movements(points), np.zeros((len(centres), 6, 7))
    image_movements[:, :3], image_movements[:, 3:, 3:6] = (
        movements(centres),
        np.eye(3) / size[pose_of_image, None, None],
    )
    mixtures, has_length = _orthonormal(points, layout.point_start), np.zeros(layout.poses, bool)
    has_length[layout.distance_pose] = True
    freedoms_by_pose = []
    for pose, mixture in enumerate(mixtures):
        i = slice(layout.image_start[pose], layout.image_start[pose + 1])
        p = slice(layout.point_start[pose], layout.point_start[pose + 1])
        freedoms_of_pose = mixture[:, : 6 if has_length[pose] else 7] if p.start < p.stop else mixture[:, :0]
        known = layout.known_slot[(layout.known_slot >= p.start) & (layout.known_slot < p.stop)]
        if len(known):
            freedoms_of_pose = freedoms_of_pose @ _null_space(point_movements[known].reshape(-1, 7) @ freedoms_of_pose)
        freedoms_by_pose.append(
            Freedom(
                _mixed(image_movements[i], freedoms_of_pose),
                _mixed(point_movements[p], freedoms_of_pose),
                freedoms_of_pose,
                middle[pose],
                size[pose],
            )
        )
    return tuple(freedoms_by_pose)


def _mixed(movements: Array, mixture: Array) -> Array:
    """Return movements (n, k, 7), combined by a mixture (7, d)."""
    flat = movements.reshape(-1, 7) @ mixture
    return flat.reshape(*movements.shape[:2], mixture.shape[1])


def _pose_numbers(start: Index) -> Index:
    """Return the pose number (n,) of items that are stored pose by pose from start (S + 1,)."""
    return np.repeat(np.arange(len(start) - 1), np.diff(start))


def _sums(values: Array, start: Index) -> Array:
    """Return the sum (S, ...) of values (n, ...) of each pose, zero for an empty pose."""
    sums, has_items = np.zeros((len(start) - 1, *values.shape[1:])), start[:-1] < start[1:]
    if len(values):
        sums[has_items] = np.add.reduceat(values, start[:-1][has_items])
    return sums


def _middles(points: Array, start: Index) -> tuple[Array, Array]:
    """Return the centroid (S, 3) of the points (p, 3) of each pose, and their rms distance (S,) from it."""
    count = np.maximum(np.diff(start), 1)
    middle = _sums(points, start) / count[:, None]
    squares = np.sum((points - middle[_pose_numbers(start)]) ** 2, -1)
    size = np.sqrt(_sums(squares, start) / count)
    return middle, np.where(size > 0, size, 1.0)


def _orthonormal(points: Array, start: Index) -> Array:
    """Return the mixtures (S, 7, 7) that orthonormalise the movements of centred and scaled points (p, 3). Shifts,
    rotations and scale are orthogonal to each other; only rotations mix, by the inertia of the points."""
    moments = _sums(points[:, :, None] * points[:, None], start)
    trace = np.trace(moments, axis1=1, axis2=2)
    inertia = trace[:, None, None] * np.eye(3) - moments
    inertia[trace == 0] = np.eye(3)
    orthonormal = np.zeros((len(moments), 7, 7))
    shifts = 1 / np.sqrt(np.maximum(np.diff(start), 1))
    orthonormal[:, [0, 1, 2, 6], [0, 1, 2, 6]] = shifts[:, None]
    orthonormal[:, 3:6, 3:6] = np.linalg.inv(np.linalg.cholesky(inertia)).transpose(0, 2, 1)
    return orthonormal


def movements(points: Array) -> Array:
    """Return the movements (n, 3, 7) of points by shifts, rotations and scale about the origin."""
    derivative = np.zeros((*points.shape, 7))
    put_rigid_motions(points, derivative[..., :6])
    derivative[..., 6] = points
    return derivative


def _null_space(rows: Array) -> Array:
    """Return an orthonormal basis (d, f) of the null space of rows (n, d)."""
    _, s, vt = np.linalg.svd(rows)
    return vt[np.count_nonzero(s > _LEAST_MOVEMENT * s.max(initial=0)) :].T


def conditions(free: Freedom, datum: Datum) -> Array:
    """Return the datum conditions B (3 p, d) on the points, which fix all freedoms."""
    rows = free.points.reshape(3 * len(free.points), free.count)
    if datum != "minimal" or not free.count:
        return rows
    # QR with pivoting picks the coordinates that fix the network most firmly.
    chosen = qr(rows.T, mode="r", pivoting=True)[1][: free.count]
    conditions_of_points = np.zeros_like(rows)
    conditions_of_points[chosen, np.arange(free.count)] = 1.0
    return conditions_of_points


def in_datum(
    layout: EquationLayout, state: NetworkState, start: NetworkState, constraints: tuple[Array, ...]
) -> NetworkState:
    """Return a state moved and scaled to satisfy the conditions B (3 p, d) of each pose relative to the start.

    The similarity is exact, not linearised: Newton's method on its seven numbers.
    """
    R, centre, points = state.R.copy(), state.centre.copy(), state.points.copy()
    for pose, free in enumerate(freedoms(layout, state)):
        if free.count:
            images = layout.images[layout.image_start[pose] : layout.image_start[pose + 1]]
            points_of_pose = layout.points[layout.point_start[pose] : layout.point_start[pose + 1]]
            rotation, scale, shift = _similarity(
                points[points_of_pose], start.points[points_of_pose], free, constraints[pose]
            )
            points[points_of_pose] = scale * points[points_of_pose] @ rotation.T + shift
            centre[images] = scale * centre[images] @ rotation.T + shift
            R[images] = rotation @ R[images]
    return NetworkState(state.interior, R, centre, points, state.bar_length_m)


def _similarity(points: Array, start: Array, free: Freedom, constraints: Array) -> tuple[Array, float, Array]:
    """Return rotation, scale and shift of points (p, 3) after which the conditions hold."""
    motion, middle, size = np.eye(4), free.middle, free.size
    for _ in range(50):
        transformed = (points - middle) @ motion[:3, :3].T + motion[:3, 3]
        derivative = constraints.T @ (movements(transformed / size) @ free.mixture).reshape(-1, free.count)
        change = free.mixture @ np.linalg.solve(derivative, constraints.T @ (start - middle - transformed).ravel())
        motion = _exponential(_generator(change, size)) @ motion  # along the freedoms only: known points stay fixed
        if np.abs(change).max() <= _SQUARED * size:
            break
    scale = float(np.cbrt(np.linalg.det(motion[:3, :3])))
    rotation = motion[:3, :3] / scale
    return rotation, scale, motion[:3, 3] + middle - scale * rotation @ middle


def _generator(change: Array, size: float) -> Array:
    """Return the generator (4, 4) of a similarity from shifts in m and from rotations and scale (7,) as movements at
    `size`."""
    x, y, z = change[:3]
    a, b, c, s = change[3:] / size
    return np.array([[s, -c, b, x], [c, s, -a, y], [-b, a, s, z], [0.0, 0.0, 0.0, 0.0]])


def _exponential(generator: Array) -> Array:
    """Return the matrix exponential of a small matrix by scaling, Taylor series and squaring."""
    halvings = max(0, int(np.ceil(np.log2(max(np.abs(generator).sum(), 1e-300)))) + 3)
    part = term = generator / 2**halvings
    for order in range(2, 12):
        term = term @ (generator / 2**halvings) / order
        part = part + term
    for _ in range(halvings):  # computes exp - 1, so that small values keep their digits
        part = 2 * part + part @ part
    return part + np.eye(len(generator))


def into_datum(free: Freedom, constraints: Array) -> Array:
    """Return F (d, 3 p), which projects a change of the points onto the freedoms."""
    if not free.count:
        return constraints.T
    return np.asarray(np.linalg.solve(constraints.T @ free.points.reshape(-1, free.count), constraints.T), np.float64)
