"""Model of elastic legs: readings at which the platform is in equilibrium (telescope report, eq. 19, 29 and 33).

Every leg is a chain of beams, with the stiffness of the reference pose; a reading moves its root, or lengthens the leg,
which is the same in linear theory. As a common shift of a leg's ends causes no load, P = K21 u_a' + K22 u_b' (eq. 29,
signs as corrected) is K22 times the displacement of b' minus that of the root. P is the wrench of the platform on the
leg at b'; the sum of all, about the platform's origin, is the external load.

The report's residual is a force. Solved for the readings it is a length and can be weighted by their noise. All
derivatives are those of the equilibrium at the readings that satisfy it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import inverse_left_jacobian_so3, log_so3, skew
from truing.simulation.change import Change
from truing.simulation.mechanisms.legs.closures import Legs
from truing.simulation.mechanisms.legs.kinematics import (
    ReferenceChange,
    ReferencePose,
    attachment_change,
    attachments,
    leg_vectors,
    reference_change,
    reference_pose,
    unit,
)
from truing.simulation.mechanisms.structures.beams import (
    Chain,
    assembled,
    assembled_change,
    beam_axes,
    condensed,
    condensed_change,
    in_frame,
    nodes,
)
from truing.simulation.mechanisms.structures.kinematic_model import shifting
from truing.simulation.mechanisms.structures.structure import BeamSection, Closing, Machine

PLATFORM_END = slice(6, 12)  # b' among the ends of a condensed chain


@dataclass(frozen=True)
class ReferenceLegs:
    """The legs at the reference, unstrained, in the base frame; batches of machines lead, at least one axis.

    half: half a flexure along its leg (..., L, 3), m; drive: motion of a leg's root per reading (..., L, 3); stiffness:
    K22 (..., L, 6, 6) of the legs at b', with fixed root; axis: direction (..., L, 3) of this stiffness, that of the
    leg at the reference unless the model follows the motion, and size (..., L): length of the mixture that gives it.
    """

    reference: ReferencePose
    half: NDArray
    drive: NDArray
    stiffness: NDArray
    axis: NDArray
    size: NDArray


@dataclass(frozen=True)
class Balance:
    """Equilibrium at B poses, solved for the readings; base frame.

    arm: from the platform's origin to b' (B, L, 3), m; theta: rotation vector from the reference (B, 3); inverse:
    readings per force and moment (B, 6, 6); excess: given readings minus those of equilibrium (B, 6), m; balanced:
    readings of equilibrium minus rho0. In equilibrium: strain, the displacement of b' minus that of the root, and
    rotation (B, L, 6); load, the wrench on b' (B, L, 6).
    """

    arm: NDArray
    theta: NDArray
    inverse: NDArray
    excess: NDArray
    balanced: NDArray
    strain: NDArray
    load: NDArray


def chain_of(machine: Machine) -> Chain:
    """Return the legs as chains of beams; raises ValueError if flexures or tubes are unknown."""
    l_b, flexure, tube, legs = machine.flexure_length, machine.flexure, machine.tube, machine.legs
    if l_b is None or flexure is None or tube is None:
        raise ValueError("stiffness: found a machine without flexure_length, flexure or tube, expected all three")
    length = legs.closure.length(legs, legs.rho0)
    beams = [np.asarray(k)[..., None] for beam in (flexure, tube) for k in (beam.bending, beam.axial, beam.torsion)]
    parts: list[Any] = list(np.broadcast_arrays(l_b, length - l_b, *beams))
    return Chain(parts[0], parts[1], BeamSection(*parts[2:5]), BeamSection(*parts[5:]))


def at_rest(machine: Machine) -> ReferenceLegs:
    """Return the legs in the reference pose; raises ValueError if flexures or tubes are unknown."""
    legs, chain = machine.legs, chain_of(machine)
    reference = reference_pose(legs)
    local = condensed(assembled(chain))[..., PLATFORM_END, PLATFORM_END]
    half = 0.5 * chain.flexure_length[..., None] * reference.z
    stiffness = in_frame(local, beam_axes(reference.z))
    size = np.ones(reference.z.shape[:-1])
    return ReferenceLegs(reference, half, drive(legs, reference.z), stiffness, reference.z, size)


def followed(
    machine: Machine, reference_legs: ReferenceLegs, p: NDArray, R: NDArray, rho: NDArray, share: float
) -> ReferenceLegs:
    """Return the legs with the stiffness along z0 + share (z - z0); z0 and z their directions at the reference and at
    poses p (B, 3), R (B, 3, 3) with readings rho (B, L).

    One half is the mean direction of the motion: load = K displacement then integrates K along it to second order.
    """
    z = unit(leg_vectors(machine.legs, p, R, rho, machine.delta_bz(rho)))
    mixed = reference_legs.reference.z + share * (z - reference_legs.reference.z)
    size = np.sqrt(np.sum(mixed * mixed, -1))
    axis = mixed / size[..., None]
    local = condensed(assembled(chain_of(machine)))[..., PLATFORM_END, PLATFORM_END]
    return replace(reference_legs, stiffness=in_frame(local, beam_axes(axis)), axis=axis, size=size)


def drive(legs: Legs, z: NDArray) -> NDArray:
    """Return the motion (..., L, 3) per reading of the roots of legs with fixed directions z (..., L, 3).

    Along the actuator for a 6-pus, along the leg for a ups; follows from the closure, which is linear in the readings.
    """
    zero, closure = np.zeros(legs.count), legs.closure
    along = closure.length(legs, zero + 1.0) - closure.length(legs, zero)
    return closure.lower(legs, zero + 1.0) - closure.lower(legs, zero) + along[..., None] * z


def unbalanced(machine: Machine, p: NDArray, R: NDArray, rho: NDArray) -> NDArray:
    """Return the load missing for equilibrium (B, 6), N and N m, at the platform's origin (eq. 33).

    At poses p (B, 3), R (B, 3, 3) and readings rho (B, L), m: the sum of M P over the legs minus the external load.
    """
    reference_legs = at_rest(machine)
    arm, theta, shift = _displaced(machine, reference_legs, p, R, rho)
    return _total(arm, _loads(reference_legs, shift, theta, rho - machine.legs.rho0)[1]) - machine.load


def balance(machine: Machine, reference_legs: ReferenceLegs, p: NDArray, R: NDArray, rho: NDArray) -> Balance:
    """Return the equilibrium of a platform on six legs at poses p (B, 3), R (B, 3, 3), deformed as at rho (B, 6), m."""
    arm, theta, shift = _displaced(machine, reference_legs, p, R, rho)
    moved = rho - machine.legs.rho0
    missing = _total(arm, _loads(reference_legs, shift, theta, moved)[1]) - machine.load
    pushed = -np.einsum("...lij,...lj->...li", reference_legs.stiffness[..., :3], reference_legs.drive)
    inverse = np.linalg.inv(np.swapaxes(_about_origin(arm, pushed), -1, -2))
    excess = np.einsum("...ij,...j->...i", inverse, missing)
    strain, load = _loads(reference_legs, shift, theta, moved - excess)
    return Balance(arm, theta, inverse, excess, moved - excess, strain, load)


def _displaced(
    machine: Machine, reference_legs: ReferenceLegs, p: NDArray, R: NDArray, rho: NDArray
) -> tuple[NDArray, NDArray, NDArray]:
    """Return R b' (B, L, 3), log(R R0') (B, 3) and the displacement of b' (B, L, 3), before eq. 30 as corrected.

    The platform is undeformed at the reference, so that its deformation counts as displacement.
    """
    legs, reference = machine.legs, reference_legs.reference
    at_reference = nodes(legs.a, legs.b, reference_legs.half, reference.R).b
    now = nodes(legs.a, attachments(legs, machine.delta_bz(rho)), reference_legs.half, reference.R).b
    arm = now @ np.swapaxes(R, -1, -2)
    displacement = (p - reference.p)[..., None, :] + arm - at_reference @ np.swapaxes(reference.R, -1, -2)
    return arm, log_so3(R @ np.swapaxes(reference.R, -1, -2)), displacement


def _loads(reference_legs: ReferenceLegs, shift: NDArray, theta: NDArray, moved: NDArray) -> tuple[NDArray, NDArray]:
    """Return strain and load of the legs (B, L, 6) at displacements of their ends and of the readings."""
    deflection = shift - moved[..., None] * reference_legs.drive
    strain = np.concatenate([deflection, np.broadcast_to(theta[..., None, :], deflection.shape)], -1)
    return strain, np.einsum("...ij,...j->...i", reference_legs.stiffness, strain)


def _total(arm: NDArray, load: NDArray) -> NDArray:
    return _about_origin(arm, load).sum(-2)


def _about_origin(arm: NDArray, load: NDArray) -> NDArray:
    """Return wrenches (B, L, 6) at arms (B, L, 3) as wrenches about the platform's origin: M P (eq. 19)."""
    force, moment = np.broadcast_arrays(load[..., :3], arm)[0], load[..., 3:]
    return np.concatenate([force, moment + np.cross(arm, force)], -1)


