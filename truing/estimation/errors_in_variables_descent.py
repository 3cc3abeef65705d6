"""Descent of an eliminated implicit model to the maximum of its likelihood and prior, with given weights of poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.errors_in_variables_elimination import Eliminated, Measured, project
from truing.estimation.least_squares import SolverStatus

MAX_ITERATIONS = 100
# By how much the next step would still lower the cost: nothing moves by more than a millionth of its sigma.
_SETTLED = 1e-12
# Below this the cost is no judge any more, for its own rounding; what stalls here stands as well as numbers allow.
NEAR = 1e-6
# Share of a step's promise by which the deviations may be unsettled when it is judged.
_JUDGED = 1e-3
# Damping that rounding alone would need where nothing is known of some combination of values.
_LEAST_DAMPING = 1e-13
_FIRST_DAMPING, _HOPELESS = 1e-3, 1e12


@dataclass(frozen=True)
class Prior:
    """What is known of the values before: mean (P,), information (P, P), the inverse of their covariance.

    A row and column of zeros says that nothing is known.
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
class Descent:
    """Where the descent ended."""

    at: Eliminated
    cost: float
    iterations: int
    status: SolverStatus


@dataclass(frozen=True)
class _Normal:
    """Normal equations in columns of unit length: ``curvature step = -slope``."""

    curvature: NDArray
    slope: NDArray
    scale: NDArray

    def step(self, damping: float) -> tuple[NDArray, float]:
        """Return the damped step (P,) of the values and by how much it promises to lower the cost."""
        damped = self.curvature + max(damping, _LEAST_DAMPING) * np.eye(len(self.slope))
        step = -np.linalg.solve(damped, self.slope)
        return step / self.scale, float(-step @ (2 * self.slope + self.curvature @ step))


def descend(measured: Measured, values: NDArray, pull: NDArray, prior: Prior, weight: NDArray) -> Descent:
    """Return the least of ``sum weight d' C^+ d + prior`` near values (P,) and the deviations of a pull (B, n).

    Levenberg-Marquardt: at every trial the deviations are first brought to where they belong, so that costs compare.
    """
    at = project(measured, values, pull, weight, NEAR)
    cost, normal = _cost(at, prior, weight), _normal(at, prior, weight)
    if not np.isfinite(cost):
        return Descent(at, cost, 0, SolverStatus.NOT_FINITE)
    damping, before = 0.0, np.inf
    for iteration in range(MAX_ITERATIONS):
        step, promise = normal.step(damping)
        if damping == 0.0 and _stands(promise, before):
            return Descent(at, cost, iteration, SolverStatus.CONVERGED)
        trial = _trial(measured, at, step, weight, promise)
        reached = np.inf if trial is None else _cost(trial, prior, weight)
        if trial is not None and (reached < cost or (promise < NEAR and np.isfinite(reached))):
            at, cost, before = trial, reached, promise
            normal = _normal(at, prior, weight)
            damping = damping / 10 if damping > _FIRST_DAMPING else 0.0
        elif damping > _HOPELESS:
            return Descent(at, cost, iteration, SolverStatus.STALLED)
        else:
            damping = max(10 * damping, _FIRST_DAMPING)
    return Descent(at, cost, MAX_ITERATIONS, SolverStatus.ITERATION_LIMIT)


def _stands(promise: float, before: float) -> bool:
    """Return whether a full step that promises so little, after one that promised so much, is not worth taking."""
    return promise < _SETTLED or before / 2 < promise < NEAR


def _trial(measured: Measured, at: Eliminated, step: NDArray, weight: NDArray, promise: float) -> Eliminated | None:
    """Return the model after a step, or None where its deviations do not settle well enough to judge it."""
    allowed = max(_JUDGED * promise, _SETTLED)
    try:
        trial = project(measured, at.values + step, at.pull_after(step), weight, allowed)
    except np.linalg.LinAlgError:
        return None
    return trial if weight @ trial.unsettled <= max(allowed, NEAR) else None


def _cost(at: Eliminated, prior: Prior, weight: NDArray) -> float:
    return float(weight @ at.chi_square + prior.cost(at.values))


def _normal(at: Eliminated, prior: Prior, weight: NDArray) -> _Normal:
    information, slope = weighted_normal(at, weight)
    information, slope = information + prior.information, slope + prior.pull(at.values)
    scale = column_scale(information)
    return _Normal(information / np.outer(scale, scale), slope / scale, scale)


def weighted_normal(at: Eliminated, weight: NDArray) -> tuple[NDArray, NDArray]:
    """Return the information (P, P) of the data and half the gradient (P,) of their cost, weight (B,)."""
    size = at.jacobian.shape[-1]
    rows = (np.sqrt(weight)[:, None, None] * at.jacobian).reshape(-1, size)
    residual = (np.sqrt(weight)[:, None] * at.residual).ravel()
    return rows.T @ rows, rows.T @ residual


def column_scale(information: NDArray) -> NDArray:
    """Return what makes the diagonal of an information (P, P) one; one for values of which nothing is known."""
    root = np.sqrt(np.diagonal(information))
    return np.where(root > 0, root, 1.0)
