"""A flexure joint bent by its leg: deflection, and how far its end stands from the ideal pivot in its middle.

The flexure is a uniform beam of length l_b whose end takes the slope delta, rad (telescope report, eq. 10-17). A leg
ends in one at each joint; what a flexure adds to the leg's length is the distance from the pivot to the flexure's end,
l_b/2 while it is straight.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

# The circle through all ends of the flexure is centred at 3/4 l_b from the end, a quarter from the root (eq. 13).
BETA = 0.25
# Below this slope, squared, closed forms lose digits to 0/0; the first term that a series leaves out is under 1e-16.
_SERIES_BELOW = 0.01
_SHORTENING = (0.0, 1 / 6, -1 / 40, 1 / 112, -5 / 1152, 7 / 2816, -21 / 13312, 11 / 10240)
_ARC_SHORTENING = (0.0, 1 / 6, -1 / 120, 1 / 5040, -1 / 362880, 1 / 39916800, -1 / 6227020800)
_ARC_DEFLECTION = (1 / 2, -1 / 24, 1 / 720, -1 / 40320, 1 / 3628800, -1 / 479001600)
_SINC = (1.0, -1 / 6, 1 / 120, -1 / 5040, 1 / 362880, -1 / 39916800, 1 / 6227020800)
# (2 arcsin sqrt(s))^2 in 4 s, s = (1 - cos) / 2.
_SQUARED_ANGLE = (0.0, 1.0, 1 / 12, 1 / 90, 1 / 560, 1 / 3150, 1 / 16632, 1 / 84084, 1 / 411840)
# -(d(sin t / t) / dt) / t; divided by (sin t) / t it is the derivative by cos t.
_SINC_SLOPE = (1 / 3, -1 / 30, 1 / 840, -1 / 45360, 1 / 3991680, -1 / 518918400)


@dataclass(frozen=True)
class Distance:
    """Distance (...) from a flexure's pivot to its end, m, with its derivatives by cosine of the bend and by l_b."""

    value: NDArray
    by_cosine: NDArray
    by_length: NDArray


# From the flexure's length l_b (...), m, and the cosine of its bend (...).
BendLaw = Callable[[NDArray, NDArray], Distance]


def deflection(length: ArrayLike, slope: ArrayLike) -> tuple[NDArray, NDArray]:
    """Return shortening and deflection (dx, dy) (...), m, of the end, as the arc of a parabola over l_b (eq. 12).

    dx is counted from the straight flexure's end towards its root.
    """
    l_b, delta = np.asarray(length), np.asarray(slope)
    return l_b * _by_series(delta * delta, _SHORTENING, _parabola_shortening), l_b * delta / 2


def arc_deflection(length: ArrayLike, slope: ArrayLike) -> tuple[NDArray, NDArray]:
    """Return shortening and deflection (dx, dy) (...), m, of the end of a circular arc of length l_b, inextensible."""
    l_b, delta = np.asarray(length), np.asarray(slope)
    dy = l_b * delta * _by_series(delta * delta, _ARC_DEFLECTION, lambda t: 2 * np.sin(t / 2) ** 2 / t**2)
    return l_b * _by_series(delta * delta, _ARC_SHORTENING, lambda t: 1 - np.sin(t) / t), dy


def circle_remainder(length: ArrayLike, dx: ArrayLike, dy: ArrayLike) -> NDArray:
    """Return how far an end is from the circle of radius 3/4 l_b about (3/4 l_b, 0), in squares (...), m2 (eq. 13).

    Of fourth order in the slope: 47/720 l_b^2 for eq. 12, -1/720 l_b^2 for the circular arc.
    """
    l_b, x, y = np.asarray(length), np.asarray(dx), np.asarray(dy)
    return x * x - 1.5 * l_b * x + y * y


def circle_distance(length: NDArray, cosine: NDArray, beta: float = BETA) -> Distance:
    """Return the distance for a flexure whose end stays on the circle of radius (1 - beta) l_b (eq. 15-17).

    length l_b and cosine of the bend (...); beta below 3/4, beyond which eq. 15 has no positive root or two.
    """
    lean = (1 - 2 * beta) * cosine
    root = np.sqrt(3 - 4 * beta + lean * lean)
    share = (root - lean) / 2
    return Distance(length * share, -length * (1 - 2 * beta) * share / root, share + 0.0 * length)


def arc_distance(length: NDArray, cosine: NDArray) -> Distance:
    """Return the distance for a flexure bent to a circular arc, without approximation: l_b (sin t / t - cos t / 2).

    Along the leg, the arc's tangent. It passes the pivot at l_b t^3 / 24, which lengthens no leg to first order.
    """
    squared = _squared_angle(cosine)
    sinc = _by_series(squared, _SINC, lambda t: np.sin(t) / t)
    slope = _by_series(squared, _SINC_SLOPE, lambda t: (np.sin(t) - t * np.cos(t)) / t**3) / sinc
    share = sinc - cosine / 2
    return Distance(length * share, length * (slope - 0.5), share + 0.0 * length)


def _parabola_shortening(t: NDArray) -> NDArray:
    return (np.sqrt(1 + t * t) + np.arcsinh(t) / t) / 2 - 1


def _squared_angle(cosine: NDArray) -> NDArray:
    """Return the squared angle of a cosine; smooth at 1, where the angle itself is not."""
    gap = 2 - 2 * cosine
    return _by_series(gap, _SQUARED_ANGLE, lambda t: 4 * np.arcsin(t / 2) ** 2)


def _by_series(x: NDArray, series: tuple[float, ...], closed: Callable[[NDArray], NDArray]) -> NDArray:
    """Return a function of sqrt(x) by its series in x where x is small, else in closed form."""
    small = np.abs(x) < _SERIES_BELOW
    near, total = np.where(small, x, 0.0), np.zeros_like(x)
    for coefficient in reversed(series):
        total = total * near + coefficient
    return np.where(small, total, closed(np.sqrt(np.where(small, 1.0, x))))
