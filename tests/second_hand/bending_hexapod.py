"""A hexapod with bending flexures as joints, by the report's circle model (eq. 13 to 17); m and rad.

The end of a flexure of length h stays (1 - beta) h from a point beta h from its root, while its axis points at its
middle. A leg is then shorter or longer by what the quadratic of eq. 15 gives at both ends.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from tests.second_hand.elastic_hexapod import Hexapod
from tests.second_hand.rigid_hexapod import poses

Array = np.ndarray


def reach(cosine: Array, h: float, beta: Array) -> Array:
    """Distance from a flexure's middle along the bent leg to the circle: positive root of eq. 15."""
    half = (0.5 - beta) * h * cosine
    return -half + np.sqrt(half**2 + (0.75 - beta) * h**2)


def bent_poses(machine: Hexapod, reading: Array, beta: Array) -> tuple[Array, Rotation]:
    """Poses (N) at readings (N, 6) of straight legs at ``machine.reading`` with flexures of ``beta`` (6,)."""
    start = np.array([[0, 0, machine.height]])
    p0, turn0, found = poses(
        machine.a, machine.b, (machine.length + machine.reading)[None], start, Rotation.identity(1)
    )
    assert found.all()
    z0 = _directions(machine, p0, turn0)[0]
    p, turn = np.repeat(p0, len(reading), 0), Rotation.from_matrix(np.repeat(turn0.as_matrix(), len(reading), 0))
    length, h = machine.length + reading, machine.flexure_length
    for _ in range(12):
        z = _directions(machine, p, turn)
        carried = np.einsum("nij,lj->nli", (turn * turn0.inv()).as_matrix(), z0)
        lower, upper = np.sum(z * z0, -1), np.sum(z * carried, -1)
        bent = length - h + reach(lower, h, beta) + reach(upper, h, beta)
        p, turn, found = poses(machine.a, machine.b, bent, p, turn)
        assert found.all()
    return p, turn


def _directions(machine: Hexapod, p: Array, turn: Rotation) -> Array:
    leg = p[:, None] + np.stack([turn.apply(one) for one in machine.b], 1) - machine.a
    return leg / np.linalg.norm(leg, axis=-1, keepdims=True)
