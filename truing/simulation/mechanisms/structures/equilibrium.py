"""Static equilibrium of the platform between elastic legs (telescope report, eq. 19 and 29, signs as corrected).

Every leg is a chain of beams, as stiff as at home; a reading moves its root, or lengthens it, which is the same in
linear theory. As a leg does not answer to a common shift of its ends, P = K21 u_a' + K22 u_b' (eq. 29) is K22 times
the displacement of b' less that of the root. P is the wrench that the platform puts on the leg at b': the sum of all,
moved to the platform's origin, is the external load.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import log_so3
from truing.simulation.mechanisms.legs.geometry import Legs
from truing.simulation.mechanisms.legs.kinematics import attachments
from truing.simulation.mechanisms.legs.leg_chain import Chain, assembled, beam_axes, condensed, in_frame, nodes
from truing.simulation.mechanisms.legs.reference_pose import Home, home_pose
from truing.simulation.mechanisms.structures.structure import Machine, Section

PLATFORM_END = slice(6, 12)  # b' among the ends of a condensed chain


@dataclass(frozen=True)
class Rest:
    """The legs at home, unstrained, in the base frame; batches of machines lead, one axis at least.

    half: half a flexure along its leg (..., L, 3), m; drive: motion of a leg's root per reading (..., L, 3);
    stiffness: K22 (..., L, 6, 6) of the legs at b', the root held.
    """

    home: Home
    half: NDArray
    drive: NDArray
    stiffness: NDArray


@dataclass(frozen=True)
class Balance:
    """The equilibrium at B poses, solved for the readings; base frame.

    arm: from the platform's origin to b' (B, L, 3), m; theta: rotation vector from home (B, 3); inverse: readings per
    force and moment (B, 6, 6); excess: given readings less those that balance (B, 6), m; balanced: those, less rho0;
    strain: displacement of b' less that of the root, and rotation (B, L, 6), load: wrench on b' (B, L, 6), in balance.
    """

    arm: NDArray
    theta: NDArray
    inverse: NDArray
    excess: NDArray
    balanced: NDArray
    strain: NDArray
    load: NDArray


def chain_of(machine: Machine) -> Chain:
    """Return the chains of the legs; raises ValueError where flexures or tubes are not known."""
    l_b, flexure, tube, legs = machine.flexure_length, machine.flexure, machine.tube, machine.legs
    if l_b is None or flexure is None or tube is None:
        raise ValueError("stiffness: found a machine without flexure_length, flexure or tube, expected all three")
    length = legs.closure.length(legs, legs.rho0)
    beams = [np.asarray(k)[..., None] for beam in (flexure, tube) for k in (beam.bending, beam.axial, beam.torsion)]
    parts: list[Any] = list(np.broadcast_arrays(l_b, length - l_b, *beams))
    return Chain(parts[0], parts[1], Section(*parts[2:5]), Section(*parts[5:]))


def at_rest(machine: Machine) -> Rest:
    """Return the legs in the home pose; raises ValueError where flexures or tubes are not known."""
    legs, chain = machine.legs, chain_of(machine)
    home = home_pose(legs)
    local = condensed(assembled(chain))[..., PLATFORM_END, PLATFORM_END]
    half = 0.5 * chain.flexure_length[..., None] * home.z
    return Rest(home, half, drive(legs, home.z), in_frame(local, beam_axes(home.z)))


def drive(legs: Legs, z: NDArray) -> NDArray:
    """Return the motion (..., L, 3) per reading of the roots of legs that keep their direction z (..., L, 3).

    Along the actuator for a 6-pus, along the leg for a ups: from the closure, straight in the readings.
    """
    zero, closure = np.zeros(legs.count), legs.closure
    along = closure.length(legs, zero + 1.0) - closure.length(legs, zero)
    return closure.lower(legs, zero + 1.0) - closure.lower(legs, zero) + along[..., None] * z


def unbalanced(machine: Machine, p: NDArray, R: NDArray, rho: NDArray) -> NDArray:
    """Return the load missing for equilibrium (B, 6), N and N m, at the platform's origin (eq. 33).

    At poses p (B, 3), R (B, 3, 3) and readings rho (B, L), m: the sum of M P over the legs less the external load.
    """
    rest = at_rest(machine)
    arm, theta, shift = _displaced(machine, rest, p, R, rho)
    return _total(arm, _loads(rest, shift, theta, rho - machine.legs.rho0)[1]) - machine.load


def balance(machine: Machine, rest: Rest, p: NDArray, R: NDArray, rho: NDArray) -> Balance:
    """Return the equilibrium of a platform on six legs at poses p (B, 3), R (B, 3, 3), deformed as at rho (B, 6), m."""
    arm, theta, shift = _displaced(machine, rest, p, R, rho)
    moved = rho - machine.legs.rho0
    missing = _total(arm, _loads(rest, shift, theta, moved)[1]) - machine.load
    pushed = -np.einsum("...lij,...lj->...li", rest.stiffness[..., :3], rest.drive)
    inverse = np.linalg.inv(np.swapaxes(_carried(arm, pushed), -1, -2))
    excess = np.einsum("...ij,...j->...i", inverse, missing)
    strain, load = _loads(rest, shift, theta, moved - excess)
    return Balance(arm, theta, inverse, excess, moved - excess, strain, load)


def _displaced(machine: Machine, rest: Rest, p: NDArray, R: NDArray, rho: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Return R b' (B, L, 3), log(R R0') (B, 3) and the displacement of b' (B, L, 3), before eq. 30 as corrected.

    The platform is as it was made at home, so that its deformation counts as displacement.
    """
    legs, home = machine.legs, rest.home
    at_home = nodes(legs.a, legs.b, rest.half, home.R).b
    now = nodes(legs.a, attachments(legs, machine.delta_bz(rho)), rest.half, home.R).b
    arm = now @ np.swapaxes(R, -1, -2)
    gone = (p - home.p)[..., None, :] + arm - at_home @ np.swapaxes(home.R, -1, -2)
    return arm, log_so3(R @ np.swapaxes(home.R, -1, -2)), gone


def _loads(rest: Rest, shift: NDArray, theta: NDArray, moved: NDArray) -> tuple[NDArray, NDArray]:
    """Return strain and load of the legs (B, L, 6) at displacements of their ends and of the readings."""
    apart = shift - moved[..., None] * rest.drive
    strain = np.concatenate([apart, np.broadcast_to(theta[..., None, :], apart.shape)], -1)
    return strain, np.einsum("...ij,...j->...i", rest.stiffness, strain)


def _total(arm: NDArray, load: NDArray) -> NDArray:
    return _carried(arm, load).sum(-2)


def _carried(arm: NDArray, load: NDArray) -> NDArray:
    """Return wrenches (B, L, 6) at arms (B, L, 3) as they are about the platform's origin: M P (eq. 19)."""
    force, moment = np.broadcast_arrays(load[..., :3], arm)[0], load[..., 3:]
    return np.concatenate([force, moment + np.cross(arm, force)], -1)
