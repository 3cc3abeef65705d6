"""A synthetic bench: a stiff platform on six legs, loaded along one axis and read in one channel at a time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

LINEAR_M, ANGULAR_RAD = 0.5e-6, 1e-6
LEVELS = np.array([0, 1, 3, 5, 7, 9, 7, 5, 3, 1, 0, -1, -3, -5, -7, -9, -7, -5, -3, -1, 0]) * 1e3


def made_compliance() -> NDArray:
    """A symmetric positive compliance (6, 6) of the size of a large force sensor, couplings and all."""
    angle = np.radians([42.0, -42.0, -98.0, -122.0, 122.0, 98.0])
    top = np.radians([11.0, -11.0, -130.0, -128.0, 128.0, 130.0])
    foot = 0.55 * np.stack([np.cos(angle), np.sin(angle), np.zeros(6)], -1) - [0.0, 0.0, 0.3]
    head = 0.55 * np.stack([np.cos(top), np.sin(top), np.zeros(6)], -1)
    along = (head - foot) / np.linalg.norm(head - foot, axis=1, keepdims=True)
    screw = np.concatenate([along, np.cross(head, along)], axis=1)
    stiffness = 8e6 * screw.T @ screw + np.diag([2e5] * 3 + [4e4] * 3)
    return np.linalg.inv(stiffness)


@dataclass(frozen=True)
class Log:
    """Rows of runs: each run has one load axis and one channel."""

    wrench: NDArray  # (N, 6)
    channel: NDArray  # (N,)
    reading: NDArray  # (N,)
    sigma: NDArray  # (N,)
    run: NDArray  # (N,)
    step: NDArray  # (N,)
    axis: NDArray  # (N,)
    truth: NDArray  # (N, 6)

    @property
    def displacement(self) -> NDArray:
        """(N, 6) with the channel that was read, NaN elsewhere."""
        out = np.full((len(self.reading), 6), np.nan)
        out[np.arange(len(out)), self.channel] = self.reading
        return out

    @property
    def covariance(self) -> NDArray:
        """(N, 6, 6), infinite where nothing was read."""
        variance = np.full((len(self.reading), 6), np.inf)
        variance[np.arange(len(variance)), self.channel] = self.sigma**2
        return np.where(np.eye(6, dtype=bool), variance[:, None], 0.0)


def made_log(
    rng: np.random.Generator, pairs: list[tuple[int, int]], compliance: NDArray | None = None, noise: float = 1.0
) -> Log:
    """Runs of (axis, channel) pairs; each counts from a zero that is itself read."""
    C = made_compliance() if compliance is None else compliance
    count, steps = len(pairs), len(LEVELS)
    axis, channel = np.repeat(np.array(pairs), steps, axis=0).T
    run, step = np.repeat(np.arange(count), steps), np.tile(np.arange(1, steps + 1), count)
    wrench = np.zeros((count * steps, 6))
    wrench[np.arange(len(run)), axis] = np.tile(LEVELS, count)
    sigma = noise * np.where(channel < 3, LINEAR_M, ANGULAR_RAD)
    truth = wrench @ C.T
    zero = (sigma[::steps] * rng.standard_normal(count))[run]
    reading = truth[np.arange(len(run)), channel] + zero + sigma * rng.standard_normal(len(run))
    return Log(wrench, channel, reading, sigma, run, step, axis, truth)


ALL_PAIRS = [(axis, channel) for axis in range(6) for channel in range(6)]
OWN_PAIRS = [(axis, axis) for axis in range(6)]
