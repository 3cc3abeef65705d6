"""How sure a candidate is: against what the same search finds where there is nothing.

Each kind of cause is judged by its own best candidate; the statistic is the smallest p-value over kinds, each
multiplied by what its choice among candidates costs and divided by its share of the budget.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from truing.estimation.diagnosis.noise_components import NoiseComponents

# What choosing among candidates costs is told from this quantile of the null distribution.
_QUANTILE = 0.02
# Below this share of the draws, p-values are extrapolated from it.
_TAIL = 0.01
# No noise is known to be so normal that smaller p-values would mean anything.
LEAST_P = 1e-9


@dataclass(frozen=True)
class Group:
    """Candidates of one kind with the same number of directions: comparable by their squares alone."""

    kind: str
    rank: int
    reading_share: float


@dataclass(frozen=True)
class Judge:
    """The null distribution of a search: ``drawn`` and ``flipped`` (draws, kinds) hold the smallest p of every kind on
    simulated and on sign-flipped residuals; ``shares`` (by kind) are the parts of the budget of false alarms."""

    groups: tuple[Group, ...]
    noise: NoiseComponents
    shares: dict[str, float]
    drawn: NDArray
    flipped: NDArray

    @cached_property
    def kinds(self) -> tuple[str, ...]:
        """Return the kinds of cause of which the campaign could see any."""
        return kinds_of(self.groups)

    def raw(self, squares: NDArray | float, group: Group, noise: NDArray | float) -> NDArray:
        """Return the F test's p of squares (...) of a group, at a level of the noise estimated without them."""
        return f_test(squares, group, noise, self.noise)

    @cached_property
    def cost(self) -> NDArray:
        """Return what the choice among its candidates costs each kind, over its share of the budget, (kinds,)."""
        quantile = (
            np.quantile(self.drawn, _QUANTILE, axis=0) if len(self.drawn) else np.full(len(self.kinds), _QUANTILE)
        )
        whole = sum(self.shares[kind] for kind in self.kinds)
        return np.array([_QUANTILE / q for q in quantile]) * [whole / self.shares[kind] for kind in self.kinds]

    @cached_property
    def _minima(self) -> tuple[NDArray, NDArray]:
        return np.min(self.drawn * self.cost, 1), np.min(self.flipped * self.cost, 1)

    def corrected(self, squares: float, group: Group) -> float:
        """Return the p-value of a candidate's squares: how often a search of everything finds as much by chance."""
        noise = self.noise.without(squares, group.rank, group.reading_share)
        statistic = float(self.raw(squares, group, noise) * self.cost[self.kinds.index(group.kind)])
        return min(1.0, max(_share(minima, statistic) for minima in self._minima))

    def group_of(self, kind: str, rank: int) -> Group:
        """Return the group of a kind's candidates with so many directions."""
        return next(group for group in self.groups if group.kind == kind and group.rank == rank)

    def threshold(self, group: Group, level: float) -> float:
        """Return the p, not corrected, that a candidate of the group must stay below for a p-value of level."""
        limits = [float(np.quantile(minima, level)) for minima in self._minima]
        return min(limits) / float(self.cost[self.kinds.index(group.kind)])


def kinds_of(groups: Sequence[Group]) -> tuple[str, ...]:
    """Return the kinds of some groups, each once."""
    return tuple(dict.fromkeys(group.kind for group in groups))


def f_test(squares: NDArray | float, group: Group, noise: NDArray | float, components: NoiseComponents) -> NDArray:
    """Return the F test's p of squares (...) of a group's candidates, at a level of the noise."""
    from scipy.special import fdtrc

    freedom = components.freedom(group.reading_share)
    return np.asarray(fdtrc(group.rank, max(freedom - group.rank, 1.0), np.asarray(squares) / group.rank / noise))


def _share(minima: NDArray, statistic: float) -> float:
    """Return how often a null search finds as much; beyond what was drawn, in proportion to the statistic.

    It is a p-value up to what correlations between candidates and tails of the noise make of it, which the lowest
    drawn quantile shows.
    """
    drawn = float((1 + np.sum(minima <= statistic)) / (1 + len(minima)))
    if drawn > _TAIL:
        return drawn
    extrapolated = statistic * max(_TAIL / float(np.quantile(minima, _TAIL)), 1.0)
    return max(min(drawn, extrapolated), LEAST_P)
