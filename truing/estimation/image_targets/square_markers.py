"""Detection of square markers in photographs: their codes, and their four corners to fractions of a pixel."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask
from truing.estimation.image_targets.image_noise import ImageNoise, estimate_noise
from truing.estimation.image_targets.marker_codes import Codes, cells_across, read_codes
from truing.estimation.image_targets.quad_corners import refine_quads

_LARGE = 6_000_000  # pixels; larger images are searched at half size
_LEAST_OUTLINE, _LEAST_SHARE = 80.0, 0.03  # px of an outline, or a share of the image's longer side if that is smaller
_MOST_CELLS = 10  # along the edge of a marker
_TWICE, _TWO_CODES = "code seen twice in one image", "read as a code of another family, too"
_WINDOWS = (3, 13, 23)  # px of the window that averages the ground
_DARKER = 7  # grey levels below the ground
_SHORTEST_SHARE = 0.05  # least share of the outline for each edge
_BENT_SHARE = 0.03  # largest deviation of the outline from straight edges, relative to its length
_MARGIN = 3  # px to the image border


@dataclass(frozen=True)
class MarkerCorners:
    """Corners of markers: family (N,) by number, code (N,), corner (N,) 0 to 3 from the marker's top left, clockwise as
    seen; xy_px (N, 2), cov_px2 (N, 2, 2), contrast (N,) in grey levels; and counts of rejected markers by family and
    reason."""

    family: Index
    code: Index
    corner: Index
    xy_px: Array
    cov_px2: Array
    contrast: Array
    rejected: Counter[tuple[int, str]] = field(default_factory=Counter)


def measure_markers(grey: NDArray, families: tuple[str, ...], noise: ImageNoise | None = None) -> MarkerCorners:
    """Return the refined corners of markers of some families in a grey image (h, w) of 8 or 16 bits.

    A marker is dark on light, with a margin of one cell. The covariance is that of single corners: two corners of a
    marker share an edge, and part of its error.
    """
    corners, read = _detected(grey, families)
    rejected: Counter[tuple[int, str]] = Counter()
    keep = np.flatnonzero(_unique_markers(corners, read, rejected))
    keep = keep[np.lexsort([read.code[keep], read.family[keep]])]
    corners, family, code = corners[keep], read.family[keep], read.code[keep]
    if not len(corners):
        empty, numbers = np.empty(0), np.empty(0, np.int64)
        return MarkerCorners(numbers, numbers, numbers, np.empty((0, 2)), np.empty((0, 2, 2)), empty, rejected)
    cells = np.array([cells_across(name) for name in families])[family]
    module = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).min(1) / cells
    quads = refine_quads(grey, corners, module, noise or estimate_noise(grey))
    for number, reason in zip(family.tolist(), quads.refused.tolist(), strict=True):
        if reason:
            rejected[(number, reason)] += 1
    good = quads.refused == ""
    count = int(good.sum())
    return MarkerCorners(
        np.repeat(family[good], 4),
        np.repeat(code[good], 4),
        np.tile(np.arange(4), count),
        quads.xy[good].reshape(-1, 2),
        quads.covariance[good].reshape(-1, 2, 2),
        np.repeat(quads.contrast[good], 4),
        rejected,
    )


def _detected(grey: NDArray, families: tuple[str, ...]) -> tuple[Array, Codes]:
    """Return corners (Q, 4, 2) to about a pixel, from each marker's first one, with the codes read (Q,)."""
    import cv2

    plain = eight_bits(grey)
    coarse = plain.size > _LARGE  # a marker lost at half size has cells too small to be measured
    if coarse:
        plain = cv2.resize(plain, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    share = min(_LEAST_SHARE, _LEAST_OUTLINE / max(grey.shape))
    quads = find_quadrangles(plain, int(share * max(plain.shape)))
    read = read_codes(plain, quads.corners, families)
    best = _best(read, quads.corners[read.quad])
    read = Codes(*(getattr(read, name)[best] for name in Codes.__dataclass_fields__))
    corners = where_edges_meet(quads.corners[read.quad], [quads.outlines[k] for k in read.quad])
    corners = np.take_along_axis(corners, ((read.first[:, None] + np.arange(4)) % 4)[..., None], axis=1)
    return _refine_at_full_size(grey, 2.0 * corners + 0.5) if coarse else corners, read


def _best(read: Codes, corners: Array) -> NDArray[np.intp]:
    """Return, for each position and family, the reading with the fewest wrong bits and then the largest outline: one
    marker has several outlines. corners (N, 4, 2) of all readings (N,)."""
    outline = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).sum(1)
    order = np.lexsort((-outline, read.errors))
    return np.flatnonzero(_first_of_each_position(corners, order, read.family))


