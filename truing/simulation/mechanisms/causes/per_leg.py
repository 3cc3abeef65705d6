"""Base classes `PerLeg` and `SharedOrPerLeg`: causes with the same parameters for each leg, on all legs or some."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import comb
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Parameter
from truing.simulation.mechanisms.point_causes import PointCause, PointScene

# Prior probability that a cause concerns all legs; one, two or three of them; any other number.
_ALL, _SOME, _OTHER = 0.36, (0.36, 0.21, 0.05), 0.02
# Legs are removed if that is more probable by this factor (log).
_CLEARLY = np.log(20.0)
# With more legs than this, sets of more than two legs are not tried: there are too many.
_MOST_LEGS = 8


@dataclass(frozen=True)
class PerLeg(PointCause):
    """A cause that concerns ``legs``, counted from 1; all legs of the mechanism if empty."""

    legs: tuple[int, ...] = ()

    @property
    def subject(self) -> str:
        """Legs as the tables name them; empty for all."""
        return " ".join(f"leg{leg}" for leg in self.legs)

    @property
    def concerns_several(self) -> bool:
        """True for several single legs."""
        return len(self.legs) > 1

    def leg_numbers(self, legs: int) -> tuple[int, ...]:
        """Return the numbers of the legs concerned, counted from 1, in a mechanism with ``legs`` legs."""
        return self.legs or tuple(range(1, legs + 1))

    def numbered(self, name: str, legs: int) -> tuple[str, ...]:
        """Return the name of a parameter for each leg concerned, with the leg as suffix."""
        return tuple(f"{name}_{leg}" for leg in self.leg_numbers(legs))

    def spread(self, values: NDArray) -> NDArray:
        """Return values (..., L) of each leg as derivatives (..., L, P) by one parameter per leg concerned."""
        legs = values.shape[-1]
        return values[..., None] * np.eye(legs)[:, np.array(self.leg_numbers(legs)) - 1]

    def like_sized(self, legs: int) -> tuple[int, ...]:
        """Return the parameters of the legs concerned; if each leg has several, the last ones."""
        count = len(self.parameters(legs))
        return tuple(range(count - len(self.leg_numbers(legs)), count))

    def excludes(self, other: PointCause) -> bool:
        """True if the other cause is of the same kind and shares a leg with this one."""
        if self.id != other.id or not isinstance(other, PerLeg):
            return False
        return not self.legs or not other.legs or bool(set(self.legs) & set(other.legs))

    def narrowed(self, values: NDArray, covariance: NDArray, legs: int) -> Self:
        """Return the cause without the legs of zero effect, if that is clearly more probable."""
        leg_of = np.array([int(parameter.name.rpartition("_")[2]) for parameter in self.parameters(legs)])
        scale = np.array([parameter.scale for parameter in self.parameters(legs)])
        fitted = values / scale, covariance / np.outer(scale, scale)
        return replace(self, legs=legs_with_effect(*fitted, leg_of, self.legs, legs))

    def candidates(self, scene: PointScene) -> Sequence[PerLeg]:
        """Return the cause for all legs and for every choice of some."""
        return [replace(self, legs=chosen) for chosen in choices(scene.legs)]

    def prior(self, scene: PointScene) -> float:
        """Return the share of this choice of legs: all, a single one or a pair are more probable than others."""
        return choice_share(len(self.legs), scene.legs)


# Prior probability of all legs alike, one leg, two legs.
_SHARE_OF_LEGS = (0.6, 0.25, 0.15)


@dataclass(frozen=True)
class SharedOrPerLeg(PerLeg):
    """A cause with one ``parameter`` common to all legs, or with a separate one for each of ``legs``."""

    parameter: ClassVar[Parameter]

    def candidates(self, scene: PointScene) -> Sequence[Self]:
        """Return one candidate for all legs together, every single leg and every pair."""
        return [replace(self, legs=chosen) for chosen in self._leg_choices(scene)]

    def prior(self, scene: PointScene) -> float:
        """Return the share of this choice of legs: all together are more probable than a single one, a single one than
        a pair."""
        sizes = [len(chosen) for chosen in self._leg_choices(scene)]
        offered = sum(_SHARE_OF_LEGS[size] for size in set(sizes))
        return _SHARE_OF_LEGS[len(self.legs)] / offered / sizes.count(len(self.legs))

    def like_sized(self, legs: int) -> tuple[int, ...]:
        """Return the parameters of the legs, if each has its own."""
        return super().like_sized(legs) if self.legs else ()

    def narrowed(self, values: NDArray, covariance: NDArray, legs: int) -> Self:
        """Return the cause without legs of zero effect; unchanged for all legs together."""
        return super().narrowed(values, covariance, legs) if self.legs else self

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the common parameter, or that of each leg concerned."""
        names = self.numbered(self.parameter.name, legs) if self.legs else (self.parameter.name,)
        return tuple(replace(self.parameter, name=name) for name in names)

    def of_legs(self, values: NDArray) -> NDArray:
        """Return values (..., L) of each leg as derivatives (..., L, P) by the parameters."""
        return self.spread(values) if self.legs else values[..., None]

    def _leg_choices(self, scene: PointScene) -> list[tuple[int, ...]]:
        """Return the choices of legs: all of them (empty), single ones, pairs."""
        return choices(scene.legs, len(_SHARE_OF_LEGS) - 1)


