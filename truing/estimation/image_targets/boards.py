"""Boards in photographs: chessboards, and chessboards with markers in their white squares, corner by corner."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from truing.estimation.image_targets.image_noise import ImageNoise, estimate_noise
from truing.estimation.image_targets.marker_codes import dictionary
from truing.estimation.image_targets.saddle_points import refine_saddles
from truing.estimation.image_targets.square_markers import eight_bits

Array = NDArray[np.float64]

_SEARCHED = 3_000_000  # pixels: in more, searching for a board takes longer than all that follows


@dataclass(frozen=True)
class BoardPlan:
    """A board of ``columns`` x ``rows`` inner corners; of one with markers also their family, the code of the first,
    a marker's edge over a square's, and whether its pattern is that of OpenCV before 4.6."""

    name: str
    kind: Literal["chessboard", "charuco"]
    columns: int
    rows: int
    family: str = ""
    first_code: int = 0
    marker_share: float = 0.75
    legacy: bool = False


@dataclass(frozen=True)
class BoardCorners:
    """Corners of a board: number (N,) row by row from 0, xy_px (N, 2), cov_px2 (N, 2, 2), contrast (N,) in grey levels;
    and how many corners were refused, why. Corners of a chessboard count from the one whose outer square is dark."""

    number: NDArray[np.int64]
    xy_px: Array
    cov_px2: Array
    contrast: Array
    rejected: Counter[str] = field(default_factory=Counter)


def measure_board(grey: NDArray, plan: BoardPlan, noise: ImageNoise | None = None) -> BoardCorners:
    """Find a board in a grey image (h, w) of 8 or 16 bits, and refine its corners; no corners where it is not seen.

    A chessboard has to be seen whole, of one with markers a part is enough.
    """
    number, start = _chessboard(grey, plan) if plan.kind == "chessboard" else _with_markers(grey, plan)
    rejected: Counter[str] = Counter()
    if len(number) < 4:
        empty = np.empty(0)
        return BoardCorners(np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2, 2)), empty, rejected)
    first, second = _steps(number, start, plan)
    spacing = np.minimum(np.linalg.norm(first, axis=1), np.linalg.norm(second, axis=1))
    # Beyond half a square there are other corners; beyond its white border, a marker.
    clear = 0.5 * spacing if plan.kind == "chessboard" else 0.6 * (1.0 - plan.marker_share) * spacing
    found = refine_saddles(grey, start, first, second, clear, noise or estimate_noise(grey))
    xy, covariance, contrast, refused = found.xy, found.covariance, found.contrast, found.refused
    if plan.kind == "chessboard":
        row, column = np.divmod(number, plan.columns)
        outer = np.sum(np.where(refused == "", np.sign(contrast), 0.0) * (1.0 - 2.0 * ((row + column) % 2)))
        if outer > 0.0:  # the outer square of the first corner is light: the board is seen turned by half a turn
            number = plan.columns * plan.rows - 1 - number
    good = refused == ""
    rejected.update(refused[~good].tolist())
    order = np.argsort(number[good])
    pick = np.flatnonzero(good)[order]
    return BoardCorners(number[pick], xy[pick], covariance[pick], np.abs(contrast[pick]), rejected)


def _chessboard(grey: NDArray, plan: BoardPlan) -> tuple[NDArray[np.int64], Array]:
    """Numbers (N,) and places (N, 2) of the corners, rows running clockwise from columns; none where it is not seen."""
    import cv2

    size = (plan.columns, plan.rows)
    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    image, factor = _reduced(grey)
    seen, corners = cv2.findChessboardCornersSB(image, size, flags)
    if not seen:
        return np.empty(0, np.int64), np.empty((0, 2))
    places = (corners.reshape(plan.rows, plan.columns, 2).astype(float) + 0.5) * factor - 0.5
    right, down = (places[:, -1] - places[:, 0]).mean(0), (places[-1] - places[0]).mean(0)
    if right[0] * down[1] < right[1] * down[0]:
        places = places[:, ::-1]
    return np.arange(plan.columns * plan.rows), places.reshape(-1, 2)


def _with_markers(grey: NDArray, plan: BoardPlan) -> tuple[NDArray[np.int64], Array]:
    """The same of a board with markers, as far as it is seen."""
    import cv2

    squares = (plan.columns + 1, plan.rows + 1)
    count = squares[0] * squares[1] // 2
    codes = np.arange(plan.first_code, plan.first_code + count)
    board = cv2.aruco.CharucoBoard(squares, 1.0, plan.marker_share, dictionary(plan.family), codes)
    board.setLegacyPattern(plan.legacy)
    parameters = cv2.aruco.CharucoParameters()
    image, factor = _reduced(grey)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(board, parameters).detectBoard(image)
    if ids is None or not len(ids):
        return np.empty(0, np.int64), np.empty((0, 2))
    return np.asarray(ids, np.int64).ravel(), (corners.reshape(-1, 2).astype(float) + 0.5) * factor - 0.5


def _reduced(grey: NDArray) -> tuple[NDArray[np.uint8], float]:
    """The image at a size at which boards are searched for, and by which factor it was larger."""
    import cv2

    plain = eight_bits(grey)
    factor = max(1.0, float(np.sqrt(plain.size / _SEARCHED)))
    if factor == 1.0:
        return plain, 1.0
    size = (round(plain.shape[1] / factor), round(plain.shape[0] / factor))
    return cv2.resize(plain, size, interpolation=cv2.INTER_AREA), plain.shape[1] / size[0]


def _steps(number: NDArray[np.int64], places: Array, plan: BoardPlan) -> tuple[Array, Array]:
    """Vectors (N, 2) from each corner to the next along its row and along its column, by the board's homography."""
    import cv2

    row, column = np.divmod(number, plan.columns)
    grid = np.stack([column, row], 1).astype(float)
    H, _ = cv2.findHomography(grid, places, 0)
    if H is None:
        H = np.eye(3)
    half = np.array([[0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]])
    ahead = (grid + half[:, None]).reshape(-1, 2)
    seen = np.concatenate([ahead, np.ones((len(ahead), 1))], 1) @ H.T
    right, left, below, above = np.split(seen[:, :2] / seen[:, 2:], 4)
    return right - left, below - above
