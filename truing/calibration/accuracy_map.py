"""Accuracy of the pose from the accuracy of the actuators, over the limits of a machine's workspace."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from truing.calibration.configuration_search import DesignProblem
from truing.simulation.mechanisms.actuator_errors import QUANTITIES, ActuatorErrors, actuator_errors
from truing.simulation.mechanisms.pose_regressors import Placed

_INSIDE = 2000  # points spread over the region, in addition to its corners
_GRID = 21  # points along each side of a section
_SECTIONS = (*combinations(range(3), 2), *combinations(range(3, 6), 2))  # pairs of displacements, of rotations
_ROUNDS, _TRIES, _SHRINK = 25, 40, 0.75  # of a climb: steps, points of each, and their spread from one to the next
_FIRST_SPREAD = 0.5  # in coordinates of the region, where limits are about 1 away


@dataclass(frozen=True)
class AccuracyMap:
    """Errors of B configurations by actuators, the reference pose first.

    moved (B, 6): displacement from the reference pose, m and rad; part (B,): reference, corner, inside, climbed, or
    the two components of a section through the reference pose, such as ``x y``; accuracy (L,), m: +- of each actuator.
    """

    placed: Placed
    moved: NDArray
    part: tuple[str, ...]
    errors: ActuatorErrors
    accuracy: NDArray
    unreached: int

    @property
    def worst(self) -> NDArray:
        """Indices (8,) of the configurations with the largest error of each of QUANTITIES."""
        return np.asarray(np.argmax(self.errors.worst, 0))

    def count(self, part: str) -> int:
        """Number of configurations of a part."""
        return self.part.count(part)


def accuracy_map(problem: DesignProblem, accuracy: NDArray, rng: np.random.Generator) -> AccuracyMap:
    """Return the errors at the reference, the corners, points in between, sections, and where climbs from them end.

    accuracy (L,), m. Raises ValueError if forbidden regions leave no candidate, and as `actuator_errors`.
    """
    corners, inside = problem.region.corners(), problem.region.draw(_INSIDE, rng)
    groups = {"reference": np.zeros((1, 6)), "corner": corners, "inside": inside}
    x = np.concatenate(list(groups.values()))
    is_reached = problem.reached(x)
    part = [name for name, group in groups.items() for _ in group]
    errors = _errors_at(problem, accuracy)
    worst = errors(x[is_reached]).worst
    ends = _climbed(problem, errors, x[is_reached][np.argmax(worst, 0)], worst.max(0), rng)
    sections = _sections(problem, corners)
    poses = np.concatenate([x[is_reached], ends, *sections.values()])
    names = [name for name, keep in zip(part, is_reached, strict=True) if keep] + ["climbed"] * len(ends)
    names += [name for name, group in sections.items() for _ in group]
    placed = problem.regressors.at(poses)
    moved = poses @ problem.regressors.scale.T
    return AccuracyMap(placed, moved, tuple(names), errors(poses), accuracy, int(np.sum(~is_reached)))


def _errors_at(problem: DesignProblem, accuracy: NDArray) -> Callable[[NDArray], ActuatorErrors]:
    regressors = problem.regressors

    def at(x: NDArray) -> ActuatorErrors:
        return actuator_errors(regressors.structure, regressors.machine, regressors.at(x), accuracy)

    return at


def _climbed(
    problem: DesignProblem,
    errors: Callable[[NDArray], ActuatorErrors],
    start: NDArray,
    value: NDArray,
    rng: np.random.Generator,
) -> NDArray:
    """Return coordinates (Q, 6) near start (Q, 6) with errors larger than value (Q,), one row for each of QUANTITIES.

    Each climbs by random steps, of falling size once none of them helps.
    """
    count, size = start.shape
    rows = np.arange(count)
    best, value, spread = start.copy(), value.copy(), np.full(count, _FIRST_SPREAD)
    for _ in range(_ROUNDS):
        steps = spread[:, None, None] * rng.normal(size=(count, _TRIES, size))
        tries = problem.region.pulled_in((best[:, None] + steps).reshape(-1, size))
        sizes = errors(tries).worst.reshape(count, _TRIES, count)[rows, :, rows]
        sizes = np.where(problem.region.allowed(tries).reshape(count, _TRIES), sizes, 0.0)
        first = np.argmax(sizes, -1)
        top = tries.reshape(count, _TRIES, size)[rows, first]
        better = (sizes[rows, first] > value) & problem.reached(top)
        best, value = np.where(better[:, None], top, best), np.where(better, sizes[rows, first], value)
        spread = np.where(better, spread, _SHRINK * spread)
    return best


def _sections(problem: DesignProblem, corners: NDArray) -> dict[str, NDArray]:
    """Return the coordinates of a grid over each pair of displacements, the others zero, within the limits."""
    scale = problem.regressors.scale
    reach = np.abs(corners @ scale.T).max(0)
    steps = np.linspace(-1.0, 1.0, _GRID)
    sections = {}
    for first, second in _SECTIONS:
        moved = np.zeros((_GRID, _GRID, 6))
        moved[..., first], moved[..., second] = reach[first] * steps[:, None], reach[second] * steps
        x = np.linalg.solve(scale, moved.reshape(-1, 6).T).T
        x = x[problem.region.within(x) & problem.region.allowed(x)]
        sections[f"{QUANTITIES[first]} {QUANTITIES[second]}"] = x[problem.reached(x)]
    return sections