def _first_of_each_position(corners: Array, order: NDArray[np.intp], group: Index) -> Mask:
    """Return the mask of quadrangles (N, 4, 2) without an earlier one of their group (N,) at the same position."""
    centre, size = corners.mean(1), np.linalg.norm(corners[:, 0] - corners[:, 2], axis=1)
    distance = np.linalg.norm(centre[:, None] - centre, axis=2)
    same = (distance < 0.25 * size[:, None]) & (group[:, None] == group)
    keep = np.ones(len(corners), dtype=bool)
    for index in order.tolist():
        if keep[index]:
            keep &= ~same[index]
            keep[index] = True
    return keep


def _refine_at_full_size(grey: NDArray, corners: Array) -> Array:
    """Return corners (Q, 4, 2), found at half size, refined to a fraction of a pixel in the full image."""
    import cv2

    bits = eight_bits(grey)
    cell = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).min(1) / _MOST_CELLS
    window = np.clip(np.round(cell), 2, 5).astype(int)
    refined = corners.astype(np.float32)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 20, 0.05)
    for size in np.unique(window).tolist():
        indices = np.flatnonzero(window == size)
        points = np.ascontiguousarray(refined[indices].reshape(-1, 1, 2))
        refined[indices] = cv2.cornerSubPix(bits, points, (size, size), (-1, -1), stop).reshape(-1, 4, 2)
    return refined.astype(float)


def eight_bits(grey: NDArray) -> NDArray[np.uint8]:
    """Return a grey image for OpenCV's detectors: contiguous, 8 bits, stretched to its own range."""
    if grey.dtype == np.uint8:
        return np.ascontiguousarray(grey)
    low, high = float(grey.min()), float(grey.max())
    stretched = (np.asarray(grey, np.float32) - low) * (255.0 / max(high - low, 1.0))
    return np.ascontiguousarray(np.rint(stretched).astype(np.uint8))


def _unique_markers(corners: Array, read: Codes, rejected: Counter[tuple[int, str]]) -> Mask:
    """Return the mask of markers (Q,): the clearest code of each position, and only codes that occur once in the
    image."""
    # a code in several families counts for the first requested one
    order = np.lexsort((read.family, read.unclear))
    keep = _first_of_each_position(corners, order, np.zeros(len(corners), np.int64))
    rejected.update((number, _TWO_CODES) for number in read.family[~keep].tolist())
    _, name, times = np.unique(
        np.stack([read.family[keep], read.code[keep]], 1), axis=0, return_inverse=True, return_counts=True
    )
    again = np.flatnonzero(keep)[times[name] > 1]
    rejected.update((number, _TWICE) for number in read.family[again].tolist())
    keep[again] = False
    return keep


@dataclass(frozen=True)
class Quadrangles:
    """Corners (Q, 4, 2) in px, at pixels of the outlines, clockwise as seen; and the outlines (Q,), each (n, 2) in
    px."""

    corners: Array
    outlines: list[NDArray[np.int32]]


