"""The stiffness model: readings that balance the platform between elastic legs (telescope report, eq. 33).

The report's residual is a force; solved for the readings it is a length and can be weighed by their noise. All
derivatives are those of the equilibrium at the readings that it asks for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import inverse_left_jacobian_so3, skew
from truing.simulation.change import Change
from truing.simulation.mechanisms.legs.kinematics import attachment_change
from truing.simulation.mechanisms.legs.leg_chain import (
    assembled,
    assembled_change,
    beam_axes,
    condensed_change,
    in_frame,
)
from truing.simulation.mechanisms.legs.reference_pose import HomeChange, home_change
from truing.simulation.mechanisms.structures.equilibrium import PLATFORM_END, Balance, Rest, at_rest, balance, chain_of
from truing.simulation.mechanisms.structures.kinematic_model import shifting
from truing.simulation.mechanisms.structures.structure import Closing, Machine


class StiffnessModel:
    """Closing: readings less those that balance the platform at the pose, deformed as at the readings.

    For six legs, where six equations determine six readings. Fewer leave loads that no reading balances; more can be
    strained against each other, so that the readings do not follow from the pose.
    """

    name = "stiffness"

    def fits(self, machine: Machine) -> bool:
        """Return whether there are six legs whose flexures and tubes are known."""
        known = (machine.flexure_length, machine.flexure, machine.tube)
        return machine.legs.count == 6 and all(part is not None for part in known)

    def close(self, machine: Machine, p: NDArray, R: NDArray, rho: NDArray, change: Change) -> Closing:
        """Return the closing at poses p (B, 3), R (B, 3, 3) and readings rho (B, 6), m.

        Raises ValueError where flexures or tubes are not known.
        """
        rest = at_rest(machine)
        found = balance(machine, rest, p, R, rho)
        response = _response(rest, found)
        by_shift = np.einsum("...lmi,...i->...ml", response.node, R[..., :, 2])
        by_parameter = by_shift @ shifting(machine, rho, change).fields["delta_bz"]
        if change.size:
            by_parameter = by_parameter + _by_parameter(machine, rest, found, response, R, change)
        by_rho = np.eye(6) + by_shift @ machine.deformation
        return Closing(found.excess, _by_twist(found, response), by_rho, by_parameter)


def compliance(machine: Machine, p: NDArray, R: NDArray, rho: NDArray) -> NDArray:
    """Return the twist of the platform per wrench at its origin (B, 6, 6), readings held, at poses in equilibrium.

    Rows m and rad, columns per N and per N m, base frame.
    """
    rest = at_rest(machine)
    found = balance(machine, rest, p, R, rho)
    return np.linalg.solve(_by_twist(found, _response(rest, found)), found.inverse)


@dataclass(frozen=True)
class _Response:
    """How the closing answers at B poses, base frame, leg by leg.

    wrench: to more load on a node (B, L, 6, 6); strain: to more strain (B, L, 6, 6); node: to a motion of the node,
    which moves the arm as well (B, L, 6, 3); turn: to a rotation of the platform that moves no node (B, 6, 3).
    """

    wrench: NDArray
    strain: NDArray
    node: NDArray
    turn: NDArray


def _response(rest: Rest, found: Balance) -> _Response:
    force, moment = found.inverse[..., None, :, :3], found.inverse[..., None, :, 3:]
    by_force = force + moment @ skew(found.arm)
    wrench = np.concatenate([by_force, np.broadcast_to(moment, by_force.shape)], -1)
    strain = wrench @ rest.stiffness
    node = strain[..., :3] - moment @ skew(found.load[..., :3])
    turn = strain[..., 3:].sum(-3) @ inverse_left_jacobian_so3(found.theta)
    return _Response(wrench, strain, node, turn)


def _by_twist(found: Balance, response: _Response) -> NDArray:
    turned = response.turn - np.sum(response.node @ skew(found.arm), -3)
    return np.concatenate([response.strain[..., :3].sum(-3), turned], -1)


def _by_parameter(
    machine: Machine, rest: Rest, found: Balance, response: _Response, R: NDArray, change: Change
) -> NDArray:
    """Return the derivative (B, 6, P) by what the machine is at home: its pose, nodes, drives and stiffness."""
    moved = home_change(machine.legs, rest.home, change)
    home_turn = -response.turn @ R @ np.swapaxes(rest.home.R, -1, -2) @ moved.twist[..., 3:, :]
    answers = (
        response.node @ R[..., None, :, :],
        -response.strain[..., :3],
        -response.strain[..., :3] * found.balanced[..., None, None],
        _by_axis(found, response, rest),
        _by_stiffness(machine, found, response, rest),
    )
    changes = (
        *_node_changes(machine, rest, moved, change),
        _drive_change(machine, moved, change),
        np.cross(rest.home.z[..., None], moved.z, axis=-2),
        _chain_change(machine, change),
    )
    legwise = _summed(np.concatenate(answers, -1), _stacked(changes))
    return legwise + home_turn - change.get("rho0", (machine.legs.count,))


def _summed(answers: NDArray, changes: NDArray) -> NDArray:
    """Return the sum over legs and features of answers (B, L, 6, C) times changes (..., L, C, P), as one product."""
    legs, rows, features = answers.shape[-3:]
    flat = np.swapaxes(answers, -3, -2).reshape(*answers.shape[:-3], rows, legs * features)
    return flat @ changes.reshape(*changes.shape[:-3], legs * features, changes.shape[-1])


def _node_changes(machine: Machine, rest: Rest, moved: HomeChange, change: Change) -> tuple[NDArray, NDArray]:
    """Return the changes (..., L, 3, P) of the nodes b': on the platform, and where they stand at home, base frame."""
    home, legs, turn = rest.home, machine.legs, moved.twist[..., None, 3:, :]
    longer, l_b = change.get("flexure_length", (legs.count,)), chain_of(machine).flexure_length
    half = 0.5 * (home.z[..., None] * longer[..., None, :] + l_b[..., None, None] * moved.z)
    joint = attachment_change(legs, home.R, Change({"b": change.get("b", (legs.count, 3))}, change.size))
    node = np.swapaxes(home.R, -1, -2)[..., None, :, :] @ (joint + half - np.cross(turn, rest.half[..., None], axis=-2))
    arms = legs.b @ np.swapaxes(home.R, -1, -2)
    stands = moved.twist[..., None, :3, :] + np.cross(turn, arms[..., None], axis=-2) + joint + half
    return node, stands


