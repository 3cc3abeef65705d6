"""Search for calibration configurations: criterion, candidates, upper bound, methods, and verification poses."""

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
# Least length of any combination of unit columns of separable parameters. This tests rank, not noise, as in the report:
# the report's parameters reach 1e-3 and more on the telescope, a_z or b_z in addition 4e-5 at most.
SEPARABLE = 2e-4
_BETWEEN = 50  # interior points, in case all corners are forbidden
# Parameters of the report (section 6.3.1); others enter only after these.
REPORTED = ("a_x", "a_y", "b_x", "b_y", "u_x", "u_y", "u_z", "l")
_DENSE = 2000  # points spread over the region, in addition to its corners
_ASCENTS = 60  # starts of gradient ascent to more sensitive points
_ROUNDS = 4  # rounds in which the points found join the candidates
_RAISED = 1e-4  # increase of the bound per parameter below which no further round is needed
_STARTS = 10
_POLISH, _ITERATIONS = 50, 1000  # iterations from an exchanged choice, and from random poses
_NEAR = 0.9  # candidates below this share of the largest sensitivity are in no good design
_OUTSIDE = 1.01  # factor on a limit: an excess of 1 % is the actuator's noise, not another range
_HULL = 7  # configurations averaged to a verification pose: one more than a pose has coordinates


