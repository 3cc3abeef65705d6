"""What each leg adds to a given stiffness of the platform, where nobody told what the legs are made of.

The six legs of a sensor are made alike, and turned about their own axis they answer alike: five numbers, which the 21
of a platform's stiffness leave no choice of. What such legs do not explain is shared among them by the forces along
them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.six_upur.geometry import JointCentres
from truing.simulation.bench.six_upur.influence import influence_matrix
from truing.simulation.bench.six_upur.stiffness import end_transport

_LEGS = 6
_KINDS = 5  # along, across, twist, bend, and across by bending
_NEARLY_PASSIVE = 1e-2  # of the platform's own: a leg that gives energy by more is none


def alike_legs(stiffness: NDArray, joints: JointCentres) -> NDArray:
    """Return the stiffness (6, 6, 6), SI, about the platform's origin, of legs that add up to a given one (6, 6)."""
    scale = 1.0 / np.sqrt(np.diag(stiffness))
    scaled = scale[:, None] * scale
    kinds = _kinds(stiffness, joints)
    design = (kinds.sum(1) * scaled).reshape(_KINDS, -1).T
    sizes = np.linalg.lstsq(design, (stiffness * scaled).ravel(), rcond=None)[0]
    own = np.tensordot(sizes, kinds, 1)
    if np.linalg.eigvalsh(own * scaled).min() < -_NEARLY_PASSIVE:
        own = np.zeros_like(own)
    return own + _by_axial_forces(stiffness - own.sum(0), joints)


def _kinds(stiffness: NDArray, joints: JointCentres) -> NDArray:
    """Return each kind of leg stiffness (5, 6, 6, 6), by leg, of one N/m; of moments, at the platform's own length."""
    moments, forces = np.trace(stiffness[3:, 3:]), np.trace(stiffness[:3, :3])
    length = np.sqrt(moments / forces)
    along = joints.direction[:, :, None] * joints.direction[:, None, :]
    turned = np.cross(joints.direction[:, None, :], np.eye(3)).swapaxes(-1, -2) * length
    own = np.zeros((_KINDS, _LEGS, 6, 6))
    own[0, :, :3, :3] = along
    own[1, :, :3, :3] = np.eye(3) - along
    own[2, :, 3:, 3:] = along * length**2
    own[3, :, 3:, 3:] = (np.eye(3) - along) * length**2
    own[4, :, :3, 3:], own[4, :, 3:, :3] = turned, turned.swapaxes(-1, -2)
    transport = end_transport(joints.arm, np.broadcast_to(np.eye(3), (_LEGS, 3, 3)))
    return np.asarray(transport @ own @ transport.swapaxes(-1, -2))


def _by_axial_forces(stiffness: NDArray, joints: JointCentres) -> NDArray:
    """Return the parts (6, 6, 6) of a stiffness that go with the force along each leg: exact where that is all."""
    G = influence_matrix(joints)
    shares = G.T[:, :, None] * np.linalg.inv(G)[:, None, :] @ stiffness
    return np.asarray(0.5 * (shares + shares.swapaxes(-1, -2)))
