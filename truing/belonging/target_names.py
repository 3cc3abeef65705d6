"""Search for the order of names that makes the points of a body congruent to its survey."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.belonging.assignment import cheapest_columns

_LEAST_TARGETS = 5  # with four, one of 24 orders often fits by chance
_ROUNDS = 10


@dataclass(frozen=True)
class NamedTargets:
    """All targets of a body: names (K,), survey (K, 3) and points (B, K, 3) in m, is_observed (B, K)."""

    names: tuple[str, ...]
    survey: Array
    points: Array
    is_observed: Mask


def meant_order(targets: NamedTargets) -> Index | None:
    """Return for each name the place (K,) in the survey of the target that its points belong to; None where there are
    too few targets, or where points are in the order of the survey.

    Distances between targets distinguish them in any frame: first the sorted distances of each one to all others, then
    its distances to the others as they are assigned. Only the best order is sought; the caller tests whether it fits.
    """
    measured = _distances(targets)
    if len(targets.names) < _LEAST_TARGETS or not np.isfinite(measured).all():
        return None
    surveyed = np.linalg.norm(targets.survey[:, None] - targets.survey, axis=-1)
    profiles = np.sort(measured, axis=1), np.sort(surveyed, axis=1)
    order = cheapest_columns(np.sum((profiles[0][:, None] - profiles[1]) ** 2, axis=-1))
    for _ in range(_ROUNDS):
        difference = measured[:, None] - surveyed[:, order]
        again = cheapest_columns(np.sum(difference**2, axis=-1))
        if np.array_equal(again, order):
            break
        order = again
    return None if np.array_equal(order, np.arange(len(order))) else order


def _distances(targets: NamedTargets) -> Array:
    """Return the median distance (K, K) of each pair of points over the poses that see both; NaN where none does."""
    distances = np.full((len(targets.names),) * 2, np.nan)
    for row in range(len(distances)):
        both = targets.is_observed & targets.is_observed[:, row, None]
        distance = np.where(both, np.linalg.norm(targets.points - targets.points[:, row, None], axis=-1), np.nan)
        known = both.any(axis=0)
        distances[row, known] = np.nanmedian(distance[:, known], axis=0)
    return distances


def renamed(targets: NamedTargets, order: Index) -> Iterator[str]:
    """Yield each name that belongs to another target, and the right one."""
    for name, index in zip(targets.names, order.tolist(), strict=True):
        if targets.names[index] != name:
            yield f"{name} is {targets.names[index]}"
