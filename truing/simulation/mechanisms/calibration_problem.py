"""Calibration of a mechanism as equations: the model must hold at every measured pose, up to measurement errors.

The implicit objectives of the telescope report (eq. 30-33) are these equations without measurement errors; errors in
variables lets poses and readings deviate from their measured values.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import exp_so3, left_jacobian_so3
from truing.simulation.change import Change
from truing.simulation.mechanisms.legs.leg_bodies import LegBodies, LegEndClosing, joints_of
from truing.simulation.mechanisms.parameters import SHARED, LegParameter, ParameterSet
from truing.simulation.mechanisms.structures.kinematic_model import shift_change
from truing.simulation.mechanisms.structures.structure import Closing, Machine, Structure


@dataclass(frozen=True)
class ShiftClosing:
    """Measured minus modelled shifts (..., A), m; derivatives by readings (..., A, L) and parameters (..., A, P)."""

    value: NDArray
    by_rho: NDArray
    by_parameter: NDArray


@dataclass(frozen=True)
class AttachmentShifts:
    """Measured shifts (B, A), m, of the attachments of legs (A,), from 0, relative to their surveyed heights (A,),
    m."""

    leg: NDArray
    shift: NDArray
    surveyed_bz: NDArray

    @property
    def deviations(self) -> int:
        """Number of deviations per pose: A."""
        return len(self.leg)

    def close(self, machine: Machine, rho: NDArray, change: Change, deviation: NDArray) -> ShiftClosing:
        """Return measured minus modelled shifts at readings rho (..., B, L); deviation (..., B, A) is added to the
        measured ones."""
        height = machine.legs.b[..., self.leg, 2] - self.surveyed_bz
        value = self.shift + deviation - height - machine.delta_bz(rho)[..., self.leg]
        raised = change.get("b", (machine.legs.count, 3))[..., 2, :]
        bent = shift_change(machine, rho, change) + raised
        by_rho = np.broadcast_to(machine.deformation, (*rho.shape[:-1], *machine.deformation.shape[-2:]))
        return ShiftClosing(value, -by_rho[..., self.leg, :], -bent[..., self.leg, :])


@dataclass(frozen=True)
class CommonErrors:
    """K independent errors common to all poses, of unit variance; effects (B, N, K), m and rad, on each pose's
    measurements."""

    effects: NDArray

    @property
    def entries(self) -> tuple[LegParameter, ...]:
        """The errors as parameters to identify."""
        return tuple(LegParameter(f"common{k + 1}", SHARED, "1", 1.0) for k in range(self.effects.shape[-1]))

    def corrected(self, deviation: NDArray, errors: NDArray) -> NDArray:
        """Return the deviations (..., B, N) without the effects of errors (..., K)."""
        return deviation - (self.effects @ errors[..., None, :, None])[..., 0]

    def slopes(self, by_deviation: NDArray) -> NDArray:
        """Return the derivatives (..., B, M, K) of equations by the errors from those by deviations (..., B, M, N)."""
        return -by_deviation @ self.effects


@dataclass(frozen=True)
class PoseEquations:
    """The M equations of each pose, m, zero if they hold, and their first derivatives."""

    value: NDArray  # (..., B, M)
    by_deviation: NDArray  # (..., B, M, N)
    by_values: NDArray  # (..., B, M, P)


@dataclass(frozen=True)
class CalibrationProblem:
    """Measured poses p (B, 3) m, R (B, 3, 3), base frame, and readings rho (B, L) m, of a machine to be identified.

    A reading is the displacement from the reference reading of the nominal machine. If rho0 is among the parameters, it
    is the position of this reference (report, section 7.1.2).
    """

    structure: Structure
    nominal: Machine
    parameters: ParameterSet
    p: NDArray
    R: NDArray
    rho: NDArray
    leg_bodies: LegBodies | None = None
    shifts: AttachmentShifts | None = None
    common: CommonErrors | None = None

    def __post_init__(self) -> None:
        """Raise ValueError if the model cannot use the legs' own poses."""
        if self.leg_bodies and not self.leg_bodies.fits(self.structure, self.nominal):
            legs = f"{self.nominal.legs.closure.name} in the model {self.structure.name}"
            raise ValueError(f"poses of legs: found {legs}, expected legs that are one rigid body each")

    @property
    def entries(self) -> tuple[LegParameter, ...]:
        """All parameters to identify: the machine's, those that place each leg in its survey frame, and the common
        errors."""
        seats = self.leg_bodies.entries if self.leg_bodies else ()
        return self.parameters.entries + seats + (self.common.entries if self.common else ())

    @property
    def start(self) -> NDArray:
        """Nominal values (P,), SI."""
        start_of_bodies = [self.leg_bodies.start] if self.leg_bodies else []
        none = [np.zeros(len(self.common.entries))] if self.common else []
        return np.concatenate([self.parameters.values(self.nominal), *start_of_bodies, *none])

    @property
    def deviations(self) -> int:
        """Number N of deviations per pose: twist (v; theta) of the platform, readings, each leg's, shifts."""
        return self._before_shifts + (self.shifts.deviations if self.shifts else 0)

    @property
    def _before_shifts(self) -> int:
        return 6 + self.rho.shape[-1] + (self.leg_bodies.deviations if self.leg_bodies else 0)

    def machine(self, values: NDArray) -> Machine:
        """Return the machine with values (..., P); batch axes precede that of the poses."""
        return self.parameters.machine(self.nominal, _leading(values)[..., : len(self.parameters)])

    def readings(self, machine: Machine) -> NDArray:
        """Return the measured actuator positions (..., B, L), m, relative to the machine's own reference."""
        return self.rho + (machine.legs.rho0 - self.nominal.legs.rho0)

    def constrain(self, values: NDArray, deviation: NDArray) -> PoseEquations:
        """Return the equations at values (..., P), SI, and at the measurements plus deviation (..., B, N).

        Rotations deviate by exp(theta) R.
        """
        if self.common is None:
            return self._constrain(values, deviation)
        first = len(self.entries) - len(self.common.entries)
        pose_equations = self._constrain(values[..., :first], self.common.corrected(deviation, values[..., first:]))
        by_values = np.concatenate([pose_equations.by_values, self.common.slopes(pose_equations.by_deviation)], -1)
        return PoseEquations(pose_equations.value, pose_equations.by_deviation, by_values)

    def _constrain(self, values: NDArray, deviation: NDArray) -> PoseEquations:
        machine, readings = self.machine(values), 6 + self.rho.shape[-1]
        p, R = self.p + deviation[..., :3], exp_so3(deviation[..., 3:6]) @ self.R
        rho = self.readings(machine) + deviation[..., 6:readings]
        change = self.parameters.change(machine)
        closing = self.structure.close(machine, p, R, rho, change)
        carried = None
        if self.leg_bodies is not None:
            joints = joints_of(self.leg_bodies.leg, machine, p, R, rho, change)
            body_values = _leading(values)[..., len(self.parameters) :]
            carried = self.leg_bodies.with_end_closures(
                body_values, deviation[..., readings : self._before_shifts], closing, joints
            )
            closing = carried.closing
        equations = _constrained(closing, deviation, change, carried)
        if self.shifts is None:
            return equations
        shifted = self.shifts.close(machine, rho, change, deviation[..., self._before_shifts :])
        return _with_shifts(equations, shifted, change)