@dataclass(frozen=True)
class StiffnessModel:
    """Closure residuals: readings minus those of equilibrium at the pose, deformed as at the readings.

    Only for six legs, where six equations determine six readings. With fewer legs, some loads have no equilibrium; with
    more, legs can strain each other, so that the readings do not follow from the pose. ``follows``: share of a leg's
    turn by which its stiffness turns with it, 0 for the stiffness of the reference.
    """

    name: str = "stiffness"
    follows: float = 0.0

    def fits(self, machine: Machine) -> bool:
        """True if there are six legs with known flexures and tubes."""
        known = (machine.flexure_length, machine.flexure, machine.tube)
        return machine.legs.count == 6 and all(part is not None for part in known)

    def close(self, machine: Machine, p: NDArray, R: NDArray, rho: NDArray, change: Change) -> Closing:
        """Return the closure residuals at poses p (B, 3), R (B, 3, 3) and readings rho (B, 6), m.

        Raises ValueError if flexures or tubes are unknown.
        """
        reference_legs = at_rest(machine)
        if self.follows:
            reference_legs = followed(machine, reference_legs, p, R, rho, self.follows)
        equilibrium = balance(machine, reference_legs, p, R, rho)
        response = _response(reference_legs, equilibrium)
        by_shift = np.einsum("...lmi,...i->...ml", response.node, R[..., :, 2])
        by_parameter = by_shift @ shifting(machine, rho, change).fields["delta_bz"]
        if change.size:
            by_parameter = by_parameter + _derivative_by_parameter(
                machine, reference_legs, equilibrium, response, R, change, self.follows
            )
        closing = Closing(
            equilibrium.excess,
            _derivative_by_twist(equilibrium, response),
            np.eye(6) + by_shift @ machine.deformation,
            by_parameter,
        )
        if not self.follows:
            return closing
        turned = _direction_changes(machine, p, R, rho, change)
        by_turn = _derivative_by_axis(equilibrium, response, reference_legs) @ _turns(
            machine, reference_legs, p, R, rho, self.follows
        )
        slopes = (np.sum(by_turn @ part, -3) for part in turned)
        parts = (closing.by_twist, closing.by_rho, closing.by_parameter)
        return Closing(equilibrium.excess, *(part + slope for part, slope in zip(parts, slopes, strict=True)))


