"""Statistics of repetitions: pure error, lack of fit, and repeatability by ISO 9283."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from truing.arrays import Array, Index, Mask
from truing.estimation.rotation import log_so3

_LEAST = 1e-6  # relative to the common variance: floor for repeats that agree in every digit
FEWEST = 5  # attained poses: with fewer, the scatter of distances is too uncertain
_DRAWS, _MANY = 2000, 20000
_COVERED = (0.025, 0.975)
_FAR_RAD = 0.2


@dataclass(frozen=True)
class Squares:
    """Sums of squared deviations (C,) of C quantities, with their degrees of freedom (C,)."""

    square: Array
    freedom: Array

    @property
    def sigma(self) -> Array:
        """Standard deviation of one measurement (C,); NaN without freedom."""
        return np.sqrt(np.where(self.freedom > 0, self.square, np.nan) / np.maximum(self.freedom, 1))

    def interval(self, level: float = 0.95) -> tuple[Array, Array]:
        """Return the interval of each standard deviation (C,), by the chi-square distribution."""
        from scipy.special import chdtri

        tail, safe = 0.5 * (1.0 - level), np.maximum(self.freedom, 1)
        square = np.where(self.freedom > 0, self.square, np.nan)
        return np.sqrt(square / chdtri(safe, tail)), np.sqrt(square / chdtri(safe, 1.0 - tail))


def within_groups(values: ArrayLike, groups: Sequence[Index]) -> Squares:
    """Return the deviations from the mean of each group, for values (N, C) with NaN if missing; groups are arrays of
    rows."""
    values = np.asarray(values, float)
    square, freedom = np.zeros((2, values.shape[1]))
    for rows in groups:
        values_of_group = values[rows]
        known = np.isfinite(values_of_group)
        count = known.sum(axis=0)
        mean = np.where(known, values_of_group, 0.0).sum(axis=0) / np.maximum(count, 1)
        square += (np.where(known, values_of_group - mean, 0.0) ** 2).sum(axis=0)
        freedom += np.maximum(count - 1, 0)
    return Squares(square, freedom)


def within_runs(values: ArrayLike, groups: Sequence[Index]) -> Squares:
    """Return the same for runs that repeat each other step by step, each from its own zero; groups are rows (R, S).

    Steps that one of the runs did not read are ignored.
    """
    values = np.asarray(values, float)
    square, freedom = np.zeros((2, values.shape[1]))
    for rows in groups:
        group_values = values[rows]
        is_complete = np.isfinite(group_values).all(axis=0)
        count = is_complete.sum(axis=0)
        complete_values = np.where(is_complete, group_values, 0.0)
        left = np.where(
            is_complete, complete_values - complete_values.sum(axis=1, keepdims=True) / np.maximum(count, 1), 0.0
        )
        left = np.where(is_complete, left - left.mean(axis=0), 0.0)
        square += (left**2).sum(axis=(0, 1))
        freedom += (len(rows) - 1) * np.maximum(count - 1, 0)
    return Squares(square, freedom)


def residuals_from_lines(values: Array, drives: Array, run: Index, fitted: Mask) -> tuple[Array, Squares]:
    """Return the residuals of values (B, C) from a zero per run (B,) and a line in every drive (B, D), over rows fitted
    (B,).

    NaN if not fitted or not recorded; also returns their squares and freedom.
    """
    left = np.full_like(values, np.nan)
    square, freedom = np.zeros((2, values.shape[1]))
    zeros = (run[:, None] == np.unique(run)).astype(float)
    size = np.abs(drives).max(axis=0)
    design = np.column_stack([zeros, drives[:, size > 0.0] / size[size > 0.0]])
    for at in range(values.shape[1]):
        rows = np.isfinite(values[:, at]) & fitted
        coefficients, _, rank, _ = np.linalg.lstsq(design[rows], values[rows, at], rcond=None)
        left[rows, at] = values[rows, at] - design[rows] @ coefficients
        square[at], freedom[at] = np.sum(left[rows, at] ** 2), rows.sum() - rank
    return left, Squares(square, freedom)


@dataclass(frozen=True)
class LackOfFit:
    """Test of a model's residuals against pure error (C,): ratio F, the two degrees of freedom, p-value."""

    ratio: Array
    of_fit: Array
    of_error: Array
    p_value: Array


