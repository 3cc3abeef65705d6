"""Rigid legs on a platform that may deform: the kinematic model and its linearisation (telescope report, eq. 5, 9, 30).

The kinematic model takes legs of any closure. The linear model has readings proportional to the platform's motion from
its reference pose: it is the kinematic residual to first order there, divided by its derivative by the leg's reading.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import exp_so3, inverse_left_jacobian_so3, log_so3
from truing.simulation.change import Change
from truing.simulation.mechanisms.legs.kinematics import attachments, forward, reference_twist, upper_joints
from truing.simulation.mechanisms.structures.structure import NO_CHANGE, Closing, Machine


@dataclass(frozen=True)
class KinematicModel:
    """Closure residual of a leg: its length minus the distance of its joints, l - |p + R b* - c| (eq. 30), or the
    closure's own.

    The model has the name of the closure, ``6-pus``, ``ups`` or a lab's own.
    """

    name: str

    def fits(self, machine: Machine) -> bool:
        """True if the machine's legs are of the type that the model is named after."""
        return machine.legs.closure.name == self.name

    def close(self, machine: Machine, p: NDArray, R: NDArray, rho: NDArray, change: Change) -> Closing:
        """Return the closure residuals at poses p (..., 3), R (..., 3, 3) and readings rho (..., L), m."""
        legs = machine.bent_legs(rho)
        arms = attachments(legs, machine.delta_bz(rho)) @ np.swapaxes(R, -1, -2)
        upper = p[..., None, :] + arms
        value, towards = legs.closure.close(legs, upper, rho)
        along = towards @ R  # of the closing by the attachments, platform frame
        reading = reading_change(machine, upper, rho)
        by_rho = reading[..., None] * np.eye(legs.count) + np.einsum(
            "...li,...lij->...lj", along, machine.by_readings()
        )
        bent = along[..., 2, None] * shift_change(machine, rho, change)
        bent = bent + np.einsum("...li,...lip->...lp", along[..., :2], in_plane_change(machine, rho, change))
        by_twist = np.concatenate([towards, np.cross(arms, towards)], -1)
        moved = np.einsum("...li,...lip->...lp", along, change.get("b", (legs.count, 3)))
        return Closing(value, by_twist, by_rho, legs.closure.close_change(legs, upper, rho, change) + moved + bent)


def reading_change(machine: Machine, upper: NDArray, rho: NDArray) -> NDArray:
    """Return the derivative (..., L) of each leg's residual by its own reading, with fixed upper joints (..., L, 3)."""
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


def in_plane_change(machine: Machine, rho: NDArray, change: Change) -> NDArray:
    """Return the derivative (..., L, 2, P) of the shift along x and y of the platform by the parameters of a change."""
    bent, moved = change.fields.get("in_plane"), change.fields.get("rho0")
    shift = np.zeros((machine.legs.count, 2, change.size))
    if bent is not None:
        shift = shift + np.einsum("...iajp,...j->...iap", bent, rho - machine.legs.rho0)
    if moved is not None and machine.in_plane is not None:
        shift = shift - np.einsum("...iaj,...jp->...iap", machine.in_plane, moved)
    return shift


def shifting(machine: Machine, rho: NDArray, change: Change) -> Change:
    """Add the change of the attachments' shift, as ``delta_bz``, to a change of the machine."""
    return Change({**change.fields, "delta_bz": shift_change(machine, rho, change)}, change.size)


_STEP = 1e-30


@dataclass(frozen=True)
class _Reference:
    """Pose at the reference readings, and the rows of the residuals there, divided by the derivative by the leg's
    reading."""

    p: NDArray  # (..., 3)
    R: NDArray  # (..., 3, 3)
    by_twist: NDArray  # (..., L, 6), -J0^-1
    by_rho: NDArray  # (..., L, L), I without deformation


