"""Interval arithmetic over arrays with outward rounding: every result contains all values of its operands.

IEEE arithmetic rounds each sum, product, quotient and square root to the nearest number; the next number outwards is
then a bound. Only these operations are used, so that every bound is rigorous.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

_PI = (np.pi, np.nextafter(np.pi, 4.0))  # the double below pi, and the one above


def _down(x: NDArray) -> NDArray:
    return np.nextafter(x, -np.inf)


def _up(x: NDArray) -> NDArray:
    return np.nextafter(x, np.inf)


@dataclass(frozen=True)
class IntervalArray:
    """Arrays of lower and upper bounds, of equal shape."""

    low: NDArray
    high: NDArray

    # numpy leaves mixed operations to this class.
    __array_ufunc__ = None

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of both arrays."""
        return self.low.shape

    @property
    def mid(self) -> NDArray:
        """A number within each interval, near its middle."""
        return np.asarray(np.clip(0.5 * (self.low + self.high), self.low, self.high))

    @property
    def magnitude(self) -> NDArray:
        """Largest absolute value."""
        return np.maximum(np.abs(self.low), np.abs(self.high))

    def __getitem__(self, key: Any) -> IntervalArray:
        return IntervalArray(self.low[key], self.high[key])

    def __neg__(self) -> IntervalArray:
        return IntervalArray(-self.high, -self.low)

    def __add__(self, other: IntervalArray | ArrayLike) -> IntervalArray:
        o = intervals(other)
        return IntervalArray(_down(self.low + o.low), _up(self.high + o.high))

    __radd__ = __add__

    def __sub__(self, other: IntervalArray | ArrayLike) -> IntervalArray:
        o = intervals(other)
        return IntervalArray(_down(self.low - o.high), _up(self.high - o.low))

    def __rsub__(self, other: ArrayLike) -> IntervalArray:
        return intervals(other) - self

    def __mul__(self, other: IntervalArray | ArrayLike) -> IntervalArray:
        o = intervals(other)
        products = (self.low * o.low, self.low * o.high, self.high * o.low, self.high * o.high)
        low, high = products[0], products[0]
        for product in products[1:]:
            low, high = np.minimum(low, product), np.maximum(high, product)
        return IntervalArray(_down(low), _up(high))

    __rmul__ = __mul__

    def __truediv__(self, other: IntervalArray | ArrayLike) -> IntervalArray:
        """Divide; intervals that contain 0 have an unbounded inverse."""
        o = intervals(other)
        valid = (o.low > 0.0) | (o.high < 0.0)
        safe = np.where(valid, o.low, 1.0), np.where(valid, o.high, 1.0)
        low = np.where(valid, _down(1.0 / safe[1]), -np.inf)
        high = np.where(valid, _up(1.0 / safe[0]), np.inf)
        inverse = IntervalArray(low, high)
        if valid.all():
            return self * inverse
        quotient = self * IntervalArray(np.where(valid, low, 1.0), np.where(valid, high, 1.0))
        return IntervalArray(np.where(valid, quotient.low, -np.inf), np.where(valid, quotient.high, np.inf))

    def __rtruediv__(self, other: ArrayLike) -> IntervalArray:
        return intervals(other) / self

    def squared(self) -> IntervalArray:
        """Return the squares, which are not negative."""
        ends = self.low * self.low, self.high * self.high
        inside = (self.low <= 0.0) & (self.high >= 0.0)
        low = np.where(inside, 0.0, np.maximum(0.0, _down(np.minimum(*ends))))
        return IntervalArray(low, _up(np.maximum(*ends)))

    def root(self) -> IntervalArray:
        """Return the square roots; of negative parts, that of 0."""
        low, high = np.sqrt(np.maximum(self.low, 0.0)), np.sqrt(np.maximum(self.high, 0.0))
        return IntervalArray(np.maximum(0.0, _down(low)), _up(high))

    def sum(self, axis: int) -> IntervalArray:
        """Return the sum along an axis, term by term."""
        parts = [self[(..., *_at(axis, k))] for k in range(self.shape[axis])]
        total = parts[0]
        for part in parts[1:]:
            total = total + part
        return total

    def overlap(self, other: IntervalArray) -> IntervalArray:
        """Return the common part of intervals that are known to have one."""
        return IntervalArray(np.maximum(self.low, other.low), np.minimum(self.high, other.high))


