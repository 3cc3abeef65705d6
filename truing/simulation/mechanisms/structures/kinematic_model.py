"""The kinematic model: rigid legs of any closure, on a platform that may deform (telescope report, eq. 5 and 30)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.change import Change
from truing.simulation.mechanisms.legs.kinematics import attachments
from truing.simulation.mechanisms.structures.structure import Closing, Machine


@dataclass(frozen=True)
class KinematicModel:
    """Closing of a leg: its length less the distance of its joints, l - |p + R b* - c| (eq. 30), or its closure's own.

    Named as the closure, ``6-pus`` or ``ups`` or a lab's own.
    """

    name: str

    def fits(self, machine: Machine) -> bool:
        """Return whether the machine's legs are of the kind that the model is named after."""
        return machine.legs.closure.name == self.name

    def close(self, machine: Machine, p: NDArray, R: NDArray, rho: NDArray, change: Change) -> Closing:
        """Return the closing at poses p (..., 3), R (..., 3, 3) and readings rho (..., L), m."""
        legs = machine.legs
        arms = attachments(legs, machine.delta_bz(rho)) @ np.swapaxes(R, -1, -2)
        upper = p[..., None, :] + arms
        value, towards = legs.closure.close(legs, upper, rho)
        along = np.sum(towards * R[..., None, :, 2], -1)  # of the closing by delta_bz
        own = reading_change(machine, upper, rho)
        by_rho = own[..., None] * np.eye(legs.count) + along[..., None] * machine.deformation
        bent = along[..., None] * shift_change(machine, rho, change)
        by_twist = np.concatenate([towards, np.cross(arms, towards)], -1)
        moved = np.einsum("...li,...lip->...lp", towards @ R, change.get("b", (legs.count, 3)))
        return Closing(value, by_twist, by_rho, legs.closure.close_change(legs, upper, rho, change) + moved + bent)


def reading_change(machine: Machine, upper: NDArray, rho: NDArray) -> NDArray:
    """Return the derivative (..., L) of each leg's closing by its own reading, upper joints (..., L, 3) held."""
    legs = machine.legs
    driven = Change({"rho": np.ones((legs.count, 1))}, 1)
    return legs.closure.close_change(legs, upper, rho, driven)[..., 0]


def shift_change(machine: Machine, rho: NDArray, change: Change) -> NDArray:
    """Return the derivative (..., L, P) of the shift K (rho - rho0) (eq. 2) by the parameters of a change."""
    bent, moved = change.fields.get("deformation"), change.fields.get("rho0")
    shift = np.zeros((machine.legs.count, change.size))
    if bent is not None:
        shift = shift + np.einsum("...ijp,...j->...ip", bent, rho - machine.legs.rho0)
    if moved is not None:
        shift = shift - machine.deformation @ moved
    return shift


def shifting(machine: Machine, rho: NDArray, change: Change) -> Change:
    """Return a change of the machine with what it makes of the attachments' shift, as ``delta_bz``."""
    return Change({**change.fields, "delta_bz": shift_change(machine, rho, change)}, change.size)
