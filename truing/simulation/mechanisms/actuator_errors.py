"""Errors of a platform's pose by errors of its actuators, to first order (telescope report, section 2.3).

An actuator is within its stated accuracy, +- a, of its reading. The pose is then within a zonotope: its farthest corner
has every actuator at one end, and the size of this corner is exact for the linearised machine.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from truing.simulation.mechanisms.legs.kinematics import solve_rows
from truing.simulation.mechanisms.pose_regressors import Placed
from truing.simulation.mechanisms.structures.structure import NO_CHANGE, Machine, Structure

# Components of a pose error, then the lengths of its position and of its rotation vector.
QUANTITIES = ("x", "y", "z", "rx", "ry", "rz", "position", "orientation")
MOST_LEGS = 12  # the corners of an error double with each leg
_NORMS = (slice(0, 3), slice(3, 6))


@dataclass(frozen=True)
class ActuatorErrors:
    """Errors of B poses by L actuators; ``gain`` (B, 6, L), m and rad: by each actuator at the end of its accuracy."""

    gain: NDArray

    @cached_property
    def worst(self) -> NDArray:
        """Largest error (B, 8) of each of QUANTITIES, m and rad, over all signs of the actuators' errors."""
        norms = [np.linalg.norm(corner, axis=-1) for corner in self._corners]
        return np.concatenate([np.abs(self.gain).sum(-1), np.stack(norms, -1)], -1)

    @cached_property
    def sigma(self) -> NDArray:
        """Standard deviation (B, 8), m and rad, of actuators spread evenly over +- a; of a length: its rms."""
        variance = np.sum(self.gain**2, -1) / 3.0
        norms = [variance[:, part].sum(-1) for part in _NORMS]
        return np.sqrt(np.concatenate([variance, np.stack(norms, -1)], -1))

    @cached_property
    def shares(self) -> NDArray:
        """Share (B, 8, L) of each leg in the largest error, along the direction of that error; 0 or more, sum 1."""
        size = np.abs(self.gain)
        along = [
            np.abs(np.einsum("bk,bkl->bl", corner, self.gain[:, part]))
            for part, corner in zip(_NORMS, self._corners, strict=True)
        ]
        parts = np.concatenate([size, np.stack(along, 1)], 1)
        total = parts.sum(-1, keepdims=True)
        return np.where(total > 0.0, parts / np.where(total > 0.0, total, 1.0), 0.0)

    @cached_property
    def _corners(self) -> tuple[NDArray, NDArray]:
        """Farthest error (B, 3) of the position and of the orientation."""
        signs = np.array(list(product((1.0,), *[(-1.0, 1.0)] * (self.gain.shape[-1] - 1))))
        farthest_corners = []
        for part in _NORMS:
            corners = self.gain[:, part] @ signs.T
            farthest = np.argmax(np.einsum("bks,bks->bs", corners, corners), -1)
            farthest_corners.append(corners[np.arange(len(corners)), :, farthest])
        return farthest_corners[0], farthest_corners[1]


def actuator_errors(structure: Structure, machine: Machine, placed: Placed, accuracy: NDArray) -> ActuatorErrors:
    """Return the errors of configurations (B) by actuators within +- accuracy (L,), m.

    Raises ValueError for fewer than six legs, and for more than MOST_LEGS.
    """
    if machine.legs.count > MOST_LEGS:
        raise ValueError(f"at most {MOST_LEGS} legs, because the combinations of their errors double with each leg")
    closing = structure.close(machine, placed.p, placed.R, placed.rho, NO_CHANGE)
    return ActuatorErrors(-solve_rows(closing.by_twist, closing.by_rho) * accuracy)
