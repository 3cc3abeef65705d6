"""Information of the rays of each pose about numbers that all poses share: cameras, bars, air.

A pose has residuals v of its observations, with weights W. Their derivatives are A by its own unknowns (points,
orientations of images) and B by the shared numbers theta. The sufficient statistics of theta are

    information N = B^T Q B,   score n = B^T Q v;   Q = W - W A (A^T W A)^-1 A^T W.

n is normal with mean N (theta in this pose - theta of the adjustment) and covariance N. It is independent between
poses, and of the adjusted points. The points depend on theta by G = -(A^T W A)^-1 A^T W B. N and n do not depend on the
datum. `ray_channels` converts them to independent channels of unit noise; `shared_errors` finds other errors that
points have in common.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from truing.arrays import Array, Index, Mask
from truing.estimation.bundle.camera import PARAMETERS, UNITS
from truing.estimation.bundle.datum import Freedom, freedoms
from truing.estimation.bundle.large_ray_statistics import distances_as_ties, information_of_pose, shared_sides
from truing.estimation.bundle.network import LinearisedRays, NetworkState, in_camera_axes, linearise
from truing.estimation.bundle.normal_equations import Distances, Observed, distances_at
from truing.estimation.rotation import rigid_motions

CAMERA, BAR, AIR, WINDOW = "camera", "bar", "air", "window"
# Information of a rigid distance relative to that of its ends.
_RIGID = 1e4
# Relevant sizes: a millionth of the index per square metre, a millimetre of glass, 10 um of a metre;
# for an interior element, the change that moves the edge of the format by a pixel, by these powers of half the width.
_CURVATURE, _THICKNESS, _STRAIN = 1e-6, 1e-3, 1e-5
_POWERS = (0, 0, 0, -3, -5, -7, -2, -2, -1, -1)
GLASS = 1.52
# Second derivatives of the refractive index along the measurement axes of a pose.
PLACES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
CURVATURES = ("xx", "yy", "zz", "xy", "xz", "yz")
# Least share of a number's information that the other numbers leave, for a pose to determine it.
_LEFT = 1e-8
# A pattern of common errors counts if its variance exceeds that of single points by this factor.
_TOGETHER = 2.0


@dataclass(frozen=True)
class SharedNumber:
    """A number that poses share: kind (camera, bar, air, window), camera or bar number (-1 for air), name and unit in
    SI or px.

    scale: relevant size; sigma: uncertainty before the adjustment, None if unknown, 0 if taken as exact; mean: prior
    minus adjusted value.
    """

    kind: str
    owner: int
    name: str
    unit: str
    scale: float
    sigma: float | None
    mean: float = 0.0


@dataclass(frozen=True)
class RayStatistics:
    """Information (S, T, T) and score (S, T) of T numbers per pose (S); and derivatives of points (P, 3, T) by them in
    m per unit, NaN for unused points."""

    numbers: tuple[SharedNumber, ...]
    information: Array
    score: Array
    by_point: Array


def ray_statistics(observed: Observed, state: NetworkState) -> RayStatistics:
    """Return information, score and derivatives of the shared numbers per pose, at an adjusted state."""
    network, layout = observed.network, observed.layout
    numbers = _numbers(observed, state)
    rays = network.rays
    image, point = rays.image[layout.rays], rays.point[layout.rays]
    linearised = linearise(network, state, image, point)
    rows = _LinearisedNetwork(
        observed,
        state,
        linearised,
        rays.xy_px[layout.rays] - linearised.xy_px,
        _derivative_by_numbers(observed, state, numbers, linearised, image, point),
        distances_at(observed, state),
        _distances_by_numbers(observed, numbers),
    )
    free = freedoms(layout, state)
    pose_of_ray = np.searchsorted(layout.image_start, layout.ray_image, side="right") - 1
    information = np.zeros((layout.poses, len(numbers), len(numbers)))
    score, by_point = np.zeros(information.shape[:2]), np.full((len(state.points), 3, len(numbers)), np.nan)
    is_large = [rows_by_point is not None for rows_by_point in layout.rows.by_point]
    sides = shared_sides(observed, state, linearised, rows.left, rows.by_numbers) if any(is_large) else None
    for pose in range(layout.poses):
        index = np.flatnonzero(pose_of_ray == pose)
        if len(index):
            points = layout.points[layout.point_start[pose] : layout.point_start[pose + 1]]
            if sides is not None and is_large[pose]:
                blocks = sides.equations.points[layout.point_start[pose] : layout.point_start[pose + 1]]
                ties = distances_as_ties(observed, pose, rows.distances, rows.by_bars, blocks, _RIGID)
                statistics = information_of_pose(sides, observed, pose, free[pose], ties)
            else:
                statistics = _statistics_of_pose(rows, pose, index, free[pose])
            information[pose], score[pose], points_by_numbers = statistics
            by_point[points] = _project_to_datum(points_by_numbers, free[pose])
    return RayStatistics(numbers, information, score, by_point)


@dataclass(frozen=True)
class _LinearisedNetwork:
    """A network at an adjusted state, linearised by its unknowns and by T shared numbers.

    left (n, 2) px: rays measured minus computed; derivatives by the numbers: by_numbers (n, 2, T) of rays, by_bars (q,
    T) of distances.
    """

    observed: Observed
    state: NetworkState
    at: LinearisedRays
    left: Array
    by_numbers: Array
    distances: Distances
    by_bars: Array


def _numbers(observed: Observed, state: NetworkState) -> tuple[SharedNumber, ...]:
    """Return the shared numbers, those hardest to separate from the rest first, cameras' c last."""
    network, layout = observed.network, observed.layout
    cameras = np.unique(network.image_camera[layout.images]).tolist()
    bars, lengths = np.unique(network.bars.bar[layout.distances]).tolist(), network.bars
    shared_numbers = [SharedNumber(AIR, -1, name, "1/m^2", _CURVATURE, 0.0) for name in CURVATURES]
    shared_numbers += [SharedNumber(WINDOW, camera, "thickness", "m", _THICKNESS, 0.0) for camera in cameras]
    sigma = lengths.sigma_m / lengths.length_m
    mean = lengths.length_m / state.bar_length_m - 1
    shared_numbers += [
        SharedNumber(BAR, bar, "strain", "1", _STRAIN, float(sigma[bar]), float(mean[bar])) for bar in bars
    ]
    for k in (*range(3, len(PARAMETERS)), 1, 2, 0):
        for camera in cameras:
            camera_of_number, name = network.cameras[camera], PARAMETERS[k]
            scale = (camera_of_number.width_px / 2) ** _POWERS[k]
            shared_numbers.append(
                SharedNumber(CAMERA, camera, name, UNITS[k], scale, None if name in camera_of_number.free else 0.0)
            )
    return tuple(shared_numbers)


