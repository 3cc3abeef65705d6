"""What a choice of configurations is judged by: region, regressors in tolerances and noise, limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.design.feasible_region import FeasibleRegion
from truing.estimation.design.identifiable_set import choose_identifiable
from truing.simulation.mechanisms.parameters import Parameter
from truing.simulation.mechanisms.pose_regressors import Placed, PoseRegressors
from truing.simulation.mechanisms.structures.structure import poses_at

_SAME = 1e-7  # m and rad
# Parameters are told apart where no combination of their unit columns is shorter than this. Rank, not noise, is asked
# for, as in the report: its seven reach 1e-3 and more on the telescope, a_z or b_z beside them 4e-5 at most.
_TOLD_APART = 2e-4
_BETWEEN = 50  # points, in case that all corners are forbidden
# The report's seven (section 6.3.1); others only enter where these leave room.
_REPORTED = ("a_x", "a_y", "b_x", "b_y", "u_x", "u_y", "u_z", "l")


@dataclass(frozen=True)
class DesignProblem:
    """What configurations are judged by; rows are in tolerances of the parameters and noise of the residual.

    names (q,) with unit and SI; tolerance (q,) SI; noise (L,) m: one sigma of a leg's residual; noise_from, in words;
    held: parameters of a leg that are not told apart from those, or were not asked for.
    """

    regressors: PoseRegressors
    region: FeasibleRegion
    names: tuple[Parameter, ...]
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
class Limits:
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
