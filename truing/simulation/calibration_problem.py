"""What a calibration asks of a model: that its equations hold at every measured pose, up to what was mismeasured there.

The implicit objectives of the telescope report (eq. 30-33) are the equations without any deviation; errors in variables
lets poses and readings deviate from what was measured.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import exp_so3, left_jacobian_so3
from truing.simulation.legs import Change
from truing.simulation.parameters import ParameterSet
from truing.simulation.structure import Closing, Machine, Structure


@dataclass(frozen=True)
class Constrained:
    """The equations of each pose, M in m, and their first derivatives; 0 where all belongs together."""

    value: NDArray  # (..., B, M)
    by_deviation: NDArray  # (..., B, M, N)
    by_values: NDArray  # (..., B, M, P)


@dataclass(frozen=True)
class CalibrationProblem:
    """Measured poses p (B, 3) m, R (B, 3, 3), base frame, and readings rho (B, L) m, of a machine to be identified.

    A reading says how far an actuator is from the reference reading of the nominal machine: where rho0 is among the
    parameters, it is the place of that reference which they identify (report, section 7.1.2).
    """

    structure: Structure
    nominal: Machine
    parameters: ParameterSet
    p: NDArray
    R: NDArray
    rho: NDArray

    @property
    def start(self) -> NDArray:
        """Return the nominal values (P,), SI."""
        return self.parameters.values(self.nominal)

    @property
    def deviations(self) -> int:
        """Return the number N of deviations of a pose: the platform's twist (v; theta), then the readings."""
        return 6 + self.rho.shape[-1]

    def machine(self, values: NDArray) -> Machine:
        """Return the machine that values (..., P) stand for; a batch of them leads that of the poses."""
        return self.parameters.machine(self.nominal, values[..., None, :] if values.ndim > 1 else values)

    def readings(self, machine: Machine) -> NDArray:
        """Return the positions of the actuators (..., B, L), m, that were read, counted as the machine counts them."""
        return self.rho + (machine.legs.rho0 - self.nominal.legs.rho0)

    def constrain(self, values: NDArray, deviation: NDArray) -> Constrained:
        """Return the equations at values (..., P), SI, where the truth is off the measurement by deviation (..., B, N).

        Rotations deviate by exp(theta) R.
        """
        machine = self.machine(values)
        p, R = self.p + deviation[..., :3], exp_so3(deviation[..., 3:6]) @ self.R
        rho = self.readings(machine) + deviation[..., 6 : self.deviations]
        change = self.parameters.change(machine)
        closing = self.structure.close(machine, p, R, rho, change)
        by_pose = by_deviation(closing.by_twist, deviation[..., 3:6])
        return Constrained(
            closing.value,
            np.concatenate([by_pose, closing.by_rho], -1),
            closing.by_parameter + _by_rho0(closing, change),
        )


def by_deviation(by_twist: NDArray, theta: NDArray) -> NDArray:
    """Return derivatives (..., M, 6) by a twist here as those by the deviation (v; theta) (..., 3) that led here."""
    turned = by_twist[..., 3:] @ left_jacobian_so3(theta)
    return np.concatenate([np.broadcast_to(by_twist[..., :3], turned.shape), turned], -1)


def _by_rho0(closing: Closing, change: Change) -> NDArray:
    """Return what the parameters change by moving the reference of the readings, (..., M, P)."""
    moved = change.fields.get("rho0")
    return np.zeros_like(closing.by_parameter) if moved is None else closing.by_rho @ moved
