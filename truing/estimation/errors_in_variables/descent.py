"""Minimisation of an eliminated implicit model: maximum of likelihood and prior for given weights of poses.

The equations ``g(x, d) = 0`` of a pose depend on values x common to all poses. They also depend on deviations d of the
truth from the measurement, with covariance C. Let ``A = dg/dd``, ``B = dg/dx``, ``V = A C A'`` and ``e = g - A d``. The
smallest deviations that satisfy the linearised equations are ``d = -C A' V^-1 e``, at the cost ``e' V^-1 e``. C is
never inverted. Derivatives must be taken at the estimated deviations (Lenzmann and Lenzmann, 2004).

Levenberg-Marquardt. At every trial the deviations converge first, so that costs are comparable. Along curved valleys of
the cost a second-order correction bends the step (acceleration of Transtrum and Sethna, 2012, for a full step).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from truing.estimation.least_squares.solver import SolverStatus

_MAX_PROJECTIONS = 30
MAX_ITERATIONS = 500
# Below this the cost is dominated by rounding; a stalled descent is accepted there.
NEAR = 1e-6
# Predicted decrease at convergence: no value moves by more than a hundred-thousandth of its sigma.
_SETTLED = 1e-10
# Squared change of converged deviations, and the share of a step's predicted decrease by which deviations may still
# change when the step is assessed.
_STILL, _JUDGED = 1e-12, 1e-3
# Damping that rounding alone requires if some combination of values is unknown.
_LEAST_DAMPING = 1e-13
_FIRST_DAMPING = 1e-6
_LARGEST_BEND = 0.75  # relative to the step's length (Transtrum and Sethna)


class ConstraintEquations(Protocol):
    """Equations of all poses and their exact derivatives."""

    @property
    def value(self) -> NDArray:
        """Return the equations (B, m), zero at the truth."""

    @property
    def by_deviation(self) -> NDArray:
        """Return the derivatives (B, m, n) by the deviations."""

    @property
    def by_values(self) -> NDArray:
        """Return the derivatives (B, m, P) by the values."""


class Constraint(Protocol):
    """An implicit model; a bound method of this signature is also accepted."""

    def __call__(self, values: NDArray, deviation: NDArray, /) -> ConstraintEquations:
        """Return the equations at values (P,) and deviations (B, n) of the truth from the measurement."""


@dataclass(frozen=True)
class ImplicitModel:
    """An implicit model with the covariance (B, n, n), possibly singular, of the measurements of each pose."""

    constrain: Constraint
    covariance: NDArray


@dataclass(frozen=True)
class Eliminated:
    """The model at values (P,), linearised at deviations ``C pull``, whitened by its equations' own noise."""

    values: NDArray
    pull: NDArray  # (B, n) point of linearisation: C^-1 d, if C has an inverse
    rows: NDArray  # (B, m, n) equations by deviations, G with G C G' = 1
    residual: NDArray  # (B, m)
    jacobian: NDArray  # (B, m, P)
    distance_to_convergence: NDArray  # (B,) of the deviations at these values, in squared sigmas

    @property
    def chi_square(self) -> NDArray:
        """Cost (B,) of the deviations of each pose."""
        return np.einsum("bm,bm->b", self.residual, self.residual)

    @property
    def closing_pull(self) -> NDArray:
        """Pull (B, n) that satisfies the linearised equations."""
        return _closing(self.rows, self.residual)

    def pull_after(self, step: NDArray) -> NDArray:
        """Return the pull (B, n) that satisfies the linearised equations after a step (P,) of the values."""
        return _closing(self.rows, self.residual + self.jacobian @ step)


def linearise(measured: ImplicitModel, values: NDArray, pull: NDArray) -> Eliminated:
    """Return the model at values (P,) with its derivatives at the deviations of a pull (B, n).

    Raises LinAlgError if an equation of a pose contains no measurement with an error.
    """
    deviation = times(measured.covariance, pull)
    constrained = measured.constrain(values, deviation)
    A = constrained.by_deviation
    factor = np.linalg.inv(np.linalg.cholesky(A @ measured.covariance @ np.swapaxes(A, 1, 2)))
    rows = factor @ A
    residual = times(factor, constrained.value - times(A, deviation))
    change = _closing(rows, residual) - pull
    distance_to_convergence = np.einsum("bi,bi->b", change, times(measured.covariance, change))
    return Eliminated(values, pull, rows, residual, factor @ constrained.by_values, distance_to_convergence)


