"""Frame and scale of oriented poses, from known points, scale bars or markers."""

from __future__ import annotations

import numpy as np

from truing.estimation.bundle.network import Array, Index, Network, State
from truing.estimation.rigid_poses.umeyama import umeyama

KNOWN, BARS, MARKERS, FREE, NOTHING = "known points", "scale bars", "markers", "none", "not oriented"
_ROUNDS = 20


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
