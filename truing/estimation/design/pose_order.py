"""Measuring order of poses: short travel, and time that no regressor imitates.

A drift during the measurement looks like every regressor that changes with time. Poses are assumed to need equal time;
the criterion is the share R of a straight line in time that regressors can imitate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_KICKS = 80  # half from the best order, half from random orders; each followed by all reversals that help
_RANDOM = 200  # random orders for comparison
# Shortening travel costs little until drift is almost separated; docs/design.md compares other values.
TRADE_OFF = 0.75


@dataclass(frozen=True)
class PoseOrder:
    """An order (N,) of poses with its travel and that of a random order on average, m.

    drift: largest share (R, from 0 to 1) of a line in time that one group of regressors imitates; random_drift: mean
    for random orders.
    """

    order: NDArray
    travel: float
    random_travel: float
    drift: float
    random_drift: float


@dataclass(frozen=True)
class _Task:
    """distance (N + 1, N + 1) with the start last; groups (G, N, k) orthonormal, orthogonal to one, zero-filled."""

    distance: NDArray
    groups: NDArray
    travel: float
    trade_off: float

    @property
    def count(self) -> int:
        return self.groups.shape[1]

    def shares(self, seen: NDArray) -> NDArray:
        """Return R^2 (..., G) from the projections (..., G, k) of time on the groups."""
        total = self.count * (self.count**2 - 1) / 12.0
        return np.asarray(np.sum(seen**2, -1) / total)

    def cost(self, travel: NDArray, seen: NDArray) -> NDArray:
        drift = np.sqrt(np.mean(self.shares(seen), -1))
        return np.asarray((1.0 - self.trade_off) * travel / self.travel + self.trade_off * drift)


def order_poses(
    drives: NDArray,
    start: NDArray,
    regressors: NDArray,
    rng: np.random.Generator,
    trade_off: float = TRADE_OFF,
) -> PoseOrder:
    """Return an order of poses with readings drives (N, L), m, starting from a position (L,).

    regressors (G, N, k): groups of columns to decorrelate from time, for instance one group per leg. trade_off: 0 for
    the shortest travel, 1 for decorrelation alone. The longest drive determines the time of a move. The search uses
    reversals (2-opt) and kicks (Martin, Otto and Felten, Complex Systems 5 (1991) 299). Raises ValueError for a
    trade-off outside of 0 to 1.
    """
    if not 0.0 <= trade_off <= 1.0:
        raise ValueError(f"trade-off: found {trade_off}, expected 0 to 1")
    if len(drives) < 2:  # one pose has no order
        travel = float(np.abs(drives - start).max(initial=0.0))
        return PoseOrder(np.arange(len(drives)), travel, travel, 0.0, 0.0)
    stops = np.concatenate([drives, start[None]])
    distance = np.abs(stops[:, None] - stops[None]).max(-1)
    groups = np.stack([_orthonormal(group) for group in regressors])
    shuffled = np.array([rng.permutation(len(drives)) for _ in range(_RANDOM)])
    usual = _travel(distance, shuffled)
    task = _Task(distance, groups, max(float(usual.mean()), np.finfo(float).tiny), trade_off)
    order = _search(task, rng)
    drift = np.sqrt(task.shares(_time_projections(task, np.concatenate([order[None], shuffled]))).max(-1))
    return PoseOrder(order, float(_travel(distance, order)), task.travel, float(drift[0]), float(drift[1:].mean()))


def _orthonormal(columns: NDArray) -> NDArray:
    """Return an orthonormal basis (N, k) of columns (N, k) after removing a constant; zeros fill it up."""
    centred = columns - columns.mean(0)
    norm = np.linalg.norm(columns, axis=0)
    basis, value, _ = np.linalg.svd(centred / np.where(norm > 0, norm, 1.0), full_matrices=False)
    significant = basis * (value > 1e-9 * max(value[0], 1e-300))
    return np.pad(significant, ((0, 0), (0, columns.shape[1] - significant.shape[1])))


def _travel(distance: NDArray, order: NDArray) -> NDArray:
    """Return the travel (...,) of orders (..., N) from the start, which has the last index."""
    before = np.concatenate([np.full((*order.shape[:-1], 1), len(distance) - 1), order[..., :-1]], -1)
    return np.asarray(distance[before, order].sum(-1))


def _time_projections(task: _Task, order: NDArray) -> NDArray:
    """Return the projections (..., G, k) of time on the groups for orders (..., N)."""
    time = np.arange(task.count) - (task.count - 1) / 2.0
    return np.einsum("n,g...nk->...gk", time, task.groups[:, order])


def _search(task: _Task, rng: np.random.Generator) -> NDArray:
    best = _descended(task, _nearest_first(task.distance))
    least = _cost(task, best)
    for kick in range(_KICKS):
        start = _double_bridge(best, rng) if kick % 2 and task.count > 3 else rng.permutation(task.count)
        trial = _descended(task, start)
        cost = _cost(task, trial)
        if cost < least:
            best, least = trial, cost
    return best


def _cost(task: _Task, order: NDArray) -> float:
    return float(task.cost(_travel(task.distance, order), _time_projections(task, order)))


def _nearest_first(distance: NDArray) -> NDArray:
    """Return the greedy order: next is always the nearest pose not yet measured."""
    remaining, at, order = list(range(len(distance) - 1)), len(distance) - 1, []
    while remaining:
        at = remaining.pop(int(np.argmin(distance[at, remaining])))
        order.append(at)
    return np.array(order)


def _double_bridge(order: NDArray, rng: np.random.Generator) -> NDArray:
    """Return an order with its middle parts exchanged (double bridge)."""
    a, b, c = np.sort(rng.choice(np.arange(1, len(order)), 3, replace=False))
    return np.concatenate([order[:a], order[b:c], order[a:b], order[c:]])


def _descended(task: _Task, order: NDArray) -> NDArray:
    """Return the order after all reversals that help, the best one first."""
    first, last = np.triu_indices(task.count, 1)
    while True:
        travel, seen = _travel(task.distance, order), _time_projections(task, order)
        more, turned = _changes_by_reversals(task, order, first, last)
        turned += seen
        cost = task.cost(travel + more, turned)
        best = int(np.argmin(cost))
        if not cost[best] < float(task.cost(travel, seen)) - 1e-12:
            return order
        part = slice(first[best], last[best] + 1)
        order = np.concatenate([order[: part.start], order[part][::-1], order[part.stop :]])


def _changes_by_reversals(task: _Task, order: NDArray, first: NDArray, last: NDArray) -> tuple[NDArray, NDArray]:
    """Return the changes of travel (M,), m, and of the projections of time (M, G, k) by reversing each part first ..
    last; travel changes only at its ends, time only within."""
    distance, start = task.distance, len(task.distance) - 1
    before, after = np.append(start, order[:-1]), np.append(order[1:], start)
    here, there = order[first], order[last]
    open_end = last < task.count - 1
    more = distance[before[first], there] - distance[before[first], here]
    more = more + open_end * (distance[here, after[last]] - distance[there, after[last]])
    columns = np.moveaxis(task.groups[:, order], 0, 1)
    zero = np.zeros((1, *columns.shape[1:]))
    sums = np.concatenate([zero, np.cumsum(columns, 0)])
    moments = np.concatenate([zero, np.cumsum(np.arange(task.count)[:, None, None] * columns, 0)])
    # In place: these arrays are the work of the whole search.
    turned, shifted = sums.take(last + 1, 0), moments.take(last + 1, 0)
    turned -= sums.take(first, 0)
    turned *= (first + last)[:, None, None]
    shifted -= moments.take(first, 0)
    shifted *= 2.0
    turned -= shifted
    return more, turned
