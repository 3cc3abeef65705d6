"""Quadrangles in grey images: outlines of what is darker than its surroundings, if four straight edges bound it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_WINDOWS = (3, 13, 23)  # px over which the ground is averaged
_DARKER = 7  # grey levels than the ground
_SHORTEST_SHARE = 0.05  # of the outline, that every edge has at least
_BENT_SHARE = 0.03  # of the outline, by which it may depart from straight edges
_MARGIN = 3  # px to the rim of the image


@dataclass(frozen=True)
class Quadrangles:
    """Corners (Q, 4, 2) in px, pixels of the outlines, clockwise as seen; and the outlines (Q,), each (n, 2) in px."""

    corners: Array
    outlines: list[NDArray[np.int32]]


def find_quadrangles(plain: NDArray[np.uint8], shortest_px: int) -> Quadrangles:
    """Quadrangles in an image (h, w) whose outline has at least ``shortest_px`` pixels; one may be found repeatedly."""
    import cv2

    found: list[NDArray[np.int32]] = []
    outlines: list[NDArray[np.int32]] = []
    for window in _WINDOWS:
        dark = cv2.adaptiveThreshold(
            plain, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV, window, float(_DARKER)
        )
        contours = cv2.findContours(dark, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0]
        for contour in contours:
            if len(contour) < shortest_px:
                continue
            corners = cv2.approxPolyDP(contour, _BENT_SHARE * len(contour), True)
            if len(corners) == 4 and cv2.isContourConvex(corners):
                found.append(corners.reshape(4, 2))
                outlines.append(np.asarray(contour, np.int32).reshape(-1, 2))
    if not found:
        return Quadrangles(np.empty((0, 4, 2)), [])
    corners = np.stack(found).astype(float)
    shortest = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).min(1)
    inside = (corners >= _MARGIN) & (corners <= np.array(plain.shape[::-1]) - 1.0 - _MARGIN)
    keep = inside.all((1, 2)) & (shortest >= _SHORTEST_SHARE * np.array([len(outline) for outline in outlines]))
    return Quadrangles(_clockwise(corners[keep]), [outlines[k] for k in np.flatnonzero(keep)])


def _clockwise(corners: Array) -> Array:
    """Corners (Q, 4, 2) in the sense of the hands of a clock, as seen, the first one being kept."""
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    counter = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0] < 0.0
    return np.where(counter[:, None, None], corners[:, [0, 3, 2, 1]], corners)


def where_edges_meet(corners: Array, outlines: list[NDArray[np.int32]]) -> Array:
    """Corners (Q, 4, 2) to a part of a pixel: of lines fitted to what of the outlines (Q,) lies between the corners."""
    if not outlines:
        return np.empty((0, 4, 2))
    quad = np.repeat(np.arange(len(outlines)), [len(outline) for outline in outlines])
    points = np.concatenate(outlines)
    at = _where(points, quad, corners)
    order = np.argsort(at, axis=1)  # as the outline meets them
    at = np.take_along_axis(at, order, axis=1)
    met = np.take_along_axis(corners, order[..., None], axis=1)
    edge = ((np.arange(len(points))[:, None] >= at[quad]).sum(1) - 1) % 4  # before the first corner: of the last edge
    middle = corners.mean(1)
    line = _lines(points - middle[quad], 4 * quad + edge, np.roll(met, -1, axis=1) - met)
    (a, b, c), (p, q, r) = (np.moveaxis(lines, 2, 0) for lines in (line, np.roll(line, 1, axis=1)))
    crossing = a * q - b * p
    meet = np.abs(crossing) > 1e-3  # of three or four pixels lines may run anyhow: corners stay where they are
    fitted = np.stack([c * q - b * r, a * r - c * p], 2) / np.where(meet, crossing, 1.0)[..., None] + middle[:, None]
    found = np.empty_like(corners)
    np.put_along_axis(found, order[..., None], np.where(meet[..., None], fitted, met), axis=1)
    return found


def _where(points: NDArray[np.int32], quad: NDArray[np.intp], corners: Array) -> NDArray[np.intp]:
    """Which of the points (P, 2) of quadrangles (P,) are the corners (Q, 4, 2): numbers (Q, 4)."""
    at = np.empty(corners.shape[:2], dtype=np.intp)
    for corner in range(4):
        same = np.flatnonzero((points == corners[quad, corner]).all(1))
        at[:, corner] = same[np.unique(quad[same], return_index=True)[1]]
    return at


def _lines(points: Array, edge: NDArray[np.intp], side: Array) -> Array:
    """Normals and distances (Q, 4, 3) of lines through the points (P, 2) of edges (P,), fitted across the axis that
    their sides (Q, 4, 2) run nearer to."""
    x, y = points.T
    sums = [np.bincount(edge, weight, side.shape[0] * 4).reshape(-1, 4) for weight in (None, x, y, x * x, x * y, y * y)]
    count, mean_x, mean_y = sums[0], sums[1] / sums[0], sums[2] / sums[0]
    xx, xy, yy = sums[3] - count * mean_x**2, sums[4] - count * mean_x * mean_y, sums[5] - count * mean_y**2
    level = np.abs(side[..., 0]) > np.abs(side[..., 1])
    slope = xy / np.maximum(np.where(level, xx, yy), 1e-9)
    normal_x, normal_y = np.where(level, slope, -1.0), np.where(level, -1.0, slope)
    return np.stack([normal_x, normal_y, normal_x * mean_x + normal_y * mean_y], -1)
