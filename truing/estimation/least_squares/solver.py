"""Non-linear least squares with damping: one problem, or many independent ones of equal shape at once.

All quantities come from the singular values of the Jacobian with scaled columns, by QR and SVD. Nothing is squared, so
nearly dependent parameters lose no digits.

Each problem of a batch has its own damping and acceptance, and leaves the batch at convergence: when its residual is
orthogonal to the columns of its Jacobian, within rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

EPS = float(np.finfo(float).eps)
# Above the first gain the linear model is trusted further, below the second less (Moré 1978).
_GOOD, _POOR = 0.75, 0.25
# Rounding of a singular value that is zero.
_ROUNDED = 10.0 * EPS
# Squared share of a parameter in an undetermined direction, above which the parameter is undetermined.
_TAKES_PART = 1e-10
_FIRST_DAMPING = 1e-3
_SECULAR_STEPS = 12
Method = Literal["levenberg-marquardt", "trust-region"]
Residuals = Callable[..., tuple[NDArray, NDArray]]
# Relative resolution of the sum of squares.
_BLIND = 1e-14
# The same for residuals that are small differences of large numbers: the share that is still to be removed.
_NEARLY_BLIND = 1e-8
# Rounding of a residual, relative to the parameters' effect on it.
_ROUNDING = 10.0 * EPS
# A change of the sum of squares this many times the predicted one has another cause.
_DOMINATED = 10.0
# Changes below this multiple of the noise of the sum of squares cannot be seen.
_LOST = 1e4
# While only the gradient decides, a further step has to reduce it to this share.
_STILL_FALLING = 0.9
# Two results are the same minimum if moving between them changes the residuals by at most this share of them,
_SAME_RESIDUAL = 1e-3
# or than this share of the parameters' total effect on the residuals (for residuals that vanish).
_SAME_EFFECT = 1e-8


@dataclass
class LinearResiduals:
    """``residual + jacobian step`` in scaled parameters: singular values, directions, and the residual along them."""

    scale: NDArray  # (B, P) largest norm so far of each column of the Jacobian
    column: NDArray  # (B, P) norm of each column here
    singular: NDArray  # (B, K) singular values of the scaled Jacobian, zero where it is deficient
    direction: NDArray  # (B, K, P) orthonormal rows, scaled parameters
    along: NDArray  # (B, K) components of the residual in the column space

    @property
    def offset(self) -> NDArray:
        """Norm (B,) of the residual's part in the column space."""
        return np.sqrt(np.sum(np.where(self.singular > 0.0, self.along, 0.0) ** 2, -1))

    @property
    def rank(self) -> NDArray:
        """Number of directions (B,) that the residuals determine."""
        return np.sum(self.singular > 0.0, -1)

    def __getitem__(self, rows: NDArray) -> LinearResiduals:
        """Return some of the problems."""
        return LinearResiduals(*(getattr(self, field.name)[rows] for field in fields(self)))

    def put(self, rows: NDArray, other: LinearResiduals) -> None:
        """Replace some of the problems."""
        for field in fields(self):
            getattr(self, field.name)[rows] = getattr(other, field.name)

    def step(self, damping: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """Return the step (B, P), its length (B,) in scaled parameters, and the predicted decrease (B,) of the sum of
        squares.

        damping (B,) is added to the squares of the singular values.
        """
        square = self.singular**2 + damping[:, None]
        part = _ratio(self.singular * self.along, np.where(self.singular > 0.0, square, 0.0))
        left = _ratio(damping[:, None] * np.ones_like(square), square)
        step = -np.einsum("bk,bkp->bp", part, self.direction) / self.scale
        promised = np.sum(np.where(self.singular > 0.0, self.along**2 * (1.0 - left**2), 0.0), -1)
        return step, np.sqrt(np.sum(part**2, -1)), promised

    def covariance(self) -> NDArray:
        """Return the inverse of J^T J (B, P, P), NaN for parameters in undetermined directions."""
        inverse = _ratio(np.ones_like(self.singular), self.singular)
        root = inverse[..., None] * self.direction / self.scale[:, None, :]
        touched = np.sum(np.where(self.singular[..., None] > 0.0, self.direction**2, 0.0), 1) < 1.0 - _TAKES_PART
        blank = np.where(touched, np.nan, 0.0)
        return np.swapaxes(root, 1, 2) @ root + blank[:, :, None] + blank[:, None, :]


def linearise(
    residual: NDArray, jacobian: NDArray, scale: NDArray | float = 0.0, tolerance: float = _ROUNDED
) -> LinearResiduals:
    """Return the linear problem for residual (B, N) and jacobian (B, N, P), with columns scaled by at least scale (B,
    P).

    Singular values below ``tolerance`` of the largest count as zero.
    """
    column = np.sqrt(np.sum(jacobian**2, 1))
    scale = np.maximum(scale, column)
    scale = np.where(scale > 0.0, scale, 1.0)
    size = jacobian.shape[2]
    augmented = np.concatenate([jacobian / scale[:, None, :], residual[..., None]], -1)
    reduced = np.asarray(np.linalg.qr(augmented, mode="r"))
    left, singular, direction = np.linalg.svd(reduced[..., :size], full_matrices=False)
    along = np.einsum("bik,bi->bk", left, reduced[..., size])
    significant = np.where(singular > tolerance * singular[:, :1], singular, 0.0)
    return LinearResiduals(scale, column, significant, direction, along)


def _ratio(above: NDArray, below: NDArray) -> NDArray:
    return np.divide(above, below, out=np.zeros_like(above), where=below > 0.0)


class StepRule(Protocol):
    """Step limit of a method; its memory is an array (B, 2)."""

    def start(self, linear: LinearResiduals, x: NDArray) -> NDArray:
        """Return the memory (B, 2) before the first step from x (B, P)."""

    def damping(self, linear: LinearResiduals, memory: NDArray) -> NDArray:
        """Return the damping (B,), which is added to the squares of the singular values."""

    def learn(self, memory: NDArray, gain: NDArray, length: NDArray) -> NDArray:
        """Return the memory after a step of a length (B,) that achieved ``gain`` (B,) of the predicted decrease."""


class LevenbergMarquardt:
    """A damping per problem: ten times smaller after a good step, growing ever faster after failed steps."""

    def start(self, linear: LinearResiduals, x: NDArray) -> NDArray:
        """Return the first damping, and the first factor of its growth."""
        return np.tile([_FIRST_DAMPING, 2.0], (len(x), 1))

    def damping(self, linear: LinearResiduals, memory: NDArray) -> NDArray:
        """Return the damping itself."""
        return memory[:, 0]

    def learn(self, memory: NDArray, gain: NDArray, length: NDArray) -> NDArray:
        """Return the new damping: Nielsen (1999) for failures, Marquardt (1963) for successes."""
        damping, growth = memory.T
        changed = np.select([gain > _GOOD, gain > _POOR, gain > 0.0], [0.1, 0.5, 2.0], growth)
        return np.stack([damping * changed, np.where(gain > 0.0, 2.0, 2.0 * growth)], 1)


class TrustRegion:
    """A radius per problem in scaled parameters, and the exact minimum of the linear problem inside (Moré 1978)."""

    def start(self, linear: LinearResiduals, x: NDArray) -> NDArray:
        """Return a first radius that allows each parameter a change of its own size, and the first damping."""
        size = np.sqrt(np.sum((linear.scale * x) ** 2, -1))
        return np.stack([np.where(size > 0.0, size, 1.0), np.zeros(len(x))], 1)

    def damping(self, linear: LinearResiduals, memory: NDArray) -> NDArray:
        """Return the damping whose step ends on the radius, zero if the undamped step ends inside."""
        radius, s, c = memory[:, 0], linear.singular, linear.along
        damping = np.zeros(len(radius))
        outside = linear.step(damping)[1] > 1.1 * radius
        for _ in range(_SECULAR_STEPS):
            square = s**2 + damping[:, None]
            part = _ratio(s * c, np.where(s > 0.0, square, 0.0))
            length = np.sqrt(np.sum(part**2, -1))
            slope = np.sum(_ratio(part**2, square), -1)
            # Hebden's step approaches the root from below, and never passes it.
            more = _ratio(length**2 * (length / radius - 1.0), slope)
            damping = np.where(outside, np.maximum(damping + more, 0.0), 0.0)
        return damping

    def learn(self, memory: NDArray, gain: NDArray, length: NDArray) -> NDArray:
        """Return the new radius: a quarter of the step after a poor one, twice the step after a good one."""
        radius = memory[:, 0]
        wider = np.where(gain > _GOOD, np.maximum(radius, 2.0 * length), radius)
        return np.stack([np.where(gain < _POOR, 0.25 * length, wider), memory[:, 1]], 1)


RULES: dict[str, StepRule] = {"levenberg-marquardt": LevenbergMarquardt(), "trust-region": TrustRegion()}


class SolverStatus(StrEnum):
    """Status of a fit, with the remedy."""

    CONVERGED = "converged"
    RANK_DEFICIENT = "rank-deficient"
    STALLED = "stalled"
    ITERATION_LIMIT = "iteration-limit"
    NOT_FINITE = "not-finite"

    @property
    def remedy(self) -> str:
        """Advice for the reader of the status, in one sentence."""
        return _REMEDIES[self]


_REMEDIES = {
    SolverStatus.CONVERGED: "Nothing to do.",
    SolverStatus.RANK_DEFICIENT: "The data do not separate some parameters: hold one of each group, or measure more.",
    SolverStatus.STALLED: "No step decreases the sum of squares: check the derivatives, or start elsewhere.",
    SolverStatus.ITERATION_LIMIT: "The fit was still moving: allow more iterations, or start closer.",
    SolverStatus.NOT_FINITE: "The residuals are not finite at the start: start where the model has values.",
}


@dataclass(frozen=True)
class Solution:
    """Results of B problems; for a problem that is not ``ok``, the last point, which is no minimum."""

    x: NDArray  # (B, P)
    cost: NDArray  # (B,) sum of squared residuals
    covariance: NDArray  # (B, P, P) for residuals of variance one; NaN for undetermined parameters
    rank: NDArray  # (B,) directions of the parameters that the residuals determine
    status: NDArray  # (B,) of SolverStatus values (str)
    iterations: NDArray  # (B,) evaluations after the first

    @property
    def ok(self) -> NDArray:
        """Mask (B,) of problems at a minimum that determines all parameters."""
        return self.status == SolverStatus.CONVERGED

    def put(self, problems: NDArray, other: Solution) -> None:
        """Replace some of the problems."""
        for field in fields(self):
            getattr(self, field.name)[problems] = getattr(other, field.name)


def join_solutions(parts: Sequence[Solution]) -> Solution:
    """Return the problems of several batches as one."""
    return Solution(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Solution)))


