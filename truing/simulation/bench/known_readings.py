"""Prior knowledge of a sensor on its bench: load steps, channel geometry (`Optics`), zeros and gains; SI.

Declared geometry (inclined or offset beams, an expanding frame) is part of the model, and causes act in addition.
Numbers with a declared uncertainty are unknowns.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.load_run import zeros_of_runs
from truing.estimation.interferometry.platform_poses import EstimatedMotion
from truing.estimation.interferometry.recorded_steps import CHANNELS, LOADS, RecordedSteps
from truing.simulation.bench.load_steps import MATERIAL, LoadSteps
from truing.simulation.bench.six_upur.influence import influence_matrix
from truing.simulation.bench.six_upur.nominal_sensor import SimulatedCompliance
from truing.simulation.bench.six_upur.uncertain_sensor import UncertainSensor

_AXES = 6


@dataclass(frozen=True)
class Optics:
    """Rows (6, 6) from displacement and rotation vector to channels, SI, and their uncertainty.

    ``by_angle`` (U, 6, 6) is the derivative of the rows per prior sigma of each angle or arm; ``growth`` (V, 6) one
    sigma of the effect of each frame's expansion on readings, per kelvin of the material since the start of the run.
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
        """Number of unknowns: of angles and arms, then of growth."""
        return len(self.by_angle) + len(self.growth)

    def rows_at(self, unknowns: NDArray) -> NDArray:
        """Return the rows (6, 6) at unknowns (U + V,) in prior sigmas."""
        return np.asarray(self.rows + np.einsum("u,uij->ij", unknowns[: len(self.by_angle)], self.by_angle))

    def grown(self, steps: LoadSteps, unknowns: NDArray) -> NDArray:
        """Return the effect (B, 6) of the frame's expansion on the readings of load steps."""
        return np.asarray(_warmer(steps)[:, None] * (unknowns[len(self.by_angle) :] @ self.growth))

    def slopes(self, steps: LoadSteps, motion: NDArray) -> NDArray:
        """Return the derivatives (B, 6, U + V) of readings by the unknowns, at motions (B, 6) of the platform."""
        by_angle = np.einsum("uij,bj->biu", self.by_angle, motion)
        return np.concatenate([by_angle, _warmer(steps)[:, None, None] * self.growth.T], -1)


def _warmer(steps: LoadSteps) -> NDArray:
    """Return the temperature (B,) of the material minus that at the start of the run; zero if it was not recorded."""
    return steps.since_first(MATERIAL) if MATERIAL in steps.covariates else np.zeros(len(steps.run))


Array = NDArray[np.float64]

_NOTHING = 1e-12  # component of one axis in another below which it is rounding, SI


@dataclass(frozen=True)
class BeamGeometry:
    """Declared geometry of the beams; a simulation, if there is one, replaces components that were not measured."""

    optics: Optics
    simulated: SimulatedCompliance | None

    def solved(self, load: Array, read: Array, covariance: Array) -> EstimatedMotion:
        """Return the motions under loads (K, 6) from channel readings (K, 6), NaN if not read.

        A component that no channel read is simulated to correct the others, and remains unknown itself. Without a
        simulation, components that depend on it are unknown too.
        """
        is_observed = np.isfinite(read)
        expected, spread = self._expected(load)
        inverse = np.linalg.inv(np.where(is_observed[:, :, None], self.optics.rows, np.eye(6)))
        filled = np.einsum("kij,kj->ki", inverse, np.where(is_observed, read, np.nan_to_num(expected)))
        missing = ~is_observed & ~np.isfinite(expected)
        known = is_observed & ~np.einsum("kij,kj->ki", np.abs(inverse) > _NOTHING, missing)
        by_angle = np.where(is_observed[:, :, None], np.einsum("uij,kj->kiu", self.optics.by_angle, filled), 0.0)
        variance = np.where(is_observed, np.einsum("kii->ki", covariance), np.nan_to_num(spread))
        inner = variance[:, :, None] * np.eye(6) + by_angle @ np.swapaxes(by_angle, 1, 2)
        solved = inverse @ inner @ np.swapaxes(inverse, 1, 2)
        both = known[:, :, None] & known[:, None, :]
        more = self.optics.rows - np.eye(6)
        common = np.where(is_observed, 0.0, np.nan_to_num(spread)) @ (more**2).T + np.sum(by_angle**2, -1)
        return EstimatedMotion(
            np.where(known, filled, np.nan),
            np.where(both, solved, np.where(np.eye(6, dtype=bool), np.inf, 0.0)),
            np.where(known, filled @ more.T, np.nan),
            np.where(known, np.sqrt(common), np.nan),
        )

    def _expected(self, load: Array) -> tuple[Array, Array]:
        """Return simulated motions (K, 6) and their variances; NaN without a simulation."""
        if self.simulated is None:
            return np.full(load.shape, np.nan), np.full(load.shape, np.nan)
        by_load = self.simulated.covariance.reshape(6, 6, 6, 6)
        return load @ self.simulated.entries.T, np.einsum("ka,iaib,kb->ki", load, by_load, load)


