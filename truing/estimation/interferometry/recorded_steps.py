"""Load steps of a bench as arrays in SI, and corrections of interferometer readings: air, dead path, material, zero.

SI throughout: m and rad, temperatures in degrees C. The caller gives the index of air (``truing.simulation.air``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from truing.arrays import Array, Index, Mask

LOADS = ("fx", "fy", "fz", "mx", "my", "mz")
CHANNELS = ("dx", "dy", "dz", "rx", "ry", "rz")
ARCSECOND = np.pi / 180.0 / 3600.0
# One unit of a channel's readings in SI.
READING_SI = np.array([1e-6] * 3 + [ARCSECOND] * 3)
READING_UNITS = ("um",) * 3 + ("arcsec",) * 3
REFERENCE_C = 20.0  # ISO 1


@dataclass(frozen=True)
class RecordedSteps:
    """The load steps of a campaign in the order of measurement: B steps of R runs.

    ``reading`` (B, 6) in m and rad, NaN if a channel was not read; ``sigma`` (B, 6): standard deviation, NaN if not
    declared; ``load`` (B, 6) in N and N m; ``signal`` (B, S) in V, NaN if missing. ``run`` (B,): index into ``runs``.
    ``covariates`` (B,): surroundings and further columns, in the units of their names.
    """

    runs: tuple[int | str, ...]
    run: Index
    step: Index
    time_s: Array
    load: Array
    reading: Array
    sigma: Array
    signal: Array
    held_out: Mask
    covariates: Mapping[str, Array]

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the signal channels: v1, v2, .."""
        return tuple(f"v{number + 1}" for number in range(self.signal.shape[1]))

    def subset(self, rows: Mask) -> RecordedSteps:
        """Return some of the steps; runs keep their numbers."""
        names = ("run", "step", "time_s", "load", "reading", "sigma", "signal", "held_out")
        covariates = {name: values[rows] for name, values in self.covariates.items()}
        return replace(self, **{name: getattr(self, name)[rows] for name in names}, covariates=covariates)


def repeated_runs(steps: RecordedSteps) -> list[Index]:
    """Return rows (R, S) of runs with the same loads in the same order, one array per group."""
    alike: dict[bytes, list[Index]] = {}
    for run in range(len(steps.runs)):
        rows = np.flatnonzero((steps.run == run) & ~steps.held_out)
        if len(rows) > 1:
            alike.setdefault((steps.load[rows].round(9) + 0.0).tobytes(), []).append(rows)
    return [np.array(rows) for rows in alike.values() if len(rows) > 1]


def displacement_in_air(
    vacuum_length: ArrayLike, index: ArrayLike, index_at_zero: ArrayLike, dead_path: ArrayLike
) -> Array:
    """Return displacements of the mirror in m since the zero, from lengths counted in vacuum wavelengths.

    index: of the air at each reading, index_at_zero: at the zero; dead_path in m: between beam splitter and mirror at
    the zero, whose optical length also changes with the air. ``n (D + d) - n0 D = counted length``. If lengths count
    positive for a shorter path, D is negative.
    """
    n, n0 = np.asarray(index, float), np.asarray(index_at_zero, float)
    return (np.asarray(vacuum_length, float) - (n - n0) * np.asarray(dead_path, float)) / n


def displacement_sigma(
    displacement: ArrayLike, dead_path: ArrayLike, index_sigma: ArrayLike, drift_sigma: ArrayLike
) -> Array:
    """Return the standard deviation in m of displacements due to the air.

    index_sigma: of the index itself (common to the run, scales the displacement); drift_sigma: of its change since the
    zero (also acts on the dead path).
    """
    d, D = np.asarray(displacement, float), np.asarray(dead_path, float)
    return np.hypot(d * np.asarray(index_sigma, float), (D + d) * np.asarray(drift_sigma, float))


@dataclass(frozen=True)
class Corrected:
    """Values (...) in m, and the standard deviation (...) of the correction."""

    value: Array
    sigma: Array


def at_reference_temperature(
    length: ArrayLike,
    expansion_per_k: float,
    temperature_c: ArrayLike,
    *,
    expansion_sigma: float = 0.0,
    temperature_sigma: ArrayLike = 0.0,
) -> Corrected:
    """Return lengths in m of a part at 20 degrees C, from lengths at its temperature."""
    measured, rise = np.asarray(length, float), np.asarray(temperature_c, float) - REFERENCE_C
    value = measured / (1.0 + expansion_per_k * rise)
    return Corrected(value, np.abs(value) * _expansion_sigma(rise, expansion_per_k, expansion_sigma, temperature_sigma))


def without_frame_growth(
    displacement: ArrayLike,
    frame_length: float,
    expansion_per_k: float,
    temperature_c: ArrayLike,
    temperature_at_zero_c: ArrayLike,
    *,
    expansion_sigma: float = 0.0,
    temperature_sigma: ArrayLike = 0.0,
) -> Corrected:
    """Return displacements in m minus the growth since the zero of the frame between mirror and point of interest.

    frame_length in m, positive if growth moves the mirror in the positive direction. temperature_sigma: of the
    difference of the two temperatures.
    """
    rise = np.asarray(temperature_c, float) - np.asarray(temperature_at_zero_c, float)
    value = np.asarray(displacement, float) - frame_length * expansion_per_k * rise
    sigma = abs(frame_length) * _expansion_sigma(rise, expansion_per_k, expansion_sigma, temperature_sigma)
    return Corrected(value, np.broadcast_to(sigma, value.shape))


def _expansion_sigma(
    rise: Array, expansion_per_k: float, expansion_sigma: float, temperature_sigma: ArrayLike
) -> Array:
    """Return the standard deviation (...) of the relative expansion by a rise of temperature in K."""
    return np.hypot(rise * expansion_sigma, expansion_per_k * np.asarray(temperature_sigma, float))


def linear_rows(beam: ArrayLike, arm: ArrayLike) -> Array:
    """Return rows (..., 6), the derivatives of linear readings by displacement and rotation vector of the platform's
    origin.

    beam (..., 3): direction in which the reading counts positive, of any length but zero; arm (..., 3) in m: from the
    origin to the point where the beam meets the platform. ``reading = beam . (d + r x arm)``: a wrong direction causes
    the cosine error, the arm Abbe's.
    """
    direction = _unit(beam)
    return np.concatenate(np.broadcast_arrays(direction, np.cross(np.asarray(arm, float), direction)), axis=-1)


def angular_rows(axis: ArrayLike) -> Array:
    """Return rows (..., 6) of angular readings about axes (..., 3)."""
    direction = _unit(axis)
    return np.concatenate([np.zeros_like(direction), direction], axis=-1)


def _unit(vectors: ArrayLike) -> Array:
    """Return vectors (..., 3) with length one."""
    directions = np.asarray(vectors, float)
    return np.asarray(directions / np.linalg.norm(directions, axis=-1, keepdims=True))
