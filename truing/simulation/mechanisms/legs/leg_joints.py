"""The joints at both ends of legs, and how they follow the platform, the readings and the machine's numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import skew
from truing.simulation.change import Change
from truing.simulation.mechanisms.legs.kinematics import attachments, upper_joints
from truing.simulation.mechanisms.structures.kinematic_model import shift_change
from truing.simulation.mechanisms.structures.structure import Closing, Machine


@dataclass(frozen=True)
class Joints:
    """Joints of some legs (K,), m, base frame; derivatives by D = 6 + L + P: platform's twist, readings, parameters."""

    leg: NDArray
    lower: NDArray  # (..., K, 3)
    upper: NDArray  # (..., K, 3)
    lower_slope: NDArray  # (..., K, 3, D)
    upper_slope: NDArray  # (..., K, 3, D)

    def lengths(self, closing: Closing) -> tuple[NDArray, NDArray]:
        """Return what a model of single legs takes for their lengths (..., K), m, and the derivatives (..., K, D).

        Its closing is that length less the distance of the joints.
        """
        g = self.upper - self.lower
        distance = np.sqrt(np.sum(g * g, -1))
        slope = np.einsum("...ki,...kid->...kd", g / distance[..., None], self.upper_slope - self.lower_slope)
        return closing.value[..., self.leg] + distance, stacked(closing)[..., self.leg, :] + slope


def joints_of(leg: NDArray, machine: Machine, p: NDArray, R: NDArray, rho: NDArray, change: Change) -> Joints:
    """Return the joints of legs (K,), from 0, at poses p (..., 3), R (..., 3, 3) and readings rho (..., L)."""
    legs, shift = machine.legs, machine.delta_bz(rho)
    upper, lower = upper_joints(legs, p, R, shift), legs.closure.lower(legs, rho)
    arms = attachments(legs, shift) @ np.swapaxes(R, -1, -2)
    axis = R[..., None, :, 2, None]
    driven = legs.closure.lower_change(legs, rho, Change({"rho": np.eye(legs.count)}, legs.count))
    moved = np.einsum("...ij,...ljp->...lip", R, change.get("b", (legs.count, 3)))
    bent = axis * shift_change(machine, rho, change)[..., None, :]
    upper_parts = (np.eye(3), -skew(arms), axis * machine.deformation[..., None, :], moved + bent)
    lower_parts = (np.zeros((3, 6)), driven, legs.closure.lower_change(legs, rho, change))
    slopes = (beside(upper.shape, *parts)[..., leg, :, :] for parts in (lower_parts, upper_parts))
    return Joints(leg, lower[..., leg, :], upper[..., leg, :], *slopes)


def stacked(closing: Closing) -> NDArray:
    """Return a closing's derivatives (..., M, D) by twist, readings and parameters."""
    return np.concatenate([closing.by_twist, closing.by_rho, closing.by_parameter], -1)


def beside(shape: tuple[int, ...], *parts: NDArray) -> NDArray:
    """Return derivatives (*shape, D) from parts (..., d) beside each other, each of which broadcasts to the shape."""
    return np.concatenate([np.broadcast_to(part, (*shape, part.shape[-1])) for part in parts], -1)