def compliance(machine: Machine, p: NDArray, R: NDArray, rho: NDArray) -> NDArray:
    """Return the twist of the platform per wrench at its origin (B, 6, 6), at fixed readings and poses in equilibrium.

    Rows m and rad, columns per N and per N m, base frame.
    """
    reference_legs = at_rest(machine)
    equilibrium = balance(machine, reference_legs, p, R, rho)
    return np.linalg.solve(
        _derivative_by_twist(equilibrium, _response(reference_legs, equilibrium)), equilibrium.inverse
    )


def _direction_changes(
    machine: Machine, p: NDArray, R: NDArray, rho: NDArray, change: Change
) -> tuple[NDArray, NDArray, NDArray]:
    """Return the derivatives (B, L, 3, n) of the vectors from lower to upper joints by twist, readings, parameters."""
    legs, shift = machine.legs, machine.delta_bz(rho)
    arms = attachments(legs, shift) @ np.swapaxes(R, -1, -2)
    driven = Change({"rho": np.eye(legs.count), "delta_bz": machine.deformation}, legs.count)
    by_twist = np.concatenate([np.broadcast_to(np.eye(3), (*arms.shape, 3)), -skew(arms)], -1)
    bent = shifting(machine, rho, change)
    by_rho, by_parameter = (
        attachment_change(legs, R, part) - legs.closure.lower_change(legs, rho, part) for part in (driven, bent)
    )
    return by_twist, by_rho, by_parameter


