"""True wrench of a load on the bench: load of one axis, off its line, and driven by two units.

A force acts off the origin, or a torque is accompanied by a force. Two units share a load differently when they push
and when they pull, and their difference is a moment. All are functions of the nominal load only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

AXES = ("fx", "fy", "fz", "mx", "my", "mz")


def wrench_of(axis: str, load: ArrayLike) -> NDArray:
    """Return wrenches (..., 6), N and N m, of loads (...) along one axis; raises ValueError for another name."""
    if axis not in AXES:
        raise ValueError(f"load axis: found {axis!r}, expected one of {', '.join(AXES)}")
    return np.asarray(load)[..., None] * np.eye(6)[AXES.index(axis)]


def eccentric_wrench(
    axis: str, load: ArrayLike, offset_m: ArrayLike = (0.0, 0.0, 0.0), force_per_m: ArrayLike = (0.0, 0.0, 0.0)
) -> NDArray:
    """Return wrenches (..., 6) of loads (...) whose line of action is off the origin.

    offset_m: of a force, whose moment is offset x force; force_per_m: force that accompanies a torque, N per N m. The
    one that does not apply to the axis has no effect.
    """
    wrench = wrench_of(axis, load)
    force, moment = wrench[..., :3], wrench[..., 3:]
    along = moment.sum(-1, keepdims=True) * np.asarray(force_per_m)
    return np.concatenate([force + along, moment + np.cross(np.asarray(offset_m), force)], -1)


@dataclass(frozen=True)
class Imbalance:
    """A parasitic wrench per load (6,): 1 or m for a driven force, 1/m or 1 for a driven torque.

    ratio: on average; asymmetry: difference between positive and negative loads; growth: increase from no load to the
    largest.
    """

    ratio: NDArray
    asymmetry: NDArray
    growth: NDArray


def imbalance(ratio: ArrayLike = 0.0, asymmetry: ArrayLike = 0.0, growth: ArrayLike = 0.0) -> Imbalance:
    """Return an imbalance; each argument is one number for all components or six of them."""
    return Imbalance(*(np.broadcast_to(np.asarray(each), (6,)) for each in (ratio, asymmetry, growth)))


def imbalanced_wrench(axis: str, load: ArrayLike, found: Imbalance, largest: float) -> NDArray:
    """Return wrenches (..., 6) of loads (...) plus their parasitic part ratio + asymmetry/2 sign + growth |load| /
    largest."""
    wrench, F = wrench_of(axis, load), np.asarray(load)[..., None]
    size = F * np.sign(F.real)
    return wrench + F * found.ratio + 0.5 * size * found.asymmetry + F * size / largest * found.growth


@dataclass(frozen=True)
class UnitForces:
    """Units that drive one axis together: positions (U, 3), m from the platform's origin, and forces.

    pushing and pulling: the force (U, 3) of each per nominal load, for positive and for negative loads.
    """

    at: NDArray
    pushing: NDArray
    pulling: NDArray

    def wrench(self, load: ArrayLike) -> NDArray:
        """Return the wrenches (..., 6), N and N m, of nominal loads (...)."""
        F = np.asarray(load)[..., None]
        pushing, pulling = (_wrench_per_load(self.at, force) for force in (self.pushing, self.pulling))
        return F * np.where(F.real < 0.0, pulling, pushing)

    def imbalance(self, axis: str) -> Imbalance:
        """Return the parasitic part of these units' load on the axis."""
        per_load = [_wrench_per_load(self.at, force) for force in (self.pushing, self.pulling)]
        mean, difference = 0.5 * (per_load[0] + per_load[1]), per_load[0] - per_load[1]
        return imbalance(mean - wrench_of(axis, 1.0), difference)


def two_units(axis: str, arm_m: ArrayLike, pushing: float = 0.0, pulling: float = 0.0) -> UnitForces:
    """Return two units at +arm and -arm (3,), m, that apply a load: the first takes 1/2 + its excess of it.

    pushing, pulling: the excess for positive and for negative loads, 1. A force is shared; a torque is the couple of
    two opposite forces across arm and axis. Raises ValueError for another axis, and for an arm along that of a torque.
    """
    arm, force, signs = np.asarray(arm_m, float), *_of_unit(axis, np.asarray(arm_m, float))
    shares = (np.array([0.5 + excess, 0.5 - excess]) * signs for excess in (pushing, pulling))
    return UnitForces(np.stack([arm, -arm]), *(np.outer(share, force) for share in shares))


def share_wrench(axis: str, arm_m: ArrayLike) -> NDArray:
    """Return the parasitic wrench (6,) per load and excess of the first of two units at +arm and -arm (3,), m."""
    return two_units(axis, arm_m, 1.0, 1.0).imbalance(axis).ratio


def _of_unit(axis: str, arm: NDArray) -> tuple[NDArray, NDArray]:
    """Return the force (3,) of a unit that takes the whole load, per load, and the signs (2,) of both units."""
    direction = wrench_of(axis, 1.0)
    if axis in AXES[:3]:
        return direction[:3], np.array([1.0, 1.0])
    along = np.cross(direction[3:], arm)
    if not along.any():
        raise ValueError(f"arm of {axis}: found {arm.tolist()} m, expected one across the axis")
    return along / (along @ along), np.array([1.0, -1.0])


def _wrench_per_load(at: NDArray, force: NDArray) -> NDArray:
    return np.concatenate([force.sum(-2), np.cross(at, force).sum(-2)], -1)
