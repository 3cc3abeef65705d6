"""Start values of a network without the user: every image's orientation and every point, from named points alone.

Each pose is oriented for itself: from points with known coordinates where an image sees enough of them, else from the
relative orientation of two images, else from a marker of known size; the other images follow by resection and
intersection in turn, with adjustments in between that also free the principal distance. A principal distance that is
not known is tried at several field widths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from truing.estimation.bundle.growing import Grown, grow, intersected
from truing.estimation.bundle.intersection import Mask
from truing.estimation.bundle.network import Array, Index, Network, State
from truing.estimation.bundle.pose_networks import PoseNetwork, pose_networks
from truing.estimation.bundle.start_refinement import joined, refined, refined_together, reopened
from truing.estimation.bundle.start_seeds import begin, usual_distance
from truing.estimation.rigid_poses.umeyama import umeyama

KNOWN, BARS, MARKERS, FREE, NOTHING = "known points", "scale bars", "markers", "none", "not oriented"
_ROUNDS = 20


@dataclass(frozen=True)
class Markers:
    """Square markers of known size: their corners (M, 4) as points by number, in order round the square, and the length
    of an edge size_m (M,)."""

    corners: Index
    size_m: Array

    @classmethod
    def none(cls) -> Markers:
        """No marker at all."""
        return cls(np.empty((0, 4), np.int64), np.empty(0))


@dataclass(frozen=True)
class Start:
    """Start values: the state (NaN where nothing was found), which images (I,) are oriented and points (P,) placed,
    which rays (N,) agree, and per pose (S) where its frame and its scale come from ("known points", "scale bars",
    "markers", "none": free, "not oriented")."""

    state: State
    image_oriented: Mask
    point_placed: Mask
    ray_agrees: Mask
    frame: tuple[str, ...]
    scale: tuple[str, ...]


def find_start(network: Network, interior: Array, markers: Markers | None = None) -> Start:
    """Return start values of all images and points that can be oriented.

    interior (C, 10) as known beforehand, in the order of camera.PARAMETERS: a principal distance from EXIF data or a
    calibration, NaN where nothing is known; other elements 0 where nothing is known.
    """
    markers = Markers.none() if markers is None else markers
    poses = pose_networks(network)
    poses.sort(key=lambda pose: -len(pose.ray))
    found: list[Grown] = []
    values = interior.copy()
    for pose in poses:
        corners, size_m = _markers_of(pose, markers)
        found.append(begin(pose.network, values, corners, size_m))
        used = np.unique(pose.network.image_camera[found[-1].oriented])
        values[used] = found[-1].interior[used]
    values[:, 0] = np.where(np.isnan(values[:, 0]), usual_distance(network), values[:, 0])
    found = _finished(network, poses, [replace(now, interior=values) for now in found])
    whole = joined(network, poses, found)
    state, frame, scale = in_frame(network, whole, markers.corners, markers.size_m)
    agrees = np.zeros(network.rays.count, bool)
    for pose, now in zip(poses, found, strict=True):
        agrees[pose.ray] = now.agrees
    oriented, placed = np.isfinite(state.centre[:, 0]), np.isfinite(state.points[:, 0])
    return Start(state, oriented, placed, agrees, tuple(frame), tuple(scale))


def _markers_of(pose: PoseNetwork, markers: Markers) -> tuple[Index, Array]:
    """Return corners (m, 4), by the pose's own numbers, and sizes (m,) of the markers whose corners are all the
    pose's."""
    own = np.isin(markers.corners, pose.point).all(axis=1)
    return np.searchsorted(pose.point, markers.corners[own]), markers.size_m[own]