def _turns(
    machine: Machine, reference_legs: ReferenceLegs, p: NDArray, R: NDArray, rho: NDArray, share: float
) -> NDArray:
    """Return the rotation (B, L, 3, 3) of a leg's stiffness per change of the vector between its joints."""
    g = leg_vectors(machine.legs, p, R, rho, machine.delta_bz(rho))
    z, distance = unit(g), np.sqrt(np.sum(g * g, -1))
    across = np.eye(3) - z[..., :, None] * z[..., None, :]
    return skew(reference_legs.axis) @ across * (share / distance / reference_legs.size)[..., None, None]


@dataclass(frozen=True)
class _Response:
    """Derivatives of the residuals at B poses, base frame, leg by leg.

    wrench: by load on a node (B, L, 6, 6); strain: by strain (B, L, 6, 6); node: by motion of the node, which also
    moves the arm (B, L, 6, 3); turn: by rotation of the platform at fixed nodes (B, 6, 3).
    """

    wrench: NDArray
    strain: NDArray
    node: NDArray
    turn: NDArray


def _response(reference_legs: ReferenceLegs, equilibrium: Balance) -> _Response:
    force, moment = equilibrium.inverse[..., None, :, :3], equilibrium.inverse[..., None, :, 3:]
    by_force = force + moment @ skew(equilibrium.arm)
    wrench = np.concatenate([by_force, np.broadcast_to(moment, by_force.shape)], -1)
    strain = wrench @ reference_legs.stiffness
    node = strain[..., :3] - moment @ skew(equilibrium.load[..., :3])
    turn = strain[..., 3:].sum(-3) @ inverse_left_jacobian_so3(equilibrium.theta)
    return _Response(wrench, strain, node, turn)


def _derivative_by_twist(equilibrium: Balance, response: _Response) -> NDArray:
    turned = response.turn - np.sum(response.node @ skew(equilibrium.arm), -3)
    return np.concatenate([response.strain[..., :3].sum(-3), turned], -1)


def _derivative_by_parameter(
    machine: Machine,
    reference_legs: ReferenceLegs,
    equilibrium: Balance,
    response: _Response,
    R: NDArray,
    change: Change,
    share: float = 0.0,
) -> NDArray:
    """Return the derivative (B, 6, P) by the machine at the reference: pose, nodes, drives and stiffness."""
    moved = reference_change(machine.legs, reference_legs.reference, change)
    reference_turn = -response.turn @ R @ np.swapaxes(reference_legs.reference.R, -1, -2) @ moved.twist[..., 3:, :]
    answers = (
        response.node @ R[..., None, :, :],
        -response.strain[..., :3],
        -response.strain[..., :3] * equilibrium.balanced[..., None, None],
        _derivative_by_axis(equilibrium, response, reference_legs),
        _derivative_by_stiffness(machine, equilibrium, response, reference_legs),
    )
    changes = (
        *_node_changes(machine, reference_legs, moved, change),
        _drive_change(machine, moved, change),
        _turn_by_reference(reference_legs, moved.z, share),
        _chain_change(machine, change),
    )
    legwise = _summed(np.concatenate(answers, -1), _stacked(changes))
    return legwise + reference_turn - change.get("rho0", (machine.legs.count,))


def _turn_by_reference(reference_legs: ReferenceLegs, moved: NDArray, share: float) -> NDArray:
    """Return the rotation (..., L, 3, P) of the stiffness by changes (..., L, 3, P) of the directions at the
    reference."""
    return (
        (1.0 - share) * np.cross(reference_legs.axis[..., None], moved, axis=-2) / reference_legs.size[..., None, None]
    )