def _leading(values: NDArray) -> NDArray:
    return values[..., None, :] if values.ndim > 1 else values


def _constrained(
    closing: Closing, deviation: NDArray, change: Change, carried: LegEndClosing | None = None
) -> PoseEquations:
    """Join the derivatives by the platform's pose and the readings, by the parameters, and by the legs' own poses."""
    by_pose = [by_deviation(closing.by_twist, deviation[..., 3:6]), closing.by_rho]
    by_values = [closing.by_parameter + _derivative_by_rho0(closing, change)]
    if carried is not None:
        by_pose, by_values = [*by_pose, carried.by_deviation], [*by_values, carried.by_values]
    return PoseEquations(closing.value, np.concatenate(by_pose, -1), np.concatenate(by_values, -1))


def _with_shifts(equations: PoseEquations, shifted: ShiftClosing, change: Change) -> PoseEquations:
    """Append the equations of the shifts, and their deviations."""
    count, legs = shifted.by_rho.shape[-2:]
    batch = equations.value.shape[:-1]
    below = np.zeros((*batch, count, equations.by_deviation.shape[-1] + count), shifted.by_rho.dtype)
    below[..., 6 : 6 + legs], below[..., -count:] = shifted.by_rho, np.eye(count)
    values = np.zeros((*batch, count, equations.by_values.shape[-1]), shifted.by_parameter.dtype)
    moved = change.get("rho0", (legs,))
    values[..., : change.size] = shifted.by_parameter + shifted.by_rho @ moved
    beside = np.zeros((*equations.by_deviation.shape[:-1], count))
    return PoseEquations(
        np.concatenate([equations.value, shifted.value], -1),
        np.concatenate([np.concatenate([equations.by_deviation, beside], -1), below], -2),
        np.concatenate([equations.by_values, values], -2),
    )


def by_deviation(by_twist: NDArray, theta: NDArray) -> NDArray:
    """Convert derivatives (..., M, 6) by a twist at this pose to those by the deviation (v; theta), with theta (...,
    3)."""
    turned = by_twist[..., 3:] @ left_jacobian_so3(theta)
    return np.concatenate([np.broadcast_to(by_twist[..., :3], turned.shape), turned], -1)


def _derivative_by_rho0(closing: Closing, change: Change) -> NDArray:
    """Return the derivatives (..., M, P) by parameters that move the reference of the readings."""
    moved = change.fields.get("rho0")
    return np.zeros_like(closing.by_parameter) if moved is None else closing.by_rho @ moved