def _derivative_by_numbers(
    observed: Observed,
    state: NetworkState,
    numbers: tuple[SharedNumber, ...],
    linearised: LinearisedRays,
    image: Index,
    point: Index,
) -> Array:
    """Return the derivatives of rays (n, 2, T) by the numbers, zero for bars."""
    camera, points = observed.network.image_camera[image], state.points[point]
    origin = points.mean(0) if len(points) else np.zeros(3)
    air = linearised.by_point @ by_curvature(points, state.centre[image], origin)
    axis = state.R[image][:, :, 2]
    pane = (
        np.einsum("nki,ni->nk", linearised.by_point, axis) * by_thickness(in_camera_axes(state, image, point))[:, None]
    )
    derivative = np.zeros((len(image), 2, len(numbers)))
    for column, number in enumerate(numbers):
        is_owned = camera == number.owner
        if number.kind == AIR:
            derivative[..., column] = air[..., CURVATURES.index(number.name)]
        elif number.kind == WINDOW:
            derivative[is_owned, :, column] = pane[is_owned]
        elif number.kind == CAMERA:
            derivative[is_owned, :, column] = linearised.by_interior[is_owned, :, PARAMETERS.index(number.name)]
    return derivative


def _statistics_of_pose(
    rows: _LinearisedNetwork, pose: int, rows_of_pose: Index, free: Freedom
) -> tuple[Array, Array, Array]:
    """Return information (T, T), score (T,) and derivatives of the points (p, 3, T) of a pose.

    rows_of_pose: indices of its rays.
    """
    layout = rows.observed.layout
    first_image, first_point = layout.image_start[pose], layout.point_start[pose]
    images, points = layout.image_start[pose + 1] - first_image, layout.point_start[pose + 1] - first_point
    size = 6 * images + 3 * points
    # Rows of rays depend on nine unknowns: the image's six and the point's three.
    unknowns = np.concatenate(
        [
            6 * (layout.ray_image[rows_of_pose] - first_image)[:, None] + np.arange(6),
            6 * images + 3 * (layout.ray_point[rows_of_pose] - first_point)[:, None] + np.arange(3),
        ],
        1,
    )
    by_own = np.concatenate([rows.at.by_image[rows_of_pose], rows.at.by_point[rows_of_pose]], -1)
    by_numbers, residual, weight = (
        rows.by_numbers[rows_of_pose],
        rows.left[rows_of_pose],
        rows.observed.rays[rows_of_pose],
    )
    weighted_by_own = np.einsum("nki,nkl->nil", by_own, weight)
    weighted_by_numbers = np.einsum("nkt,nkl->ntl", by_numbers, weight)
    normal, sides = np.zeros((size, size)), np.zeros((size, by_numbers.shape[-1] + 1))
    np.add.at(normal, (unknowns[:, :, None], unknowns[:, None]), weighted_by_own @ by_own)
    by_numbers_and_residual = np.concatenate([by_numbers, residual[..., None]], -1)
    np.add.at(sides, unknowns, weighted_by_own @ by_numbers_and_residual)
    shared_normal = np.einsum("ntl,nls->ts", weighted_by_numbers, by_numbers_and_residual)
    _add_known(rows, pose, normal, sides, 6 * images)
    shared_normal += _add_distances(rows, pose, normal, sides, 6 * images)
    scale = 1 / np.sqrt(np.diagonal(normal))
    normal *= scale * scale[:, None]
    sides *= scale[:, None]
    # Rows of unit weight along the datum's freedoms fix what no observation determines.
    datum_rows = np.concatenate([_flattened(free.images), _flattened(free.points)]) / scale[:, None]
    datum_rows = np.linalg.qr(datum_rows)[0]
    normal += datum_rows @ datum_rows.T
    solved = cho_solve(cho_factor(normal, lower=True), sides)
    reduced = shared_normal - sides[:, :-1].T @ solved
    information = (reduced[:, :-1] + reduced[:, :-1].T) / 2
    points_by_numbers = -(solved[:, :-1] * scale[:, None])[6 * images :]
    return information, reduced[:, -1], points_by_numbers.reshape(points, 3, -1)


