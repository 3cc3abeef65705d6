"""The model of bending flexures: rigid legs whose joints shift as flexures bend (telescope report, eq. 14-18, 32)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.change import Change
from truing.simulation.mechanisms.legs.flexure import BendLaw, Distance, circle_distance
from truing.simulation.mechanisms.legs.geometry import Legs
from truing.simulation.mechanisms.legs.kinematics import attachment_change, closure_rows, leg_vectors
from truing.simulation.mechanisms.legs.reference_pose import Home, home_change, home_pose
from truing.simulation.mechanisms.structures.kinematic_model import shifting
from truing.simulation.mechanisms.structures.structure import Closing, Machine


@dataclass(frozen=True)
class Bend:
    """Legs between flexures A, on the base, and B, on the platform, at B poses; base frame, m.

    value: closing (B, L) of the legs (eq. 32); z: their directions (B, L, 3); turned: those at home as the platform has
    turned them, R R0' z0; a, b: distances from pivot to end; pull: derivative (B, L, 3) of the closing by lower joints.
    """

    value: NDArray
    z: NDArray
    turned: NDArray
    a: Distance
    b: Distance
    pull: NDArray


@dataclass(frozen=True)
class BeamModel:
    """Closing of a leg: length - l_b + dl_A + dl_B - |p + R b* - c| (eq. 32), whatever its closure.

    Flexures are straight in the home pose, which follows from the parameters by the readings' reference: six legs at
    least. ``distance`` says what a bent flexure adds to the leg, from l_b and the cosine of the bend.
    """

    name: str = "beam"
    distance: BendLaw = circle_distance

    def fits(self, machine: Machine) -> bool:
        """Return whether the joints are flexures of known length and the home pose follows from the readings."""
        return machine.flexure_length is not None and machine.legs.count >= 6

    def close(self, machine: Machine, p: NDArray, R: NDArray, rho: NDArray, change: Change) -> Closing:
        """Return the closing at poses p (B, 3), R (B, 3, 3) and readings rho (B, L), m.

        Raises ValueError where the model does not fit the machine.
        """
        home, legs = home_pose(machine.legs), machine.legs
        bend = bent(self.distance, machine, home, p, R, rho)
        by_twist = -closure_rows(legs, R, bend.pull, machine.delta_bz(rho))
        by_twist[..., 3:] += bend.b.by_cosine[..., None] * np.cross(bend.turned, bend.z)
        driven = Change({"rho": np.eye(legs.count), "delta_bz": machine.deformation}, legs.count)
        by_rho = _moved(legs, R, rho, bend, driven)
        by_parameter = _moved(legs, R, rho, bend, shifting(machine, rho, change))
        by_parameter = by_parameter + _straight_changed(legs, home, R, bend, change)
        return Closing(bend.value, by_twist, by_rho, by_parameter)


def bent(distance: BendLaw, machine: Machine, home: Home, p: NDArray, R: NDArray, rho: NDArray) -> Bend:
    """Return how the flexures bend at poses p (B, 3), R (B, 3, 3) and readings rho (B, L), m, from straight at home.

    The cosine of a bend is z z0 on the base (eq. 16) and z R R0' z0 on the platform (eq. 17, any home rotation).
    Raises ValueError where the machine has no flexure_length.
    """
    legs, l_b = machine.legs, _flexure_length(machine)
    g = leg_vectors(legs, p, R, rho, machine.delta_bz(rho))
    apart = np.sqrt(np.sum(g * g, -1))
    z, turned = g / apart[..., None], home.z @ home.R @ np.swapaxes(R, -1, -2)
    cos_a, cos_b = np.sum(z * home.z, -1), np.sum(z * turned, -1)
    a, b = distance(l_b, cos_a), distance(l_b, cos_b)
    sideways = _times(a.by_cosine, home.z - _times(cos_a, z)) + _times(b.by_cosine, turned - _times(cos_b, z))
    value = legs.closure.length(legs, rho) - l_b + a.value + b.value - apart
    return Bend(value, z, turned, a, b, z - sideways / apart[..., None])


def _moved(legs: Legs, R: NDArray, rho: NDArray, bend: Bend, change: Change) -> NDArray:
    """Return the derivative (B, L, P) of the closing by what moves joints and lengths, straight flexures held."""
    apart = attachment_change(legs, R, change) - legs.closure.lower_change(legs, rho, change)
    return legs.closure.length_change(legs, change) - np.einsum("...li,...lip->...lp", bend.pull, apart)


def _straight_changed(legs: Legs, home: Home, R: NDArray, bend: Bend, change: Change) -> NDArray:
    """Return the derivative (B, L, P) of the closing by directions and lengths of the straight flexures."""
    moved = home_change(legs, home, change)
    on_platform = moved.z - np.cross(moved.twist[..., None, 3:, :], home.z[..., None], axis=-2)
    seen = bend.z @ R @ np.swapaxes(home.R, -1, -2)  # what the platform has turned, turned back
    a = np.einsum("...li,...lip->...lp", _times(bend.a.by_cosine, bend.z), moved.z)
    b = np.einsum("...li,...lip->...lp", _times(bend.b.by_cosine, seen), on_platform)
    longer = (bend.a.by_length + bend.b.by_length - 1)[..., None]
    return a + b + longer * change.get("flexure_length", (legs.count,))


def _times(scalars: NDArray, vectors: NDArray) -> NDArray:
    return scalars[..., None] * vectors


def _flexure_length(machine: Machine) -> NDArray:
    if machine.flexure_length is None:
        raise ValueError("beam model: found a machine without flexure_length, expected one per leg")
    return machine.flexure_length
