"""A hexapod with ideal joints: poses by Newton's method, many at once; m, rad."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

Array = np.ndarray


def spans(a: Array, b: Array, p: Array, turn: Rotation) -> Array:
    """Distances (N, L) of the joints of the legs at N poses: the inverse problem of ideal legs."""
    return np.linalg.norm(p[:, None] + np.stack([turn.apply(one) for one in b], 1) - a, axis=-1)


def poses(a: Array, b: Array, length: Array, p: Array, turn: Rotation) -> tuple[Array, Rotation, Array]:
    """Poses whose joints are ``length`` (N, 6) apart, from starts p (N, 3) and ``turn``; and which were found."""
    for _ in range(40):
        arm = np.stack([turn.apply(one) for one in b], 1)
        leg = p[:, None] + arm - a
        span = np.linalg.norm(leg, axis=-1)
        slope = np.concatenate([leg, np.cross(arm, leg)], -1) / span[..., None]
        step = np.einsum("nij,nj->ni", np.linalg.pinv(slope), length - span)
        step /= np.maximum(1.0, np.abs(step).max(1) / 0.1)[:, None]  # no farther than 0.1 m or rad at a time
        p, turn = p + step[:, :3], Rotation.from_rotvec(step[:, 3:]) * turn
        if np.abs(step).max() < 1e-14:
            break
    return p, turn, np.abs(spans(a, b, p, turn) - length).max(1) < 1e-11
