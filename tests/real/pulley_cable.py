"""A cable over a swivelling pulley: a leg type as a laboratory adds it, without changes to any stage."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.change import Change
from truing.simulation.mechanisms.legs.closures import Legs, Ups


@dataclass(frozen=True)
class Wrapped:
    """The path of a cable: its length (..., L), m, on the pulley and beyond, and the unit vectors (..., L, 3) from
    pulley to platform; by_axis (..., L, 3): the derivative of the length by the swivel axis."""

    length: NDArray
    direction: NDArray
    by_axis: NDArray


@dataclass(frozen=True)
class PulleyCable(Ups):
    """Leg of variable length over a pulley of given radius, which swivels about an axis u through the point a.

    The cable comes along the axis through a, follows the pulley's rim and leaves it on the tangent to the platform's
    joint: l + rho = rim + tangent. Without radius it is a straight leg, from which Newton starts.
    """

    radius: float = 0.0
    name: str = "pulley-cable"
    geometry: tuple[str, ...] = ("a", "b", "u", "l")

    def wrap(self, legs: Legs, upper: NDArray) -> Wrapped:
        """Return the paths of the cables to joints upper (..., L, 3), m.

        To first order, a shift of the tangent point along the rim does not change a cable's length.
        """
        r, from_a = self.radius, upper - legs.a
        along = np.sum(from_a * legs.u, -1)
        across = from_a - along[..., None] * legs.u
        reach = np.sqrt(np.sum(across * across, -1))
        tangent = np.sqrt((reach - r) ** 2 + along**2 - r**2)
        ratio = along / reach
        angle = 2 * np.arctan(ratio + np.sqrt(ratio**2 + 1 - 2 * r / reach))  # about the pulley, from its far side
        sine, cosine = np.sin(angle), np.cos(angle)
        direction = (sine / reach)[..., None] * across - cosine[..., None] * legs.u
        by_axis = (-sine * ratio - cosine)[..., None] * from_a
        return Wrapped(r * (np.pi - angle) + tangent, direction, by_axis)

    def close(self, legs: Legs, upper: NDArray, rho: NDArray) -> tuple[NDArray, NDArray]:
        """Return l + rho less the cable's length, (..., L) m, and its gradient by the platform's joints."""
        cable = self.wrap(legs, upper)
        return legs.l + rho - cable.length, -cable.direction

    def close_change(self, legs: Legs, upper: NDArray, rho: NDArray, change: Change) -> NDArray:
        """Return the derivative (..., L, P) of `close`, joints held."""
        cable, scalar, vector = self.wrap(legs, upper), (legs.count,), (legs.count, 3)
        by_a = np.einsum("...li,...lip->...lp", cable.direction, change.get("a", vector))
        by_u = np.einsum("...li,...lip->...lp", cable.by_axis, change.get("u", vector))
        return change.get("l", scalar) + change.get("rho", scalar) + by_a - by_u

    def invert(self, legs: Legs, h: NDArray) -> NDArray:
        """Return the readings (..., L) for h = p + R b - a."""
        return self.wrap(legs, legs.a + h).length - legs.l