def _summed(answers: NDArray, changes: NDArray) -> NDArray:
    """Return the sum over legs and features of answers (B, L, 6, C) times changes (..., L, C, P), as one product."""
    legs, rows, features = answers.shape[-3:]
    flat = np.swapaxes(answers, -3, -2).reshape(*answers.shape[:-3], rows, legs * features)
    return flat @ changes.reshape(*changes.shape[:-3], legs * features, changes.shape[-1])


def _node_changes(
    machine: Machine, reference_legs: ReferenceLegs, moved: ReferenceChange, change: Change
) -> tuple[NDArray, NDArray]:
    """Return the changes (..., L, 3, P) of the nodes b': on the platform, and at the reference in the base frame."""
    reference, legs, turn = reference_legs.reference, machine.legs, moved.twist[..., None, 3:, :]
    longer, l_b = change.get("flexure_length", (legs.count,)), chain_of(machine).flexure_length
    half = 0.5 * (reference.z[..., None] * longer[..., None, :] + l_b[..., None, None] * moved.z)
    joint = attachment_change(legs, reference.R, Change({"b": change.get("b", (legs.count, 3))}, change.size))
    back = np.swapaxes(reference.R, -1, -2)
    node = back[..., None, :, :] @ (joint + half - np.cross(turn, reference_legs.half[..., None], axis=-2))
    arms = legs.b @ back
    stands = moved.twist[..., None, :3, :] + np.cross(turn, arms[..., None], axis=-2) + joint + half
    return node, stands


def _drive_change(machine: Machine, moved: ReferenceChange, change: Change) -> NDArray:
    """Return the derivative (..., L, 3, P) of `drive`."""
    legs, zero = machine.legs, np.zeros(machine.legs.count)
    closure = legs.closure
    carried = closure.lower_change(legs, zero + 1.0, change) - closure.lower_change(legs, zero, change)
    along = closure.length(legs, zero + 1.0) - closure.length(legs, zero)
    return carried + along[..., None, None] * moved.z


def _derivative_by_axis(equilibrium: Balance, response: _Response, reference_legs: ReferenceLegs) -> NDArray:
    """Return the derivative (B, L, 6, 3) by a rotation of the legs' stiffness: W ([w]x K e - K [w]x e)."""
    strain = np.concatenate([skew(equilibrium.strain[..., :3]), skew(equilibrium.strain[..., 3:])], -2)
    load = np.concatenate([skew(equilibrium.load[..., :3]), skew(equilibrium.load[..., 3:])], -2)
    return response.strain @ strain - response.wrench @ load


def _derivative_by_stiffness(
    machine: Machine, equilibrium: Balance, response: _Response, reference_legs: ReferenceLegs
) -> NDArray:
    """Return the derivative (B, L, 6, 8) by the inputs of a chain's stiffness, in the order of `assembled_change`."""
    chain = chain_of(machine)
    local = condensed_change(assembled(chain), assembled_change(chain))[..., PLATFORM_END, PLATFORM_END]
    slope = in_frame(local, beam_axes(reference_legs.axis)[..., None, :, :])
    load = np.einsum("...lqij,...lj->...liq", slope, equilibrium.strain)
    return response.wrench @ load


def _chain_change(machine: Machine, change: Change) -> NDArray:
    """Return the change (..., L, 8, P) of a chain's inputs, in the order of `assembled_change`."""
    legs = machine.legs
    scalar = (legs.count,)
    moved = Change({"l": change.get("l", scalar), "rho": change.get("rho0", scalar)}, change.size)
    flexure_length = change.get("flexure_length", scalar)
    tube_length = legs.closure.length_change(legs, moved) - flexure_length
    sections = (change.get(name, (3,))[..., None, :, :] for name in ("flexure", "tube"))  # the same for all legs
    return _stacked((flexure_length[..., None, :], tube_length[..., None, :], *sections))


def _stacked(parts: Sequence[NDArray]) -> NDArray:
    """Concatenate features (..., L, C, P) along C, with broadcast leading axes."""
    leading = np.broadcast_shapes(*(part.shape[:-2] for part in parts))
    return np.concatenate([np.broadcast_to(part, (*leading, *part.shape[-2:])) for part in parts], -2)
