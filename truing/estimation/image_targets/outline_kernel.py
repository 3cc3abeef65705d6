"""The ellipse with the moments of an outline, compiled: thousands of outlines of all lengths. Imports numba."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from truing.estimation.lane_arithmetic import compiled

SHAPE = 10  # centre x y, semi-axes, angle of the major one, rms distance, left, top, right, bottom
_OUTLINE_INSIDE = 0.5  # px from the centres of outer pixels to the edge


def measure_outlines(points: NDArray, starts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the shapes (N, 10) of closed outlines: points (P, 2) in px one outline after the other, starts (N + 1,).

    The ellipse has the area, centroid and second moments of the polygon, and half a pixel more all round, since the
    outline runs through the centres of pixels. NaN where an outline encloses nothing.
    """
    shape = np.empty((len(starts) - 1, SHAPE))
    _measure(np.ascontiguousarray(points, np.int32), np.ascontiguousarray(starts, np.int64), shape)
    return shape


@compiled(__file__)
def _measure(points, starts, shape):  # type: ignore[no-untyped-def]
    for k in range(len(starts) - 1):
        first, last = starts[k], starts[k + 1]
        x0, y0 = float(points[first, 0]), float(points[first, 1])
        area = mx = my = mxx = mxy = myy = 0.0
        left = right = x0
        top = bottom = y0
        for i in range(first, last):
            j = i + 1 if i + 1 < last else first
            px, py = points[i, 0] - x0, points[i, 1] - y0
            qx, qy = points[j, 0] - x0, points[j, 1] - y0
            cross = px * qy - qx * py
            area += cross / 2
            mx += cross * (px + qx) / 6
            my += cross * (py + qy) / 6
            mxx += cross * (px * px + px * qx + qx * qx) / 12
            myy += cross * (py * py + py * qy + qy * qy) / 12
            mxy += cross * (px * qy + 2 * px * py + 2 * qx * qy + qx * py) / 24
            left, right = min(left, px + x0), max(right, px + x0)
            top, bottom = min(top, py + y0), max(bottom, py + y0)
        shape[k, 6], shape[k, 7], shape[k, 8], shape[k, 9] = left, top, right, bottom
        if abs(area) < 1.0:
            shape[k, :6] = math.nan
            continue
        cx, cy = mx / area, my / area
        sxx, syy, sxy = mxx / area - cx * cx, myy / area - cy * cy, mxy / area - cx * cy
        half, skew = (sxx + syy) / 2, math.hypot((sxx - syy) / 2, sxy)
        a = 2 * math.sqrt(max(half + skew, 0.0)) + _OUTLINE_INSIDE
        b = 2 * math.sqrt(max(half - skew, 0.0)) + _OUTLINE_INSIDE
        angle = 0.5 * math.atan2(2 * sxy, sxx - syy)
        c, s = math.cos(angle), math.sin(angle)
        inner_a, inner_b = max(a - _OUTLINE_INSIDE, 1e-9), max(b - _OUTLINE_INSIDE, 1e-9)
        square = 0.0
        for i in range(first, last):
            dx, dy = points[i, 0] - x0 - cx, points[i, 1] - y0 - cy
            u, v = (c * dx + s * dy) / inner_a, (-s * dx + c * dy) / inner_b
            q = math.sqrt(u * u + v * v)
            slope = math.hypot(u / inner_a, v / inner_b) / max(q, 1e-9)
            square += ((q - 1) / max(slope, 1e-9)) ** 2
        shape[k, 0], shape[k, 1], shape[k, 2], shape[k, 3] = cx + x0, cy + y0, a, b
        shape[k, 4], shape[k, 5] = angle, math.sqrt(square / (last - first))