@dataclass
class _Walk:
    """The problems that have not converged."""

    problem: NDArray  # (b,) index in the batch
    data: tuple[NDArray, ...]
    x: NDArray  # (b, P)
    cost: NDArray  # (b,)
    linear: LinearResiduals
    memory: NDArray  # (b, 2) of the rule
    fine: NDArray  # (b,) whether the sum of squares is too coarse to assess a further step
    noise: NDArray  # (b,) observed rounding of the sum of squares

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

    residuals: called as ``residuals(x, *data)`` with x (b, P) and the rows of every data array (B, ...) of the b <= B
    active problems; returns residual (b, N) and jacobian (b, N, P); non-finite values mean that the model is undefined
    there. With residuals in units of their standard deviation, ``covariance`` is that of x. Singular values of the
    scaled Jacobian below ``rank_tolerance`` of the largest count as zero. Steps are limited by a radius (Moré 1978) or
    damped (Levenberg 1944, Marquardt 1963). Raises ValueError for an unknown method and for shapes that do not agree.
    """
    if method not in RULES:
        raise ValueError(f"method: found {method!r}, expected one of {', '.join(RULES)}")
    x = np.array(np.atleast_2d(start), float)
    with np.errstate(all="ignore"):
        residual, jacobian = _evaluate(residuals, x, data)
        solution, rows = _empty_solution(x, residual, jacobian)
        if len(rows):
            linear = linearise(residual[rows], jacobian[rows])
            memory = RULES[method].start(linear, x[rows])
            begin = x[rows], solution.cost[rows]
            is_observed = np.zeros(len(rows), bool), np.zeros(len(rows))
            walk = _Walk(rows, tuple(d[rows] for d in data), *begin, linear, memory, *is_observed)
            for finished, status, iteration in _steps(walk, residuals, RULES[method], max_iterations):
                _record(solution, finished, residuals, status, iteration, rank_tolerance)
    return solution


def _evaluate(residuals: Residuals, x: NDArray, data: tuple[NDArray, ...]) -> tuple[NDArray, NDArray]:
    residual, jacobian = residuals(x, *data)
    if residual.ndim != 2 or len(residual) != len(x) or jacobian.shape != (*residual.shape, x.shape[1]):
        actual = f"residual {residual.shape} and jacobian {jacobian.shape}"
        raise ValueError(
            f"{actual} for {x.shape[0]} problems of {x.shape[1]} parameters, expected (B, N) and (B, N, P)"
        )
    return residual, jacobian


def _finite(residual: NDArray, jacobian: NDArray) -> NDArray:
    return np.isfinite(np.sum(residual**2, -1)) & np.isfinite(np.sum(jacobian**2, (1, 2)))


def _empty_solution(x: NDArray, residual: NDArray, jacobian: NDArray) -> tuple[Solution, NDArray]:
    """Return a solution to be filled in, and the mask of problems with a defined start."""
    count, size = x.shape
    status = np.full(count, str(SolverStatus.NOT_FINITE), np.array([str(s) for s in SolverStatus]).dtype)
    rank, iterations = np.zeros((2, count), np.int64)
    blank = np.full((count, size, size), np.nan)
    solution = Solution(x, np.sum(residual**2, -1), blank, rank, status, iterations)
    return solution, np.flatnonzero(_finite(residual, jacobian))


def _steps(
    walk: _Walk, residuals: Residuals, rule: StepRule, max_iterations: int
) -> Iterator[tuple[_Walk, NDArray, int]]:
    """Take steps until every problem has ended; yield problems as they end, with status and iteration."""
    for iteration in range(1, max_iterations + 1):
        status = _advance(walk, residuals, rule)
        finished = status != ""
        if finished.any():
            yield walk.take(finished), status[finished], iteration
            walk = walk.take(~finished)
        if not len(walk.problem):
            return
    yield walk, np.full(len(walk.problem), str(SolverStatus.ITERATION_LIMIT)), max_iterations


def _advance(walk: _Walk, residuals: Residuals, rule: StepRule) -> NDArray:
    """Try one step of every problem, keep successful ones, and return the status (b,) of finished problems, else ''."""
    fine = walk.fine | _cannot_decrease(walk, _BLIND)
    damping = np.where(fine, 0.0, rule.damping(walk.linear, walk.memory))
    step, length, promised = walk.linear.step(damping)
    trial = walk.x + step
    residual, jacobian = _evaluate(residuals, trial, walk.data)
    cost = np.where(_finite(residual, jacobian), np.sum(residual**2, -1), np.inf)
    gain = np.where(promised > 0.0, (walk.cost - cost) / np.where(promised > 0.0, promised, 1.0), -1.0)
    is_useful = np.isfinite(cost) & (fine | (gain > 0.0))
    accepted = _accept(walk, _TrialStep(trial, cost, residual, jacobian), is_useful, fine)
    walk.noise = np.select([fine, accepted], [walk.noise, 0.0], _noise(walk, cost, promised))
    walk.memory = np.where(fine[:, None], walk.memory, rule.learn(walk.memory, gain, length))
    still = length <= EPS * np.sqrt(np.sum((walk.linear.scale * walk.x) ** 2, -1))
    stuck = ~fine & ~accepted & (still | np.all(trial == walk.x, -1))
    walk.fine = fine | (stuck & _cannot_decrease(walk, _NEARLY_BLIND, walk.noise))
    return np.select([fine & ~accepted, stuck & ~walk.fine], [SolverStatus.CONVERGED, SolverStatus.STALLED], "")


def _cannot_decrease(walk: _Walk, share: float, noise: NDArray | float = 0.0) -> NDArray:
    """Return the mask (b,) of problems where at most a share of the sum of squares, or its rounding or noise, can be
    removed."""
    norm = np.sqrt(walk.cost)
    rounding = _ROUNDING * np.sqrt(np.sum((walk.linear.column * walk.x) ** 2, -1))
    return walk.linear.offset**2 <= norm * (share * norm + rounding) + _LOST * noise


def _noise(walk: _Walk, cost: NDArray, promised: NDArray) -> NDArray:
    """Return the rounding noise of the sums of squares (b,), as far as failed steps have shown it. A change far from
    the predicted one is rounding or curvature. As steps get shorter, curvature disappears (or the change becomes the
    negative of the prediction, if derivatives are wrong), while rounding remains."""
    off = np.abs(cost - walk.cost + promised)
    shown = np.isfinite(off) & ((off > _DOMINATED * promised) | (cost == walk.cost))
    return np.where(shown, np.maximum(off, walk.noise), 0.0)


@dataclass(frozen=True)
class _TrialStep:
    """Values (b, P) that a step leads to, with cost (b,), residuals (b, N) and Jacobian (b, N, P)."""

    x: NDArray
    cost: NDArray
    residual: NDArray
    jacobian: NDArray


def _accept(walk: _Walk, trial: _TrialStep, useful: NDArray, fine: NDArray) -> NDArray:
    """Move the useful problems to their trials, fine ones only if the gradient decreases; return the mask (b,) of moved
    ones."""
    rows = np.flatnonzero(useful)
    linear = linearise(trial.residual[rows], trial.jacobian[rows], walk.linear.scale[rows])
    falling = linear.offset < _STILL_FALLING * walk.linear.offset[rows]
    mask = falling | ~fine[rows]
    rows = rows[mask]
    walk.x[rows], walk.cost[rows] = trial.x[rows], trial.cost[rows]
    walk.linear.put(rows, linear[mask])
    return np.isin(np.arange(len(useful)), rows)


def _record(
    solution: Solution, walk: _Walk, residuals: Residuals, status: NDArray, iteration: int, rank_tolerance: float
) -> None:
    """Store the results of finished problems, assessed by the final Jacobian alone."""
    walk.linear = linear = linearise(*_evaluate(residuals, walk.x, walk.data), tolerance=rank_tolerance)
    arrived = status == SolverStatus.CONVERGED
    status = np.where(arrived & ~_cannot_decrease(walk, _NEARLY_BLIND, walk.noise), SolverStatus.STALLED, status)
    deficient = (linear.rank < walk.x.shape[1]) & (status == SolverStatus.CONVERGED)
    solution.x[walk.problem], solution.cost[walk.problem] = walk.x, walk.cost
    solution.covariance[walk.problem], solution.rank[walk.problem] = linear.covariance(), linear.rank
    solution.status[walk.problem] = np.where(deficient, SolverStatus.RANK_DEFICIENT, status)
    solution.iterations[walk.problem] = iteration


@dataclass(frozen=True)
class Minima:
    """Distinct minima of one problem, the lowest first."""

    x: NDArray  # (M, P)
    cost: NDArray  # (M,)
    reached: NDArray  # (M,) number of starts that led there
    failed: int  # number of starts that did not reach a minimum

    @property
    def is_unique(self) -> bool:
        """True if every start led to the same minimum."""
        return len(self.x) == 1 and self.failed == 0


def distinct_minima(solution: Solution) -> Minima:
    """Return the distinct minima among fits of the same problem from many starts.

    Two results are compared in the measure of the residuals, ``|J (x1 - x2)|``. Only fits that are ``ok`` count as
    minima.
    """
    order = np.argsort(solution.cost, kind="stable")
    order = order[solution.ok[order]]
    lowest: list[int] = []
    reached: list[int] = []
    while len(order):
        same = _same_minimum(solution, int(order[0]), order)
        lowest.append(int(order[0]))
        reached.append(int(same.sum()))
        order = order[~same]
    failed = int(np.sum(~solution.ok))
    return Minima(solution.x[lowest], solution.cost[lowest], np.array(reached, np.int64), failed)


def _same_minimum(solution: Solution, first: int, others: NDArray) -> NDArray:
    """Return the mask (n,) of other fits at the same minimum as one fit."""
    normal = np.linalg.inv(solution.covariance[first])
    gap = solution.x[others] - solution.x[first]
    distance = np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", gap, normal, gap), 0.0))
    effect = np.sqrt(np.sum(np.diag(normal) * solution.x[first] ** 2))
    same = distance <= _SAME_RESIDUAL * np.sqrt(solution.cost[first]) + _SAME_EFFECT * effect
    return same | (others == first)