def project(measured: ImplicitModel, values: NDArray, pull: NDArray, weight: NDArray, allowed: float) -> Eliminated:
    """Return the model linearised at converged deviations, to an allowed weighted squared change.

    It has not converged if `distance_to_convergence` is larger.
    """
    for _ in range(_MAX_PROJECTIONS):
        eliminated = linearise(measured, values, pull)
        if not weight @ eliminated.distance_to_convergence > allowed:
            break
        pull = eliminated.closing_pull
    return eliminated


def _closing(rows: NDArray, residual: NDArray) -> NDArray:
    return -np.einsum("bmn,bm->bn", rows, residual)


def times(matrix: NDArray, vector: NDArray) -> NDArray:
    """Return the products (B, i) of matrices (B, i, j) with vectors (B, j)."""
    return (matrix @ vector[..., None])[..., 0]


@dataclass(frozen=True)
class Prior:
    """Prior of the values: mean (P,), information (P, P), the inverse of their covariance.

    A zero row and column means no knowledge.
    """

    mean: NDArray
    information: NDArray

    def pull(self, values: NDArray) -> NDArray:
        """Return half the gradient (P,) of the cost."""
        return self.information @ (values - self.mean)

    def cost(self, values: NDArray) -> float:
        """Return the squared distance of values (P,) from the mean, in sigmas."""
        return float((values - self.mean) @ self.pull(values))


@dataclass(frozen=True)
class Objective:
    """Objective function: ``sum weight d' C^+ d`` over the poses, plus the prior."""

    measured: ImplicitModel
    prior: Prior
    weight: NDArray  # (B,)

    def point(self, values: NDArray, pull: NDArray, allowed: float) -> Point:
        """Return the objective at values (P,), from a pull (B, n), with deviations converged to the allowed change."""
        return self.starting_point(project(self.measured, values, pull, self.weight, allowed))

    def starting_point(self, at: Eliminated) -> Point:
        """Return the objective at the point of linearisation."""
        return Point(self, at, float(self.weight @ at.chi_square + self.prior.cost(at.values)))

    def trial(self, start: Point, step: NDArray, promise: float) -> Point | None:
        """Return the objective after a step, or None if it has no reliable value."""
        allowed = max(_JUDGED * promise, _STILL)
        try:
            point = self.point(start.at.values + step, start.at.pull_after(step), allowed)
        except np.linalg.LinAlgError:
            return None
        return point if np.isfinite(point.cost) and point.distance_to_convergence <= max(allowed, NEAR) else None


@dataclass(frozen=True)
class Point:
    """The objective at some values, with derivatives."""

    objective: Objective
    at: Eliminated
    cost: float

    @property
    def distance_to_convergence(self) -> float:
        """Weighted squared distance of the deviations from convergence."""
        return float(self.objective.weight @ self.at.distance_to_convergence)

    @cached_property
    def _rows(self) -> NDArray:
        return (self.objective.weight[:, None, None] * self.at.jacobian).reshape(-1, len(self.at.values))

    @cached_property
    def _slope(self) -> NDArray:
        return self._rows.T @ self.at.residual.ravel() + self.objective.prior.pull(self.at.values)

    @cached_property
    def _information(self) -> NDArray:
        size = len(self.at.values)
        return self._rows.T @ self.at.jacobian.reshape(-1, size) + self.objective.prior.information

    @cached_property
    def scale(self) -> NDArray:
        """Factors (P,) that scale the columns of the normal equations to unit length."""
        return column_scale(self._information)

    @cached_property
    def _curvature(self) -> NDArray:
        return self._information / np.outer(self.scale, self.scale)

    def step(self, damping: float) -> tuple[NDArray, float]:
        """Return the damped step (P,) and the predicted decrease of the cost."""
        step = self._solved_step(self._slope, damping)
        return step, float(-step @ (2 * self._slope + self._information @ step))

    def converged(self) -> Point:
        """Return the same point with converged deviations, as far as it matters."""
        return self.objective.point(self.at.values, self.at.closing_pull, _STILL)

    def second_order_correction(self, straight: Point, step: NDArray, damping: float) -> NDArray | None:
        """Return the second-order correction (P,) of a step from its end point; None if it is too large."""
        change = straight.at.residual - self.at.residual - self.at.jacobian @ step
        bend = self._solved_step(self._rows.T @ change.ravel(), damping)
        small = np.linalg.norm(self.scale * bend) <= _LARGEST_BEND * np.linalg.norm(self.scale * step)
        return bend if small else None

    def _solved_step(self, slope: NDArray, damping: float) -> NDArray:
        damped = self._curvature + max(damping, _LEAST_DAMPING) * np.eye(len(slope))
        return -np.linalg.solve(damped, slope / self.scale) / self.scale


