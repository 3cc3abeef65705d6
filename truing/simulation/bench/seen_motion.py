"""From what channels read to how the platform moved, where beams are declared to be askew or at an arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.platform_poses import SeenMotion
from truing.simulation.bench.optics import Optics
from truing.simulation.bench.six_upur.nominal_sensor import SimulatedCompliance

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
