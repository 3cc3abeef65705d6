"""Which stations to take: one after the other the one that helps most, then exchanged while that helps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from truing.estimation.bundle.network import Array, Index

_AT_ONCE = 64
_WORTH = 1e-3  # of the mean variance, that an exchange has to save
_MOST_POINTS = 48

Progress = Callable[[int, int], None]


def spread_points(points: Array, most: int = _MOST_POINTS) -> Index:
    """Some of the points (P, 3), each as far as possible from those before it; all where there are no more."""
    if len(points) <= most:
        return np.arange(len(points))
    chosen = [int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    nearest = np.full(len(points), np.inf)
    while len(chosen) < most:
        nearest = np.minimum(nearest, np.linalg.norm(points - points[chosen[-1]], axis=1))
        chosen.append(int(np.argmax(nearest)))
    return np.sort(chosen)


@dataclass(frozen=True)
class Candidates:
    """What is to choose from: information (K, n, n) of each station on points (P, 3) and the camera, what is known
    without any station (n, n), and whether anything gives the scale."""

    information: Array
    prior: Array
    points: Array
    has_scale: bool

    @property
    def movements(self) -> Array:
        """Orthonormal movements (3 P, 6 or 7) of all points together that no photograph tells."""
        own = self.points - self.points.mean(axis=0)
        columns = [np.tile(axis, (len(own), 1)) for axis in np.eye(3)]
        columns += [np.cross(axis, own) for axis in np.eye(3)]
        columns += [] if self.has_scale else [own]
        basis, _ = np.linalg.qr(np.stack([column.ravel() for column in columns], axis=1))
        return np.asarray(basis)


def one_by_one(candidates: Candidates, count: int, progress: Progress) -> Index:
    """Take ``count`` stations, each the one after which the mean variance of the points in the free datum is least."""
    information, remove = candidates.information, candidates.movements
    total, chosen = candidates.prior.copy(), list[int]()
    while len(chosen) < min(count, len(information)):
        progress(len(chosen), count)
        best = int(np.argmin(_costs(total, information, remove, set(chosen))))
        chosen.append(best)
        total = total + information[best]
    return np.array(chosen, dtype=np.int64)


def exchanged(candidates: Candidates, chosen: Index, progress: Progress) -> Index:
    """Give each station in turn up for the one that helps most in its place, once round, where that saves enough."""
    information, remove, chosen = candidates.information, candidates.movements, chosen.copy()
    total = candidates.prior + information[chosen].sum(axis=0)
    cost = float(_costs(total, np.zeros((1, *total.shape)), remove, set())[0])
    for place in range(len(chosen)):
        progress(place, len(chosen))
        without = total - information[chosen[place]]
        others = set(np.delete(chosen, place).tolist())
        costs = _costs(without, information, remove, others)
        best = int(np.argmin(costs))
        if costs[best] < (1.0 - _WORTH) * cost:
            chosen[place], cost = best, float(costs[best])
            total = without + information[best]
    return chosen


def _costs(total: Array, information: Array, remove: Array, taken: set[int]) -> Array:
    """The mean variance of the points (K,) with each station beside what there is; infinite for those that are
    taken."""
    size = len(remove)
    costs = np.full(len(information), np.inf)
    free = np.array([place for place in range(len(information)) if place not in taken])
    for first in range(0, len(free), _AT_ONCE):
        some = free[first : first + _AT_ONCE]
        covariance = np.linalg.inv(total + information[some])[:, :size, :size]
        moved = np.sum(remove * (covariance @ remove), axis=(1, 2))
        costs[some] = (np.trace(covariance, axis1=1, axis2=2) - moved) / size
    return costs