def _at(axis: int, k: int) -> tuple[int | slice, ...]:
    """Return the index of one slice along a negative axis."""
    return (k, *[slice(None)] * (-axis - 1))


def intervals(value: IntervalArray | ArrayLike) -> IntervalArray:
    """Return numbers as intervals of width 0; intervals as they are."""
    if isinstance(value, IntervalArray):
        return value
    exact = np.asarray(value, float)
    return IntervalArray(exact, exact)


def around(value: ArrayLike, half: ArrayLike) -> IntervalArray:
    """Return the intervals value +- half."""
    middle, reach = np.asarray(value, float), np.asarray(half, float)
    return IntervalArray(_down(middle - reach), _up(middle + reach))


def hull(low: ArrayLike, high: ArrayLike) -> IntervalArray:
    """Return the intervals between bounds, as given."""
    return IntervalArray(
        *(np.array(part) for part in np.broadcast_arrays(np.asarray(low, float), np.asarray(high, float)))
    )


def stack(parts: list[IntervalArray], axis: int = -1) -> IntervalArray:
    """Stack intervals along a new axis."""
    return IntervalArray(
        np.stack(np.broadcast_arrays(*(part.low for part in parts)), axis),
        np.stack(np.broadcast_arrays(*(part.high for part in parts)), axis),
    )


def concatenate(parts: list[IntervalArray], axis: int = -1) -> IntervalArray:
    """Concatenate intervals along an axis."""
    return IntervalArray(
        np.concatenate([part.low for part in parts], axis), np.concatenate([part.high for part in parts], axis)
    )


def product(matrix: IntervalArray, other: IntervalArray) -> IntervalArray:
    """Return the matrix product (..., m, n) of (..., m, k) and (..., k, n)."""
    total = None
    for k in range(other.shape[-2]):
        term = matrix[..., :, k, None] * other[..., None, k, :]
        total = term if total is None else total + term
    assert total is not None
    return total


def dot(interval_array: IntervalArray, other: IntervalArray) -> IntervalArray:
    """Return the scalar products (...) of vectors (..., n)."""
    return (interval_array * other).sum(-1)


def cross(interval_array: IntervalArray, other: IntervalArray) -> IntervalArray:
    """Return the vector products (..., 3)."""
    parts = []
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        parts.append(interval_array[..., i] * other[..., j] - interval_array[..., j] * other[..., i])
    return stack(parts)


def tangent_of_half(angle_high: float) -> float:
    """Return an upper bound of tan(x / 2) for 0 <= x < 2 rad, by Becker and Stark: tan y < pi^2 y / (pi^2 - 4 y^2)."""
    half, pi2 = intervals(angle_high) / 2.0, hull(*_PI).squared()
    return float((pi2 * half / (pi2 - 4.0 * half.squared())).high)


def is_regular(matrices: IntervalArray) -> NDArray:
    """True if every matrix in intervals (..., m, n), m >= n, has rank n: True (...) where this is proven.

    With C an inverse of the middle, computed in floating point, C A is within I + E. If a positive vector d has |E| d
    < d, row by row, C A is regular (Neumaier, Interval Methods, 1990, section 4.1). So no vector is in the kernel of
    A.
    """
    usable = np.isfinite(matrices.low).all((-2, -1)) & np.isfinite(matrices.high).all((-2, -1))
    rows, size = matrices.shape[-2:]
    regular = usable[..., None, None]
    bounded = IntervalArray(*(np.where(regular, part, np.eye(rows, size)) for part in (matrices.low, matrices.high)))
    middle = bounded.mid
    inverse = np.linalg.pinv(middle)
    rest = (product(intervals(inverse), bounded) - np.eye(size)).magnitude
    d = np.ones((*rest.shape[:-2], size))
    for _ in range(20):  # towards the dominant eigenvector: any positive d is a proof
        d = np.maximum((rest @ d[..., None])[..., 0], 1e-6 * d.max(-1, keepdims=True))
        d = d / d.max(-1, keepdims=True)
    largest = product(intervals(rest), intervals(d[..., None])).high[..., 0]
    return np.asarray(usable & (largest < d).all(-1))