def _project_to_datum(points_by_numbers: Array, free: Freedom) -> Array:
    """Return derivatives of points (p, 3, T) without shifts, rotations and scale of all points that the observations
    leave free."""
    flat, movements = (
        points_by_numbers.reshape(3 * len(points_by_numbers), points_by_numbers.shape[-1]),
        _flattened(free.points),
    )
    return (flat - movements @ (movements.T @ flat)).reshape(points_by_numbers.shape)


def _distances_by_numbers(observed: Observed, numbers: tuple[SharedNumber, ...]) -> Array:
    """Return the derivatives (q, T) of distances minus the lengths of their bars by the shared numbers."""
    bars, bar = observed.network.bars, observed.network.bars.bar[observed.layout.distances]
    strain = {number.owner: column for column, number in enumerate(numbers) if number.kind == BAR}
    derivative = np.zeros((len(bar), len(numbers)))
    for row, bar_number in enumerate(bar.tolist()):
        derivative[row, strain[bar_number]] = -bars.length_m[bar_number]
    return derivative


def _add_known(rows: _LinearisedNetwork, pose: int, normal: Array, sides: Array, first: int) -> None:
    """Add the known points of a pose to its normal equations; ``first``: column of its first point."""
    observed, state = rows.observed, rows.state
    layout, known = observed.layout, observed.network.known
    start, stop = layout.point_start[pose], layout.point_start[pose + 1]
    for row in np.flatnonzero((layout.known_slot >= start) & (layout.known_slot < stop)):
        unknowns = first + 3 * (layout.known_slot[row] - start) + np.arange(3)
        number = layout.known[row]
        normal[np.ix_(unknowns, unknowns)] += observed.known[row]
        sides[unknowns, -1] += observed.known[row] @ (known.xyz_m[number] - state.points[known.point[number]])


def _add_distances(rows: _LinearisedNetwork, pose: int, normal: Array, sides: Array, first: int) -> Array:
    """Add the distances of a pose to its normal equations; return their contribution (T, T + 1) to those of the
    numbers."""
    observed, distances, by_bars = rows.observed, rows.distances, rows.by_bars
    layout, start = observed.layout, observed.layout.point_start[pose]
    added = np.zeros((by_bars.shape[1], by_bars.shape[1] + 1))
    for row in np.flatnonzero(layout.distance_pose == pose):
        end_points = np.array([layout.first[row], layout.second[row]]) - start
        flat = (first + 3 * end_points[:, None] + np.arange(3)).ravel()
        gradient = np.concatenate([-distances.direction[row], distances.direction[row]])
        weight_limit = _RIGID * float(np.sum(np.diagonal(normal)[flat])) / len(flat)
        weight = min(1 / max(float(observed.distance_variance[row]), 1e-300), weight_limit)
        # The observation is zero: the distance minus the bar's length.
        by_bar_and_misclosure = np.append(by_bars[row], distances.misclosure[row])
        normal[np.ix_(flat, flat)] += weight * np.outer(gradient, gradient)
        sides[flat] += weight * np.outer(gradient, by_bar_and_misclosure)
        added += weight * np.outer(by_bar_and_misclosure[:-1], by_bar_and_misclosure)
    return added


