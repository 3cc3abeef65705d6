"""Compiled expensive steps of `truing.estimation.rigid_poses.consensus_steps`: same results, for large batches.

Residuals use the lanes of `truing.estimation.rigid_poses.batched_kernel`; poses without a verified result go to NumPy.
Importing this module imports numba; compiled code is cached on disk. With it `consensus` finds 2 to 19 times as many
poses a second as TEASER++ (`python -m benchmarks.pose`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.compiled_code import compiled, inner
from truing.estimation import simd_arithmetic
from truing.estimation.rigid_poses import batched_kernel, consensus_steps
from truing.estimation.rigid_poses.batched_kernel import (
    CLEAR,
    FIELDS,
    ROTATION,
    ROWS,
    SOURCE_CENTRE,
    TARGET_CENTRE,
    TURN_INVERSE,
    WEIGHT,
    PointPairs,
    accumulate_moments,
    load_block,
    solve_rotations,
)
from truing.estimation.simd_arithmetic import (
    IDENTITY,
    LANES,
    apply,
    cofactors,
    combine,
    dot,
    get3,
    get6,
    get9,
    mix,
    point3,
    rows_times,
    skew,
    times,
    transpose,
)

_SOURCES = (simd_arithmetic.__file__, batched_kernel.__file__, consensus_steps.__file__, __file__)


def statuses(clouds: consensus_steps.Clouds) -> NDArray:
    """Same as `consensus_steps.statuses`."""
    return batched_kernel.solve(clouds.x, clouds.y, clouds.is_observed / clouds.sigma**2, threads=1).status


def squared_residuals(clouds: consensus_steps.Clouds, members: NDArray) -> tuple[NDArray, NDArray]:
    """Same as `consensus_steps.squared_residuals`."""
    student, plain, clear = np.empty(members.shape), np.empty(members.shape), np.empty(len(members), bool)
    pairs = PointPairs(clouds.x, clouds.y, clouds.is_observed, np.empty((0, 1)))
    residuals_of_poses(pairs, clouds.sigma, members, student, plain, clear)
    unclear = np.flatnonzero(~clear)
    if len(unclear):
        student[unclear], plain[unclear] = consensus_steps.squared_residuals(clouds[unclear], members[unclear])
    return student, plain


def same_distances(clouds: consensus_steps.Clouds) -> NDArray:
    """Same as `consensus_steps.same_distances`."""
    graph = np.empty((*clouds.is_observed.shape, clouds.is_observed.shape[1]), np.float32)
    edges_of_poses(clouds.x, clouds.y, clouds.is_observed, np.square(consensus_steps.PAIR_LIMIT * clouds.sigma), graph)
    return graph


def grow(graph: NDArray, seed: NDArray, taken: NDArray) -> NDArray:
    """Same as `consensus_steps.grow`."""
    members = np.zeros(graph.shape[:2], bool)
    sets_of_poses(graph, seed, taken, consensus_steps.ANCHORS, members)
    return members


@inner
def load_members(sigma: NDArray, members: NDArray, first: int, points: NDArray) -> None:
    """Replace the weights in all lanes by those of the members, with the variances next to them."""
    for j in range(LANES):
        b = min(first + j, len(members) - 1)
        for n in range(len(points)):
            variance = sigma[b, n] * sigma[b, n]
            points[n, 6 * LANES + j] = 1.0 / variance if members[b, n] else 0.0
            points[n, 7 * LANES + j] = variance


@inner
def measure(points: NDArray, n: int, lane: NDArray) -> None:
    """Replace the first two fields of a point by its squared residuals, studentised and plain, in all lanes."""
    for j in range(LANES):
        q = mix(1.0, point3(points, n, 0, j), -1.0, get3(lane, SOURCE_CENTRE, j))
        c = mix(1.0, point3(points, n, 3, j), -1.0, get3(lane, TARGET_CENTRE, j))
        r = mix(1.0, apply(transpose(get9(lane, ROTATION, j)), c), -1.0, q)
        variance, sign = points[n, 7 * LANES + j], -1.0 if points[n, 6 * LANES + j] > 0.0 else 1.0
        turn = rows_times(times(skew(q), get6(lane, TURN_INVERSE, j)), skew(q))
        covariance = variance * (1.0 + consensus_steps.FLOOR) + sign / lane[WEIGHT * LANES + j]
        M = combine(sign, turn, covariance, IDENTITY)
        K = cofactors(M)
        points[n, j] = dot(r, apply(K, r)) / dot(M[0], K[0])
        points[n, LANES + j] = dot(r, r) / variance


@compiled(*_SOURCES)
def residuals_of_poses(
    pairs: PointPairs, sigma: NDArray, members: NDArray, student: NDArray, plain: NDArray, clear: NDArray
) -> None:
    """Fill in squared residuals (B, N) of the fit to members (B, N), and the mask (B,) of poses with a verified fit."""
    points, lane = np.empty((pairs.x.shape[1], FIELDS * LANES)), np.empty(ROWS * LANES)
    for first in range(0, len(members), LANES):
        load_block(pairs, first, len(members), points, lane)
        load_members(sigma, members, first, points)
        accumulate_moments(points, lane)
        solve_rotations(lane)
        for n in range(len(points)):
            measure(points, n, lane)
        for j in range(min(LANES, len(members) - first)):
            clear[first + j] = lane[CLEAR * LANES + j] > 0.0
            for n in range(len(points)):
                student[first + j, n] = points[n, j]
                plain[first + j, n] = points[n, LANES + j]


@inner
def edges_of_point(p: NDArray, is_observed: NDArray, variance: NDArray, i: int, count: int, out: NDArray) -> None:
    """Fill in the edges of one point; p holds the coordinates of both clouds as six rows of count numbers."""
    for j in range(count):
        u, v, w = p[j] - p[i], p[count + j] - p[count + i], p[2 * count + j] - p[2 * count + i]
        a = u * u + v * v + w * w
        u, v, w = (
            p[3 * count + j] - p[3 * count + i],
            p[4 * count + j] - p[4 * count + i],
            p[5 * count + j] - p[5 * count + i],
        )
        b = u * u + v * v + w * w
        total = a + b + 2.0 * np.sqrt(a * b)
        change = (a - b) * (a - b) / (total if total > 0.0 else 1.0)
        share = np.float32(1.0 - change / (variance[i] + variance[j]))
        edge = np.float32(1.0) + np.float32(0.5 / count) * share
        out[j] = edge if (share > np.float32(0.0)) & is_observed[i] & is_observed[j] & (i != j) else np.float32(0.0)


@compiled(*_SOURCES)
def edges_of_poses(x: NDArray, y: NDArray, is_observed: NDArray, variance: NDArray, graph: NDArray) -> None:
    """Fill in the graphs (B, N, N) of points with equal distances in both clouds."""
    count = x.shape[1]
    p = np.empty(6 * count)
    for b in range(len(x)):
        for i in range(3):
            for n in range(count):
                p[i * count + n], p[(3 + i) * count + n] = x[b, n, i], y[b, n, i]
        for i in range(count):
            edges_of_point(p, is_observed[b], variance[b], i, count, graph[b, i])


@compiled(*_SOURCES)
def sets_of_poses(graph: NDArray, seed: NDArray, taken: NDArray, anchors: int, members: NDArray) -> None:
    """Fill in the sets (B, N) of anchors grown from the seeds (B,), and of all points connected to every anchor."""
    count = graph.shape[1]
    joined, votes = np.empty(count, np.bool_), np.empty(count, np.float32)
    for b in range(len(graph)):
        pick = seed[b]
        joined[:] = True
        for step in range(anchors):
            members[b, pick] = True
            for i in range(count):
                joined[i] &= graph[b, pick, i] > 0
            votes[:] = np.float32(1.0)
            if not joined.any() or step == anchors - 1:
                break
            for j in range(count):
                if joined[j]:
                    for i in range(count):
                        votes[i] += graph[b, j, i]
            for i in range(count):
                votes[i] *= (1.0 / (2 * count) if taken[b, i] else 1.0) if joined[i] else 0.0
            pick = votes.argmax()
        members[b] |= joined
