"""Consensus search: points of a pose that agree on one rigid motion, deterministic for any kind of gross errors.

Three steps, each only for poses that the one before left open. (1) Trim all points to a set that a fit explains; a set
of more than half is the largest. (2) Pairs of points with equal distances in both clouds form a graph. Sets grown from
one seed point after another are candidates, until no seed has enough neighbours for a larger set. (3) If a candidate
fails its fit (errors across a plane leave distances unchanged), the motions of all its triples compete.
Every set ends as a fixpoint: exactly the points whose studentised residual passes a chi-square test.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.estimation.rigid_poses import consensus_steps
from truing.estimation.rigid_poses.consensus_steps import Clouds
from truing.estimation.rigid_poses.rigid import FitStatus, check_correspondences, solve_motion

# Probability that a pose without gross errors loses any of its points.
FALSE_ALARM = 1e-4
# Least number of agreeing points, or all but one of fewer: three of many agree by chance too easily.
FEWEST = 4
_FREE_ROUNDS = 12  # rounds of trimming in which points may return; afterwards the search must end
_TRIPLE_BLOCK = 23  # points whose triples compete: 1771
_PAIRS_AT_ONCE, _TRIPLES_AT_ONCE = 400_000, 400_000
# Number of points from which compiled code is faster in spite of its loading time (0.4 s).
_MANY_POINTS, _MANY_PAIRS = 500_000, 4_000_000


@dataclass(frozen=True)
class Tools:
    """The expensive steps of the search, in NumPy or compiled."""

    statuses: Callable[[Clouds], NDArray]
    squared_residuals: Callable[[Clouds, NDArray], tuple[NDArray, NDArray]]
    same_distances: Callable[[Clouds], NDArray]
    grow: Callable[[NDArray, NDArray, NDArray], NDArray]


def consensus(
    source: ArrayLike, target: ArrayLike, mask: ArrayLike | None, sigma: ArrayLike
) -> tuple[NDArray, NDArray]:
    """Return the mask (B, N) of points that agree on one rigid motion, and a status (B,) of FitStatus values.

    source, target: (B, N, 3) or (N, 3) in m; mask (B, N) or (N,): False for a missing point, which may be NaN; sigma in
    m, scalar, (N,), (B, 1) or (B, N): standard deviation per coordinate of ``target - R source``, with the noise of
    both clouds (along the worst direction). OK: the points are the largest set that agrees, with at least 4 points, or
    3 of 3 or 4; gross errors may outnumber them. AMBIGUOUS: two motions have equally many points, none is kept.
    NO_CONSENSUS: fewer agree; the two or three that do are kept if they are the only ones. The result does not depend
    on the order of points, frames or the unit of length. If fewer than half agree, memory grows with N^2 for one pose
    at a time. Raises ValueError as `umeyama`, and for a sigma that is not positive.
    """
    x, y, w = check_correspondences(source, target, None if mask is None else np.asarray(mask, bool))
    observed = w > 0
    sigma_of_point = np.where(observed, np.broadcast_to(np.asarray(sigma, np.float64), observed.shape), 1.0)
    if not np.all((sigma_of_point > 0) & np.isfinite(sigma_of_point)):
        raise ValueError("sigma: found a value that is not positive, expected a standard deviation in m")
    clouds = Clouds(x, y, observed, sigma_of_point, chi_square_limit(FALSE_ALARM, observed))
    members, status = _trimmed_sets(clouds, _tools(observed.size >= _MANY_POINTS))
    rows = np.flatnonzero(status == FitStatus.NO_CONSENSUS)
    tools = _tools(len(rows) * observed.shape[1] ** 2 >= _MANY_PAIRS)
    step = max(1, _PAIRS_AT_ONCE // observed.shape[1] ** 2)
    for first in range(0, len(rows), step):
        batch = rows[first : first + step]
        members[batch], status[batch] = _search(clouds[batch], tools)
    return members, status


def _tools(many: bool) -> Tools:
    if not many:
        steps = consensus_steps
        return Tools(steps.statuses, steps.squared_residuals, steps.same_distances, steps.grow)
    from truing.estimation.rigid_poses import robust_kernel as kernel

    return Tools(kernel.statuses, kernel.squared_residuals, kernel.same_distances, kernel.grow)


def chi_square_limit(false_alarm: float, observed: NDArray) -> NDArray:
    """Limits (B,) of squared residuals that all points of a pose pass with probability 1 - ``false_alarm``; seen
    (B, N)."""
    from scipy.special import chdtri

    return chdtri(3, false_alarm / np.maximum(observed.sum(-1), 1))


def _trimmed_sets(clouds: Clouds, tools: Tools) -> tuple[NDArray, NDArray]:
    """Return the sets (B, N) and statuses (B,) of poses in which trimming leaves a majority; else NO_CONSENSUS."""
    points = clouds.is_observed.sum(-1)
    # two sets of more than (n + 4) / 2 of n points share four, and so the motion
    min_size = np.minimum(np.maximum(points, 3), (points + FEWEST + 1) // 2)
    members, _ = _fixpoints(clouds, clouds.is_observed, min_size, tools)
    unsolved = np.flatnonzero(~members.any(-1))
    status = np.full(len(members), str(FitStatus.OK), np.array([str(s) for s in FitStatus]).dtype)
    status[unsolved] = tools.statuses(clouds[unsolved])
    unresolved = unsolved[np.isin(status[unsolved], (FitStatus.OK, FitStatus.AMBIGUOUS))]
    status[unresolved] = FitStatus.NO_CONSENSUS
    return members, status


def _fixpoints(clouds: Clouds, members: NDArray, min_size: NDArray, tools: Tools) -> tuple[NDArray, NDArray]:
    """Return the fixpoints (B, N) reached from members, empty if fewer than min_size (B,) remain, and their cost. At
    first only the worst points are removed (down to a quarter of the largest squared residual), since they bend all the
    others."""
    members, cost = members.copy(), np.zeros(len(members))
    rows = np.arange(len(members))
    for iteration in range(_FREE_ROUNDS + members.shape[1]):
        batch, previous = clouds[rows], members[rows]
        studentised, squared_residual = tools.squared_residuals(batch, previous)
        largest = np.max(studentised, axis=-1, where=previous, initial=0.0)
        limit = np.maximum(batch.limit, largest / 4)
        renewed = (
            batch.is_observed
            & np.isfinite(studentised)
            & (studentised <= np.where(previous, limit[:, None], batch.limit[:, None]))
        )
        may_return = (largest <= batch.limit) & (iteration < _FREE_ROUNDS)
        renewed &= previous | may_return[:, None]
        renewed &= (renewed.sum(-1) >= min_size[rows])[:, None]
        members[rows], cost[rows] = renewed, np.sum(squared_residual, axis=-1, where=renewed)
        rows = rows[np.any(renewed != previous, axis=-1) & renewed.any(-1)]
        if len(rows) == 0:
            break
    return members, cost


@dataclass
class _Best:
    """The best set of every pose so far: the largest, then the one whose fit scatters like noise."""

    kept: NDArray  # (B, N)
    size: NDArray  # (B,)
    regular: NDArray  # (B,) whether the scatter of the fit is no larger than that of noise
    rival: NDArray  # (B,) whether another set is as good

    def offer(self, rows: NDArray, sets: NDArray, cost: NDArray) -> None:
        """Update with found sets (b, N) of rows (b,), given the sums of squared residuals of their fits."""
        from scipy.special import chdtri

        size = sets.sum(-1)
        regular = cost <= chdtri(np.maximum(3 * size - 6, 1), FALSE_ALARM)
        rank, best_rank = 2 * size + regular, 2 * self.size[rows] + self.regular[rows]
        common_points = np.count_nonzero(sets & self.kept[rows], axis=-1)
        is_other_motion = (common_points < 3) | (2 * common_points < size)
        self.rival[rows[(rank == best_rank) & is_other_motion & (size > 0)]] = True
        is_better = rank > best_rank
        improved = rows[is_better]
        self.kept[improved], self.size[improved], self.regular[improved] = (
            sets[is_better],
            size[is_better],
            regular[is_better],
        )
        self.rival[improved] = False


def _search(clouds: Clouds, tools: Tools) -> tuple[NDArray, NDArray]:
    """Return the largest sets (B, N) that agree, and statuses (B,)."""
    graph, seeds, count = tools.same_distances(clouds), clouds.is_observed.copy(), len(clouds.is_observed)
    best = _Best(np.zeros_like(seeds), np.zeros(count, int), np.zeros(count, bool), np.zeros(count, bool))
    degree = graph.sum(-1)
    least_size = np.clip(clouds.is_observed.sum(-1) - 1, 3, FEWEST)
    while True:
        min_size = np.maximum(best.size, least_size)
        is_seed = seeds & (degree >= min_size[:, None] - 1)
        rows = np.flatnonzero(is_seed.any(-1))
        if len(rows) == 0:
            break
        seed = np.where(is_seed[rows], degree[rows], -1.0).argmax(-1)
        proposed = tools.grow(graph[rows], seed, best.kept[rows])
        sets, cost = _fixpoints(clouds[rows], proposed, min_size[rows], tools)
        seeds[rows] &= ~sets
        seeds[rows, seed] = False
        best.offer(rows, sets, cost)
        may_have_rival = np.flatnonzero(_may_have_rival(proposed, sets, min_size[rows]))
        if len(may_have_rival):
            rival_rows, members = rows[may_have_rival], proposed[may_have_rival]
            sets, cost = _among_triples(clouds[rival_rows], members, degree[rival_rows], min_size[rival_rows], tools)
            best.offer(rival_rows, sets, cost)
            # any set with three points among the members would have been found: leave at most two of them as seeds
            seeds[rival_rows] &= ~np.where(np.any(sets, axis=-1, keepdims=True), sets, members)
            graph[rival_rows] *= ~sets[:, :, None] & ~sets[:, None]
            degree[rival_rows] = graph[rival_rows].sum(-1)
    without_set = np.flatnonzero(~best.kept.any(-1))
    best.kept[without_set] = _only_few(clouds[without_set], tools)
    status = np.where(best.rival, str(FitStatus.AMBIGUOUS), str(FitStatus.OK))
    return best.kept & ~best.rival[:, None], np.where(best.size > 0, status, str(FitStatus.NO_CONSENSUS))


def _may_have_rival(proposed: NDArray, sets: NDArray, min_size: NDArray) -> NDArray:
    """Return the mask of poses in which a candidate may hide a larger set than the found sets (B, N), with another
    motion."""
    members, remaining = proposed.sum(-1), sets.sum(-1)
    return (members >= min_size) & (remaining < members) & (2 * remaining < members + FEWEST)


def _among_triples(
    clouds: Clouds, members: NDArray, degree: NDArray, min_size: NDArray, tools: Tools
) -> tuple[NDArray, NDArray]:
    """Return the largest sets (B, N) reached from motions of triples of members (B, N), and their costs (B,)."""
    order = np.argsort(np.where(members, -degree, np.inf), axis=-1, kind="stable")
    max_members = int(members.sum(-1).max())
    blocks = -(-max_members // _TRIPLE_BLOCK)
    sets, cost = np.zeros_like(members), np.full(len(members), np.inf)
    for k in range(blocks):
        start = _near_best_triple(clouds, members, order[:, k:max_members:blocks])
        converged, set_cost = _fixpoints(clouds, start, min_size, tools)
        set_size, size = converged.sum(-1), sets.sum(-1)
        is_better = (set_size > size) | (set_size == size) & (set_cost < cost)
        sets[is_better], cost[is_better] = converged[is_better], set_cost[is_better]
    return sets, cost


def _near_best_triple(clouds: Clouds, members: NDArray, block: NDArray) -> NDArray:
    """Return the points (B, N) near the motion of the triple of members in a block (B, K) that has most points near
    it."""
    triples = np.array(list(combinations(range(block.shape[1]), 3)), int).reshape(-1, 3)
    near_points = np.zeros_like(members)
    step = max(1, _TRIPLES_AT_ONCE // max(1, len(triples) * members.shape[1]))
    for first in range(0, len(members) if len(triples) else 0, step):
        rows = slice(first, first + step)
        near_points[rows] = _near_one_of(clouds[rows], members[rows], block[rows][:, triples])
    return near_points


def _near_one_of(clouds: Clouds, members: NDArray, triples: NDArray) -> NDArray:
    """Return the points (B, N) near the motion of the best triple (B, T, 3) of members, empty without any."""
    rows = np.arange(len(members))
    index = (rows[:, None, None], triples)
    x, y, w = (a[index] for a in (clouds.x, clouds.y, members))
    R, t, _, status = solve_motion(x.reshape(-1, 3, 3), y.reshape(-1, 3, 3), w.reshape(-1, 3).astype(float))
    motions = np.concatenate([R, t[..., None]], -1)
    motions[status != FitStatus.OK] = np.nan
    motions = motions.reshape(len(rows), -1, 4)
    homogeneous = np.concatenate([np.swapaxes(clouds.x, 1, 2), np.ones((len(rows), 1, clouds.x.shape[1]))], 1)
    residual = (motions @ homogeneous).reshape(*triples.shape, -1)  # (B, T, 3, N)
    residual -= np.swapaxes(clouds.y, 1, 2)[:, None]
    normalised_square = np.sum(np.square(residual, out=residual), axis=2) / np.square(clouds.sigma)[:, None]
    limit = 4 * clouds.limit[:, None, None]  # includes the error of a triple's motion
    cost = (np.minimum(normalised_square, limit) @ clouds.is_observed[..., None].astype(float))[..., 0]
    best = np.where(np.isnan(cost), np.inf, cost).argmin(-1)
    return clouds.is_observed & (normalised_square[rows, best] <= limit[:, 0])


def _only_few(clouds: Clouds, tools: Tools) -> NDArray:
    """Return the three points (B, N) of the only triangle of equal distances, or the two of the only pair."""
    edge = (tools.same_distances(clouds) > 0).astype(float)
    corner = (edge @ edge) * edge
    triangles = corner.sum((-1, -2)) / 6
    pairs = edge.sum((-1, -2)) / 2
    is_few = np.where((triangles == 1)[:, None], corner.any(-1), edge.any(-1))
    return is_few & ((triangles == 1) | (triangles == 0) & (pairs == 1))[:, None]
