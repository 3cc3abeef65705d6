"""Square markers in photographs: which codes are there, and their four corners to fractions of a pixel."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.estimation.image_targets.image_noise import ImageNoise, estimate_noise
from truing.estimation.image_targets.quad_corners import refine_quads

Array = NDArray[np.float64]

_ARUCO = {f"aruco{n}x{n}_{codes}": f"DICT_{n}X{n}_{codes}" for n in (4, 5, 6, 7) for codes in (50, 100, 250, 1000)}
_DICTIONARIES = {
    **_ARUCO,
    "aruco_original": "DICT_ARUCO_ORIGINAL",
    "aruco_mip_36h12": "DICT_ARUCO_MIP_36h12",
    **{f"apriltag{size}": f"DICT_APRILTAG_{size}" for size in ("16h5", "25h9", "36h10", "36h11")},
}
FAMILIES = tuple(_DICTIONARIES)
_LARGE = 6_000_000  # pixels; larger images are searched at half their size
_MOST_CELLS = 10  # along a marker's edge
_TWICE = "code seen twice in one image"


@dataclass(frozen=True)
class MarkerCorners:
    """Corners of markers: family (N,) by number, code (N,), corner (N,) 0 to 3 from the marker's top left, clockwise as
    seen; xy_px (N, 2), cov_px2 (N, 2, 2), contrast (N,) in grey levels; and how many markers were refused, why.
    """

    family: NDArray[np.int64]
    code: NDArray[np.int64]
    corner: NDArray[np.int64]
    xy_px: Array
    cov_px2: Array
    contrast: Array
    rejected: Counter[tuple[int, str]] = field(default_factory=Counter)


def dictionary(family: str) -> Any:
    """The OpenCV dictionary of a family of ``FAMILIES``."""
    import cv2

    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, _DICTIONARIES[family]))


def codes_of(family: str) -> int:
    """How many codes a family has, counted from 0."""
    return len(dictionary(family).bytesList)


def measure_markers(grey: NDArray, families: tuple[str, ...], noise: ImageNoise | None = None) -> MarkerCorners:
    """Find the markers of some families in a grey image (h, w) of 8 or 16 bits, and refine their corners.

    A marker is dark on light, with a margin of one of its cells. What is refused is counted by family and reason. The
    covariance is that of one corner: two corners of a marker share an edge, and with it a part of their errors.
    """
    corners, family, code = _detected(grey, families)
    rejected: Counter[tuple[int, str]] = Counter()
    keep = np.flatnonzero(_once(corners, family, code, rejected))
    keep = keep[np.lexsort([code[keep], family[keep]])]
    corners, family, code = corners[keep], family[keep], code[keep]
    if not len(corners):
        empty, numbers = np.empty(0), np.empty(0, np.int64)
        return MarkerCorners(numbers, numbers, numbers, np.empty((0, 2)), np.empty((0, 2, 2)), empty, rejected)
    cells = np.array([dictionary(name).markerSize + 2 for name in families])[family]
    module = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).min(1) / cells
    found = refine_quads(grey, corners, module, noise or estimate_noise(grey))
    for number, reason in zip(family.tolist(), found.refused.tolist(), strict=True):
        if reason:
            rejected[(number, reason)] += 1
    good = found.refused == ""
    count = int(good.sum())
    return MarkerCorners(
        np.repeat(family[good], 4),
        np.repeat(code[good], 4),
        np.tile(np.arange(4), count),
        found.xy[good].reshape(-1, 2),
        found.covariance[good].reshape(-1, 2, 2),
        np.repeat(found.contrast[good], 4),
        rejected,
    )


def _detected(grey: NDArray, families: tuple[str, ...]) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
    """Corners (Q, 4, 2) to about a pixel, family (Q,) and code (Q,)."""
    import cv2

    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
    parameters.minMarkerPerimeterRate = min(0.03, 80.0 / max(grey.shape))
    parameters.errorCorrectionRate = 0.3  # chance makes a code of anything if enough of it is corrected
    detector = cv2.aruco.ArucoDetector([dictionary(family) for family in families], parameters)
    plain = eight_bits(grey)
    coarse = plain.size > _LARGE  # a marker that is lost at half the size has cells too small to be measured
    if coarse:
        plain = cv2.resize(plain, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    quads, ids, _, numbers = detector.detectMarkersMultiDict(plain)
    if ids is None or not len(ids):
        return np.empty((0, 4, 2)), np.empty(0, np.int64), np.empty(0, np.int64)
    corners = np.array([quad.reshape(4, 2) for quad in quads], dtype=float)
    if coarse:
        corners = _at_full_size(grey, 2.0 * corners + 0.5)
    return corners, np.asarray(numbers, np.int64).ravel(), np.asarray(ids, np.int64).ravel()


def _at_full_size(grey: NDArray, corners: Array) -> Array:
    """Corners (Q, 4, 2) that were found at half the size, to a part of a pixel in the whole image."""
    import cv2

    whole = eight_bits(grey)
    cell = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).min(1) / _MOST_CELLS
    window = np.clip(np.round(cell), 2, 5).astype(int)
    found = corners.astype(np.float32)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 20, 0.05)
    for size in np.unique(window).tolist():
        own = np.flatnonzero(window == size)
        points = np.ascontiguousarray(found[own].reshape(-1, 1, 2))
        found[own] = cv2.cornerSubPix(whole, points, (size, size), (-1, -1), stop).reshape(-1, 4, 2)
    return found.astype(float)


def eight_bits(grey: NDArray) -> NDArray[np.uint8]:
    """A grey image as detectors want it: contiguous, of 8 bits, over the range that it has."""
    if grey.dtype == np.uint8:
        return np.ascontiguousarray(grey)
    low, high = float(grey.min()), float(grey.max())
    stretched = (np.asarray(grey, np.float32) - low) * (255.0 / max(high - low, 1.0))
    return np.ascontiguousarray(np.rint(stretched).astype(np.uint8))


def _once(
    corners: Array, family: NDArray[np.int64], code: NDArray[np.int64], rejected: Counter[tuple[int, str]]
) -> NDArray[np.bool_]:
    """Markers (Q,) whose code stands in the image once, and that are read as one code."""
    centre = corners.mean(1)
    keep = np.ones(len(corners), dtype=bool)
    for number, own in set(zip(family.tolist(), code.tolist(), strict=True)):
        same = np.flatnonzero((family == number) & (code == own))
        if len(same) > 1:
            keep[same] = False
            rejected[(number, _TWICE)] += len(same)
    size = np.linalg.norm(corners[:, 0] - corners[:, 2], axis=1)
    for one in np.flatnonzero(keep):
        others = np.flatnonzero(keep & (np.linalg.norm(centre - centre[one], axis=1) < 0.25 * size[one]))
        # The smallest family that a code belongs to is the first that was asked for.
        for other in others[others > one]:
            keep[other] = False
            rejected[(int(family[other]), "read as a code of another family, too")] += 1
    return keep