@dataclass(frozen=True)
class DesignProblem:
    """Criterion of configurations; rows are in tolerances of the parameters and noise of the residual.

    names (q,) with unit and SI; tolerance (q,) SI; noise (L,) m: one sigma of a leg's residual; noise_from, in words;
    held: parameters of a leg that are not separable from those, or were not requested.
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
        """Number of legs."""
        return len(self.noise)

    @property
    def size(self) -> int:
        """Number of parameters of all legs."""
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
        """Return True for coordinates (B, 6) within the limits that readings reach without passing a singular pose."""
        regressors, placed = self.regressors, self.regressors.at(x)
        forward = poses_at(regressors.structure, regressors.machine, placed.rho)
        away = np.abs(np.concatenate([forward.p - placed.p, (forward.R - placed.R).reshape(-1, 9)], -1)).max(-1)
        return np.asarray(forward.converged & (away < _SAME) & self.region.within(x))

    def placed_at(self, rho: NDArray) -> Placed:
        """Return configurations at readings rho (B, L), m; raises ValueError where they reach no pose."""
        regressors = self.regressors
        reached = poses_at(regressors.structure, regressors.machine, rho)
        if not reached.converged.all():
            raise ValueError("readings at which the mechanism can be assembled")
        return Placed(reached.p, reached.R, rho)


@dataclass(frozen=True)
class ConfigurationLimits:
    """Half ranges of pose (6,) and readings (L,), SI, infinite where there is none; forbidden boxes (F, 6 + L)."""

    pose: NDArray
    readings: NDArray
    lower: NDArray
    upper: NDArray


def identifiable_parameters(problem: DesignProblem) -> list[int]:
    """Return a maximal set of parameters, the same for every leg, that corner and interior configurations separate."""
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
    first = [0.0 if entry.name in REPORTED else 1.0 for entry in problem.names] * problem.legs
    groups = list(range(size)) * problem.legs
    chosen_set = choose_identifiable(
        jacobian, np.ones(len(labels)), labels, groups=groups, preference=first, unidentifiable=1.0 / SEPARABLE
    )
    return [int(k) for k in np.flatnonzero(chosen_set.chosen[:size])]


@dataclass(frozen=True)
class AssessedConfigurations:
    """Information of a calibration from configurations: their number, information (L, q, q), number outside
    the limits."""

    count: int
    information: NDArray
    outside: int

    @property
    def log_det(self) -> float:
        """O1, the log determinant over all legs."""
        return sum_log_det(self.information)

    @property
    def sigma(self) -> NDArray:
        """Standard deviations (L, q), in tolerances, from data alone."""
        return np.sqrt(np.diagonal(np.linalg.inv(self.information), axis1=1, axis2=2))


def assessed(problem: DesignProblem, rho: NDArray) -> AssessedConfigurations:
    """Return the information of a calibration from configurations at readings rho (B, L), m.

    Raises ValueError where they reach no pose.
    """
    placed = problem.placed_at(rho)
    outside = problem.region.excess(problem.regressors.coordinates(placed)) > _OUTSIDE
    return AssessedConfigurations(len(rho), information_of(problem.rows(placed)), int(outside.sum()))


def ordered(
    problem: DesignProblem, placed: Placed, last: NDArray | None, rng: np.random.Generator, trade_off: float
) -> PoseOrder:
    """Return the order of configurations, starting from the readings ``last`` (L,), or from the reference.

    The order decorrelates time from every leg's regressors and from the drives; trade_off: see `order_poses`.
    """
    rho0 = problem.regressors.machine.legs.rho0
    groups = [*np.moveaxis(problem.rows(placed), 1, 0), placed.rho - rho0]
    size = max(group.shape[-1] for group in groups)
    padded = np.stack([np.pad(group, ((0, 0), (0, size - group.shape[-1]))) for group in groups])
    return order_poses(placed.rho, rho0 if last is None else last, padded, rng, trade_off)


@dataclass(frozen=True)
class Bounded:
    """Candidates x (C, 6), corners first, the best design on them, and ``upper``, a bound that includes points between
    them.

    unreached: number of candidates left out because readings do not lead to them from the reference pose.
    """

    x: NDArray
    corners: int
    dense: int
    unreached: int
    bound: DesignBound
    upper: float

    @property
    def raised(self) -> float:
        """Increase of the bound, in log det, by points between candidates."""
        return self.upper - self.bound.upper

    @property
    def ascended(self) -> int:
        """Number of candidates found by gradient ascent."""
        return len(self.x) - self.corners - self.dense


def bounded(problem: DesignProblem, poses: int, existing: NDArray | None, rng: np.random.Generator) -> Bounded:
    """Return candidates with an upper bound for any choice of poses; raises ValueError if forbidden regions leave no
    candidate."""
    corners, between = problem.region.corners(), problem.region.draw(_DENSE, rng)
    is_reached = problem.reached(corners), problem.reached(between)
    x = np.concatenate([corners[is_reached[0]], between[is_reached[1]]])
    numbers = int(is_reached[0].sum()), int(is_reached[1].sum()), int(sum(np.sum(~mask) for mask in is_reached))
    for _ in range(_ROUNDS):
        bound = bound_design(problem.rows_at(x), poses, existing)
        top = np.argsort(bound.sensitivity)[::-1][: _ASCENTS // 2]
        start = x[np.concatenate([top, rng.choice(len(x), _ASCENTS // 2)])]
        largest = largest_sensitivity(problem.region, problem.rows_and_changes, bound, start)
        result = Bounded(x, *numbers, bound, bound.with_sensitivity(largest.value))
        if result.raised <= _RAISED * problem.size:
            break
        x = np.concatenate([x, largest.x[problem.reached(largest.x)]])
    return result


def choose(
    problem: DesignProblem,
    candidates: Bounded,
    method: str,
    poses: int,
    existing: NDArray | None,
    rng: np.random.Generator,
) -> NDArray:
    """Return the coordinates (N, 6) of the configurations that a method finds: exchange, direct, ioops or random."""
    if method == "exchange":
        return _choose_by_exchange(problem, candidates, poses, existing, rng)
    start = _drawn(problem, poses, rng)
    if method == "direct":
        return _ascended(problem, start, existing, _ITERATIONS)
    if method == "ioops":
        pool = np.concatenate([start, candidates.x])
        return pool[ioops(problem.rows_at(pool), np.arange(poses), existing).chosen]
    return start


def _drawn(problem: DesignProblem, count: int, rng: np.random.Generator) -> NDArray:
    """Return random points of the region, reachable ones first."""
    x = problem.region.draw(4 * count, rng)
    return x[np.argsort(~problem.reached(x), kind="stable")[:count]]


def _ascended(problem: DesignProblem, x: NDArray, existing: NDArray | None, iterations: int) -> NDArray:
    """Return configurations improved along the gradient, or unchanged if one would become unreachable."""
    ascent = optimise_directly(problem.region, problem.rows_and_changes, x, existing, iterations)
    return ascent.x if problem.reached(ascent.x).all() else x


def _choose_by_exchange(
    problem: DesignProblem, candidates: Bounded, poses: int, existing: NDArray | None, rng: np.random.Generator
) -> NDArray:
    """Return the best exchange from the rounded optimum and from random starts, improved to points between
    candidates."""
    sensitivity = candidates.bound.sensitivity
    pool = np.flatnonzero(sensitivity >= _NEAR * sensitivity.max())
    rows, index = problem.rows_at(candidates.x[pool]), np.full(len(sensitivity), -1)
    index[pool] = np.arange(len(pool))
    starts = [index[rounded_design(candidates.bound, poses)], one_by_one(rows, poses, candidates.bound, existing)]
    starts += [rng.choice(len(pool), poses, replace=len(pool) < poses) for _ in range(_STARTS)]
    selections = [
        exchange(rows, s, existing) for s in starts if np.isfinite(sum_log_det(information_of(rows[s], existing)))
    ]
    best = max(selections, key=lambda selection: selection.log_det)
    start = candidates.x[pool[best.chosen]]
    moved = _ascended(problem, start, existing, _POLISH)
    gained = sum_log_det(information_of(problem.rows_at(moved), existing)) > best.log_det
    return moved if gained else start


def verification(problem: DesignProblem, x: NDArray, count: int, rng: np.random.Generator) -> NDArray:
    """Return poses (count, 6) within the hull of the chosen (N, 6), far from them and from each other.

    Raises ValueError if forbidden regions leave fewer configurations.
    """
    if not count:
        return np.empty((0, 6))
    picked = rng.integers(len(x), size=(100 * count, min(_HULL, len(x))))
    shares = rng.dirichlet(np.ones(picked.shape[1]), len(picked))
    inside = problem.region.pulled_in(np.einsum("nk,nki->ni", shares, x[picked]))
    inside = inside[problem.region.allowed(inside) & problem.reached(inside)]
    if len(inside) < count:
        raise ValueError("enough reachable poses outside forbidden regions, between the chosen poses")
    near = np.full(len(inside), np.inf)
    for pose in x:  # pose by pose: all distances at once would not fit in memory
        near = np.minimum(near, np.linalg.norm(inside - pose, axis=-1))
    chosen: list[int] = []
    for _ in range(count):
        chosen.append(int(np.argmax(near)))
        near = np.minimum(near, np.linalg.norm(inside - inside[chosen[-1]], axis=-1))
    return inside[chosen]
