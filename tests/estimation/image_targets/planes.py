"""Rendered planar patterns in perspective: light is integrated over pixels after the blur, on a fine grid."""

from __future__ import annotations

import cv2
import numpy as np

from tests.estimation.image_targets.pictures import pixel_weights

FINE = 8  # samples per pixel and axis
MARGIN = 5  # pixels around a picture that shine into it
CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
DICTIONARIES = {
    "aruco4x4_50": cv2.aruco.DICT_4X4_50,
    "aruco5x5_100": cv2.aruco.DICT_5X5_100,
    "aruco6x6_250": cv2.aruco.DICT_6X6_250,
    "apriltag36h11": cv2.aruco.DICT_APRILTAG_36h11,
}


def homography(corners):
    """The matrix (3, 3) that takes the unit square to four points (4, 2)."""
    rows = []
    for (u, v), (x, y) in zip(CORNERS, corners, strict=True):
        rows += [[u, v, 1, 0, 0, 0, -u * x, -v * x], [0, 0, 0, u, v, 1, -u * y, -v * y]]
    return np.append(np.linalg.solve(rows, np.ravel(corners)), 1.0).reshape(3, 3)


def through(H, points):
    """Points (N, 2) of the plane as H shows them."""
    seen = np.column_stack([points, np.ones(len(points))]) @ H.T
    return seen[:, :2] / seen[:, 2:]


def plane_picture(pattern, H, size, blur, fine=FINE):
    """Return (size, size) the light of a pattern, pattern(u, v) from 0 to 1 in the plane."""
    at = (np.arange((size + 2 * MARGIN) * fine) + 0.5) / fine - 0.5 - MARGIN
    x, y = np.meshgrid(at, at)
    u, v, w = np.tensordot(np.linalg.inv(H), np.stack([x, y, np.ones_like(x)]), 1)
    weights = pixel_weights(size, at, blur)
    return weights @ pattern(u / w, v / w) @ weights.T


def marker_pattern(family, code):
    """A marker on the unit square, white around it."""
    dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[family])
    cells = dictionary.markerSize + 2
    bits = (dictionary.generateImageMarker(code, cells) > 127).astype(float)

    def light(u, v):
        row, column = np.floor(v * cells).astype(int), np.floor(u * cells).astype(int)
        inside = (row >= 0) & (row < cells) & (column >= 0) & (column < cells)
        return np.where(inside, bits[np.clip(row, 0, cells - 1), np.clip(column, 0, cells - 1)], 1.0)

    return light


def board_pattern(columns, rows, family=None, share=0.75):
    """A chessboard of so many inner corners on the unit square, its first square dark; white ones hold markers."""

    def light(u, v):
        x, y = u * (columns + 1), v * (rows + 1)
        row, column = np.floor(y).astype(int), np.floor(x).astype(int)
        inside = (row >= 0) & (row <= rows) & (column >= 0) & (column <= columns)
        board = np.where(inside, ((row + column) % 2).astype(float), 1.0)
        white = [(r, c) for r in range(rows + 1) for c in range(columns + 1) if (r + c) % 2]
        for code, (r, c) in enumerate(white if family else []):
            own = (row == r) & (column == c)
            board[own] = marker_pattern(family, code)(
                (x[own] - c - 0.5) / share + 0.5, (y[own] - r - 0.5) / share + 0.5
            )
        return board

    return light


def exposed(light, rng, dark=40.0, bright=200.0, noise=2.0):
    """A picture of 8 bits of some light, with noise of so many grey levels."""
    return np.clip(np.round(dark + (bright - dark) * light + rng.normal(0.0, noise, light.shape)), 0, 255).astype(
        np.uint8
    )
