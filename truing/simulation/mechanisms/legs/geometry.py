"""The legs of a parallel mechanism: geometry as arrays, and the closure that says what a leg constrains."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.simulation.change import Change


class Closure:
    """What distinguishes one kind of leg from another; every function takes any batch shape, real or complex.

    The own kinds are straight between two joints and say where the lower one is and how far away the upper one; `close`
    follows. A kind that is not (a cable over a pulley, whose lower end depends on the upper) says `close` and
    `close_change` itself, and lets `lower` and `length` be those of a straight leg near it, from which Newton starts.
    """

    name: str
    geometry: tuple[str, ...] = ("a", "b", "u", "l")  # the arrays of `Legs` that the closure depends on
    one_body: bool = False  # whether a leg is rigid from joint to joint

    def lower(self, legs: Legs, rho: NDArray) -> NDArray:
        """Return the lower joints (..., L, 3), base frame, m, at readings rho (..., L)."""
        raise NotImplementedError

    def length(self, legs: Legs, rho: NDArray) -> NDArray:
        """Return the distances (..., L), m, between lower and upper joint."""
        raise NotImplementedError

    def invert(self, legs: Legs, h: NDArray) -> NDArray:
        """Return the readings (..., L) for h = p + R b* - a (..., L, 3), NaN where there is none."""
        raise NotImplementedError

    def lower_change(self, legs: Legs, rho: NDArray, change: Change) -> NDArray:
        """Return the derivative (..., L, 3, P) of `lower` by the P parameters of a change."""
        raise NotImplementedError

    def length_change(self, legs: Legs, change: Change) -> NDArray:
        """Return the derivative (..., L, P) of `length` by the P parameters of a change."""
        raise NotImplementedError

    def close(self, legs: Legs, upper: NDArray, rho: NDArray) -> tuple[NDArray, NDArray]:
        """Return how far legs are from meeting the platform's joints, and its gradient by those.

        upper (..., L, 3): the joints in the base frame, m. The first is (..., L) m, too long positive; the second
        (..., L, 3): for a straight leg length - |g| and -z, its direction (telescope report, eq. 5 and 30).
        """
        g = upper - self.lower(legs, rho)
        distance = np.sqrt(np.einsum("...i,...i->...", g, g))
        return self.length(legs, rho) - distance, -g / distance[..., None]

    def close_change(self, legs: Legs, upper: NDArray, rho: NDArray, change: Change) -> NDArray:
        """Return the derivative (..., L, P) of `close` by the P parameters of a change, upper joints held."""
        towards = self.close(legs, upper, rho)[1]
        lower = self.lower_change(legs, rho, change)
        return self.length_change(legs, change) - np.einsum("...li,...lip->...lp", towards, lower)


@dataclass(frozen=True)
class Legs:
    """Geometry of L legs, each array with any leading batch; m, unit vectors.

    a: actuator's zero on the base (..., L, 3), base frame; b: joint on the platform (..., L, 3), platform frame;
    u: unit direction of the actuator (..., L, 3), base frame; l: length (..., L); rho0: reference reading (..., L).
    """

    a: NDArray
    b: NDArray
    u: NDArray
    l: NDArray  # noqa: E741 (the papers' symbol)
    rho0: NDArray
    closure: Closure

    @property
    def count(self) -> int:
        """Return the number of legs L."""
        return self.b.shape[-2]

    def replace(self, **arrays: Any) -> Legs:
        """Return a copy with some arrays exchanged."""
        return replace(self, **arrays)
