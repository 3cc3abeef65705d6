"""A force sensor on its bench, for the pages about its calibration: nominal geometry, signals, loads and their noise.

Radii, height, cells and range are those of the force-sensor paper. The joints' polar angles are not its authors'
design: they belong to a parameter set with the paper's compliance and condition number (cond G = 6.33 in metres).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.sensor.calibration import newton_per_millivolt
from truing.estimation.sensor.load_table import LoadTable, load_table
from truing.simulation.bench.six_upur.geometry import joint_centres
from truing.simulation.bench.six_upur.influence import influence_matrix

RADIUS_M, HEIGHT_M = 0.55, 0.30
LOWER_DEG, UPPER_DEG = (42.3503, 97.9072, 121.8812), (10.6529, 129.6093, 127.9275)  # legs 1, 6, 5; 2, 3, 4 mirrored
RANGE = np.array([1e4, 1e4, 1e4, 5e3, 5e3, 5e3])  # N, N m
TABLE_3 = np.array([1.0, 3, 5, 7, 9, 7, 5, 3, 1, 0]) / 10
CELL_N_PER_MV = newton_per_millivolt(2000.0, 2.0, 10.0)
LEG_LIMIT_N = 2000.0 * 9.80665
SIGNAL_MV, LOAD_SHARE = 0.01, 1e-3


def _joints(angles: tuple[float, ...]) -> NDArray:
    first = np.radians(angles)
    polar = np.concatenate([[first[0], -first[0]], [-first[1], -first[2], first[2], first[1]]])
    return np.column_stack([RADIUS_M * np.cos(polar), RADIUS_M * np.sin(polar), np.zeros(6)])


def influence() -> NDArray:
    """Return G (6, 6), from forces along the legs to the wrench about the platform's centre, N and N m."""
    return influence_matrix(joint_centres(_joints(LOWER_DEG), _joints(UPPER_DEG), HEIGHT_M))


@dataclass(frozen=True)
class Bench:
    """Signals V = A F (C, 6) in mV of cells on the legs, with noise of signals (mV) and loads (share of the range)."""

    A: NDArray
    signal_mv: float = SIGNAL_MV
    load_share: float = LOAD_SHARE

    @property
    def signal_cov(self) -> NDArray:
        """Return the covariance (C, C) of one row of signals."""
        return np.eye(len(self.A)) * self.signal_mv**2

    @property
    def load_cov(self) -> NDArray:
        """Return the covariance (6, 6) of one applied load."""
        return np.diag((self.load_share * RANGE) ** 2)

    def recorded(
        self, rng: np.random.Generator, loads: NDArray, case: NDArray, more: NDArray | float = 0.0, **columns: NDArray
    ) -> LoadTable:
        """Return the table recorded at true loads (N, 6), with noise; more (N, C): further parts of the signals, mV."""
        signals = loads @ self.A.T + more
        return load_table(
            signals + self.signal_mv * rng.normal(size=signals.shape),
            loads + self.load_share * RANGE * rng.normal(size=loads.shape),
            case,
            signal_cov=self.signal_cov,
            load_cov=self.load_cov,
            **columns,  # type: ignore[arg-type]
        )


def six_channels(**noise: float) -> Bench:
    """Return the sensor with a cell on every leg."""
    return Bench(np.linalg.inv(influence()) / CELL_N_PER_MV, **noise)


def eight_channels(**noise: float) -> Bench:
    """Return the same with two more channels that see the legs too: sums of neighbours, as a bridge may be wired."""
    legs = np.linalg.inv(influence()) / CELL_N_PER_MV
    return Bench(np.concatenate([legs, legs[[0, 3]] + legs[[1, 4]]]), **noise)


def single_axis() -> tuple[NDArray, NDArray]:
    """Return the paper's loads (120, 6), Table 3 for each axis and sign as shares of its range, and their runs."""
    steps = [sign * np.outer(TABLE_3, one) for one in np.eye(6) for sign in (1.0, -1.0)]
    return np.concatenate(steps) * RANGE, np.repeat(np.arange(12), 10)


def along_rays(rng: np.random.Generator, cases: int = 24) -> tuple[NDArray, NDArray]:
    """Return loads (5 cases, 6) that grow along directions of all components at once, and their runs."""
    way = rng.uniform(-1.0, 1.0, (cases, 6))
    shares = np.array([0.2, 0.4, 0.6, 0.8, 1.0])
    return (way[:, None] * shares[:, None]).reshape(-1, 6) * RANGE, np.repeat(np.arange(cases), 5)
