"""Rigid legs on a platform that may deform: the kinematic model and its linearisation (telescope report, eq. 5, 9, 30).

The kinematic model takes legs of any closure. In the linear one actuators move in proportion to the platform's motion
from its reference pose: the kinematic closing to first order there, divided by what a reading does to its own leg.
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


_STEP = 1e-30


@dataclass(frozen=True)
class _Reference:
    """Pose at the reference readings, and the closing's rows there per reading of their own leg."""

    p: NDArray  # (..., 3)
    R: NDArray  # (..., 3, 3)
    by_twist: NDArray  # (..., L, 6), -J0^-1
    by_rho: NDArray  # (..., L, L), I without deformation


@dataclass(frozen=True)
class JacobianModel:
    """Closing of leg i: (rho - rho0) - J0^-1 (X - X0), m, with X - X0 = (p - p0; log(R R0')), any R0 (eq. 9 and 31).

    The reference pose X0 follows from rho0 by the forward kinematics of the rigid legs, which takes at least six. Where
    the platform deforms, its shift K (rho - rho0) reaches a reading through the leg and the actuator, which is the
    report's (1 - kappa)(rho - rho0) for actuators along z of the platform.
    """

    name: str = "jacobian"

    def fits(self, machine: Machine) -> bool:
        """Return whether readings fix the pose, as they have to at the reference."""
        return machine.legs.count >= 6

    def close(self, machine: Machine, p: NDArray, R: NDArray, rho: NDArray, change: Change) -> Closing:
        """Return the closing at poses p (..., 3), R (..., 3, 3) and readings rho (..., L), m."""
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
        return Closing(value, by_twist, by_rho, _by_parameter(machine, reference, away, turn, moved, change))


def _by_parameter(
    machine: Machine, reference: _Reference, away: NDArray, turn: NDArray, moved: NDArray, change: Change
) -> NDArray:
    """Return the derivative (..., L, P): of the rows at the reference, of the pose there, and of the readings there."""
    if change.size == 0:
        return np.zeros((*moved.shape, 0))
    twist = reference_twist(machine.legs, reference.p, reference.R, change)
    rows = _reference_slope(machine, reference, twist, change)
    steered = np.einsum("...ijp,...j->...ip", rows.by_twist, away) + np.einsum("...ijp,...j->...ip", rows.by_rho, moved)
    # log(R R0') loses J^-T w where R0 turns by w: the right Jacobian is the left one's transpose.
    left = np.swapaxes(turn, -1, -2) @ twist[..., 3:, :]
    followed = reference.by_twist @ np.concatenate([np.broadcast_to(twist[..., :3, :], left.shape), left], -2)
    return steered - followed - reference.by_rho @ change.get("rho0", (machine.legs.count,))


def _reference(machine: Machine) -> _Reference:
    """Return the reference of a machine, batched as its arrays are; NaN where it has none."""
    reference = forward(machine.legs, machine.legs.rho0)
    return _rows(machine, np.where(reference.converged[..., None], reference.p, np.nan), reference.R)


def _rows(machine: Machine, p: NDArray, R: NDArray) -> _Reference:
    """Return the closing's rows at a reference pose, where the attachments are not shifted."""
    rho0 = machine.legs.rho0
    closing = KinematicModel(machine.legs.closure.name).close(machine, p, R, rho0, NO_CHANGE)
    own = reading_change(machine, upper_joints(machine.legs, p, R), rho0)[..., None]
    return _Reference(p, R, closing.by_twist / own, closing.by_rho / own)


def _reference_slope(machine: Machine, reference: _Reference, twist: NDArray, change: Change) -> _Reference:
    """Return the derivatives of the rows (..., L, 6, P) and (..., L, L, P): complex steps, exact to rounding.

    They are second derivatives of the closure, which a closure of a lab's own need not state for that.
    """
    nudge = 1j * _STEP * np.moveaxis(twist, -1, 0)
    with np.errstate(invalid="ignore"):  # where there is no reference pose, and nothing is a number
        turned = exp_so3(nudge[..., 3:]) @ reference.R
        there = _rows(_nudged(machine, change, reference.p.ndim - 1), reference.p + nudge[..., :3], turned)
    slopes = (np.moveaxis(rows.imag, 0, -1) / _STEP for rows in (there.by_twist, there.by_rho))
    return _Reference(reference.p, reference.R, *slopes)


def _nudged(machine: Machine, change: Change, batch: int) -> Machine:
    """Return the machine a complex step along each parameter, which lead its batch of so many axes: (P, ..., L, 3)."""
    arrays = {}
    for name, rank in {"a": 2, "b": 2, "u": 2, "l": 1, "rho0": 1, "deformation": 2}.items():
        held = machine.deformation if name == "deformation" else getattr(machine.legs, name)
        if name in change.fields:
            slope = np.moveaxis(change.fields[name], -1, 0)
            missing = tuple(range(1, 2 + batch + rank - slope.ndim))
            held = held + 1j * _STEP * np.expand_dims(slope, missing)
        arrays[name] = held
    deformation = arrays.pop("deformation")
    return replace(machine, legs=machine.legs.replace(**arrays), deformation=deformation)
