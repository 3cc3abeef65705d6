"""How many different minima the fits from many starts have found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.least_squares.solver import Solution

# Two ends are one minimum if moving from one to the other changes the residuals by no more than this share of them,
_SAME_RESIDUAL = 1e-3
# or than this share of what the parameters do to the residuals altogether (for residuals that vanish).
_SAME_EFFECT = 1e-8


@dataclass(frozen=True)
class Minima:
    """Different minima of one problem, the lowest first."""

    x: NDArray  # (M, P)
    cost: NDArray  # (M,)
    reached: NDArray  # (M,) how many starts led there
    failed: int  # how many starts did not end at a minimum

    @property
    def agree(self) -> bool:
        """Return whether every start led to one and the same minimum."""
        return len(self.x) == 1 and self.failed == 0


def distinct_minima(solution: Solution) -> Minima:
    """Return the different minima among fits of one and the same problem from many starts.

    Ends are told apart in the residuals' own measure: by the part of the residual, ``|J (x1 - x2)|``, that lies between
    them. Only fits that are ``ok`` count as minima.
    """
    order = np.argsort(solution.cost, kind="stable")
    order = order[solution.ok[order]]
    lowest: list[int] = []
    reached: list[int] = []
    while len(order):
        same = _same(solution, int(order[0]), order)
        lowest.append(int(order[0]))
        reached.append(int(same.sum()))
        order = order[~same]
    failed = int(np.sum(~solution.ok))
    return Minima(solution.x[lowest], solution.cost[lowest], np.array(reached, np.int64), failed)


def _same(solution: Solution, one: int, others: NDArray) -> NDArray:
    """Return which of the others (n,) are at the same minimum as one of the fits."""
    normal = np.linalg.inv(solution.covariance[one])
    gap = solution.x[others] - solution.x[one]
    distance = np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", gap, normal, gap), 0.0))
    effect = np.sqrt(np.sum(np.diag(normal) * solution.x[one] ** 2))
    same = distance <= _SAME_RESIDUAL * np.sqrt(solution.cost[one]) + _SAME_EFFECT * effect
    return same | (others == one)