@dataclass(frozen=True)
class JacobianModel:
    """Closure residual of leg i: (rho - rho0) - J0^-1 (X - X0), m, X - X0 = (p - p0; log(R R0')), any R0 (eq. 9 and
    31).

    The reference pose X0 follows from rho0 by the forward kinematics of the rigid legs, at least six. A deformation of
    the platform, K (rho - rho0), changes a reading through leg and actuator; for actuators along z of the platform this
    is the report's (1 - kappa)(rho - rho0).
    """

    name: str = "jacobian"

    def fits(self, machine: Machine) -> bool:
        """True if readings determine the pose, which is needed at the reference."""
        return machine.legs.count >= 6

    def close(self, machine: Machine, p: NDArray, R: NDArray, rho: NDArray, change: Change) -> Closing:
        """Return the closure residuals at poses p (..., 3), R (..., 3, 3) and readings rho (..., L), m."""
        reference = _reference(machine)
        moved = rho - machine.legs.rho0
        theta = log_so3(R @ np.swapaxes(reference.R, -1, -2))
        away = np.concatenate([p - reference.p, theta], -1)
        value = np.einsum("...ij,...j->...i", reference.by_twist, away) + np.einsum(
            "...ij,...j->...i", reference.by_rho, moved
        )
        turn = inverse_left_jacobian_so3(theta)
        turned = reference.by_twist[..., 3:] @ turn
        by_twist = np.concatenate([np.broadcast_to(reference.by_twist[..., :3], turned.shape), turned], -1)
        by_rho = np.broadcast_to(reference.by_rho, (*value.shape, value.shape[-1]))
        return Closing(value, by_twist, by_rho, _derivative_by_parameter(machine, reference, away, turn, moved, change))


def _derivative_by_parameter(
    machine: Machine, reference: _Reference, away: NDArray, turn: NDArray, moved: NDArray, change: Change
) -> NDArray:
    """Return the derivative (..., L, P) through the rows at the reference, the pose there, and the readings there."""
    if change.size == 0:
        return np.zeros((*moved.shape, 0))
    twist = reference_twist(machine.legs, reference.p, reference.R, change)
    rows = _reference_slope(machine, reference, twist, change)
    steered = np.einsum("...ijp,...j->...ip", rows.by_twist, away) + np.einsum("...ijp,...j->...ip", rows.by_rho, moved)
    # log(R R0') changes by -J^-T w if R0 turns by w: the right Jacobian is the transpose of the left one.
    left = np.swapaxes(turn, -1, -2) @ twist[..., 3:, :]
    followed = reference.by_twist @ np.concatenate([np.broadcast_to(twist[..., :3, :], left.shape), left], -2)
    return steered - followed - reference.by_rho @ change.get("rho0", (machine.legs.count,))


def _reference(machine: Machine) -> _Reference:
    """Return the reference of a machine, with its batch; NaN if the legs do not close there."""
    reference = forward(machine.legs, machine.legs.rho0)
    return _rows(machine, np.where(reference.converged[..., None], reference.p, np.nan), reference.R)


def _rows(machine: Machine, p: NDArray, R: NDArray) -> _Reference:
    """Return the rows of the residuals at a reference pose with unshifted attachments."""
    rho0 = machine.legs.rho0
    closing = KinematicModel(machine.legs.closure.name).close(machine, p, R, rho0, NO_CHANGE)
    derivative = reading_change(machine, upper_joints(machine.legs, p, R), rho0)[..., None]
    return _Reference(p, R, closing.by_twist / derivative, closing.by_rho / derivative)


def _reference_slope(machine: Machine, reference: _Reference, twist: NDArray, change: Change) -> _Reference:
    """Return the derivatives of the rows, (..., L, 6, P) and (..., L, L, P), by complex steps, exact to rounding.

    They are second derivatives of the closure; thus a lab's own closure need not define them.
    """
    nudge = 1j * _STEP * np.moveaxis(twist, -1, 0)
    with np.errstate(invalid="ignore"):  # NaN if there is no reference pose
        turned = exp_so3(nudge[..., 3:]) @ reference.R
        moved_rows = _rows(_nudged(machine, change, reference.p.ndim - 1), reference.p + nudge[..., :3], turned)
    slopes = (np.moveaxis(rows.imag, 0, -1) / _STEP for rows in (moved_rows.by_twist, moved_rows.by_rho))
    return _Reference(reference.p, reference.R, *slopes)


def _nudged(machine: Machine, change: Change, batch: int) -> Machine:
    """Return the machine with a complex step along each parameter as leading axis, before ``batch`` axes: (P, ...,
    L, 3)."""
    arrays = {}
    for name, rank in {"a": 2, "b": 2, "u": 2, "l": 1, "rho0": 1, "deformation": 2}.items():
        value = machine.deformation if name == "deformation" else getattr(machine.legs, name)
        if name in change.fields:
            slope = np.moveaxis(change.fields[name], -1, 0)
            missing = tuple(range(1, 2 + batch + rank - slope.ndim))
            value = value + 1j * _STEP * np.expand_dims(slope, missing)
        arrays[name] = value
    deformation = arrays.pop("deformation")
    return replace(machine, legs=machine.legs.replace(**arrays), deformation=deformation)
