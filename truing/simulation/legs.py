"""The legs of a parallel mechanism: geometry as arrays, and the closure that says what a leg constrains."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray


class Closure(Protocol):
    """What distinguishes one kind of leg from another; every function takes any batch shape, real or complex."""

    name: str

    def lower(self, legs: Legs, rho: NDArray) -> NDArray:
        """Return the lower joints (..., L, 3), base frame, m, at readings rho (..., L)."""

    def length(self, legs: Legs, rho: NDArray) -> NDArray:
        """Return the distances (..., L), m, between lower and upper joint."""

    def invert(self, legs: Legs, h: NDArray) -> NDArray:
        """Return the readings (..., L) for h = p + R b* - a (..., L, 3)."""

    def lower_change(self, legs: Legs, rho: NDArray, change: Change) -> NDArray:
        """Return the derivative (..., L, 3, P) of `lower` by the P parameters of a change."""

    def length_change(self, legs: Legs, change: Change) -> NDArray:
        """Return the derivative (..., L, P) of `length` by the P parameters of a change."""


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


@dataclass(frozen=True)
class Change:
    """Derivatives of the state by P parameters, field by field; a field that does not change is absent.

    Values: (..., L, 3, P) for a, b, u; (..., L, P) for rho, indicated, l, delta_bz. Leading axes are poses, or
    broadcast against them.
    """

    fields: dict[str, NDArray]
    size: int

    def get(self, name: str, shape: tuple[int, ...]) -> NDArray:
        """Return a field's derivative, or zeros of the shape that it would have."""
        found = self.fields.get(name)
        return np.zeros((*shape, self.size)) if found is None else found
