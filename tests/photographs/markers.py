"""Square markers and boards as rasters of cells; bits are data of OpenCV's dictionaries."""

from __future__ import annotations

import cv2
import numpy as np

from tests.blind.generator.quaternions import Array
from tests.photographs.patterns import Cells

WHITE, BLACK = 0.85, 0.015
SHARES = 8  # cells of a square's edge of a ChArUco board; its marker has six


def marker(dictionary: str, number: int, edge_mm: float, quiet_cells: int = 1) -> Cells:
    """A marker of a dictionary ("4X4_50", "APRILTAG_36h11") with its black border, edge to edge ``edge_mm``."""
    found = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{dictionary}"))
    across = found.markerSize + 2
    bits = found.generateImageMarker(number, across) > 0
    return Cells(_inked(np.pad(bits, quiet_cells, constant_values=True)), edge_mm / across)


def chessboard(columns: int, rows: int, square_mm: float) -> Cells:
    """A board of squares, its first one black, with a white margin of one square."""
    white = (np.add.outer(np.arange(rows), np.arange(columns)) % 2).astype(bool)
    return Cells(_inked(np.pad(white, 1, constant_values=True)), square_mm)


def charuco(columns: int, rows: int, square_mm: float, dictionary: str = "4X4_50") -> Cells:
    """A ChArUco board whose markers fill six eighths of a white square's edge (dictionaries of 4 x 4 bits)."""
    found = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{dictionary}"))
    board = cv2.aruco.CharucoBoard((columns, rows), SHARES, SHARES - 2, found)
    cells = board.generateImage((SHARES * columns, SHARES * rows), marginSize=0) > 0
    return Cells(_inked(np.pad(cells, SHARES, constant_values=True)), square_mm / SHARES)


def words(text: str, height_mm: float) -> Cells:
    """Lettering, light on dark, as on a type plate."""
    raster = np.zeros((30, 18 * len(text) + 12), np.uint8)
    cv2.putText(raster, text, (6, 22), cv2.FONT_HERSHEY_SIMPLEX, 0.75, 255, 2, cv2.LINE_AA)
    return Cells(0.03 + 0.5 * raster / 255, height_mm / len(raster))


def _inked(white: Array) -> Array:
    return np.where(white, WHITE, BLACK)
