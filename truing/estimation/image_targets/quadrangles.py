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
    return np.array([_meet(*pair) for pair in zip(corners, outlines, strict=True)]).reshape(-1, 4, 2)


def _meet(corners: Array, outline: NDArray[np.int32]) -> Array:
    """Corners (4, 2) of one outline (n, 2)."""
    at = (outline[:, None] == corners).all(2).argmax(0)  # where along the outline the corners are
    order = np.argsort(at)
    ring = np.roll(outline, -at[order[0]], axis=0).astype(float)
    line = np.array([_line(points) for points in np.split(ring, (at[order] - at[order[0]])[1:])])
    before = np.roll(line, 1, axis=0)
    met = np.empty((4, 2))
    pairs = np.stack([line, before], 1)
    met[order] = np.linalg.solve(pairs[..., :2], pairs[..., 2:])[..., 0]
    return met


def _line(points: Array) -> Array:
    """Normal and distance (3,) of the line through points (n, 2), fitted across the axis that it runs nearer to."""
    mean = points.mean(0)
    lead = int(np.argmax(np.ptp(points, axis=0)))
    off = points - mean
    slope = (off[:, 0] @ off[:, 1]) / max(float(off[:, lead] @ off[:, lead]), 1e-12)
    normal = np.array([slope, -1.0]) if lead == 0 else np.array([-1.0, slope])
    return np.array([*normal, normal @ mean])
