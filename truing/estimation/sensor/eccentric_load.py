"""Line of action of a force from its wrench, and the moment that no line explains.

A force f along a line through r has the moment r x f. One wrench determines r except for a shift along f.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.covariance import symmetric
from truing.estimation.rotation import skew


@dataclass(frozen=True)
class LineOfAction:
    """Lines of action of B forces.

    arm (B, 3), m: to the point nearest to the origin, with covariance (B, 3, 3); along (B,), N m: moment about the
    force's own direction, which no line explains, with its sigma (B,).
    """

    arm: NDArray
    covariance: NDArray
    along: NDArray
    along_sigma: NDArray

    @property
    def length(self) -> NDArray:
        """Lever arms (B,), m."""
        return np.sqrt(np.sum(self.arm**2, -1))


def line_of_action(wrench: NDArray, covariance: NDArray) -> LineOfAction:
    """Return the lines of action from wrenches (B, 6), N and N m, of covariance (B, 6, 6): ``r = f x m / |f|^2``.

    Raises ValueError for a wrench without force.
    """
    f, m = wrench[:, :3], wrench[:, 3:]
    square = np.sum(f * f, -1)
    if not np.all(square > 0):
        raise ValueError("found a wrench without a force, expected one that has a line of action")
    arm = np.cross(f, m) / square[:, None]
    # derivatives by f: (-[m]x - 2 r f^T) / |f|^2; by m: [f]x / |f|^2
    by_force = (-skew(m) - 2.0 * arm[:, :, None] * f[:, None]) / square[:, None, None]
    by = np.concatenate([by_force, skew(f) / square[:, None, None]], axis=2)
    size = np.sqrt(square)
    along = np.sum(f * m, -1) / size
    turn = np.concatenate([(m - (along / size)[:, None] * f), f], axis=1) / size[:, None]
    spread = np.einsum("bi,bij,bj->b", turn, covariance, turn)
    return LineOfAction(arm, symmetric(by @ covariance @ np.swapaxes(by, 1, 2)), along, np.sqrt(spread))
