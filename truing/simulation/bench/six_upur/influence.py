"""Leg forces and the wrench on the platform: the influence matrix G and its merit (force-sensor paper, eq. 1-4, 35-37).

`F_w = G F_a`: a wrench (f; m) on the platform at its origin and the forces along the legs, tension positive.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.six_upur.geometry import JointCentres


def influence_matrix(joints: JointCentres) -> NDArray:
    """Return G (..., 6, 6), 1 and m: its columns are the legs' screws (S; r x S) about the platform's origin.

    The moment part as printed, (r_b x r_B) / L, is the negative of that.
    """
    S = joints.direction
    return np.swapaxes(np.concatenate([S, np.cross(joints.arm, S)], -1), -1, -2)


def moments_about(G: NDArray, point: NDArray) -> NDArray:
    """Return G with its moments about a point (..., 3), m from the platform's origin."""
    force, moment = G[..., :3, :], G[..., 3:, :]
    return np.concatenate([force, moment - np.cross(point[..., None], force, axis=-2)], -2)


def per_length(G: NDArray, length_m: float) -> NDArray:
    """Return G without units: moments over a characteristic length; 1 m leaves it unchanged, 1 mm gives G in mm."""
    return G / _levers(length_m)[:, None]


def characteristic_length(G: NDArray) -> NDArray:
    """Return the length (...), m, at which moments weigh as much as forces: the legs' rms distance from the origin."""
    return np.sqrt(np.sum(G[..., 3:, :] ** 2, (-1, -2)) / np.sum(G[..., :3, :] ** 2, (-1, -2)))


def sensitivities(G: NDArray) -> NDArray:
    """Return the norm (..., 6) of the six leg forces per unit of each load: column norms of J = 1 / G; 1, then 1/m.

    For any unit screws, the reciprocal squares of the first three add up to 6 at most (`force_bound`).
    """
    J = np.linalg.inv(G)
    return np.sqrt(np.sum(J * J, -2))


def force_bound(sensitivity: NDArray) -> NDArray:
    """Return the sum (...) of 1/S^2 over the forces, of sensitivities (..., 6): at most the number of legs.

    The rows of G times the columns of its inverse are 1. The squared force rows of unit screws add up to the number of
    legs; so the sum is at most 6 for six unit screws.
    """
    return np.sum(sensitivity[..., :3] ** -2.0, -1)


@dataclass(frozen=True)
class Merit:
    """Figures of merit of G, moments over a characteristic length."""

    length_m: float
    condition: NDArray  # (...) of the 2-norm
    isotropy: NDArray  # (...) 1 / condition: 1 if all wrenches are measured equally well
    force_isotropy: NDArray  # (...) smallest over largest singular value of the force rows
    torque_isotropy: NDArray  # (...) the same of the moment rows; independent of the length
    sensitivity: NDArray  # (..., 6)


def merit(G: NDArray, length_m: float = 1.0) -> Merit:
    """Return the merit of G (..., 6, 6); raises LinAlgError if six legs do not hold the platform."""
    scaled = per_length(G, length_m)
    total, force, torque = (_isotropy(rows) for rows in (scaled, scaled[..., :3, :], scaled[..., 3:, :]))
    return Merit(length_m, 1.0 / total, total, force, torque, sensitivities(scaled))


def _isotropy(rows: NDArray) -> NDArray:
    values = np.linalg.svd(rows, compute_uv=False)
    return values[..., -1] / values[..., 0]


def _levers(length_m: float) -> NDArray:
    return np.repeat([1.0, length_m], 3)


def roll_pitch_yaw(angles: NDArray) -> NDArray:
    """Return Rz Ry Rx (..., 3, 3) of angles (..., 3), rad, about x, y, z: eq. 30 as corrected.

    The printed matrix is its transpose, and turns the platform the other way.
    """
    (cx, cy, cz), (sx, sy, sz) = (np.moveaxis(f(angles), -1, 0) for f in (np.cos, np.sin))
    rows = (
        (cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx),
        (sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx),
        (-sy, cy * sx, cy * cx),
    )
    return np.stack([np.stack(row, -1) for row in rows], -2)


def displaced_joints(joints: JointCentres, error: NDArray) -> JointCentres:
    """Return the joints with the platform displaced by errors (..., 6), m and rad, of its origin (eq. 29, 31)."""
    return joints.displaced(error[..., :3], roll_pitch_yaw(error[..., 3:]))


def influence_with_error(joints: JointCentres, error: NDArray) -> NDArray:
    """Return G' (..., 6, 6), moments about the displaced origin, for synthetic errors (..., 6) (eq. 32)."""
    return influence_matrix(displaced_joints(joints, error))
