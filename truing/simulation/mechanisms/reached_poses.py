"""Where a calibrated machine says the platform stands, and how sure it is: readings and parameters propagated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.change import Change
from truing.simulation.mechanisms.legs.kinematics import solve_rows
from truing.simulation.mechanisms.structures.structure import Machine, Structure, poses_at

# A platform whose legs hold one of its motions so much less than another is not held; motions counted in m and rad.
_SINGULAR = 1e8
_LENGTHS = np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])  # what a rad moves, m


@dataclass(frozen=True)
class ReachedPoses:
    """Poses p (B, 3) m, R (B, 3, 3), and whether the legs closed and hold it; its twist (v; omega), base frame, per
    reading (B, 6, L) and per parameter (B, 6, P)."""

    p: NDArray
    R: NDArray
    by_rho: NDArray
    by_parameter: NDArray
    converged: NDArray

    def covariance(self, reading_sigma: float, parameters: NDArray) -> NDArray:
        """Return the covariance (B, 6, 6) from readings of one sigma, m, and from parameters (P, P)."""
        readings = reading_sigma**2 * self.by_rho @ np.swapaxes(self.by_rho, -1, -2)
        return readings + self.by_parameter @ parameters @ np.swapaxes(self.by_parameter, -1, -2)


def reached_poses(structure: Structure, machine: Machine, rho: NDArray, change: Change) -> ReachedPoses:
    """Return the poses at readings rho (B, L), m, with their derivatives by a change of the machine.

    Raises ValueError for fewer than six legs, whose readings do not say where the platform is.
    """
    found = poses_at(structure, machine, rho)
    closing = structure.close(machine, found.p, found.R, rho, change)
    fixed = found.converged & (np.linalg.cond(closing.by_twist / _LENGTHS) < _SINGULAR)
    rows = np.where(fixed[:, None, None], closing.by_twist, np.eye(rho.shape[-1], 6))
    twist = -solve_rows(rows, np.concatenate([closing.by_rho, closing.by_parameter], -1))
    legs = rho.shape[-1]
    return ReachedPoses(found.p, found.R, twist[..., :legs], twist[..., legs:], fixed)
