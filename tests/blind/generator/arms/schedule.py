"""Poses of an arm, their order and their temperature, before effects are hidden."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.blind.generator.arms.arm import Arm
from tests.blind.generator.arms.transforms import Array

SPEED = 0.6  # rad/s or m/s of the joint that moves farthest
MOVED = 5.0  # standard deviations of the reading: a smaller step is no movement


@dataclass(frozen=True)
class Schedule:
    """N poses of K joints: exact readings (N, K), m or rad, in the order of time."""

    readings: Array
    time: Array
    warmth: Array  # temperature above the reference temperature, K
    held_out: NDArray[np.bool_]
    series: NDArray[np.int64]
    approach: Array  # (N, K) direction of each joint's last movement

    @property
    def steps(self) -> Array:
        """Movement (N, K) of each joint before each pose; none before the first."""
        return np.diff(self.readings, axis=0, prepend=self.readings[:1])

    @property
    def waits(self) -> Array:
        """Seconds (N,) from the end of the movement to the measurement; the arm leaves after each measurement."""
        passed = np.diff(self.time, prepend=self.time[0] - 60.0)
        return np.asarray(passed - np.minimum(np.abs(self.steps).max(axis=1) / SPEED, 0.8 * passed))


def draw_schedule(arm: Arm, sigmas: Array, rng: np.random.Generator, count: int | None = None) -> Schedule:
    """Draw 40 to 150 poses within the limits of the joints, in up to three series."""
    count = count or int(rng.integers(40, 151))
    low, high = np.array([arm.joints[n].limits for n in arm.actuated]).T
    readings = low + (high - low) * rng.uniform(0.03, 0.97, (count, len(low)))
    time = np.cumsum(rng.uniform(20.0, 60.0, count))
    time -= time[0]
    course = np.sin(2.0 * np.pi * time / time[-1] * rng.uniform(0.3, 1.5) + rng.uniform(0.0, 6.28))
    warmth = rng.uniform(-2.0, 4.0) + rng.uniform(1.0, 4.0) * course + rng.normal(0.0, 0.05, count)
    held = rng.random(count) < (rng.uniform(0.1, 0.3) if rng.random() < 0.8 else 0.0)
    parts = int(rng.integers(1, 4))
    series = np.minimum(np.arange(count) * parts // count, parts - 1)
    return Schedule(readings, time, warmth, held, series, approach(readings, sigmas))


def approach(readings: Array, sigmas: Array) -> Array:
    """Direction (N, K) of the last movement larger than five sigmas of the reading; +1 before any."""
    way = np.ones(readings.shape)
    for n in range(1, len(readings)):
        step = readings[n] - readings[n - 1]
        way[n] = np.where(np.abs(step) > MOVED * sigmas, np.sign(step), way[n - 1])
    return way