def lack_of_fit(left: Squares, pure: Squares) -> LackOfFit:
    """Return the F test of a model's residuals, ``left``, against the pure error contained in them; NaN without
    freedom."""
    from scipy.special import fdtrc

    freedom = left.freedom - pure.freedom
    determined = (freedom > 0) & (pure.freedom > 0) & (pure.square > 0)
    safe, below = np.maximum(freedom, 1), np.maximum(pure.freedom, 1)
    share = np.maximum(left.square - pure.square, 0.0) / safe
    ratio = np.where(determined, share / np.where(determined, pure.square / below, 1.0), np.nan)
    p = np.where(determined, fdtrc(safe, below, np.nan_to_num(ratio)), np.nan)
    return LackOfFit(ratio, freedom, pure.freedom, p)


@dataclass(frozen=True)
class EqualScatter:
    """Test of equal scatter in groups: p-value, and the group that scatters most.

    ``others``: standard deviation of all other groups together; NaN without any.
    """

    p_value: float
    worst: int
    others: float


def equal_scatter(square: ArrayLike, freedom: ArrayLike) -> EqualScatter | None:
    """Return Bartlett's test of sums of squared deviations (G,) with degrees of freedom (G,) for one common scatter.

    None for fewer than two groups with a degree of freedom. Source: Bartlett, Proc. R. Soc. A 160 (1937) 268.
    """
    from scipy.special import chdtrc

    square, freedom = np.asarray(square, float), np.asarray(freedom, float)
    repeated = np.flatnonzero(freedom > 0.0)
    if len(repeated) < 2 or not square[repeated].any():
        return None
    f = freedom[repeated]
    common = float(square[repeated].sum() / f.sum())
    variance = np.maximum(square[repeated] / f, _LEAST * common)
    spread = float(f.sum() * np.log(common) - np.sum(f * np.log(variance)))
    correction = 1.0 + (np.sum(1.0 / f) - 1.0 / f.sum()) / (3.0 * (len(repeated) - 1.0))
    worst = int(np.argmax(variance))
    variance_of_others = float((square[repeated].sum() - square[repeated][worst]) / (f.sum() - f[worst]))
    return EqualScatter(
        float(chdtrc(len(repeated) - 1.0, spread / correction)),
        int(repeated[worst]),
        float(np.sqrt(variance_of_others)),
    )


def at_one_reading(values: Array, readings: Array, groups: Sequence[Index]) -> Array:
    """Return values (B, C), each group moved to its mean reading by a common line in the readings (B, D).

    Declared repeats may differ slightly in their readings. Too few values are not changed.
    """
    known = np.asarray(np.isfinite(np.column_stack([values, readings])).all(axis=1), bool)
    design = np.column_stack([np.ones(len(readings)), readings])
    out = values.copy()
    if not readings.shape[1] or known.sum() < 2 * design.shape[1]:
        return out
    slope = np.linalg.lstsq(design[known], values[known], rcond=None)[0][1:]
    for group in groups:
        rows_at_reading = group[known[group]]
        out[rows_at_reading] -= (
            (readings[rows_at_reading] - readings[rows_at_reading].mean(axis=0)) @ slope
            if len(rows_at_reading)
            else 0.0
        )
    return out


def known_mean(values: Array) -> Array:
    """Return the mean (C,) of known values (N, C); NaN without any."""
    known = np.isfinite(values)
    total = np.where(known, values, 0.0).sum(axis=0)
    return np.where(known.any(axis=0), total / np.maximum(known.sum(axis=0), 1), np.nan)


@dataclass(frozen=True)
class Figure:
    """A characteristic value with its 95 % interval."""

    value: float
    low: float
    high: float


def position_sigma(points: Array) -> Figure:
    """Return the standard deviation of one coordinate of repeated positions (N, 3), in their unit.

    N of at least 2. The interval assumes normal errors of equal size in all directions.
    """
    groups = within_groups(points.reshape(-1, 3) - points.mean(axis=0), [np.arange(len(points))])
    return _interval(float(groups.square.sum()), 3.0 * (len(points) - 1.0), 1.0)