def _finished(network: Network, poses: Sequence[PoseNetwork], found: Sequence[Grown]) -> list[Grown]:
    """Return all poses adjusted together with the first tolerance, images tried again that failed before, and once more
    adjusted."""
    together = refined_together(network, poses, [reopened(p.network, now) for p, now in zip(poses, found, strict=True)])
    again = []
    for pose, now in zip(poses, together, strict=True):
        rng = np.random.default_rng(0)
        if now.oriented.any() and not now.oriented.all():
            wide = replace(reopened(pose.network, now), failed={})
            now = grow(intersected(wide, rng), rng, partial(refined, pose.network))
        again.append(intersected(replace(now, interior=together[0].interior), rng) if now.oriented.any() else now)
    return refined_together(network, poses, again)


def in_frame(network: Network, state: State, corners: Index, size_m: Array) -> tuple[State, list[str], list[str]]:
    """Return the state with every pose in the frame of its known points, or to scale; and where each pose (S) has its
    frame and its scale from."""
    R, centre, points = state.R.copy(), state.centre.copy(), state.points.copy()
    poses = 1 + int(max(network.image_pose.max(initial=-1), network.point_pose.max(initial=-1)))
    frames, scales = [FREE] * poses, [FREE] * poses
    for pose in range(poses):
        images, own = network.image_pose == pose, network.point_pose == pose
        if not np.isfinite(centre[images]).any():
            frames[pose] = scales[pose] = NOTHING
            continue
        turn, factor, shift, frames[pose], scales[pose] = _similarity(network, points, own, corners, size_m)
        points[own] = factor * points[own] @ turn.T + shift
        centre[images] = factor * centre[images] @ turn.T + shift
        R[images] = turn @ R[images]
    return State(state.interior, R, centre, points, network.bars.length_m.copy()), frames, scales


def _similarity(
    network: Network, points: Array, own: Array, corners: Index, size_m: Array
) -> tuple[Array, float, Array, str, str]:
    """Return rotation, factor and shift of a pose, and where its frame and its factor come from."""
    known = network.known
    here = own[known.point] & np.isfinite(points[known.point, 0])
    there, target = points[known.point[here]], known.xyz_m[here]
    if len(target) >= 3 and np.linalg.svd(target - target.mean(0), compute_uv=False)[1] > 1e-6:
        return *_robust_similarity(there, target), KNOWN, KNOWN
    bars = network.bars
    chosen = own[bars.first]
    lengths = [(bars.length_m[bars.bar[chosen]], bars.first[chosen], bars.second[chosen], BARS)]
    sides = corners[own[corners[:, 0]]] if len(corners) else np.empty((0, 4), np.int64)
    sizes = np.repeat(size_m[own[corners[:, 0]]] if len(corners) else size_m, 4)
    lengths.append((sizes, sides.ravel(), np.roll(sides, -1, axis=1).ravel(), MARKERS))
    if len(target) == 2:
        two = known.point[here]
        lengths.append((np.linalg.norm(target[:1] - target[1:], axis=1), two[:1], two[1:], KNOWN))
    for length, first, second, source in lengths:
        with np.errstate(divide="ignore"):
            ratio = length / np.linalg.norm(points[first] - points[second], axis=1)
        if np.isfinite(ratio).any():
            return np.eye(3), float(np.median(ratio[np.isfinite(ratio)])), np.zeros(3), FREE, source
    placed = points[own & np.isfinite(points[:, 0])]
    size = float(np.sqrt(np.mean((placed - placed.mean(0)) ** 2) * 3)) if len(placed) > 1 else 1.0
    return np.eye(3), 1.0 / size, np.zeros(3), FREE, FREE


def _robust_similarity(source: Array, target: Array) -> tuple[Array, float, Array]:
    """Return rotation, factor and shift from source to target (n, 3), by least absolute distances: a few wrong known
    points move it little."""
    weight = np.ones(len(source))
    for _ in range(_ROUNDS):
        fit = umeyama(source[None], target[None], weight[None], with_scale=True)
        R, scale, shift = fit.R[0], float(fit.scale[0]), fit.t[0]
        off = np.linalg.norm(scale * source @ R.T + shift - target, axis=1)
        weight = 1 / np.maximum(off, 1e-9 + 1e-3 * np.median(off))
        weight /= weight.max()
    return R, scale, shift
