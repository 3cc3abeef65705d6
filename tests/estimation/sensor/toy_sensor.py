"""A synthetic linear sensor, loaded case by case, with noise on loads and signals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.sensor.load_table import LoadTable, load_table

RANGE = np.array([1e4, 1e4, 1e4, 5e3, 5e3, 5e3])


@dataclass(frozen=True)
class ToySensor:
    """Signals V = A F, mV: A (C, 6); standard deviations of one signal (C,) and of one load (6,)."""

    A: NDArray
    signal_sigma: NDArray
    load_sigma: NDArray

    @property
    def signal_cov(self) -> NDArray:
        return np.diag(self.signal_sigma**2)

    @property
    def load_cov(self) -> NDArray:
        return np.diag(self.load_sigma**2)

    def table(self, rng: np.random.Generator, loads: NDArray, case: NDArray, more: NDArray | float = 0.0) -> LoadTable:
        """Return the table recorded at true loads (N, 6), with noise; more (N, C): further parts of the signals."""
        signals = loads @ self.A.T + more
        return load_table(
            signals + rng.normal(size=signals.shape) * self.signal_sigma,
            loads + rng.normal(size=loads.shape) * self.load_sigma,
            case,
            signal_cov=self.signal_cov,
            load_cov=self.load_cov,
        )


def sensor(rng: np.random.Generator, channels: int = 6, signal: float = 0.02, load: float = 1e-3) -> ToySensor:
    """Return a well-conditioned sensor of 10 mV at full load; noise in mV and as a share of the range."""
    A = np.linalg.qr(rng.normal(size=(max(channels, 6), 6)))[0][:channels] + 0.1 * rng.normal(size=(channels, 6))
    return ToySensor(10.0 * A / RANGE, np.full(channels, signal), load * RANGE)


def loads(rng: np.random.Generator, cases: int = 24, steps: int = 5) -> tuple[NDArray, NDArray]:
    """Return true loads (cases * steps, 6) that grow in every case along a direction of its own, and their case."""
    way = rng.uniform(-1.0, 1.0, (cases, 6)) * RANGE
    shares = np.linspace(0.2, 1.0, steps)
    return (way[:, None] * shares[:, None]).reshape(-1, 6), np.repeat(np.arange(cases), steps)


def squares(error: NDArray, covariance: NDArray) -> float:
    """Return the squared length of an error in sigmas."""
    return float(error.ravel() @ np.linalg.solve(covariance, error.ravel()))
