"""What a reading of an interferometer is: air, dead path, warm material, direction of the beam, and its zero.

SI throughout: m and rad, temperatures in degrees C. The index of air comes from outside (``truing.simulation.air``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

REFERENCE_C = 20.0  # ISO 1


def displacement_in_air(
    vacuum_length: ArrayLike, index: ArrayLike, index_at_zero: ArrayLike, dead_path: ArrayLike
) -> Array:
    """Return displacements of the mirror in m since the zero, of lengths counted in wavelengths of vacuum.

    index: of the air at each reading, index_at_zero: at the zero; dead_path in m: between beam splitter and mirror at
    the zero, which the changing air stretches too. ``n (D + d) - n0 D = counted length``. Where lengths count positive
    as the path gets shorter, D is negative.
    """
    n, n0 = np.asarray(index, float), np.asarray(index_at_zero, float)
    return (np.asarray(vacuum_length, float) - (n - n0) * np.asarray(dead_path, float)) / n


def displacement_sigma(
    displacement: ArrayLike, dead_path: ArrayLike, index_sigma: ArrayLike, drift_sigma: ArrayLike
) -> Array:
    """Return what the air leaves uncertain in displacements, one sigma in m.

    index_sigma: of the index itself (common to the run, it scales the displacement); drift_sigma: of its change since
    the zero (it moves the dead path as well).
    """
    d, D = np.asarray(displacement, float), np.asarray(dead_path, float)
    return np.hypot(d * np.asarray(index_sigma, float), (D + d) * np.asarray(drift_sigma, float))


@dataclass(frozen=True)
class Corrected:
    """Values (...) in m, and the standard deviation (...) that the correction itself has."""

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
    """Return lengths in m of a part as they are at 20 degrees C, from lengths at its temperature."""
    measured, warmer = np.asarray(length, float), np.asarray(temperature_c, float) - REFERENCE_C
    value = measured / (1.0 + expansion_per_k * warmer)
    relative = np.hypot(warmer * expansion_sigma, expansion_per_k * np.asarray(temperature_sigma, float))
    return Corrected(value, np.abs(value) * relative)


def less_growth(
    displacement: ArrayLike,
    frame_length: float,
    expansion_per_k: float,
    temperature_c: ArrayLike,
    temperature_at_zero_c: ArrayLike,
    *,
    expansion_sigma: float = 0.0,
    temperature_sigma: ArrayLike = 0.0,
) -> Corrected:
    """Return displacements in m less what the frame between mirror and point of interest grew since the zero.

    frame_length in m, positive where growth moves the mirror in the direction that counts as positive.
    temperature_sigma: of the difference of the two temperatures.
    """
    warmer = np.asarray(temperature_c, float) - np.asarray(temperature_at_zero_c, float)
    value = np.asarray(displacement, float) - frame_length * expansion_per_k * warmer
    unsure = np.hypot(warmer * expansion_sigma, expansion_per_k * np.asarray(temperature_sigma, float))
    return Corrected(value, np.broadcast_to(abs(frame_length) * unsure, value.shape))


def linear_rows(beam: ArrayLike, arm: ArrayLike) -> Array:
    """Return rows (..., 6) by which linear readings follow displacement and rotation vector of the platform's origin.

    beam (..., 3): direction in which the reading counts positive, of any length but zero; arm (..., 3) in m: from the
    origin to the point that the beam meets. ``reading = beam . (d + r x arm)``: what is not along the axis is the
    cosine error, what the arm brings is Abbe's.
    """
    direction = np.asarray(beam, float)
    direction = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    return np.concatenate(np.broadcast_arrays(direction, np.cross(np.asarray(arm, float), direction)), axis=-1)


def angular_rows(axis: ArrayLike) -> Array:
    """Return rows (..., 6) of angular readings about axes (..., 3)."""
    direction = np.asarray(axis, float)
    direction = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    return np.concatenate([np.zeros_like(direction), direction], axis=-1)
