"""Non-linear least squares, damped: one problem, or many independent ones of equal shape at once.

Each problem of a batch is damped, accepted and finished by itself, and leaves the batch when it is finished: when its
residual has no part along the columns of its Jacobian any more, as far as rounding lets one see.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.estimation.least_squares.step import EPS, RULES, Linear, Rule, linearise

Method = Literal["levenberg-marquardt", "trust-region"]
Residuals = Callable[..., tuple[NDArray, NDArray]]

# The sum of squares no longer tells two points apart that differ by so little of it.
_BLIND = 1e-14
# Nor may it, where residuals are small differences of large numbers, if so little of it is left to remove.
_NEARLY_BLIND = 1e-8
# What rounding may do to a residual, in units of the parameters' own effect on it.
_ROUNDING = 10.0 * EPS
# A change of the sum of squares so many times the promised one has another cause.
_DOMINATED = 10.0
# Whatever is not that many times the noise of the sum of squares is lost in it.
_LOST = 1e4
# While only the gradient can tell, a further step has to take so much of it away.
_STILL_FALLING = 0.9


class SolverStatus(StrEnum):
    """How a fit ended, and ``remedy`` says what to do about it."""

    CONVERGED = "converged"
    RANK_DEFICIENT = "rank-deficient"
    STALLED = "stalled"
    ITERATION_LIMIT = "iteration-limit"
    NOT_FINITE = "not-finite"

    @property
    def remedy(self) -> str:
        """One sentence for the person who reads the status."""
        return _REMEDIES[self]


_REMEDIES = {
    SolverStatus.CONVERGED: "Nothing to do.",
    SolverStatus.RANK_DEFICIENT: "Some parameters cannot be told apart: hold one of each group, or measure elsewhere.",
    SolverStatus.STALLED: "No step decreases the sum of squares: check the derivatives, or start elsewhere.",
    SolverStatus.ITERATION_LIMIT: "The fit was still moving: allow more iterations, or start closer.",
    SolverStatus.NOT_FINITE: "The residuals are not finite at the start: start where the model has values.",
}


@dataclass(frozen=True)
class Solution:
    """Where B problems ended; numbers of a problem that is not ``ok`` are where it stood, no minimum."""

    x: NDArray  # (B, P)
    cost: NDArray  # (B,) sum of squared residuals
    covariance: NDArray  # (B, P, P) for residuals of variance one; NaN for what the residuals do not determine
    rank: NDArray  # (B,) directions of the parameters that the residuals determine
    status: NDArray  # (B,) of SolverStatus values (str)
    iterations: NDArray  # (B,) evaluations after the first

    @property
    def ok(self) -> NDArray:
        """Return which problems (B,) stand at a minimum, where all parameters are determined."""
        return self.status == SolverStatus.CONVERGED

    def put(self, problems: NDArray, other: Solution) -> None:
        """Exchange some of the problems."""
        for field in fields(self):
            getattr(self, field.name)[problems] = getattr(other, field.name)


def join_solutions(parts: Sequence[Solution]) -> Solution:
    """Return the problems of several batches as one."""
    return Solution(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Solution)))


@dataclass
class _Walk:
    """The problems that still move."""

    problem: NDArray  # (b,) which of the batch
    data: tuple[NDArray, ...]
    x: NDArray  # (b, P)
    cost: NDArray  # (b,)
    linear: Linear
    memory: NDArray  # (b, 2) of the rule
    fine: NDArray  # (b,) whether the sum of squares is too coarse to judge a further step
    noise: NDArray  # (b,) what rounding has been seen to do to the sum of squares

    def take(self, rows: NDArray) -> _Walk:
        """Return some of the problems."""
        data = tuple(array[rows] for array in self.data)
        x, cost, memory = self.x[rows], self.cost[rows], self.memory[rows]
        return _Walk(self.problem[rows], data, x, cost, self.linear[rows], memory, self.fine[rows], self.noise[rows])


def least_squares(
    residuals: Residuals,
    start: ArrayLike,
    *data: NDArray,
    method: Method = "trust-region",
    max_iterations: int = 2000,
    rank_tolerance: float = 1e-12,
) -> Solution:
    """Return the minima of ``sum residual^2`` that B problems reach from their starts (B, P), or (P,) for one.

    residuals: called as ``residuals(x, *data)`` with x (b, P) and the rows of every array of data (B, ...) that
    belong to the b <= B problems still moving; returns residual (b, N) and jacobian (b, N, P), where values that are
    not finite mean that the model has none there. Residuals in units of their standard deviation make
    ``covariance`` that of x. Singular values of the Jacobian, its columns scaled, count as zero below
    ``rank_tolerance`` of the largest. Steps end on a radius (Moré 1978) or are damped (Levenberg 1944, Marquardt
    1963). Raises ValueError for an unknown method and for shapes that do not agree.
    """
    if method not in RULES:
        raise ValueError(f"method: found {method!r}, expected one of {', '.join(RULES)}")
    x = np.array(np.atleast_2d(start), float)
    with np.errstate(all="ignore"):
        residual, jacobian = _evaluate(residuals, x, data)
        solution, rows = _unsolved(x, residual, jacobian)
        if len(rows):
            linear = linearise(residual[rows], jacobian[rows])
            memory = RULES[method].start(linear, x[rows])
            begin = x[rows], solution.cost[rows]
            seen = np.zeros(len(rows), bool), np.zeros(len(rows))
            walk = _Walk(rows, tuple(d[rows] for d in data), *begin, linear, memory, *seen)
            for finished, status, iteration in _steps(walk, residuals, RULES[method], max_iterations):
                _record(solution, finished, residuals, status, iteration, rank_tolerance)
    return solution


def _evaluate(residuals: Residuals, x: NDArray, data: tuple[NDArray, ...]) -> tuple[NDArray, NDArray]:
    residual, jacobian = residuals(x, *data)
    if residual.ndim != 2 or len(residual) != len(x) or jacobian.shape != (*residual.shape, x.shape[1]):
        found = f"residual {residual.shape} and jacobian {jacobian.shape}"
        raise ValueError(f"{found} for {x.shape[0]} problems of {x.shape[1]} parameters, expected (B, N) and (B, N, P)")
    return residual, jacobian


def _finite(residual: NDArray, jacobian: NDArray) -> NDArray:
    return np.isfinite(np.sum(residual**2, -1)) & np.isfinite(np.sum(jacobian**2, (1, 2)))


def _unsolved(x: NDArray, residual: NDArray, jacobian: NDArray) -> tuple[Solution, NDArray]:
    """Return a solution yet to be filled, and which problems can be."""
    count, size = x.shape
    status = np.full(count, str(SolverStatus.NOT_FINITE), np.array([str(s) for s in SolverStatus]).dtype)
    rank, iterations = np.zeros((2, count), np.int64)
    blank = np.full((count, size, size), np.nan)
    solution = Solution(x, np.sum(residual**2, -1), blank, rank, status, iterations)
    return solution, np.flatnonzero(_finite(residual, jacobian))


def _steps(walk: _Walk, residuals: Residuals, rule: Rule, max_iterations: int) -> Iterator[tuple[_Walk, NDArray, int]]:
    """Take steps until every problem is finished; yield problems as they finish, with their status and iteration."""
    for iteration in range(1, max_iterations + 1):
        status = _advance(walk, residuals, rule)
        finished = status != ""
        if finished.any():
            yield walk.take(finished), status[finished], iteration
            walk = walk.take(~finished)
        if not len(walk.problem):
            return
    yield walk, np.full(len(walk.problem), str(SolverStatus.ITERATION_LIMIT)), max_iterations


def _advance(walk: _Walk, residuals: Residuals, rule: Rule) -> NDArray:
    """Try one step of every problem, keep those that help, and return the status (b,) of the finished ones, else ''."""
    fine = walk.fine | _flat(walk, _BLIND)
    damping = np.where(fine, 0.0, rule.damping(walk.linear, walk.memory))
    step, length, promised = walk.linear.step(damping)
    trial = walk.x + step
    residual, jacobian = _evaluate(residuals, trial, walk.data)
    cost = np.where(_finite(residual, jacobian), np.sum(residual**2, -1), np.inf)
    gain = np.where(promised > 0.0, (walk.cost - cost) / np.where(promised > 0.0, promised, 1.0), -1.0)
    taken = _accept(walk, np.isfinite(cost) & (fine | (gain > 0.0)), fine, trial, cost, residual, jacobian)
    walk.noise = np.select([fine, taken], [walk.noise, 0.0], _noise(walk, cost, promised))
    walk.memory = np.where(fine[:, None], walk.memory, rule.learn(walk.memory, gain, length))
    still = length <= EPS * np.sqrt(np.sum((walk.linear.scale * walk.x) ** 2, -1))
    stuck = ~fine & ~taken & (still | np.all(trial == walk.x, -1))
    walk.fine = fine | (stuck & _flat(walk, _NEARLY_BLIND, walk.noise))
    return np.select([fine & ~taken, stuck & ~walk.fine], [SolverStatus.CONVERGED, SolverStatus.STALLED], "")


def _flat(walk: _Walk, share: float, noise: NDArray | float = 0.0) -> NDArray:
    """Return where (b,) no more than a share of the sum of squares, or than its rounding or noise, can be removed."""
    norm = np.sqrt(walk.cost)
    rounding = _ROUNDING * np.sqrt(np.sum((walk.linear.column * walk.x) ** 2, -1))
    return walk.linear.offset**2 <= norm * (share * norm + rounding) + _LOST * noise


def _noise(walk: _Walk, cost: NDArray, promised: NDArray) -> NDArray:
    """Return what rounding does to the sums of squares (b,), as far as failed steps have shown it.

    A change far from the one promised is rounding or curvature; as steps get shorter curvature gives way to the
    promise, or to its negative where derivatives are wrong, but rounding stays, or leaves no change at all.
    """
    off = np.abs(cost - walk.cost + promised)
    shown = np.isfinite(off) & ((off > _DOMINATED * promised) | (cost == walk.cost))
    return np.where(shown, np.maximum(off, walk.noise), 0.0)


def _accept(
    walk: _Walk, useful: NDArray, fine: NDArray, trial: NDArray, cost: NDArray, residual: NDArray, jacobian: NDArray
) -> NDArray:
    """Move the useful problems to their trials, fine ones only where the gradient falls; return which (b,) moved."""
    rows = np.flatnonzero(useful)
    linear = linearise(residual[rows], jacobian[rows], walk.linear.scale[rows])
    falling = linear.offset < _STILL_FALLING * walk.linear.offset[rows]
    kept = falling | ~fine[rows]
    rows = rows[kept]
    walk.x[rows], walk.cost[rows] = trial[rows], cost[rows]
    walk.linear.put(rows, linear[kept])
    return np.isin(np.arange(len(useful)), rows)


def _record(
    solution: Solution, walk: _Walk, residuals: Residuals, status: NDArray, iteration: int, rank_tolerance: float
) -> None:
    """Write where the problems of a walk ended, judged by the Jacobian there alone."""
    walk.linear = linear = linearise(*_evaluate(residuals, walk.x, walk.data), tolerance=rank_tolerance)
    arrived = status == SolverStatus.CONVERGED
    status = np.where(arrived & ~_flat(walk, _NEARLY_BLIND, walk.noise), SolverStatus.STALLED, status)
    deficient = (linear.rank < walk.x.shape[1]) & (status == SolverStatus.CONVERGED)
    solution.x[walk.problem], solution.cost[walk.problem] = walk.x, walk.cost
    solution.covariance[walk.problem], solution.rank[walk.problem] = linear.covariance(), linear.rank
    solution.status[walk.problem] = np.where(deficient, SolverStatus.RANK_DEFICIENT, status)
    solution.iterations[walk.problem] = iteration
