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
from truing.estimation.rigid_poses.rigid import FitStatus, check_correspondences, solve_weighted

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
    seen = w > 0
    spread = np.where(seen, np.broadcast_to(np.asarray(sigma, np.float64), seen.shape), 1.0)
    if not np.all((spread > 0) & np.isfinite(spread)):
        raise ValueError("sigma: found a value that is not positive, expected a standard deviation in m")
    clouds = Clouds(x, y, seen, spread, chi_square_limit(FALSE_ALARM, seen))
    members, status = _trimmed_sets(clouds, _tools(seen.size >= _MANY_POINTS))
    rows = np.flatnonzero(status == FitStatus.NO_CONSENSUS)
    tools = _tools(len(rows) * seen.shape[1] ** 2 >= _MANY_PAIRS)
    step = max(1, _PAIRS_AT_ONCE // seen.shape[1] ** 2)
    for first in range(0, len(rows), step):
        part = rows[first : first + step]
        members[part], status[part] = _search(clouds[part], tools)
    return members, status


def _tools(many: bool) -> Tools:
    if not many:
        steps = consensus_steps
        return Tools(steps.statuses, steps.squared_residuals, steps.same_distances, steps.grow)
    from truing.estimation.rigid_poses import robust_kernel as kernel

    return Tools(kernel.statuses, kernel.squared_residuals, kernel.same_distances, kernel.grow)


def chi_square_limit(false_alarm: float, seen: NDArray) -> NDArray:
    """Limits (B,) of squared residuals that all points of a pose pass with probability 1 - ``false_alarm``; seen
    (B, N)."""
    from scipy.special import chdtri

    return chdtri(3, false_alarm / np.maximum(seen.sum(-1), 1))


def _trimmed_sets(clouds: Clouds, tools: Tools) -> tuple[NDArray, NDArray]:
    """Return the sets (B, N) and statuses (B,) of poses in which trimming leaves a majority; else NO_CONSENSUS."""
    points = clouds.seen.sum(-1)
    # two sets of more than (n + 4) / 2 of n points share four, and so the motion
    fewest = np.minimum(np.maximum(points, 3), (points + FEWEST + 1) // 2)
    members, _ = _fixpoints(clouds, clouds.seen, fewest, tools)
    rest = np.flatnonzero(~members.any(-1))
    status = np.full(len(members), str(FitStatus.OK), np.array([str(s) for s in FitStatus]).dtype)
    status[rest] = tools.statuses(clouds[rest])
    open_rows = rest[np.isin(status[rest], (FitStatus.OK, FitStatus.AMBIGUOUS))]
    status[open_rows] = FitStatus.NO_CONSENSUS
    return members, status


def _fixpoints(clouds: Clouds, members: NDArray, fewest: NDArray, tools: Tools) -> tuple[NDArray, NDArray]:
    """Return the fixpoints (B, N) reached from members, empty if fewer than fewest (B,) remain, and their cost. At
    first only the worst points are removed (down to a quarter of the largest squared residual), since they bend all the
    others."""
    members, cost = members.copy(), np.zeros(len(members))
    rows = np.arange(len(members))
    for turn in range(_FREE_ROUNDS + members.shape[1]):
        part, old = clouds[rows], members[rows]
        studentised, plain = tools.squared_residuals(part, old)
        worst = np.max(studentised, axis=-1, where=old, initial=0.0)
        bar = np.maximum(part.limit, worst / 4)
        new = part.seen & np.isfinite(studentised) & (studentised <= np.where(old, bar[:, None], part.limit[:, None]))
        free = (worst <= part.limit) & (turn < _FREE_ROUNDS)
        new &= old | free[:, None]
        new &= (new.sum(-1) >= fewest[rows])[:, None]
        members[rows], cost[rows] = new, np.sum(plain, axis=-1, where=new)
        rows = rows[np.any(new != old, axis=-1) & new.any(-1)]
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

    def offer(self, rows: NDArray, found: NDArray, cost: NDArray) -> None:
        """Update with found sets (b, N) of rows (b,), given the sums of squared residuals of their fits."""
        from scipy.special import chdtri

        size = found.sum(-1)
        regular = cost <= chdtri(np.maximum(3 * size - 6, 1), FALSE_ALARM)
        rank, best = 2 * size + regular, 2 * self.size[rows] + self.regular[rows]
        shared = np.count_nonzero(found & self.kept[rows], axis=-1)
        other = (shared < 3) | (2 * shared < size)
        self.rival[rows[(rank == best) & other & (size > 0)]] = True
        better = rank > best
        won = rows[better]
        self.kept[won], self.size[won], self.regular[won] = found[better], size[better], regular[better]
        self.rival[won] = False


def _search(clouds: Clouds, tools: Tools) -> tuple[NDArray, NDArray]:
    """Return the largest sets (B, N) that agree, and statuses (B,)."""
    graph, seeds, count = tools.same_distances(clouds), clouds.seen.copy(), len(clouds.seen)
    best = _Best(np.zeros_like(seeds), np.zeros(count, int), np.zeros(count, bool), np.zeros(count, bool))
    degree = graph.sum(-1)
    enough = np.clip(clouds.seen.sum(-1) - 1, 3, FEWEST)
    while True:
        fewest = np.maximum(best.size, enough)
        worth = seeds & (degree >= fewest[:, None] - 1)
        rows = np.flatnonzero(worth.any(-1))
        if len(rows) == 0:
            break
        seed = np.where(worth[rows], degree[rows], -1.0).argmax(-1)
        proposed = tools.grow(graph[rows], seed, best.kept[rows])
        sets, cost = _fixpoints(clouds[rows], proposed, fewest[rows], tools)
        seeds[rows] &= ~sets
        seeds[rows, seed] = False
        best.offer(rows, sets, cost)
        split = np.flatnonzero(_may_have_rival(proposed, sets, fewest[rows]))
        if len(split):
            part, members = rows[split], proposed[split]
            sets, cost = _among_triples(clouds[part], members, degree[part], fewest[part], tools)
            best.offer(part, sets, cost)
            # any set with three points among the members would have been found: leave at most two of them as seeds
            seeds[part] &= ~np.where(np.any(sets, axis=-1, keepdims=True), sets, members)
            graph[part] *= ~sets[:, :, None] & ~sets[:, None]
            degree[part] = graph[part].sum(-1)
    few = np.flatnonzero(~best.kept.any(-1))
    best.kept[few] = _only_few(clouds[few], tools)
    won = np.where(best.rival, str(FitStatus.AMBIGUOUS), str(FitStatus.OK))
    return best.kept & ~best.rival[:, None], np.where(best.size > 0, won, str(FitStatus.NO_CONSENSUS))


def _may_have_rival(proposed: NDArray, found: NDArray, fewest: NDArray) -> NDArray:
    """Return the mask of poses in which a candidate may hide a larger set than found (B, N), with another motion."""
    members, left = proposed.sum(-1), found.sum(-1)
    return (members >= fewest) & (left < members) & (2 * left < members + FEWEST)


def _among_triples(
    clouds: Clouds, members: NDArray, degree: NDArray, fewest: NDArray, tools: Tools
) -> tuple[NDArray, NDArray]:
    """Return the largest sets (B, N) reached from motions of triples of members (B, N), and their costs (B,)."""
    order = np.argsort(np.where(members, -degree, np.inf), axis=-1, kind="stable")
    most = int(members.sum(-1).max())
    blocks = -(-most // _TRIPLE_BLOCK)
    sets, cost = np.zeros_like(members), np.full(len(members), np.inf)
    for k in range(blocks):
        start = _near_best_triple(clouds, members, order[:, k:most:blocks])
        converged, spent = _fixpoints(clouds, start, fewest, tools)
        more, size = converged.sum(-1), sets.sum(-1)
        better = (more > size) | (more == size) & (spent < cost)
        sets[better], cost[better] = converged[better], spent[better]
    return sets, cost


def _near_best_triple(clouds: Clouds, members: NDArray, block: NDArray) -> NDArray:
    """Return the points (B, N) near the motion of the triple of members in a block (B, K) that has most points near
    it."""
    triples = np.array(list(combinations(range(block.shape[1]), 3)), int).reshape(-1, 3)
    out = np.zeros_like(members)
    step = max(1, _TRIPLES_AT_ONCE // max(1, len(triples) * members.shape[1]))
    for first in range(0, len(members) if len(triples) else 0, step):
        rows = slice(first, first + step)
        out[rows] = _near_one_of(clouds[rows], members[rows], block[rows][:, triples])
    return out


def _near_one_of(clouds: Clouds, members: NDArray, triples: NDArray) -> NDArray:
    """Return the points (B, N) near the motion of the best triple (B, T, 3) of members, empty without any."""
    rows = np.arange(len(members))
    index = (rows[:, None, None], triples)
    x, y, w = (a[index] for a in (clouds.x, clouds.y, members))
    fit = solve_weighted(x.reshape(-1, 3, 3), y.reshape(-1, 3, 3), w.reshape(-1, 3).astype(float))
    motions = np.concatenate([fit.R, fit.t[..., None]], -1).reshape(len(rows), -1, 4)
    ahead = np.concatenate([np.swapaxes(clouds.x, 1, 2), np.ones((len(rows), 1, clouds.x.shape[1]))], 1)
    gap = (motions @ ahead).reshape(*triples.shape, -1)  # (B, T, 3, N)
    gap -= np.swapaxes(clouds.y, 1, 2)[:, None]
    square = np.sum(np.square(gap, out=gap), axis=2) / np.square(clouds.sigma)[:, None]
    near = 4 * clouds.limit[:, None, None]  # includes the error of a triple's motion
    cost = (np.minimum(square, near) @ clouds.seen[..., None].astype(float))[..., 0]
    best = np.where(np.isnan(cost), np.inf, cost).argmin(-1)
    return clouds.seen & (square[rows, best] <= near[:, 0])


def _only_few(clouds: Clouds, tools: Tools) -> NDArray:
    """Return the three points (B, N) of the only triangle of equal distances, or the two of the only pair."""
    edge = (tools.same_distances(clouds) > 0).astype(float)
    corner = (edge @ edge) * edge
    triangles = corner.sum((-1, -2)) / 6
    pairs = edge.sum((-1, -2)) / 2
    is_few = np.where((triangles == 1)[:, None], corner.any(-1), edge.any(-1))
    return is_few & ((triangles == 1) | (triangles == 0) & (pairs == 1))[:, None]
