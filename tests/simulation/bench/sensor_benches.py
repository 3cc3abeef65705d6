"""Benches with a force sensor, as arrays: runs up and down along each axis, all channels and signals."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from tests.simulation.bench.six_upur.sensors import TOLERANCES_UM, sensor_of
from truing.simulation.bench.known_readings import KnownReadings, ReadingConditions, SignalGains, zeros_of
from truing.simulation.bench.load_steps import AIR, CHANNELS, HUMIDITY, MATERIAL, PRESSURE
from truing.simulation.bench.model import BenchModel
from truing.simulation.bench.six_upur.stiffness import ElasticSensor
from truing.simulation.bench.six_upur.uncertain_sensor import UncertainSensor
from truing.simulation.cause import Cause

ARCSEC = np.pi / 180.0 / 3600.0
LARGEST = np.array([1e4] * 3 + [5e3] * 3)
SIGMA = np.array([0.5e-6] * 3 + [0.2 * ARCSEC] * 3 + [1e-5] * 6)
WAVELENGTH_M = 632.990577e-9
# Up and down both ways, with the steps of a run in shares of the range.
CYCLE = np.array([0, 1, 3, 5, 7, 9, 7, 5, 3, 1, 0, -1, -3, -5, -7, -9, -7, -5, -3, -1, 0]) / 10.0
GAINS = 1e-6 * np.array([1.1, 0.9, 1.3, 0.8, 1.0, 1.2])  # V/N


@dataclass(frozen=True)
class Bench:
    """A sensor and its conditions, and which of the readings and signals (B, K) there are."""

    sensor: ElasticSensor
    conditions: ReadingConditions
    is_observed: NDArray
    load_sigma: NDArray
    stiffness_sigma: float = 0.02

    def model(self, *causes: Cause, signals: bool = True) -> BenchModel:
        """Return the model of the bench."""
        count = len(CHANNELS) + 6 * signals
        names = (*CHANNELS, *(f"v{n}" for n in range(1, 7)))[:count]
        sigma, is_observed = SIGMA[:count], self.is_observed[:, :count]
        tolerance = np.array(TOLERANCES_UM) * 1e-6 / 6.0
        known = KnownReadings(
            UncertainSensor(self.sensor.joints, self.sensor, None, tolerance, self.stiffness_sigma),
            names,
            sigma,
            LARGEST,
            self.load_sigma,
            zeros_of(self.conditions.run, is_observed, sigma, signals=6 * signals),
            SignalGains(GAINS, 10.0 * GAINS) if signals else SignalGains.none(),
            WAVELENGTH_M,
        )
        return BenchModel(known, self.conditions).with_causes(causes)


@cache
def bench(seed: int = 0, *, lone: bool = False, together: int = 0, load_sigma: float = 0.0) -> Bench:
    """Return a bench: one run per axis with all channels; ``lone``: one run per axis and channel; ``together``: so many
    runs of random loads along all axes."""
    rng = np.random.default_rng(seed)
    if together:
        loads = rng.choice(CYCLE, (together * len(CYCLE), 6)) * LARGEST
    else:
        loads = np.concatenate([CYCLE[:, None] * LARGEST * axis for axis in np.eye(6)])
    runs = loads.reshape(-1, len(CYCLE), 6)
    watched = np.ones((len(runs), len(CHANNELS)), bool)
    if lone:
        runs, watched = np.repeat(runs, 6, 0), np.tile(np.eye(6, dtype=bool), (len(runs), 1))
    count, size = len(runs), len(CYCLE)
    pauses = np.where(np.arange(count * size) % size == 0, 900.0, rng.uniform(50.0, 90.0, count * size))
    time = np.cumsum(pauses) - pauses[0]
    air = 20.0 + np.cumsum(rng.normal(0.0, 0.05, len(time)))
    surroundings = {
        AIR: air,
        MATERIAL: 20.0 + np.cumsum(rng.normal(0.0, 0.03, len(time))),
        PRESSURE: 1013.0 + np.cumsum(rng.normal(0.0, 0.1, len(time))),
        HUMIDITY: 45.0 + np.cumsum(rng.normal(0.0, 0.2, len(time))),
    }
    conditions = ReadingConditions(
        np.repeat(np.arange(1, count + 1), size),
        np.tile(np.arange(size), count),
        time,
        runs.reshape(-1, 6),
        surroundings,
        (0.0, float(time[-1])),
    )
    is_observed = np.concatenate([np.repeat(watched, size, 0), np.ones((count * size, 6), bool)], 1)
    errors = load_sigma * LARGEST
    return Bench(sensor_of("A"), conditions, is_observed, errors)