def find_quadrangles(plain: NDArray[np.uint8], shortest_px: int) -> Quadrangles:
    """Return the quadrangles in an image (h, w) with outlines of at least ``shortest_px`` pixels; one may occur
    repeatedly."""
    import cv2

    quadrangles: list[NDArray[np.int32]] = []
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
                quadrangles.append(corners.reshape(4, 2))
                outlines.append(np.asarray(contour, np.int32).reshape(-1, 2))
    if not quadrangles:
        return Quadrangles(np.empty((0, 4, 2)), [])
    corners = np.stack(quadrangles).astype(float)
    shortest = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).min(1)
    inside = (corners >= _MARGIN) & (corners <= np.array(plain.shape[::-1]) - 1.0 - _MARGIN)
    keep = inside.all((1, 2)) & (shortest >= _SHORTEST_SHARE * np.array([len(outline) for outline in outlines]))
    return Quadrangles(_clockwise(corners[keep]), [outlines[k] for k in np.flatnonzero(keep)])


def _clockwise(corners: Array) -> Array:
    """Return corners (Q, 4, 2) in clockwise order as seen, with the same first corner."""
    first, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    counter = first[:, 0] * two[:, 1] - first[:, 1] * two[:, 0] < 0.0
    return np.where(counter[:, None, None], corners[:, [0, 3, 2, 1]], corners)


def where_edges_meet(corners: Array, outlines: list[NDArray[np.int32]]) -> Array:
    """Return corners (Q, 4, 2) to a fraction of a pixel, as intersections of lines fitted to the outlines (Q,) between
    the corners."""
    if not outlines:
        return np.empty((0, 4, 2))
    quad = np.repeat(np.arange(len(outlines)), [len(outline) for outline in outlines])
    points = np.concatenate(outlines)
    at = _corner_indices(points, quad, corners)
    order = np.argsort(at, axis=1)  # in the order along the outline
    at = np.take_along_axis(at, order, axis=1)
    met = np.take_along_axis(corners, order[..., None], axis=1)
    # Points before the first corner belong to the last edge.
    edge = ((np.arange(len(points))[:, None] >= at[quad]).sum(1) - 1) % 4
    middle = corners.mean(1)
    line = _lines(points - middle[quad], 4 * quad + edge, np.roll(met, -1, axis=1) - met)
    (a, b, c), (p, q, r) = (np.moveaxis(lines, 2, 0) for lines in (line, np.roll(line, 1, axis=1)))
    crossing = a * q - b * p
    # Lines through three or four pixels are unreliable: such corners keep their position.
    meet = np.abs(crossing) > 1e-3
    fitted = np.stack([c * q - b * r, a * r - c * p], 2) / np.where(meet, crossing, 1.0)[..., None] + middle[:, None]
    result = np.empty_like(corners)
    np.put_along_axis(result, order[..., None], np.where(meet[..., None], fitted, met), axis=1)
    return result


def _corner_indices(points: NDArray[np.int32], quad: NDArray[np.intp], corners: Array) -> NDArray[np.intp]:
    """Return the indices (Q, 4) of the corners (Q, 4, 2) among the points (P, 2) of quadrangles (P,)."""
    at = np.empty(corners.shape[:2], dtype=np.intp)
    for corner in range(4):
        same = np.flatnonzero((points == corners[quad, corner]).all(1))
        at[:, corner] = same[np.unique(quad[same], return_index=True)[1]]
    return at


def _lines(points: Array, edge: NDArray[np.intp], side: Array) -> Array:
    """Return normals and distances (Q, 4, 3) of lines through the points (P, 2) of edges (P,). They are fitted across
    the axis nearest to their sides (Q, 4, 2)."""
    x, y = points.T
    sums = [np.bincount(edge, weight, side.shape[0] * 4).reshape(-1, 4) for weight in (None, x, y, x * x, x * y, y * y)]
    count, mean_x, mean_y = sums[0], sums[1] / sums[0], sums[2] / sums[0]
    xx, xy, yy = sums[3] - count * mean_x**2, sums[4] - count * mean_x * mean_y, sums[5] - count * mean_y**2
    level = np.abs(side[..., 0]) > np.abs(side[..., 1])
    slope = xy / np.maximum(np.where(level, xx, yy), 1e-9)
    normal_x, normal_y = np.where(level, slope, -1.0), np.where(level, -1.0, slope)
    return np.stack([normal_x, normal_y, normal_x * mean_x + normal_y * mean_y], -1)
