"""Assembly and load together: the platform's synthetic error and G' (force-sensor paper, eq. 29-32)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.six_upur.geometry import JointCentres
from truing.simulation.bench.six_upur.influence import influence_matrix


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
