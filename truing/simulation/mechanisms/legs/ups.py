"""Closure of a leg of variable length, the ordinary hexapod: |p + R b - a| = l + rho."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.simulation.change import Change
from truing.simulation.mechanisms.legs.geometry import Closure, Legs


class Ups(Closure):
    """UPS: the lower joint stands still, the actuator changes the leg's length."""

    name = "ups"
    geometry = ("a", "b", "l")

    def lower(self, legs: Legs, rho: NDArray) -> NDArray:
        """Return a, (..., L, 3) m."""
        return legs.a + 0.0 * rho[..., None]

    def length(self, legs: Legs, rho: NDArray) -> NDArray:
        """Return l + rho, (..., L) m."""
        return legs.l + rho

    def invert(self, legs: Legs, h: NDArray) -> NDArray:
        """Return rho = |h| - l, (..., L) m."""
        return np.sqrt(np.sum(h * h, -1)) - legs.l

    def lower_change(self, legs: Legs, rho: NDArray, change: Change) -> NDArray:
        """Return da, (..., L, 3, P)."""
        return change.get("a", (legs.count, 3))

    def length_change(self, legs: Legs, change: Change) -> NDArray:
        """Return dl + drho, (..., L, P)."""
        return change.get("l", (legs.count,)) + change.get("rho", (legs.count,))
