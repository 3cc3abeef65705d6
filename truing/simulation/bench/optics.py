"""How channels see the platform's motion, as it is declared: beams askew or at an arm, and a frame that grows.

Declared geometry is no error: causes find what is left. What is declared to be uncertain is among the unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.load_steps import MATERIAL, LoadSteps

_AXES = 6


@dataclass(frozen=True)
class Optics:
    """Rows (6, 6) by which the channels follow displacement and rotation vector, SI, and how well they are known.

    ``by_angle`` (U, 6, 6) is how rows change per prior sigma of each angle or arm, ``growth`` (V, 6) one sigma of what
    each frame's expansion leaves in readings per kelvin of the material since the start of the run.
    """

    rows: NDArray
    by_angle: NDArray
    growth: NDArray

    @staticmethod
    def plain() -> Optics:
        """Return channels along their own axes through the platform's origin."""
        return Optics(np.eye(_AXES), np.zeros((0, _AXES, _AXES)), np.zeros((0, _AXES)))

    @property
    def size(self) -> int:
        """Return the number of unknowns: of angles and arms, then of growth."""
        return len(self.by_angle) + len(self.growth)

    def rows_at(self, unknowns: NDArray) -> NDArray:
        """Return the rows (6, 6) at unknowns (U + V,) in prior sigmas."""
        return np.asarray(self.rows + np.einsum("u,uij->ij", unknowns[: len(self.by_angle)], self.by_angle))

    def grown(self, steps: LoadSteps, unknowns: NDArray) -> NDArray:
        """Return what the frame's growth leaves in readings (B, 6) of load steps."""
        return np.asarray(_warmer(steps)[:, None] * (unknowns[len(self.by_angle) :] @ self.growth))

    def slopes(self, steps: LoadSteps, motion: NDArray) -> NDArray:
        """Return the derivatives (B, 6, U + V) of readings by the unknowns, at motions (B, 6) of the platform."""
        by_angle = np.einsum("uij,bj->biu", self.by_angle, motion)
        return np.concatenate([by_angle, _warmer(steps)[:, None, None] * self.growth.T], -1)


def _warmer(steps: LoadSteps) -> NDArray:
    """Return by how much the material (B,) is warmer than at the start of the run; not at all where nobody read it."""
    return steps.since_first(MATERIAL) if MATERIAL in steps.covariates else np.zeros(len(steps.run))
