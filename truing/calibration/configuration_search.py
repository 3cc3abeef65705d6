"""The search for configurations: what judges them, candidates, bound, methods, and poses to hold out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.design.feasible_region import FeasibleRegion
from truing.estimation.design.observability import choose_identifiable
from truing.estimation.design.pose_order import PoseOrder, order_poses
from truing.estimation.design.pose_selection import (
    DesignBound,
    bound_design,
    exchange,
    information_of,
    ioops,
    largest_sensitivity,
    one_by_one,
    optimise_directly,
    rounded_design,
    sum_log_det,
)
from truing.simulation.mechanisms.parameters import LegParameter
from truing.simulation.mechanisms.pose_regressors import Placed, PoseRegressors
from truing.simulation.mechanisms.structures.structure import poses_at

_SAME = 1e-7  # m and rad
# Parameters are told apart where no combination of their unit columns is shorter than this. Rank, not noise, is asked
# for, as in the report: its seven reach 1e-3 and more on the telescope, a_z or b_z beside them 4e-5 at most.
_TOLD_APART = 2e-4
_BETWEEN = 50  # points, in case that all corners are forbidden
# The report's seven (section 6.3.1); others only enter where these leave room.
_REPORTED = ("a_x", "a_y", "b_x", "b_y", "u_x", "u_y", "u_z", "l")
_DENSE = 2000  # points spread over the region, beside its corners
_CLIMBERS = 60  # from which more sensitive points than those are sought
_ROUNDS = 4  # in which what climbs have found joins the candidates
_RAISED = 1e-4  # of the bound, as a share of the measurements, that needs no further round
_STARTS = 10
_POLISH, _ITERATIONS = 50, 1000  # of moving an exchanged choice, and random poses
_NEAR = 0.9  # of the largest sensitivity: candidates less sensitive than that are in no good design
_OUTSIDE = 1.01  # of a limit: a hundredth beyond it is the actuator's noise, not another range
_HULL = 7  # configurations that a verification pose is a mean of: one more than a pose has coordinates


@dataclass(frozen=True)
class DesignProblem:
    """What configurations are judged by; rows are in tolerances of the parameters and noise of the residual.

    names (q,) with unit and SI; tolerance (q,) SI; noise (L,) m: one sigma of a leg's residual; noise_from, in words;
    held: parameters of a leg that are not told apart from those, or were not asked for.
    """

    regressors: PoseRegressors
    region: FeasibleRegion
    names: tuple[LegParameter, ...]
    tolerance: NDArray
    noise: NDArray
    noise_from: str
    held: tuple[str, ...] = ()

    @property
    def legs(self) -> int:
        """Return the number of legs."""
        return len(self.noise)

    @property
    def size(self) -> int:
        """Return the number of parameters of all legs."""
        return self.legs * len(self.names)

    def rows(self, placed: Placed) -> NDArray:
        """Return rows (B, L, q) of the scaled observability Jacobian."""
        return self.regressors.rows(placed) * self.tolerance / self.noise[:, None]

    def rows_at(self, x: NDArray) -> NDArray:
        """Return the rows at coordinates x (B, 6)."""
        return self.rows(self.regressors.at(x))

    def rows_and_changes(self, x: NDArray) -> tuple[NDArray, NDArray]:
        """Return the rows and their derivative (B, L, q, 6)."""
        rows, changes = self.regressors.rows_and_changes(x)
        scale = self.tolerance / self.noise[:, None]
        return rows * scale, changes * scale[..., None]

    def reached(self, x: NDArray) -> NDArray:
        """Return which coordinates (B, 6) lie within the limits, and readings lead to past no singular pose."""
        regressors, placed = self.regressors, self.regressors.at(x)
        found = poses_at(regressors.structure, regressors.machine, placed.rho)
        away = np.abs(np.concatenate([found.p - placed.p, (found.R - placed.R).reshape(-1, 9)], -1)).max(-1)
        return np.asarray(found.converged & (away < _SAME) & self.region.within(x))

    def placed_at(self, rho: NDArray) -> Placed:
        """Return configurations by readings rho (B, L), m; raises ValueError where they reach no pose."""
        regressors = self.regressors
        reached = poses_at(regressors.structure, regressors.machine, rho)
        if not reached.converged.all():
            raise ValueError("readings that the mechanism can reach")
        return Placed(reached.p, reached.R, rho)


@dataclass(frozen=True)
class ConfigurationLimits:
    """Half ranges of pose (6,) and readings (L,), SI, infinite where there is none; forbidden boxes (F, 6 + L)."""

    pose: NDArray
    readings: NDArray
    lower: NDArray
    upper: NDArray


def identifiable_parameters(problem: DesignProblem) -> list[int]:
    """Return a maximal set that configurations at the corners and between tell apart, every leg having the same."""
    between = problem.region.draw(_BETWEEN, np.random.default_rng(0))
    rows = problem.rows_at(np.concatenate([problem.region.corners(), between]))
    rows = rows / np.linalg.norm(rows, axis=0)
    size = len(problem.names)
    blocks = np.zeros((problem.legs, size, problem.legs, size))
    for leg in range(problem.legs):
        triangle = np.linalg.qr(rows[:, leg], mode="r")
        blocks[leg, : len(triangle), leg] = triangle
    jacobian = blocks.reshape(problem.legs * size, -1)
    labels = [f"{entry.name}{leg + 1}" for leg in range(problem.legs) for entry in problem.names]
    first = [0.0 if entry.name in _REPORTED else 1.0 for entry in problem.names] * problem.legs
    groups = list(range(size)) * problem.legs
    found = choose_identifiable(
        jacobian, np.ones(len(labels)), labels, groups=groups, preference=first, unidentifiable=1.0 / _TOLD_APART
    )
    return [int(k) for k in np.flatnonzero(found.chosen[:size])]


@dataclass(frozen=True)
class AssessedConfigurations:
    """Configurations as a calibration sees them: their number, information (L, q, q), how many lie outside."""

    count: int
    information: NDArray
    outside: int

    @property
    def log_det(self) -> float:
        """O1, the log determinant over all legs."""
        return sum_log_det(self.information)

    @property
    def sigma(self) -> NDArray:
        """The standard deviations (L, q), in tolerances, that data alone will leave."""
        return np.sqrt(np.diagonal(np.linalg.inv(self.information), axis1=1, axis2=2))


def assessed(problem: DesignProblem, rho: NDArray) -> AssessedConfigurations:
    """What a calibration learns from configurations by readings rho (B, L), m.

    Raises ValueError where they reach no pose.
    """
    placed = problem.placed_at(rho)
    outside = problem.region.excess(problem.regressors.coordinates(placed)) > _OUTSIDE
    return AssessedConfigurations(len(rho), information_of(problem.rows(placed)), int(outside.sum()))


def ordered(
    problem: DesignProblem, placed: Placed, last: NDArray | None, rng: np.random.Generator, trade_off: float
) -> PoseOrder:
    """The order of configurations after the readings ``last`` (L,), or the reference.

    Time is kept apart from every leg's regressors and from the drives; trade_off: see `order_poses`.
    """
    rho0 = problem.regressors.machine.legs.rho0
    groups = [*np.moveaxis(problem.rows(placed), 1, 0), placed.rho - rho0]
    size = max(group.shape[-1] for group in groups)
    padded = np.stack([np.pad(group, ((0, 0), (0, size - group.shape[-1]))) for group in groups])
    return order_poses(placed.rho, rho0 if last is None else last, padded, rng, trade_off)


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
