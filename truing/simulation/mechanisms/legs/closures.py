"""Legs of a parallel mechanism (`Legs`), and the closure equation of each type of leg (`Closure`).

Leg of fixed length on a linear actuator: p + R b = a + rho u + l z, |z| = 1. Leg of variable length, the ordinary
hexapod: |p + R b - a| = l + rho.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.schemas.installed import with_installed
from truing.simulation.change import Change


class Closure:
    """Base class of leg types; every function takes any batch shape, real or complex.

    truing's own types are straight between two joints and define the lower joint (`lower`) and the distance of the
    upper one (`length`); `close` follows. Another type (a cable over a pulley, whose lower end depends on the upper)
    defines `close` and `close_change` itself; its `lower` and `length` are those of a similar straight leg, the start
    of Newton.
    """

    name: str
    geometry: tuple[str, ...] = ("a", "b", "u", "l")  # the arrays of `Legs` that the closure depends on
    one_body: bool = False  # whether the leg is one rigid body from joint to joint

    def lower(self, legs: Legs, rho: NDArray) -> NDArray:
        """Return the lower joints (..., L, 3), base frame, m, at readings rho (..., L)."""
        raise NotImplementedError

    def length(self, legs: Legs, rho: NDArray) -> NDArray:
        """Return the distances (..., L), m, between lower and upper joint."""
        raise NotImplementedError

    def invert(self, legs: Legs, h: NDArray) -> NDArray:
        """Return the readings (..., L) for h = p + R b* - a (..., L, 3); NaN if there is none."""
        raise NotImplementedError

    def lower_change(self, legs: Legs, rho: NDArray, change: Change) -> NDArray:
        """Return the derivative (..., L, 3, P) of `lower` by the P parameters of a change."""
        raise NotImplementedError

    def length_change(self, legs: Legs, change: Change) -> NDArray:
        """Return the derivative (..., L, P) of `length` by the P parameters of a change."""
        raise NotImplementedError

    def close(self, legs: Legs, upper: NDArray, rho: NDArray) -> tuple[NDArray, NDArray]:
        """Return the gap between legs and the platform's joints, and its gradient by these joints.

        upper (..., L, 3): the joints in the base frame, m. The gap is (..., L), m, positive if a leg is too long; the
        gradient is (..., L, 3). For a straight leg these are length - |g| and -z, its direction (telescope report, eq.
        5 and 30).
        """
        g = upper - self.lower(legs, rho)
        distance = np.sqrt(np.einsum("...i,...i->...", g, g))
        return self.length(legs, rho) - distance, -g / distance[..., None]

    def close_change(self, legs: Legs, upper: NDArray, rho: NDArray, change: Change) -> NDArray:
        """Return the derivative (..., L, P) of `close` by the P parameters of a change, with fixed upper joints."""
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
        """Number of legs L."""
        return self.b.shape[-2]

    def replace(self, **arrays: Any) -> Legs:
        """Return a copy with some arrays replaced."""
        return replace(self, **arrays)


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
        """Return the reading with z u > 0, that is, with the platform ahead of the actuators (eq. 7); NaN out of
        reach."""
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


class Ups(Closure):
    """UPS: the lower joint is fixed, the actuator changes the leg's length."""

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


OWN_CLOSURES = (SixPus(), Ups())
# A lab's package names its own closures under this group: `"my-legs" = "my_package.legs:MyClosure"`.
ENTRY_POINTS = "truing.closures"


def closures() -> dict[str, Closure]:
    """Return all closures by name: truing's own, then those of installed packages.

    Raises ValueError if two closures have the same name.
    """
    return with_installed(OWN_CLOSURES, ENTRY_POINTS, "closure", lambda closure: closure.name)


def mechanism(
    kind: str,
    a: ArrayLike,
    b: ArrayLike,
    u: ArrayLike | None,
    l: ArrayLike,  # noqa: E741
    rho0: ArrayLike,
) -> Legs:
    """Return the legs of a mechanism of type ``6-pus``, ``ups`` or a lab's own type from its data in m.

    Shapes as in `Legs`. Without u, which a ups does not need, the actuators point along z of the base. Raises
    ValueError for an unknown type or arrays of wrong shape.
    """
    built_in = {closure.name: closure for closure in OWN_CLOSURES}
    known = built_in if kind in built_in else closures()  # searching installed packages is slow
    if kind not in known:
        raise ValueError(f"mechanism type: found {kind!r}, expected one of {', '.join(known)}")
    joints = np.asarray(a, float)
    directions = np.broadcast_to([0.0, 0.0, 1.0], joints.shape) if u is None else np.asarray(u, float)
    arrays = (joints, np.asarray(b, float), directions, np.asarray(l, float), np.asarray(rho0, float))
    wanted = (joints.shape, joints.shape, joints.shape, joints.shape[:-1], joints.shape[:-1])
    if joints.shape[-1:] != (3,) or any(array.shape != shape for array, shape in zip(arrays, wanted, strict=True)):
        raise ValueError(f"legs: found shapes {[array.shape for array in arrays]}, expected {list(wanted)}")
    return Legs(*arrays, known[kind])
