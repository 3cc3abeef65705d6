"""Repeatability of a pose by ISO 9283, clause 7.2: how far attained poses lie from their mean."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.pure_error import Index, within_groups
from truing.estimation.rotation import log_so3

Array = NDArray[np.float64]

FEWEST = 5  # attained poses: of fewer, the scatter of distances says too little
_DRAWS, _MANY = 2000, 20000
_COVERED = (0.025, 0.975)
_FAR_RAD = 0.2


@dataclass(frozen=True)
class Figure:
    """A figure with its interval of 95 %."""

    value: float
    low: float
    high: float


def position_sigma(points: Array) -> Figure:
    """Return the standard deviation of one coordinate of repeated positions (N, 3), in their unit.

    N of at least 2. The interval holds where errors are normal and as large in all directions.
    """
    found = within_groups(points.reshape(-1, 3) - points.mean(axis=0), [np.arange(len(points))])
    return _interval(float(found.square.sum()), 3.0 * (len(points) - 1.0), 1.0)


def position_repeatability(points: Array, rng: np.random.Generator) -> Figure:
    """Return RP = mean + 3 S of the distances of repeated positions (N, 3) from their mean, in their unit.

    N of at least FEWEST. The interval is drawn: normal errors with the covariance that was found (JCGM 101), so that it
    holds what a long test of the same machine would give. Source: ISO 9283:1998, equation for RP_l.
    """
    n = len(points)
    if n < FEWEST:
        raise ValueError(f"points: found {n}, expected at least {FEWEST}")
    value = float(_attained(points))
    variance, axes = np.linalg.eigh(np.cov(points.T))
    root = axes * np.sqrt(np.maximum(variance, 0.0))
    if not root.any():
        return Figure(0.0, 0.0, 0.0)
    drawn = _attained(rng.standard_normal((_DRAWS, n, 3)) @ root.T)
    low, high = np.quantile(drawn / _attained(rng.standard_normal((_MANY, 3)) @ root.T), _COVERED)
    return Figure(value, value / float(high), value / float(low))


def _attained(points: Array) -> Array:
    """RP of positions (..., N, 3)."""
    distance = np.linalg.norm(points - points.mean(axis=-2, keepdims=True), axis=-1)
    return np.asarray(distance.mean(axis=-1) + 3.0 * distance.std(axis=-1, ddof=1))


def orientation_repeatability(angles: Array) -> tuple[Figure, ...]:
    """Return RP_a, RP_b, RP_c = 3 S of the angles (N, 3) of repeated orientations about each axis, in their unit.

    angles: small rotations from one orientation; N of at least FEWEST. Source: ISO 9283:1998, equations for RP_a..RP_c.
    """
    if len(angles) < FEWEST:
        raise ValueError(f"angles: found {len(angles)}, expected at least {FEWEST}")
    square = np.sum((angles - angles.mean(axis=0)) ** 2, axis=0)
    return tuple(_interval(float(one), len(angles) - 1.0, 3.0) for one in square)


def _interval(square: float, freedom: float, times: float) -> Figure:
    """A multiple of a standard deviation with the interval of the chi-square distribution."""
    from scipy.special import chdtri

    value, ends = np.sqrt(square / freedom), [np.sqrt(square / chdtri(freedom, p)) for p in _COVERED]
    return Figure(float(times * value), float(times * ends[0]), float(times * ends[1]))


def turned_from_first(R: Array, rows: Index, groups: Sequence[Index]) -> Array:
    """Rotation vectors (K, 3) of rotations (K, 3, 3) of these rows, from the first or from the first of their group."""
    turned = log_so3(R @ R[0].T)
    if np.linalg.norm(turned, axis=1).max() < _FAR_RAD:
        return turned
    for group in groups:
        own = np.flatnonzero(np.isin(rows, group))
        if len(own):
            turned[own] = log_so3(R[own] @ R[own[0]].T)
    return turned