def _flattened(freedoms: Array) -> Array:
    """Return freedoms (n, k, d) flattened to (n k, d), also if empty."""
    return freedoms.reshape(freedoms.shape[0] * freedoms.shape[1], freedoms.shape[2])


def by_curvature(points: Array, centres: Array, origin: Array) -> Array:
    """Return apparent movements (N, 3, 6) of points (N, 3) in m, seen from centres (N, 3); per second derivative of the
    index, 1/m^2, in the order of CURVATURES.

    origin (3,): place without index gradient.
    """
    to_camera = centres - points
    length = np.linalg.norm(to_camera, axis=-1, keepdims=True)
    moment = (points - origin) * length**2 / 2 + to_camera * length**2 / 3
    result = np.zeros((*points.shape, len(PLACES)))
    for number, (i, j) in enumerate(PLACES):
        result[:, i, number] -= moment[:, j]
        if i != j:
            result[:, j, number] -= moment[:, i]
    return result


def by_thickness(in_camera: Array) -> Array:
    """Return the apparent movement (N,) of points (N, 3) in a camera's axes along its axis, per thickness of a pane."""
    cosine = in_camera[:, 2] / np.linalg.norm(in_camera, axis=-1)
    return np.asarray(cosine / np.sqrt(GLASS**2 - 1 + cosine**2) - 1)


@dataclass(frozen=True)
class RayChannels:
    """Per pose (S): values (S, T) with unit noise and derivative root (S, T, T) by the numbers.

    determined (S, T): channels with information. The channel of a number does not depend on the numbers before it.
    """

    value: Array
    root: Array
    determined: Mask


def ray_channels(information: Array, score: Array) -> RayChannels:
    """Return the channels of information (S, T, T) and scores (S, T) by a Cholesky factor per pose, skipping
    undetermined numbers."""
    remaining, remaining_score = information.copy(), score.copy()
    total = np.diagonal(information, axis1=1, axis2=2)
    root, value = np.zeros_like(information), np.zeros_like(score)
    determined = np.zeros(score.shape, bool)
    for k in range(score.shape[1]):
        pivot = remaining[:, k, k]
        determined[:, k] = pivot > _LEFT * total[:, k]
        factor = np.where(determined[:, k], 1 / np.sqrt(np.where(determined[:, k], pivot, 1.0)), 0.0)
        root[:, k, k:] = remaining[:, k, k:] * factor[:, None]
        value[:, k] = remaining_score[:, k] * factor
        remaining -= root[:, k, :, None] * root[:, k, None]
        remaining_score -= root[:, k] * value[:, k, None]
    return RayChannels(value, root, determined)


@dataclass(frozen=True)
class SharedErrors:
    """Error patterns (p, 3, E) in m per unit-variance number, and the remaining covariance (p, 3, 3) of each point."""

    patterns: Array
    own: Array


def shared_errors(covariance: Array, points: Array, max_patterns: int) -> SharedErrors:
    """Return the patterns, at most `max_patterns`, of a covariance (3 p, 3 p) in m^2 of points (p, 3) with common
    errors.

    Shifts and rotations of all points, which a pose leaves free, are removed. Patterns are the largest eigenvectors of
    the rest, in units of the points' own standard deviations.
    """
    count = len(points)
    arms = points - points.mean(0)
    rigid = rigid_motions(arms).reshape(3 * count, 6)
    orthonormal = np.linalg.qr(rigid / np.linalg.norm(rigid, axis=0))[0]
    remaining = covariance - orthonormal @ (orthonormal.T @ covariance)
    remaining = remaining - (remaining @ orthonormal) @ orthonormal.T
    sigma = np.sqrt(
        max(float(np.mean(np.diagonal(remaining))), 0.0)
    )  # of a nearly singular network, only rounding remains
    values, vectors = np.linalg.eigh((remaining + remaining.T) / 2)
    noise_variance = float(np.median(values[6:])) if count > 2 else sigma**2
    chosen = np.arange(len(values))[::-1][:max_patterns]
    chosen = chosen[values[chosen] > _TOGETHER * noise_variance]
    patterns = vectors[:, chosen] * np.sqrt(values[chosen] - noise_variance)
    diagonal = np.arange(count)
    blocks = (remaining - patterns @ patterns.T).reshape(count, 3, count, 3)[diagonal, :, diagonal]
    return SharedErrors(patterns.reshape(count, 3, -1), blocks)
