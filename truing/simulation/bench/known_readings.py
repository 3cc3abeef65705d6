"""What is known beforehand of a sensor on its bench, and of its load steps; SI."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.optics import Optics
from truing.simulation.bench.six_upur.uncertain_sensor import UncertainSensor

# What nothing is known of: so many times a plausible size.
_FREE = 1e4


@dataclass(frozen=True)
class Zeros:
    """Zeros of run and channel: labels of the runs (Z,), numbers of the channels, prior sigma, whether it is known."""

    run: NDArray
    channel: NDArray
    sigma: NDArray
    known: NDArray

    def at(self, run: NDArray, channels: int) -> NDArray:
        """Return which zero (B, K) each reading counts from; -1 for none."""
        places = {(label, channel): n for n, (label, channel) in enumerate(zip(self.run, self.channel, strict=True))}
        labels = run.tolist()
        return np.array([[places.get((label, k), -1) for k in range(channels)] for label in labels]).reshape(
            -1, channels
        )


def zeros_of(run: NDArray, seen: NDArray, sigma: NDArray, *, signals: int = 0) -> Zeros:
    """Return the zeros of readings seen (B, K) in runs (B,): one of the noise sigma (K,) per run and channel.

    Those of signals, which come last, are free.
    """
    found = [(label, k) for label in dict.fromkeys(run.tolist()) for k in np.flatnonzero(seen[run == label].any(0))]
    labels = np.array([label for label, _ in found], run.dtype)
    channel = np.array([k for _, k in found], int)
    known = channel < len(sigma) - signals
    return Zeros(labels, channel, np.where(known, 1.0, _FREE) * sigma[channel], known)


@dataclass(frozen=True)
class SignalGains:
    """How signals follow leg forces or wrenches: V per N of each leg's force (S,), or rows (S, 6) V per N and N m.

    ``start`` and one prior sigma, of one shape; ``known``: whether the prior is knowledge.
    """

    start: NDArray
    sigma: NDArray
    known: bool = False

    @staticmethod
    def none() -> SignalGains:
        """Return what stands for no signals."""
        return SignalGains(np.zeros(0), np.zeros(0))

    @property
    def are_of_legs(self) -> bool:
        """Return whether each signal is that of one leg."""
        return self.start.ndim == 1


@dataclass(frozen=True)
class KnownReadings:
    """What is known beforehand of a sensor, its bench and the instruments; SI.

    ``channels`` are the platform's six, then the signals; ``sigma`` (K,) their noise; ``largest`` (6,) the largest load
    of each axis; ``load_sigma`` (6,) the noise of loads, 0 where they are exact; ``optics``: how channels see motion.
    """

    sensor: UncertainSensor
    channels: tuple[str, ...]
    sigma: NDArray
    largest: NDArray
    load_sigma: NDArray
    zeros: Zeros
    gains: SignalGains = field(default_factory=SignalGains.none)
    wavelength_m: float = 632.990577e-9
    reference_temperature_c: float = 20.0
    optics: Optics = field(default_factory=Optics.plain)

    @property
    def signals(self) -> int:
        """Return the number of signals S."""
        return len(self.gains.start)


@dataclass(frozen=True)
class ReadingConditions:
    """What is known of B load steps: labels of run and step, time, loads (B, 6) as declared, columns (B,) by name.

    Steps of a run are in the order in which they were taken. ``span_s`` is the first and last time of the campaign.
    """

    run: NDArray
    step: NDArray
    time_s: NDArray
    load: NDArray
    covariates: Mapping[str, NDArray] = field(default_factory=dict)
    span_s: tuple[float, float] | None = None

    @property
    def readings(self) -> NDArray:
        """Return what stands for the readings of actuators: the loads (B, 6)."""
        return self.load

    @property
    def poses(self) -> tuple[str, ...]:
        """Return names of the steps."""
        return tuple(f"run {run} step {step}" for run, step in zip(self.run.tolist(), self.step.tolist(), strict=True))
