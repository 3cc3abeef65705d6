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
    quads, ids, _, numbers = detector.detectMarkersMultiDict(eight_bits(grey))
    if ids is None or not len(ids):
        return np.empty((0, 4, 2)), np.empty(0, np.int64), np.empty(0, np.int64)
    corners = np.array([quad.reshape(4, 2) for quad in quads], dtype=float)
    return corners, np.asarray(numbers, np.int64).ravel(), np.asarray(ids, np.int64).ravel()


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