@dataclass(frozen=True)
class _Damping:
    """Addition to a curvature of unit diagonal: zero while steps lower the cost as predicted."""

    value: float = 0.0
    growth: float = 10.0

    def lowered(self, gain: float) -> _Damping:
        """Return the damping after a step that achieved a share `gain` of its predicted decrease."""
        value = self.value * (0.1 if gain > 0.75 else 0.5 if gain > 0.25 else 2.0)
        return _Damping(value if value > _FIRST_DAMPING / 100 else 0.0)

    def raised(self) -> _Damping:
        """Return the damping after a failed step; it grows faster each time."""
        return _Damping(max(self.value * self.growth, _FIRST_DAMPING), 2 * self.growth)


@dataclass(frozen=True)
class Descent:
    """Result of a descent."""

    at: Eliminated
    cost: float
    iterations: int
    status: SolverStatus


def descend(objective: Objective, start: Eliminated) -> Descent:
    """Return the minimum of an objective near the point of linearisation; its deviations need not have converged."""
    point, damping, before = objective.starting_point(start), _Damping(), np.inf
    if not np.isfinite(point.cost):
        return Descent(point.at, point.cost, 0, SolverStatus.NOT_FINITE)
    sure = False
    for iteration in range(MAX_ITERATIONS):
        step, promise = point.step(damping.value)
        has_stalled = _has_stalled(promise, before if damping.value == 0.0 else np.inf)
        trial = None if has_stalled else _lower_point(point, step, promise, damping.value)
        if trial is not None:
            damping = damping.lowered((point.cost - trial.cost) / promise)
            point, before, sure = trial, promise, trial.distance_to_convergence <= _STILL
        elif not sure:
            point, sure = point.converged(), True
        elif has_stalled:
            return Descent(point.at, point.cost, iteration, _status(point, damping))
        else:
            damping = damping.raised()
    return Descent(point.at, point.cost, MAX_ITERATIONS, SolverStatus.ITERATION_LIMIT)


def _status(point: Point, damping: _Damping) -> SolverStatus:
    """Return the status: a minimum if no step promises a decrease, or only steps suppressed by damping."""
    least = damping.value == 0.0 or point.step(0.0)[1] < NEAR
    return SolverStatus.CONVERGED if least else SolverStatus.STALLED


def _has_stalled(promise: float, before: float) -> bool:
    """True if the predicted decrease, compared with the one before, is too small to continue."""
    return promise < _SETTLED or before / 2 < promise < NEAR


def _lower_point(point: Point, step: NDArray, promise: float, damping: float) -> Point | None:
    """Return a lower point at the end of a step, straight or bent, or None."""
    straight = point.objective.trial(point, step, promise)
    if straight is None or straight.cost < point.cost or (promise < NEAR and damping == 0.0):
        return straight
    bend = point.second_order_correction(straight, step, damping)
    bent = None if bend is None else point.objective.trial(point, step + bend, promise)
    return bent if bent is not None and bent.cost < point.cost else None


def column_scale(information: NDArray) -> NDArray:
    """Return factors that scale the diagonal of an information (P, P) to one; one for unknown values."""
    root = np.sqrt(np.diagonal(information))
    return np.where(root > 0, root, 1.0)