# Prior sigma of an undeclared gain over its first estimate.
_WIDE = 10.0
# Prior sigma of an unknown zero, as a multiple of the noise.
_FREE = 1e4


@dataclass(frozen=True)
class ChannelZeros:
    """Zeros of Z pairs of run and channel: run labels, channel numbers, prior sigma, and whether this prior is
    knowledge."""

    run: NDArray
    channel: NDArray
    sigma: NDArray
    known: NDArray

    def at(self, run: NDArray, channels: int) -> NDArray:
        """Return the index (B, K) of the zero of each reading; -1 for none."""
        index_of = {(label, channel): n for n, (label, channel) in enumerate(zip(self.run, self.channel, strict=True))}
        labels = run.tolist()
        return np.array([[index_of.get((label, k), -1) for k in range(channels)] for label in labels]).reshape(
            -1, channels
        )


def zeros_of(run: NDArray, is_observed: NDArray, sigma: NDArray, *, signals: int = 0) -> ChannelZeros:
    """Return the zeros of readings, one per run and channel, each with the prior sigma of the channel's noise.

    run (B,); is_observed (B, K): readings that exist; sigma (K,): noise. Zeros of signals, which come last, are free.
    """
    found = [
        (label, k) for label in dict.fromkeys(run.tolist()) for k in np.flatnonzero(is_observed[run == label].any(0))
    ]
    labels = np.array([label for label, _ in found], run.dtype)
    channel = np.array([k for _, k in found], int)
    known = channel < len(sigma) - signals
    return ChannelZeros(labels, channel, np.where(known, 1.0, _FREE) * sigma[channel], known)


@dataclass(frozen=True)
class SignalGains:
    """Gains of signals: V per N of each leg's force, (S,), or by wrench, (S, 6) in V per N and N m.

    ``start`` and one prior sigma have the same shape; ``known``: whether the prior is knowledge.
    """

    start: NDArray
    sigma: NDArray
    known: bool = False

    @staticmethod
    def none() -> SignalGains:
        """Return empty gains, for a sensor without signals."""
        return SignalGains(np.zeros(0), np.zeros(0))

    @property
    def are_of_legs(self) -> bool:
        """True if each signal is that of one leg."""
        return self.start.ndim == 1


@dataclass(frozen=True)
class KnownReadings:
    """Prior knowledge of a sensor, its bench and the instruments; SI.

    ``channels`` are the platform's six, then the signals; ``sigma`` (K,) their noise; ``largest`` (6,) the largest load
    of each axis; ``load_sigma`` (6,) the noise of loads, 0 if exact; ``optics`` the channels' response to motion.
    """

    sensor: UncertainSensor
    channels: tuple[str, ...]
    sigma: NDArray
    largest: NDArray
    load_sigma: NDArray
    zeros: ChannelZeros
    gains: SignalGains = field(default_factory=SignalGains.none)
    wavelength_m: float = 632.990577e-9
    reference_temperature_c: float = 20.0
    optics: Optics = field(default_factory=Optics.plain)
    arms: Mapping[str, tuple[float, ...]] = field(default_factory=dict)  # m, of the first of two units, by load axis

    @property
    def signals(self) -> int:
        """Number of signals S."""
        return len(self.gains.start)


