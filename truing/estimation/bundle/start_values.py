"""Start values of a network from named points alone: the orientation of every image and the coordinates of every point.

Each pose is oriented separately: from points with known coordinates if an image sees enough of them. Else the relative
orientation of two images, else a marker of known size. Of several seeds, the one that explains most rays
is taken, and the other images follow (`truing.estimation.bundle.growing`). An unknown principal distance is tried at
several field widths.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.estimation.bundle.growing import (
    Grown,
    grow,
    intersected,
    joined_poses,
    longer_sides,
    prepare,
    refined,
    refined_together,
    reopened,
)
from truing.estimation.bundle.network import Markers, Network, NetworkState, PoseNetwork, pose_networks
from truing.estimation.bundle.orientation import (
    FEWEST_COMMON,
    FEWEST_POINTS,
    ImagePair,
    common_points,
    relative_orientations,
)
from truing.estimation.rigid_poses.umeyama import umeyama

KNOWN, BARS, MARKERS, FREE, NOTHING = "known points", "scale bars", "markers", "none", "not oriented"
_ROUNDS = 20
_FLAT = 0.05  # relative to the larger extent: points closer to a line give no scale
_MEDIAN_OF_NORMAL = 0.6745  # median absolute value over the standard deviation
_FIELD_WIDTHS = (1.25, 0.85, 1.8, 2.6, 0.6, 4.0)  # principal distance over the longer side, the most common first
_FEW_SEEDS = 1  # seeds tried with each field width in the first round
_PAIRS = 12  # pairs of images whose relative orientation is tried
_BEST_PAIRS = 3  # pairs that are grown
_GOOD_PAIR = 0.8  # share of common points that agree, at a good angle; after enough such pairs the search stops
_TRIAL_IMAGES = 6  # size to which rival seeds are grown before one is chosen
_GOOD_ANGLE = np.radians(15.0)  # of intersection; larger angles are no better as a start
_LEAST_ANGLE = np.radians(2.0)
_CLEAR_IMAGES = 0.6  # share of the possible images that are oriented, and
_CLEAR_SHARE = 0.6  # share of an oriented image's rays that agree, and
_CLEAR_PER_SIDE = 5e-4  # residuals over the longer side: with all three, no rival is tried
_SCORED_PER_SIDE = 5e-3  # residual over the longer side from which a ray counts nothing


@dataclass(frozen=True)
class Start:
    """Start values: state (NaN if not found), masks of oriented images (I,), placed points (P,) and agreeing rays (N,).

    Per pose (S): source of its frame and of its scale ("known points", "scale bars", "markers", "none": free, "not
    oriented").
    """

    state: NetworkState
    image_oriented: Mask
    point_placed: Mask
    ray_agrees: Mask
    frame: tuple[str, ...]
    scale: tuple[str, ...]


def find_start(network: Network, interior: Array, markers: Markers | None = None) -> Start:
    """Return start values of all images and points that can be oriented.

    interior (C, 10): known values in the order of camera.PARAMETERS; principal distance from EXIF data or a
    calibration, NaN if unknown; other elements 0 if unknown.
    """
    markers = Markers.none() if markers is None else markers
    poses = pose_networks(network)
    poses.sort(key=lambda pose: -len(pose.ray))
    grown_poses: list[Grown] = []
    values = interior.copy()
    for pose in poses:
        in_pose = np.isin(markers.corners, pose.point).all(axis=1)  # markers with all corners in the pose
        corners = np.searchsorted(pose.point, markers.corners[in_pose])
        grown_poses.append(oriented_pose(pose.network, values, corners, markers.size_m[in_pose]))
        used = np.unique(pose.network.image_camera[grown_poses[-1].oriented])
        values[used] = grown_poses[-1].interior[used]
    values[:, 0] = np.where(np.isnan(values[:, 0]), usual_distance(network), values[:, 0])
    grown_poses = _finished(network, poses, [replace(grown, interior=values) for grown in grown_poses])
    network_state = joined_poses(network, poses, grown_poses)
    state, frame, scale = in_frame(network, network_state, markers.corners, markers.size_m)
    inliers = np.zeros(network.rays.count, bool)
    for pose, grown in zip(poses, grown_poses, strict=True):
        inliers[pose.ray] = grown.agrees
    oriented, placed = np.isfinite(state.centre[:, 0]), np.isfinite(state.points[:, 0])
    return Start(state, oriented, placed, inliers, tuple(frame), tuple(scale))


def _finished(network: Network, poses: Sequence[PoseNetwork], grown_poses: Sequence[Grown]) -> list[Grown]:
    """Return all poses after a joint adjustment with the first tolerance, another attempt at failed images, and a
    second adjustment."""
    adjusted_poses = refined_together(
        network, poses, [reopened(p.network, grown) for p, grown in zip(poses, grown_poses, strict=True)]
    )
    regrown_poses = []
    for pose, grown in zip(poses, adjusted_poses, strict=True):
        rng = np.random.default_rng(0)
        if grown.oriented.any() and not grown.oriented.all():
            restarted = replace(reopened(pose.network, grown), failed={})
            grown = grow(intersected(restarted, rng), rng, partial(refined, pose.network))
        regrown_poses.append(
            intersected(replace(grown, interior=adjusted_poses[0].interior), rng) if grown.oriented.any() else grown
        )
    return refined_together(network, poses, regrown_poses)


def in_frame(
    network: Network, state: NetworkState, corners: Index, size_m: Array
) -> tuple[NetworkState, list[str], list[str]]:
    """Return the state with every pose in the frame of its known points, or to scale; and the source of frame and scale
    per pose (S)."""
    R, centre, points = state.R.copy(), state.centre.copy(), state.points.copy()
    frames, scales = [FREE] * network.poses, [FREE] * network.poses
    for pose in range(network.poses):
        images, points_of_pose = network.image_pose == pose, network.point_pose == pose
        if not np.isfinite(centre[images]).any():
            frames[pose] = scales[pose] = NOTHING
            continue
        rotation, factor, shift, frames[pose], scales[pose] = _similarity(
            network, points, points_of_pose, corners, size_m
        )
        points[points_of_pose] = factor * points[points_of_pose] @ rotation.T + shift
        centre[images] = factor * centre[images] @ rotation.T + shift
        R[images] = rotation @ R[images]
    return NetworkState(state.interior, R, centre, points, network.bars.length_m.copy()), frames, scales


def _similarity(
    network: Network, points: Array, in_pose: Array, corners: Index, size_m: Array
) -> tuple[Array, float, Array, str, str]:
    """Return rotation, factor and shift of a pose, and the sources of its frame and its scale."""
    known = network.known
    is_usable = in_pose[known.point] & np.isfinite(points[known.point, 0])
    estimated, target = points[known.point[is_usable]], known.xyz_m[is_usable]
    if len(target) >= 3 and np.linalg.svd(target - target.mean(0), compute_uv=False)[1] > 1e-6:
        return *robust_similarity(estimated, target), KNOWN, KNOWN
    bars = network.bars
    chosen = in_pose[bars.first]
    lengths = [(bars.length_m[bars.bar[chosen]], bars.first[chosen], bars.second[chosen], BARS)]
    sides = corners[in_pose[corners[:, 0]]] if len(corners) else np.empty((0, 4), np.int64)
    sizes = np.repeat(size_m[in_pose[corners[:, 0]]] if len(corners) else size_m, 4)
    lengths.append((sizes, sides.ravel(), np.roll(sides, -1, axis=1).ravel(), MARKERS))
    if len(target) == 2:
        known_pair = known.point[is_usable]
        lengths.append((np.linalg.norm(target[:1] - target[1:], axis=1), known_pair[:1], known_pair[1:], KNOWN))
    for length, first, second, source in lengths:
        with np.errstate(divide="ignore"):
            ratio = length / np.linalg.norm(points[first] - points[second], axis=1)
        if np.isfinite(ratio).any():
            return np.eye(3), float(np.median(ratio[np.isfinite(ratio)])), np.zeros(3), FREE, source
    positions = points[in_pose & np.isfinite(points[:, 0])]
    size = float(np.sqrt(np.mean((positions - positions.mean(0)) ** 2) * 3)) if len(positions) > 1 else 1.0
    return np.eye(3), 1.0 / size, np.zeros(3), FREE, FREE


def robust_similarity(source: Array, target: Array) -> tuple[Array, float, Array]:
    """Return rotation, factor and shift from source to target (n, 3) by least absolute distances, robust against a few
    wrong points."""
    weight = np.ones(len(source))
    for _ in range(_ROUNDS):
        fit = umeyama(source[None], target[None], weight[None], with_scale=True)
        R, scale, shift = fit.R[0], float(fit.scale[0]), fit.t[0]
        residual = np.linalg.norm(scale * source @ R.T + shift - target, axis=1)
        weight = 1 / np.maximum(residual, 1e-9 + 1e-3 * np.median(residual))
        weight /= weight.max()
    return R, scale, shift


def scale_ratio(observed: Array, stated: Array) -> tuple[float, float] | None:
    """Return the ratio of stated to observed lengths of points (n, 3), with sigma from the residuals; None if they are
    nearly on one line."""
    extent = np.linalg.svd(stated - stated.mean(0), compute_uv=False)
    if extent[1] < _FLAT * extent[0]:
        return None
    R, scale, shift = robust_similarity(observed, stated)
    residual = np.linalg.norm(scale * observed @ R.T + shift - stated, axis=1)
    return scale, float(np.median(residual) / (_MEDIAN_OF_NORMAL * extent[0]))


def usual_distance(network: Network) -> Array:
    """Return the principal distances (C,) in px of common lenses."""
    return _FIELD_WIDTHS[0] * longer_sides(network)


def oriented_pose(network: Network, interior: Array, corners: Index, size_m: Array) -> Grown:
    """Return a pose, alone in its network, oriented as far as possible.

    Principal distances are tried at several field widths if the given ones (C,) are NaN, or if they are free and fail.
    """
    trials = (
        # A fixed seed makes the start reproducible.
        _best_seed(network, prepare(network, values), corners, size_m, np.random.default_rng(0), max_seeds)
        for values, max_seeds in _interiors(network, interior)
    )
    best, _ = _first_clear_or_best(network, trials, (prepare(network, np.nan_to_num(interior, nan=1.0)), -1.0))
    return grow(best, np.random.default_rng(0), lambda grown: refined(network, grown))


def _interiors(network: Network, interior: Array) -> Iterator[tuple[Array, int | None]]:
    """Return the interiors to try, each with the number of seeds: as given, then at several field widths with few
    seeds, then with all."""
    cameras = np.unique(network.image_camera)
    unknown = np.isnan(interior[cameras, 0])
    free = np.array(["c" in network.cameras[k].free for k in cameras], dtype=bool)
    if not unknown.any():
        yield interior, None
    uncertain_cameras = cameras[unknown] if unknown.any() else cameras[free]
    for max_seeds in (_FEW_SEEDS, None):
        for width in _FIELD_WIDTHS if len(uncertain_cameras) else ():
            values = interior.copy()
            values[uncertain_cameras, 0] = width * longer_sides(network)[uncertain_cameras]
            yield np.nan_to_num(values, nan=1.0), max_seeds


def _best_seed(
    network: Network, empty: Grown, corners: Index, size_m: Array, rng: np.random.Generator, max_seeds: int | None
) -> tuple[Grown, float]:
    """Return the best of all seeds, or of the first `max_seeds`, grown to a few images, and its score."""
    seeds = islice(_seeds(network, empty, corners, size_m, rng), max_seeds)
    grown_seeds = (grow(seed, rng, lambda grown: refined(network, grown), _TRIAL_IMAGES) for seed in seeds)
    return _first_clear_or_best(network, ((trial, _score(network, trial)) for trial in grown_seeds), (empty, 0.0))


def _first_clear_or_best(
    network: Network, trials: Iterable[tuple[Grown, float]], best: tuple[Grown, float]
) -> tuple[Grown, float]:
    """Return the first clear trial with its score, or else the one of the highest score, ``best`` included."""
    for trial, score in trials:
        if _is_clear(network, trial):
            return trial, score
        if score > best[1]:
            best = trial, score
    return best


def _ray_distance(grown: Grown) -> Array:
    residual_px, depth = grown.rays.ray_distances(grown.X)
    with np.errstate(invalid="ignore"):
        return np.where(depth > 0, np.linalg.norm(residual_px, axis=1), np.nan)


def _score(network: Network, grown: Grown) -> float:
    """Return the number of rays that a seed explains; rays with large residuals count less."""
    is_intersected = np.bincount(grown.rays.point[grown.agrees], minlength=grown.rays.points) >= 2
    has_determined_point = (is_intersected | np.isfinite(grown.given[:, 0]))[grown.rays.point]
    limit = _SCORED_PER_SIDE * float(longer_sides(network).max())
    share = 1 - (np.nan_to_num(_ray_distance(grown), nan=np.inf) / limit) ** 2
    return float(np.maximum(share, 0.0)[has_determined_point & grown.agrees].sum())


def _is_clear(network: Network, grown: Grown) -> bool:
    """True if a seed explains nearly all rays of enough images closely."""
    image, oriented = grown.rays.image, grown.oriented
    count = np.bincount(image, minlength=len(oriented))
    is_testable = oriented[image] & (
        np.bincount(grown.rays.point[oriented[image]], minlength=grown.rays.points)[grown.rays.point] > 1
    )
    required_images = _CLEAR_IMAGES * min(_TRIAL_IMAGES, int((count >= FEWEST_COMMON).sum()))
    if not is_testable.any() or oriented.sum() < max(required_images, 2):
        return False
    median_residual_px = float(np.median(_ray_distance(grown)[grown.agrees])) if grown.agrees.any() else np.inf
    return bool(
        grown.agrees[is_testable].mean() > _CLEAR_SHARE
        and median_residual_px < _CLEAR_PER_SIDE * longer_sides(network).max()
    )


def _seeds(network: Network, empty: Grown, corners: Index, size_m: Array, rng: np.random.Generator) -> Iterator[Grown]:
    """Return all seeds of a pose, the most reliable first."""
    known = np.full_like(empty.X, np.nan)
    known[network.known.point] = network.known.xyz_m
    yield from _starts_from_coordinates(empty, known)
    yield from _starts_from_pairs(empty, rng)
    square = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    images = [_seeing(empty, corner_points) for corner_points in corners]
    for marker in np.argsort([-len(seeing_images) for seeing_images in images], kind="stable")[:_BEST_PAIRS]:
        marker_points = np.full_like(empty.X, np.nan)
        marker_points[corners[marker]] = square * size_m[marker]
        yield from _starts_from_coordinates(empty, marker_points)


def _seeing(grown: Grown, points: Index) -> Index:
    """Return the images that see all of the given points."""
    is_observed = np.isin(grown.rays.point, points)
    return np.flatnonzero(np.bincount(grown.rays.image[is_observed], minlength=len(grown.rays.R)) >= len(points))


def _starts_from_coordinates(empty: Grown, known: Array) -> Iterator[Grown]:
    """Return the seed from coordinates (P, 3), if an image sees enough of them."""
    observing_images = empty.rays.image[np.isfinite(known[empty.rays.point, 0])]
    if len(observing_images) and np.bincount(observing_images).max() >= FEWEST_POINTS:
        yield replace(empty, given=known, X=known)


def _starts_from_pairs(empty: Grown, rng: np.random.Generator) -> Iterator[Grown]:
    """Return seeds from pairs of images, sorted by number of agreeing points and intersection angle."""
    is_finite = np.isfinite(empty.rays.direction[:, 0])
    rays = empty.rays.of(is_finite)
    common_count = np.triu(common_points(rays.image, rays.point, len(rays.R), rays.points))
    order = np.argsort(-common_count, axis=None, kind="stable")[:_PAIRS]
    candidates: list[tuple[float, int, int, list[ImagePair]]] = []
    for i, j in zip(*np.unravel_index(order, common_count.shape), strict=True):
        if common_count[i, j] < FEWEST_COMMON:
            break
        a, b = np.flatnonzero(rays.image == i), np.flatnonzero(rays.image == j)
        _, at_a, at_b = np.intersect1d(rays.point[a], rays.point[b], return_indices=True)
        limit = empty.tolerance_px / float(rays.scale_px[a[0]])
        pairs = relative_orientations(rays.direction[a[at_a]], rays.direction[b[at_b]], limit)
        pairs = [pair for pair in pairs if pair.angle > _LEAST_ANGLE]
        if pairs:
            score = max(pair.agreeing * min(pair.angle / _GOOD_ANGLE, 1.0) for pair in pairs)
            candidates.append((score, int(i), int(j), pairs))
        if sum(scored[0] > _GOOD_PAIR * common_count[scored[1], scored[2]] for scored in candidates) == _BEST_PAIRS:
            break
    candidates.sort(key=lambda candidate: -candidate[0])
    for _, i, j, pairs in candidates[:_BEST_PAIRS]:
        for pair in pairs:
            oriented_pair = empty.with_images({i: (np.eye(3), np.zeros(3)), j: (pair.R, pair.centre)})
            yield intersected(oriented_pair, rng)
