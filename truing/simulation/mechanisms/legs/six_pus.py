"""Closure of a leg of fixed length on a linear actuator: p + R b = a + rho u + l z, |z| = 1."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.simulation.change import Change
from truing.simulation.mechanisms.legs.geometry import Closure, Legs


class SixPus(Closure):
    """6-PUS: the actuator moves the lower joint along u, the leg keeps its length (telescope report, eq. 5)."""

    name = "6-pus"
    one_body = True

    def lower(self, legs: Legs, rho: NDArray) -> NDArray:
        """Return c = a + rho u, (..., L, 3) m."""
        return legs.a + rho[..., None] * legs.u

    def length(self, legs: Legs, rho: NDArray) -> NDArray:
        """Return l, (..., L) m."""
        return legs.l + 0.0 * rho

    def invert(self, legs: Legs, h: NDArray) -> NDArray:
        """Return the reading of the root with z u > 0, platform ahead of actuators (eq. 7); NaN out of reach."""
        along = np.sum(h * legs.u, -1)
        square = along**2 - np.sum(h * h, -1) + legs.l**2
        return along - np.sqrt(np.where(square.real < 0.0, np.nan, square))

    def lower_change(self, legs: Legs, rho: NDArray, change: Change) -> NDArray:
        """Return dc = da + u drho + rho du, (..., L, 3, P)."""
        moved = change.get("a", (legs.count, 3))
        if "rho" in change.fields:
            moved = moved + legs.u[..., None] * change.fields["rho"][..., None, :]
        if "u" in change.fields:
            moved = moved + rho[..., None, None] * change.fields["u"]
        return moved

    def length_change(self, legs: Legs, change: Change) -> NDArray:
        """Return dl, (..., L, P)."""
        return change.get("l", (legs.count,))
