"""Targets on the attachments: how far each stands along z of the platform from where the survey has it.

The shift measures the platform's deformation directly, and the height of the attachment besides. Its error shares that
of the platform's pose, from which it is counted; the joint itself, the sum of both, is nearly free of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.change import Change
from truing.simulation.mechanisms.structures.kinematic_model import shift_change
from truing.simulation.mechanisms.structures.structure import Machine


@dataclass(frozen=True)
class ShiftClosing:
    """Measured less modelled shifts (..., A), m; derivatives by readings (..., A, L) and parameters (..., A, P)."""

    value: NDArray
    by_rho: NDArray
    by_parameter: NDArray


@dataclass(frozen=True)
class AttachmentShifts:
    """Measured shifts (B, A), m, of the attachments of legs (A,), from 0, off their surveyed heights (A,), m."""

    leg: NDArray
    shift: NDArray
    surveyed_bz: NDArray

    @property
    def deviations(self) -> int:
        """Return the number of deviations of a pose: A."""
        return len(self.leg)

    def close(self, machine: Machine, rho: NDArray, change: Change, deviation: NDArray) -> ShiftClosing:
        """Return the closing at readings rho (..., B, L) where the truth is off the shifts by deviation (..., B, A)."""
        height = machine.legs.b[..., self.leg, 2] - self.surveyed_bz
        value = self.shift + deviation - height - machine.delta_bz(rho)[..., self.leg]
        raised = change.get("b", (machine.legs.count, 3))[..., 2, :]
        bent = shift_change(machine, rho, change) + raised
        by_rho = np.broadcast_to(machine.deformation, (*rho.shape[:-1], *machine.deformation.shape[-2:]))
        return ShiftClosing(value, -by_rho[..., self.leg, :], -bent[..., self.leg, :])
