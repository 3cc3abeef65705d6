"""Poses of an arm's links: exact kinematics with elastic joints and links under gravity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.blind.generator.arms.arm import STANDARD_GRAVITY, Arm
from tests.blind.generator.arms.transforms import Array, rotation

ROUNDS = 4  # of loads and deflections: each one gains at least three digits


@dataclass(frozen=True)
class State:
    """Physical state in N poses, SI: angles (N, K) of actuated joints, elasticity, growth (N, L) of each link's
    vectors, motion (N, 6) of the base in its own frame, shifts (N, M, 3) of targets in their body's frame, and motion
    (N, K, 6) of the carriages of slides in the frames of their links."""

    angles: Array
    compliance: Array
    flexibility: Array
    growth: Array
    twist: Array
    shift: Array
    carriage: Array

    @property
    def elastic(self) -> bool:
        """Return True if any part yields to gravity."""
        return bool(np.any(self.compliance) or np.any(self.flexibility))


@dataclass(frozen=True)
class Places:
    """Rotations (N, L, 3, 3) and origins (N, L, 3) of all links in the base frame."""

    turned: Array
    moved: Array


def at_rest(arm: Arm, angles: Array, targets: int) -> State:
    """A state with nothing hidden."""
    count, links = len(angles), len(arm.links)
    return State(
        angles,
        np.zeros(angles.shape[1]),
        np.zeros(links),
        np.zeros((count, links)),
        np.zeros((count, 6)),
        np.zeros((count, targets, 3)),
        np.zeros((*angles.shape, 6)),
    )


def places(arm: Arm, state: State) -> Places:
    """All links' places; deflections are in balance with the loads of the deflected arm."""
    found = _rigid(arm, state.angles, state, {})
    for _ in range(ROUNDS if state.elastic else 0):
        angles = state.angles + state.compliance * gravity_torques(arm, found)
        found = _rigid(arm, angles, state, _bends(arm, state.flexibility, found))
    return found


def _rigid(arm: Arm, angles: Array, state: State, bends: dict[int, tuple[Array, Array]]) -> Places:
    count, growth = len(angles), state.growth
    turned, moved = np.tile(np.eye(3), (count, len(arm.links), 1, 1)), np.zeros((count, len(arm.links), 3))
    free: dict[int, Array] = {}
    for number, joint in enumerate(arm.joints):
        own, point = joint.origin[:3, :3], joint.origin[:3, 3] * (1.0 + growth[:, joint.parent, None])
        if joint.parent in bends:
            shift, turn = bends[joint.parent]
            point, own = point + shift, rotation(turn) @ own
        above = turned[:, joint.parent] @ own
        base = moved[:, joint.parent] + np.einsum("nij,nj->ni", turned[:, joint.parent], point)
        value = joint.factor * angles[:, joint.source] + joint.shift if joint.source >= 0 else np.zeros(count)
        if arm.loops is not None and number in arm.passive:
            free = free or dict(zip(arm.passive, arm.loops.values(arm, turned, moved, growth).T, strict=True))
            value = free[number]
        if joint.kind == "revolute":
            above = above @ rotation(value[:, None] * joint.axis)
        elif joint.kind == "prismatic":
            base = base + np.einsum("nij,nj->ni", above, value[:, None] * joint.axis)
            if joint.source >= 0:
                base = base + np.einsum("nij,nj->ni", above, state.carriage[:, joint.source, :3])
                above = above @ rotation(state.carriage[:, joint.source, 3:])
        turned[:, joint.child], moved[:, joint.child] = above, base
    return Places(turned, moved)


def _masses(arm: Arm, found: Places) -> tuple[Array, Array, Array]:
    """Masses (B,), their centres (N, B, 3) in the base frame, the links (B,) that carry them; the payload is last."""
    masses = np.array([*(link.mass for link in arm.links), arm.payload])
    carriers = np.array([*range(len(arm.links)), arm.tips[0]])
    own = np.array([*(link.com for link in arm.links), arm.payload_com])
    centres = found.moved[:, carriers] + np.einsum("nbij,bj->nbi", found.turned[:, carriers], own)
    return masses, centres, carriers


def _load(arm: Arm, found: Places, joint: int) -> tuple[Array, Array]:
    """Weight (N, 3), N, of all that a joint carries, and its moment (N, 3), N m, about the joint's origin."""
    masses, centres, carriers = _masses(arm, found)
    carried, origin = masses * np.isin(carriers, arm.outboard(joint)), found.moved[:, None, arm.joints[joint].child]
    weight = np.tile(STANDARD_GRAVITY * arm.gravity * carried.sum(), (len(origin), 1))
    moment = np.cross(np.einsum("b,nbi->ni", carried, centres - origin), STANDARD_GRAVITY * arm.gravity)
    if arm.loops is None:
        return weight, moment
    hung = masses[np.isin(carriers, arm.outboard(arm.passive[0]))].sum()
    links, pulls = arm.loops.pulls(arm, found.moved, STANDARD_GRAVITY * hung)
    own = np.isin(links, arm.outboard(joint))
    places_ = found.moved[:, links[own]] - origin
    return weight + pulls[:, own].sum(1), moment + np.cross(places_, pulls[:, own]).sum(1)


def gravity_torques(arm: Arm, found: Places) -> Array:
    """Torque (N, K) of gravity along each actuated joint, N m (N for a slide), with that of joints that follow it."""
    torques = np.zeros((len(found.moved), len(arm.actuated)))
    for number, joint in enumerate(arm.joints):
        if joint.source < 0:
            continue
        axis = found.turned[:, joint.child] @ joint.axis
        weight, moment = _load(arm, found, number)
        load = weight if joint.kind == "prismatic" else moment
        torques[:, joint.source] += joint.factor * np.sum(axis * load, axis=1)
    return torques


def base_moment(arm: Arm, found: Places) -> Array:
    """Moment (N, 3), N m, of all weights about the origin of the base link, in its frame."""
    masses, centres, _ = _masses(arm, found)
    return np.cross(np.einsum("b,nbi->ni", masses, centres), STANDARD_GRAVITY * arm.gravity)


def potential_energy(arm: Arm, found: Places) -> Array:
    """Potential energy (N,) of all masses in the field of gravity, J."""
    masses, centres, _ = _masses(arm, found)
    return np.asarray(-STANDARD_GRAVITY * np.einsum("b,nbi,i->n", masses, centres, arm.gravity))


def _bends(arm: Arm, flexibility: Array, found: Places) -> dict[int, tuple[Array, Array]]:
    """Shift (N, 3) and turn (N, 3) of the end of every bent link, in the link's frame.

    Euler beam, clamped at the link's frame, loaded at its end by the weight and moment of all beyond.
    """
    bent: dict[int, tuple[Array, Array]] = {}
    for link in np.flatnonzero(flexibility):
        (end,) = arm.children(int(link))
        length = float(np.linalg.norm(arm.joints[end].origin[:3, 3]))
        along = arm.joints[end].origin[:3, 3] / length
        weight, moment = _load(arm, found, end)
        back = np.swapaxes(found.turned[:, link], -1, -2)
        force, torque = np.einsum("nij,nj->ni", back, weight), np.einsum("nij,nj->ni", back, moment)
        torque = torque - np.outer(torque @ along, along)
        lever = np.cross(along, force)
        turn = flexibility[link] * (length * torque + length**2 / 2.0 * lever)
        shift = flexibility[link] * np.cross(length**2 / 2.0 * torque + length**3 / 3.0 * lever, along)
        bent[int(link)] = (shift, turn)
    return bent