def legs_with_effect(
    values: NDArray, covariance: NDArray, leg_of: NDArray, concerned: tuple[int, ...], legs: int
) -> tuple[int, ...]:
    """Return the legs whose amplitudes (P,) differ from zero, if that is clearly more probable than all ``concerned``.

    ``leg_of`` (P,): leg of each amplitude, from 1; legs: number of all legs, which an empty tuple stands for. A leg
    with an effect is expected to have one of the same size as the others. Amplitudes that no data determine (a
    covariance of zeros, as of a cause that these data cannot test) leave all ``concerned``.
    """
    if not np.any(covariance):
        return concerned
    odds = {}
    for legs_kept in choices(legs)[1:]:
        if set(legs_kept) < set(concerned or range(1, legs + 1)):
            out = ~np.isin(leg_of, legs_kept)
            shares = choice_share(len(legs_kept), legs), choice_share(len(concerned), legs)
            size = max(float(np.sqrt(np.mean(values[~out] ** 2))), 1e-300)
            log_odds = _log_odds_of_zero(values[out], covariance[np.ix_(out, out)], size)
            odds[legs_kept] = log_odds + np.log(shares[0] / shares[1])
    best = max(odds, key=lambda legs_kept: odds[legs_kept], default=None)
    return concerned if best is None or odds[best] <= _CLEARLY else best


def _log_odds_of_zero(values: NDArray, covariance: NDArray, size: float) -> float:
    """Return the log odds that values (n,) with covariance (n, n) are all zero rather than drawn from N(0, size^2).

    This is the ratio of the densities at zero with and without the data (Savage and Dickey).
    """
    _, log_det = np.linalg.slogdet(covariance)
    return float(len(values) * np.log(size) - (log_det + values @ np.linalg.solve(covariance, values)) / 2.0)


def choices(legs: int, most: int | None = None) -> list[tuple[int, ...]]:
    """Return choices of legs, counted from 1: all (empty) first, then one, two, ... of them, at most ``most``."""
    limit = (legs - 1 if legs <= _MOST_LEGS else 2) if most is None else most
    some = [chosen for size in range(1, min(limit, legs - 1) + 1) for chosen in combinations(range(1, legs + 1), size)]
    return [(), *some]


def choice_share(chosen: int, legs: int) -> float:
    """Return the prior probability of one choice of ``chosen`` legs; 0 means all legs."""
    larger = range(len(_SOME) + 1, legs)
    possible = _ALL + sum(_SOME[: legs - 1]) + (_OTHER if larger else 0.0)
    if chosen == 0:
        return _ALL / possible
    if chosen <= len(_SOME):
        return _SOME[chosen - 1] / possible / comb(legs, chosen)
    return _OTHER / possible / sum(comb(legs, size) for size in larger)
