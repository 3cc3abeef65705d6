"""Candidates for circular targets in a photograph: ellipse-like outlines of regions lighter or darker than their
surroundings."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Mask
from truing.compiled_code import compiled

# A pixel is compared with the mean of a square window of this size. This finds edges at any size of target and under
# any
# light; of a large target a band along its edge remains, with the same outline.
_WINDOW = 15
# Relative to the contrast: at an edge the mean over the window is half way, in a small dot less.
_STEP_SHARE = 0.3
_NOISE_SIGMAS = 4.0
_OUTLINE_INSIDE = 0.5  # px from the outline, through centres of pixels, to the edge
_ROUGH = 0.6  # px, rms of an outline about its ellipse; staircases of pixels have 0.3
_ROUGH_SHARE = 0.06  # the same limit for larger outlines, relative to the semi-minor axis
SHAPE = 10  # centre x y, semi-axes, angle of the major one, rms distance, left, top, right, bottom


@dataclass(frozen=True)
class EllipseCandidates:
    """Ellipses fitted to outlines: centre_px (N, 2), semi_axes_px (N, 2), axis_angle_rad (N,), white (N,) if the inside
    is lighter; and counts of rejected outlines by reason."""

    centre_px: Array
    semi_axes_px: Array
    axis_angle_rad: Array
    white: Mask
    rejected: Counter[str]


def find_candidates(
    grey: NDArray,
    polarities: tuple[bool, ...],
    size_px: tuple[float, float],
    least_ratio: float,
    least_contrast: float,
    sigma: float,
) -> EllipseCandidates:
    """Return ellipse-like outlines of a grey image (h, w).

    polarities: True for lighter than the ground, False for darker; size_px: least semi-minor and largest semi-major
    axis; least_ratio of the axes; least contrast and standard deviation of the noise in grey levels.
    """
    import cv2

    # the mean over nine pixels has a third of their noise
    step = max(_STEP_SHARE * least_contrast, _NOISE_SIGMAS * sigma / 3, 1.0)
    smooth, mean = cv2.blur(grey, (3, 3)), cv2.blur(grey, (_WINDOW, _WINDOW))
    shapes, white, rejected = [], [], Counter[str]()
    for lighter in polarities:
        difference = cv2.subtract(smooth, mean) if lighter else cv2.subtract(mean, smooth)
        mask = cv2.compare(difference, step, cv2.CMP_GT)
        outlines, levels = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        measured = _measured(outlines, levels, size_px, rejected)
        shapes.append(measured)
        white.append(np.full(len(measured), lighter))
    shape = np.concatenate(shapes)
    lighter_of = np.concatenate(white)
    reasons = _reasons(shape, grey.shape, size_px, least_ratio)
    for number, reason in enumerate(_REASONS, 1):
        rejected[reason] += int((reasons == number).sum())
    good = shape[reasons == 0]
    return EllipseCandidates(good[:, :2], good[:, 2:4], good[:, 4], lighter_of[reasons == 0], +rejected)


_REASONS = ("at border", "too small", "too large", "too oblique", "not elliptical")


def _measured(outlines: Any, levels: NDArray | None, size_px: tuple[float, float], rejected: Counter[str]) -> Array:
    """Return shapes (N, 10) of the outer outlines of suitable length, and count the others. The ellipse has the area,
    centroid and second moments of the polygon, enlarged by half a pixel, since the outline runs through pixel centres.
    NaN if an outline has no area."""
    if levels is None:
        return np.empty((0, SHAPE))
    length = np.fromiter(map(len, outlines), np.int64, len(outlines))
    outer = levels[0, :, 3] < 0
    # an outline of chained pixels is shorter than the ellipse's circumference by at most a factor sqrt(2)
    short, long = length < 4.4 * (size_px[0] - _OUTLINE_INSIDE), length > 6.3 * (size_px[1] + 2)
    rejected["too small"] += int((outer & short).sum())
    rejected["too large"] += int((outer & long).sum())
    index = np.flatnonzero(outer & ~short & ~long)
    if not len(index):
        return np.empty((0, SHAPE))
    points, shape = np.concatenate([outlines[k] for k in index])[:, 0, :], np.empty((len(index), SHAPE))
    starts = np.concatenate([[0], np.cumsum(length[index])])
    _measure(np.ascontiguousarray(points, np.int32), np.ascontiguousarray(starts, np.int64), shape)
    return shape


def _reasons(shape: Array, size: tuple[int, ...], size_px: tuple[float, float], least_ratio: float) -> NDArray:
    """Return 0 for each candidate shape, or the number of the reason for its rejection, from 1."""
    a, b = shape[:, 2], shape[:, 3]
    left, top, right, bottom = shape[:, 6:10].T
    border = (left <= 1) | (top <= 1) | (right >= size[1] - 2) | (bottom >= size[0] - 2)
    rough = ~(shape[:, 5] <= np.maximum(_ROUGH, _ROUGH_SHARE * b))
    tests = (border, ~(b >= size_px[0] - _OUTLINE_INSIDE), a > size_px[1], b < least_ratio * a, rough)
    return np.select(tests, range(1, 6), 0)


@compiled(__file__)
def _measure(points, starts, shape):  # type: ignore[no-untyped-def]
    """Fill in shapes (N, 10) of closed outlines: points (P, 2) in px one outline after the other, starts (N + 1,)."""
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