def position_repeatability(points: Array, rng: np.random.Generator) -> Figure:
    """Return RP = mean + 3 S of the distances of repeated positions (N, 3) from their mean, in their unit.

    N of at least FEWEST. The interval comes from draws of normal errors with the estimated covariance (JCGM 101). It
    refers to a long test of the same machine. Source: ISO 9283:1998, equation for RP_l.
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


def largest_distance(points: Array) -> float:
    """Return the largest distance between two of some points (N, 3): vAP of the mean positions by direction.

    Source: ISO 9283:1998, multi-directional pose accuracy variation.
    """
    return float(np.linalg.norm(points[:, None] - points[None], axis=-1).max())


def _attained(points: Array) -> Array:
    """RP of positions (..., N, 3)."""
    distance = np.linalg.norm(points - points.mean(axis=-2, keepdims=True), axis=-1)
    return np.asarray(distance.mean(axis=-1) + 3.0 * distance.std(axis=-1, ddof=1))


def orientation_repeatability(angles: Array) -> tuple[Figure, ...]:
    """Return RP_a, RP_b, RP_c = 3 S of the angles (N, 3) of repeated orientations about each axis, in their unit.

    angles: small rotations from one orientation; N of at least FEWEST. Source: ISO 9283:1998, equations for RP_a..RP_c.
    """
    return _three_sigma(angles)


def distance_figures(first: Array, second: Array, commanded: float) -> tuple[Figure, Figure]:
    """Return AD and RD of the distances between positions (N, 3) attained in turn, in their unit.

    AD is the mean distance minus the commanded one; RD = 3 S of the distances. N of at least FEWEST. Source: ISO
    9283:1998, distance accuracy and repeatability.
    """
    distance = np.linalg.norm(second - first, axis=1)[:, None]
    repeatability, *_ = _three_sigma(distance)
    return Figure(float(distance.mean()) - commanded, np.nan, np.nan), repeatability


def orientation_distance_figures(first: Array, second: Array) -> tuple[tuple[Figure, Figure], ...]:
    """Return AD and RD about each axis, from angles (N, 3) by which orientations attained in turn are off, in their
    unit.

    AD is the mean rotation by which the second is farther off than the first; RD = 3 S of it. N of at least FEWEST.
    Source: ISO 9283:1998, orientation distance accuracy and repeatability.
    """
    off = second - first
    accuracy = (Figure(float(value), np.nan, np.nan) for value in off.mean(axis=0))
    return tuple(zip(accuracy, _three_sigma(off), strict=True))


def largest_change(values: ArrayLike) -> float:
    """Return the largest change of values (T, ...) from the first one: the drift of a characteristic.

    Source: ISO 9283:1998, drift of pose characteristics: of AP and of RP over time.
    """
    values = np.asarray(values, float)
    return float(np.abs(values - values[0]).max())


def _three_sigma(values: Array) -> tuple[Figure, ...]:
    """Return 3 S of each column of values (N, C), with its interval."""
    if len(values) < FEWEST:
        raise ValueError(f"values: found {len(values)}, expected at least {FEWEST}")
    square = np.sum((values - values.mean(axis=0)) ** 2, axis=0)
    return tuple(_interval(float(variance), len(values) - 1.0, 3.0) for variance in square)


def _interval(square: float, freedom: float, times: float) -> Figure:
    """Return a multiple of a standard deviation with its chi-square interval."""
    from scipy.special import chdtri

    value, ends = np.sqrt(square / freedom), [np.sqrt(square / chdtri(freedom, p)) for p in _COVERED]
    return Figure(float(times * value), float(times * ends[0]), float(times * ends[1]))


def turned_from_first(R: Array, rows: Index, groups: Sequence[Index]) -> Array:
    """Return rotation vectors (K, 3) of rotations (K, 3, 3) of these rows relative to the first, or to the first of
    their group."""
    turned = log_so3(R @ R[0].T)
    if np.linalg.norm(turned, axis=1).max() < _FAR_RAD:
        return turned
    for group in groups:
        indices = np.flatnonzero(np.isin(rows, group))
        if len(indices):
            turned[indices] = log_so3(R[indices] @ R[indices[0]].T)
    return turned
