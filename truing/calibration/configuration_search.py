"""The search for configurations: candidates, the bound over all of them, the methods, and poses to hold out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.calibration.design_problem import DesignProblem
from truing.estimation.design.continuous_selection import largest_sensitivity, optimise_directly
from truing.estimation.design.design_bound import DesignBound, bound_design, sum_log_det
from truing.estimation.design.pose_selection import exchange, information_of, ioops, one_by_one, rounded_design

_DENSE = 2000  # points spread over the region, beside its corners
_CLIMBERS = 60  # from which more sensitive points than those are sought
_ROUNDS = 4  # in which what climbs have found joins the candidates
_RAISED = 1e-4  # of the bound, as a share of the measurements, that needs no further round
_STARTS = 10
_POLISH, _ITERATIONS = 50, 1000  # of moving an exchanged choice, and random poses
_NEAR = 0.9  # of the largest sensitivity: candidates less sensitive than that are in no good design
_HULL = 7  # configurations that a verification pose is a mean of: one more than a pose has coordinates


@dataclass(frozen=True)
class Bounded:
    """Candidates x (C, 6), the first of them corners; the best design on them; upper: with what lies between them.

    unreached: how many more were left out, for readings do not lead to them from the reference pose.
    """

    x: NDArray
    corners: int
    dense: int
    unreached: int
    bound: DesignBound
    upper: float

    @property
    def raised(self) -> float:
        """Return by how much, in log det, the points between candidates raise the bound."""
        return self.upper - self.bound.upper

    @property
    def climbed(self) -> int:
        """Return how many candidates climbs have found."""
        return len(self.x) - self.corners - self.dense


def bounded(problem: DesignProblem, poses: int, given: NDArray | None, rng: np.random.Generator) -> Bounded:
    """Return what no choice of poses can exceed; raises ValueError where forbidden regions leave no room."""
    corners, between = problem.region.corners(), problem.region.draw(_DENSE, rng)
    kept = problem.reached(corners), problem.reached(between)
    x = np.concatenate([corners[kept[0]], between[kept[1]]])
    numbers = int(kept[0].sum()), int(kept[1].sum()), int(sum(np.sum(~mask) for mask in kept))
    for _ in range(_ROUNDS):
        bound = bound_design(problem.rows_at(x), poses, given)
        top = np.argsort(bound.sensitivity)[::-1][: _CLIMBERS // 2]
        start = x[np.concatenate([top, rng.choice(len(x), _CLIMBERS // 2)])]
        found = largest_sensitivity(problem.region, problem.rows_and_changes, bound, start)
        result = Bounded(x, *numbers, bound, bound.with_sensitivity(found.value))
        if result.raised <= _RAISED * problem.size:
            break
        x = np.concatenate([x, found.x[problem.reached(found.x)]])
    return result


def choose(
    problem: DesignProblem,
    candidates: Bounded,
    method: str,
    poses: int,
    given: NDArray | None,
    rng: np.random.Generator,
) -> NDArray:
    """Return the coordinates (N, 6) of the configurations that a method finds: exchange, direct, ioops or random."""
    if method == "exchange":
        return _by_exchange(problem, candidates, poses, given, rng)
    start = _drawn(problem, poses, rng)
    if method == "direct":
        return _moved(problem, start, given, _ITERATIONS)
    if method == "ioops":
        pool = np.concatenate([start, candidates.x])
        return pool[ioops(problem.rows_at(pool), np.arange(poses), given).chosen]
    return start


def _drawn(problem: DesignProblem, count: int, rng: np.random.Generator) -> NDArray:
    """Return points spread over what can be reached of the region; as they come where that is next to nothing."""
    x = problem.region.draw(4 * count, rng)
    return x[np.argsort(~problem.reached(x), kind="stable")[:count]]


def _moved(problem: DesignProblem, x: NDArray, given: NDArray | None, iterations: int) -> NDArray:
    """Return configurations moved along the gradient; where one leaves what can be reached, as they were."""
    found = optimise_directly(problem.region, problem.rows_and_changes, x, given, iterations)
    return found.x if problem.reached(found.x).all() else x


def _by_exchange(
    problem: DesignProblem, candidates: Bounded, poses: int, given: NDArray | None, rng: np.random.Generator
) -> NDArray:
    """Return the best of exchanges from the rounded optimum and from random starts, moved on to between candidates."""
    sensitivity = candidates.bound.sensitivity
    pool = np.flatnonzero(sensitivity >= _NEAR * sensitivity.max())
    rows, place = problem.rows_at(candidates.x[pool]), np.full(len(sensitivity), -1)
    place[pool] = np.arange(len(pool))
    starts = [place[rounded_design(candidates.bound, poses)], one_by_one(rows, poses, candidates.bound, given)]
    starts += [rng.choice(len(pool), poses, replace=len(pool) < poses) for _ in range(_STARTS)]
    found = [exchange(rows, s, given) for s in starts if np.isfinite(sum_log_det(information_of(rows[s], given)))]
    best = max(found, key=lambda selection: selection.log_det)
    start = candidates.x[pool[best.chosen]]
    moved = _moved(problem, start, given, _POLISH)
    gained = sum_log_det(information_of(problem.rows_at(moved), given)) > best.log_det
    return moved if gained else start


def verification(problem: DesignProblem, x: NDArray, count: int, rng: np.random.Generator) -> NDArray:
    """Return poses (count, 6) within the hull of the chosen (N, 6), far from them and from each other.

    Raises ValueError where forbidden regions leave no room for so many.
    """
    if not count:
        return np.empty((0, 6))
    picked = rng.integers(len(x), size=(100 * count, min(_HULL, len(x))))
    shares = rng.dirichlet(np.ones(picked.shape[1]), len(picked))
    inside = problem.region.pulled_in(np.einsum("nk,nki->ni", shares, x[picked]))
    inside = inside[problem.region.allowed(inside) & problem.reached(inside)]
    if len(inside) < count:
        raise ValueError("room within the hull of the chosen poses")
    near = np.full(len(inside), np.inf)
    for one in x:  # pose by pose: all distances at once would not fit in memory
        near = np.minimum(near, np.linalg.norm(inside - one, axis=-1))
    chosen: list[int] = []
    for _ in range(count):
        chosen.append(int(np.argmax(near)))
        near = np.minimum(near, np.linalg.norm(inside - inside[chosen[-1]], axis=-1))
    return inside[chosen]
