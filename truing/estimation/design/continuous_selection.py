"""Configurations anywhere between limits: all of them moved at once along the exact gradient (report, Figure 13).

Spectral projected gradient (Birgin, Martínez and Raydan, SIAM J. Optim. 10 (2000) 1196) in a `FeasibleRegion`, whose
limits are linearised anew at every step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.design.design_bound import DesignBound, sum_log_det
from truing.estimation.design.feasible_region import FeasibleRegion
from truing.estimation.design.pose_selection import SelectionStatus, information_of

# x (N, n) -> rows (N, L, q) and their derivative (N, L, q, n)
RowsAt = Callable[[NDArray], tuple[NDArray, NDArray]]
# x (N, n) -> a number for all of them, and its gradient (N, n)
Objective = Callable[[NDArray], tuple[float, NDArray]]

_MEMORY = 8  # values that a step may fall behind, without which the spectral step lengths are wasted
_SUFFICIENT = 1e-4
_SHORTEST = 1e-8
_FARTHEST = 3.0  # that a step may aim beyond the limits, which are about 1 away: more only slows the projection
_HALVINGS = 12  # a shorter move is none, beside the spectral length
_STILL = 1e-6  # a move of the coordinates, whose limits are about 1 away, that counts as none
_GAIN = 1e-7  # of the value, over the memory, that counts as none


@dataclass(frozen=True)
class Climb:
    """Where a climb ended: points (N, n) within the region, the objective there, and how it ended."""

    x: NDArray
    value: float
    status: SelectionStatus
    iterations: int


def optimise_directly(
    region: FeasibleRegion, rows_at: RowsAt, start: NDArray, given: NDArray | None = None, max_iterations: int = 1000
) -> Climb:
    """Return N configurations that no small move within the region improves, from a start (N, n) in it.

    Maximises sum_l log det A_l, given (L, q, q) being what is known already. Raises ValueError where the start does not
    determine every leg.
    """

    def objective(x: NDArray) -> tuple[float, NDArray]:
        rows, changes = rows_at(x)
        information = information_of(rows, given)
        value = sum_log_det(information)
        if not np.isfinite(value):
            return -np.inf, np.zeros_like(x)
        return value, 2.0 * np.einsum("nlq,nlqi->ni", _solved(rows, information), changes)

    if not np.isfinite(objective(start)[0]):
        raise ValueError(f"a start of {len(start)} configurations that determines every parameter")
    return climb(region, objective, start, max_iterations)


def largest_sensitivity(
    region: FeasibleRegion, rows_at: RowsAt, design: DesignBound, start: NDArray, max_iterations: int = 40
) -> Climb:
    """Return the most sensitive points that climbs from a start (N, n) reach; value: the sensitivity of the best.

    What a set of candidates leaves out between them shows here: `DesignBound.with_sensitivity` turns it into a bound.
    """

    def each(x: NDArray) -> tuple[NDArray, NDArray]:
        rows, changes = rows_at(x)
        solved = _solved(rows, design.information)
        gradient = 2.0 * design.count * np.einsum("nlq,nlqi->ni", solved, changes)
        return design.count * np.sum(rows * solved, (1, 2)), gradient

    def objective(x: NDArray) -> tuple[float, NDArray]:
        value, gradient = each(x)
        return float(value.sum()), gradient

    found = climb(region, objective, start, max_iterations)
    return Climb(found.x, float(each(found.x)[0].max()), found.status, found.iterations)


def _solved(rows: NDArray, information: NDArray) -> NDArray:
    """Return A_l^-1 r_nl (N, L, q)."""
    return np.einsum("lqr,nlr->nlq", np.linalg.inv(information), rows)


def climb(region: FeasibleRegion, objective: Objective, start: NDArray, max_iterations: int) -> Climb:
    """Return where the objective no longer grows from a start (N, n) within the region."""
    x, status = start, SelectionStatus.ITERATION_LIMIT
    value, gradient = objective(x)
    length, past, best = np.inf, [value], (x, value)
    while len(past) <= max_iterations:
        steepest = max(float(np.abs(gradient).max()), 1e-300)
        move = region.project(x + min(length, _FARTHEST / steepest) * gradient, x) - x
        trial, reached, slope = _step(region, objective, x, move, gradient, min(past[-_MEMORY:]))
        if trial is None or np.abs(move).max() <= _STILL or _settled(past):
            status = SelectionStatus.CONVERGED
            break
        length = _spectral_length(trial - x, slope - gradient)
        x, value, gradient = trial, reached, slope
        past.append(value)
        best = (x, value) if value > best[1] else best
    inside = region.pulled_in(best[0])
    return Climb(inside, objective(inside)[0], status, len(past) - 1)


def _settled(past: list[float]) -> bool:
    """Return whether the best value has hardly grown over as many steps as may fall behind."""
    if len(past) <= 2 * _MEMORY:
        return False
    return max(past[-_MEMORY:]) - max(past[:-_MEMORY]) <= _GAIN * max(1.0, abs(past[-1]))


def _step(
    region: FeasibleRegion, objective: Objective, x: NDArray, move: NDArray, gradient: NDArray, least: float
) -> tuple[NDArray | None, float, NDArray]:
    """Return the first point of halved moves that is good enough; a point whose move ends in a forbidden box stays."""
    rise, share = float(np.sum(gradient * move)), 1.0
    for _ in range(_HALVINGS):
        trial = region.pulled_in(x + share * move)
        trial = np.where(region.allowed(trial)[:, None], trial, x)
        value, slope = objective(trial)
        if value >= least + _SUFFICIENT * share * rise and np.any(trial != x):
            return trial, value, slope
        share /= 2.0
    return None, least, gradient


def _spectral_length(moved: NDArray, turned: NDArray) -> float:
    """Return the step length that fits the last change of the gradient; without end where it grew along the move."""
    bend = -float(np.sum(moved * turned))
    return np.inf if bend <= 0 else max(float(np.sum(moved**2)) / bend, _SHORTEST)