def _drive_change(machine: Machine, moved: HomeChange, change: Change) -> NDArray:
    """Return the change (..., L, 3, P) of `equilibrium.drive`."""
    legs, zero = machine.legs, np.zeros(machine.legs.count)
    closure = legs.closure
    carried = closure.lower_change(legs, zero + 1.0, change) - closure.lower_change(legs, zero, change)
    along = closure.length(legs, zero + 1.0) - closure.length(legs, zero)
    return carried + along[..., None, None] * moved.z


def _by_axis(found: Balance, response: _Response, rest: Rest) -> NDArray:
    """Return the answer (B, L, 6, 3) to a rotation of the legs' stiffness: W ([w]x K e - K [w]x e)."""
    strain = np.concatenate([skew(found.strain[..., :3]), skew(found.strain[..., 3:])], -2)
    load = np.concatenate([skew(found.load[..., :3]), skew(found.load[..., 3:])], -2)
    return response.strain @ strain - response.wrench @ load


def _by_stiffness(machine: Machine, found: Balance, response: _Response, rest: Rest) -> NDArray:
    """Return the answer (B, L, 6, 8) to the inputs of a chain's stiffness, in the order of `assembled_change`."""
    chain = chain_of(machine)
    local = condensed_change(assembled(chain), assembled_change(chain))[..., PLATFORM_END, PLATFORM_END]
    slope = in_frame(local, beam_axes(rest.home.z)[..., None, :, :])
    load = np.einsum("...lqij,...lj->...liq", slope, found.strain)
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
    """Return features (..., L, C, P) one after the other along C, whatever leads them."""
    leading = np.broadcast_shapes(*(part.shape[:-2] for part in parts))
    return np.concatenate([np.broadcast_to(part, (*leading, *part.shape[-2:])) for part in parts], -2)