@dataclass(frozen=True)
class ReadingConditions:
    """Data of B load steps: labels of run and step, time, declared loads (B, 6), columns (B,) by name.

    Steps of a run are in order of time. ``span_s`` is the first and last time of the campaign. ``is_timed``: False if
    times only count the steps.
    """

    run: NDArray
    step: NDArray
    time_s: NDArray
    load: NDArray
    covariates: Mapping[str, NDArray] = field(default_factory=dict)
    span_s: tuple[float, float] | None = None
    is_timed: bool = True

    @property
    def readings(self) -> NDArray:
        """Inputs in the place of actuator readings: the loads (B, 6)."""
        return self.load

    @property
    def poses(self) -> tuple[str, ...]:
        """Names of the steps."""
        return tuple(f"run {run} step {step}" for run, step in zip(self.run.tolist(), self.step.tolist(), strict=True))


def run_names(steps: RecordedSteps) -> NDArray:
    """Return the names of the runs (B,) of steps."""
    return np.array(steps.runs)[steps.run]


def zeros_of_steps(
    steps: RecordedSteps,
    is_observed: NDArray[np.bool_],
    fitted: NDArray[np.bool_],
    typical: NDArray,
    tared: float | None,
) -> ChannelZeros:
    """Return the zeros of runs, with the uncertainty that their starts show; zeros of signals are free, unless tared.

    is_observed (B, K) at steps that may be fitted (B,); typical (K,) noise of a channel, SI; tared: standard
    deviation of a signal's zero, V.
    """
    zeros = zeros_of(run_names(steps)[fitted], is_observed[fitted], typical, signals=steps.signal.shape[1])
    noise = typical[: len(CHANNELS)]
    spread = zeros_of_runs(steps, steps.reading, noise).spread(noise)
    index_of = {label: number for number, label in enumerate(np.array(steps.runs).tolist())}
    indices = np.flatnonzero(zeros.channel < len(CHANNELS))
    sigma = zeros.sigma.copy()
    sigma[indices] = spread[[index_of[label] for label in zeros.run[indices].tolist()], zeros.channel[indices]]
    zeros = replace(zeros, sigma=sigma)
    if tared is None:
        return zeros
    signal = zeros.channel >= len(CHANNELS)
    return replace(zeros, sigma=np.where(signal, tared, zeros.sigma), known=zeros.known | signal)


def gains_of_steps(
    sensor: UncertainSensor,
    steps: RecordedSteps,
    is_observed: NDArray[np.bool_],
    declared: NDArray | None,
    tolerance: float | None,
) -> SignalGains:
    """Return the prior of the signals' gains: by leg if there is one channel per leg, otherwise by load.

    is_observed (B, S) signals at steps that may be fitted; declared () or (S,) gains, V/N, with their relative
    tolerance.
    """
    count = is_observed.shape[1]
    if not is_observed.any():
        return SignalGains.none() if not count else SignalGains(np.zeros((count, 6)), np.ones((count, 6)), False)
    if sensor.joints is None or count != len(LOADS):
        rows = np.stack([_slopes(steps.load, steps.signal[:, j], steps.run, is_observed[:, j]) for j in range(count)])
        return SignalGains(rows, _wide_sigmas(rows, axis=1), False)
    if declared is not None:
        gains = np.broadcast_to(declared, (count,)).copy()
        return SignalGains(gains, np.abs(gains) * max(tolerance or 0.0, 1e-6), True)
    columns = np.linalg.solve(influence_matrix(sensor.joints), steps.load.T).T[..., None]
    slopes = [_slopes(columns[:, j], steps.signal[:, j], steps.run, is_observed[:, j])[0] for j in range(count)]
    gains = np.array(slopes)
    return SignalGains(gains, _wide_sigmas(gains), False)


def _wide_sigmas(values: NDArray, axis: int | None = None) -> NDArray:
    size = np.abs(values).max(axis=axis, keepdims=axis is not None)
    return np.broadcast_to(_WIDE * np.where(size > 0.0, size, 1.0), values.shape).copy()


def _slopes(columns: NDArray, values: NDArray, run: NDArray[np.int64], is_observed: NDArray[np.bool_]) -> NDArray:
    """Return the slopes (W,) of values (B,) along columns (B, W), with one zero per run."""
    at = np.unique(run[is_observed], return_inverse=True)[1]
    zeros = np.eye(int(at.max()) + 1)[at] if is_observed.any() else np.zeros((0, 0))
    design = np.hstack([columns[is_observed], zeros])
    return np.asarray(np.linalg.lstsq(design, values[is_observed], rcond=None)[0][: columns.shape[1]])
