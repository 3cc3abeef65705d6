"""How channels see the platform's motion as declared: beams askew or at an arm, a frame that grows; and the way back.

Declared geometry is no error: causes find what is left. What is declared to be uncertain is among the unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.platform_poses import SeenMotion
from truing.simulation.bench.load_steps import MATERIAL, LoadSteps
from truing.simulation.bench.six_upur.nominal_sensor import SimulatedCompliance

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


Array = NDArray[np.float64]

_NOTHING = 1e-12  # of a component in another one, SI


@dataclass(frozen=True)
class BeamGeometry:
    """How beams see the platform as declared; the simulation, if there is one, tells what was not measured."""

    optics: Optics
    simulated: SimulatedCompliance | None

    def solved(self, load: Array, read: Array, covariance: Array) -> SeenMotion:
        """The motions of cases under loads (K, 6) by what their channels read (K, 6), NaN where nothing was.

        A component that no channel read is simulated to tell what of it is in the others: it stays unknown itself, and
        so does, without a simulation, what holds some of it.
        """
        seen = np.isfinite(read)
        expected, spread = self._expected(load)
        inverse = np.linalg.inv(np.where(seen[:, :, None], self.optics.rows, np.eye(6)))
        filled = np.einsum("kij,kj->ki", inverse, np.where(seen, read, np.nan_to_num(expected)))
        missing = ~seen & ~np.isfinite(expected)
        known = seen & ~np.einsum("kij,kj->ki", np.abs(inverse) > _NOTHING, missing)
        by_angle = np.where(seen[:, :, None], np.einsum("uij,kj->kiu", self.optics.by_angle, filled), 0.0)
        own = np.where(seen, np.einsum("kii->ki", covariance), np.nan_to_num(spread))
        inner = own[:, :, None] * np.eye(6) + by_angle @ np.swapaxes(by_angle, 1, 2)
        whole = inverse @ inner @ np.swapaxes(inverse, 1, 2)
        both = known[:, :, None] & known[:, None, :]
        more = self.optics.rows - np.eye(6)
        common = np.where(seen, 0.0, np.nan_to_num(spread)) @ (more**2).T + np.sum(by_angle**2, -1)
        return SeenMotion(
            np.where(known, filled, np.nan),
            np.where(both, whole, np.where(np.eye(6, dtype=bool), np.inf, 0.0)),
            np.where(known, filled @ more.T, np.nan),
            np.where(known, np.sqrt(common), np.nan),
        )

    def _expected(self, load: Array) -> tuple[Array, Array]:
        """Simulated motions (K, 6) and their variances; NaN without a simulation."""
        if self.simulated is None:
            return np.full(load.shape, np.nan), np.full(load.shape, np.nan)
        by_load = self.simulated.covariance.reshape(6, 6, 6, 6)
        return load @ self.simulated.entries.T, np.einsum("ka,iaib,kb->ki", load, by_load, load)
