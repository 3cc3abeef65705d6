"""Corners of chessboards and of chessboards with markers (ChArUco) in photographs.

A corner, where four squares meet, is a saddle point of the image. Its model is the product of two crossing edges: a
pixel shows (mean + contrast E(d1 / s) E(d2 / s)) (1 + slope . (x - start) / radius). Its distances from the two edges
are d1 and d2; s is the blur, including the pixel's own area; E(z) = erf(z / sqrt 2). The model is symmetric under half
a turn, so neither blur nor a wrong brightness of dark or light squares shifts its centre.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from truing.arrays import Array, Index
from truing.estimation.image_targets.image_noise import ImageNoise, estimate_noise
from truing.estimation.image_targets.marker_codes import dictionary
from truing.estimation.image_targets.patch_fit import PatchFit, bounded_blur, equations_of, fit_patches
from truing.estimation.image_targets.square_markers import eight_bits

_SEARCHED = 3_000_000  # pixels; the search for a board in a larger image would dominate the time
_SMALLEST, _LARGEST = 3.0, 9.0  # radius of a patch, px
_CHUNK = 256
_INV_SQRT2PI = 0.3989422804014327
# Unknowns: centre, directions of the edges' normals, blur, mean, contrast, slopes
_X, _Y, _NORMAL_1, _NORMAL_2, _BLUR, _MEAN, _CONTRAST, _SLOPE_X, _SLOPE_Y = range(9)
# Priors: a sharp picture does not determine the blur; light changes over a patch by a tenth as one sigma.
_PRIOR = np.array([0.0, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 100.0, 100.0])


@dataclass(frozen=True)
class BoardPlan:
    """A board of ``columns`` x ``rows`` inner corners; with markers also their family, the first code, marker edge over
    square edge, and whether the pattern is that of OpenCV before 4.6."""

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
    and counts of rejected corners by reason.

    Corners of a chessboard count from the one whose outer square is dark.
    """

    number: Index
    xy_px: Array
    cov_px2: Array
    contrast: Array
    rejected: Counter[str] = field(default_factory=Counter)


def measure_board(grey: NDArray, plan: BoardPlan, noise: ImageNoise | None = None) -> BoardCorners:
    """Return the refined corners of a board in a grey image (h, w) of 8 or 16 bits; empty if none is found.

    A chessboard must be completely visible; of a board with markers a part is enough.
    """
    number, start = _chessboard(grey, plan) if plan.kind == "chessboard" else _with_markers(grey, plan)
    rejected: Counter[str] = Counter()
    if len(number) < 4:
        empty = np.empty(0)
        return BoardCorners(np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2, 2)), empty, rejected)
    first, second = _steps(number, start, plan)
    spacing = np.minimum(np.linalg.norm(first, axis=1), np.linalg.norm(second, axis=1))
    # Nothing else is within half a square, or within the white border of a marker.
    clear = 0.5 * spacing if plan.kind == "chessboard" else 0.6 * (1.0 - plan.marker_share) * spacing
    corners = refine_saddles(grey, start, first, second, clear, noise or estimate_noise(grey))
    xy, covariance, contrast, refused = corners.xy, corners.covariance, corners.contrast, corners.refused
    if plan.kind == "chessboard":
        row, column = np.divmod(number, plan.columns)
        outer = np.sum(np.where(refused == "", np.sign(contrast), 0.0) * (1.0 - 2.0 * ((row + column) % 2)))
        if outer > 0.0:  # the outer square of the first corner is light: the board is rotated by half a turn
            number = plan.columns * plan.rows - 1 - number
    good = refused == ""
    rejected.update(refused[~good].tolist())
    order = np.argsort(number[good])
    pick = np.flatnonzero(good)[order]
    return BoardCorners(number[pick], xy[pick], covariance[pick], np.abs(contrast[pick]), rejected)


def _chessboard(grey: NDArray, plan: BoardPlan) -> tuple[Index, Array]:
    """Return numbers (N,) and positions (N, 2) of chessboard corners, rows clockwise from columns; empty if not
    found."""
    import cv2

    size = (plan.columns, plan.rows)
    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    image, factor = _reduced(grey)
    seen, corners = cv2.findChessboardCornersSB(image, size, flags)
    if not seen:
        return np.empty(0, np.int64), np.empty((0, 2))
    grid = (corners.reshape(plan.rows, plan.columns, 2).astype(float) + 0.5) * factor - 0.5
    right, down = (grid[:, -1] - grid[:, 0]).mean(0), (grid[-1] - grid[0]).mean(0)
    if right[0] * down[1] < right[1] * down[0]:
        grid = grid[:, ::-1]
    return np.arange(plan.columns * plan.rows), grid.reshape(-1, 2)


def _with_markers(grey: NDArray, plan: BoardPlan) -> tuple[Index, Array]:
    """Return the same for the visible part of a board with markers."""
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
    """Return the image reduced for the board search, and the reduction factor."""
    import cv2

    plain = eight_bits(grey)
    factor = max(1.0, float(np.sqrt(plain.size / _SEARCHED)))
    if factor == 1.0:
        return plain, 1.0
    size = (round(plain.shape[1] / factor), round(plain.shape[0] / factor))
    return cv2.resize(plain, size, interpolation=cv2.INTER_AREA), plain.shape[1] / size[0]


def _steps(number: Index, points: Array, plan: BoardPlan) -> tuple[Array, Array]:
    """Return the vectors (N, 2) from each corner to the next along row and column, by the board's homography."""
    import cv2

    row, column = np.divmod(number, plan.columns)
    grid = np.stack([column, row], 1).astype(float)
    H, _ = cv2.findHomography(grid, points, 0)
    if H is None:
        H = np.eye(3)
    half = np.array([[0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]])
    ahead = (grid + half[:, None]).reshape(-1, 2)
    seen = np.concatenate([ahead, np.ones((len(ahead), 1))], 1) @ H.T
    right, left, below, above = np.split(seen[:, :2] / seen[:, 2:], 4)
    return right - left, below - above


@dataclass(frozen=True)
class SaddlePoints:
    """Saddle points (N, 2) in px with covariance (N, 2, 2) in px^2; contrast (N,) in grey levels, positive if the
    squares along the sum of both directions are light; reason of rejection (N,), empty if accepted."""

    xy: Array
    covariance: Array
    contrast: Array
    refused: NDArray[np.str_]


def refine_saddles(
    grey: NDArray, start: Array, first: Array, second: Array, clear_px: Array, noise: ImageNoise
) -> SaddlePoints:
    """Return refined saddle points (N, 2) in a grey image (h, w), starting within 2 px of the truth.

    ``first`` and ``second`` (N, 2): vectors to the next corner along both edges; ``clear_px`` (N,): radius without
    other edges.
    """
    xy, covariance = start.astype(float), np.full((len(start), 2, 2), np.nan)
    contrast, refused = np.zeros(len(start)), np.zeros(len(start), dtype="U40")
    radius = np.clip(0.9 * clear_px, _SMALLEST, _LARGEST)
    for _ in range(2):  # the second time around the corrected point
        good = np.flatnonzero(refused == "")
        for chosen in np.array_split(good, -(-len(good) // _CHUNK)) if len(good) else ():
            fit, level = _fit(grey, xy[chosen], first[chosen], second[chosen], radius[chosen], noise)
            refused[chosen] = _refused(fit, level, radius[chosen])
            mask = refused[chosen] == ""
            xy[chosen[mask]] += fit.values[mask, :2]
            contrast[chosen] = 2.0 * fit.values[:, _CONTRAST]
            covariance[chosen] = fit.covariance[:, :2, :2] * (fit.covariance_factor * noise.correlation)[:, None, None]
    moved = np.linalg.norm(xy - start, axis=1)
    refused[(refused == "") & (moved > 3.0)] = "a corner elsewhere than expected"
    return SaddlePoints(xy, covariance, contrast, refused)


def _fit(
    grey: NDArray, start: Array, first: Array, second: Array, radius: Array, noise: ImageNoise
) -> tuple[PatchFit, Array]:
    """Return patches fitted around ``start``, and the noise (n,) of a pixel at their mean grey value."""
    reach = int(np.ceil(radius.max())) + 1
    offset = np.arange(-reach, reach + 1)
    middle = np.round(start).astype(int)
    x = (middle[:, :1, None] + offset[None, None, :]) + np.zeros((1, len(offset), 1), int)
    y = (middle[:, 1:, None] + offset[None, :, None]) + np.zeros((1, 1, len(offset)), int)
    x, y = x.reshape(len(start), -1), y.reshape(len(start), -1)
    inside = (x >= 0) & (y >= 0) & (x < grey.shape[1]) & (y < grey.shape[0])
    picture = grey[np.clip(y, 0, grey.shape[0] - 1), np.clip(x, 0, grey.shape[1] - 1)].astype(float)
    fx, fy = x - start[:, :1], y - start[:, 1:]
    usable = inside & (np.hypot(fx, fy) <= radius[:, None]) & (picture > grey.min()) & (picture < grey.max())
    count = np.maximum(usable.sum(1), 1)
    mean = (picture * usable).sum(1) / count
    spread = np.sqrt((np.square(picture - mean[:, None]) * usable).sum(1) / count)
    # The normal of one edge is perpendicular to that edge, along which the other corner vector lies.
    angles = [np.arctan2(-along[:, 0], along[:, 1]) for along in (second, first)]
    towards = [np.cos(a) * v[:, 0] + np.sin(a) * v[:, 1] for a, v in zip(angles, (first, second), strict=True)]
    angles = [np.where(t < 0.0, a + np.pi, a) for a, t in zip(angles, towards, strict=True)]
    values = np.zeros((len(start), 9))
    values[:, _NORMAL_1], values[:, _NORMAL_2] = angles
    values[:, _BLUR], values[:, _MEAN] = 0.9, mean
    sign = np.sum((picture - mean[:, None]) * _distances(values, fx, fy) * usable, axis=1)
    values[:, _CONTRAST] = np.where(sign < 0.0, -1.0, 1.0) * np.maximum(spread, 1e-3)
    level = noise.variance(mean)
    # Dark squares have less noise than light ones; the start classifies pixels well enough.
    expected = values[:, _MEAN, None] + values[:, _CONTRAST, None] * _distances(values, fx, fy)
    weight = np.where(usable, 1.0 / np.maximum(noise.variance(expected), 1e-12), 0.0)

    def model(unknowns: Array, patches: NDArray[np.intp]) -> tuple[Array, Array]:
        return _picture(unknowns, fx[patches], fy[patches], radius[patches])

    equations = equations_of(model, picture, weight, _PRIOR)
    return fit_patches(equations, values, (weight > 0.0).sum(1)), np.sqrt(level)


def _distances(values: Array, fx: Array, fy: Array) -> Array:
    """Return the sign (n, M) of the product of both distances."""
    a, b = values[:, _NORMAL_1, None], values[:, _NORMAL_2, None]
    return np.sign((np.cos(a) * fx + np.sin(a) * fy) * (np.cos(b) * fx + np.sin(b) * fy))


def _picture(unknowns: Array, fx: Array, fy: Array, radius: Array) -> tuple[Array, Array]:
    """Return grey values (n, M) and derivatives (n, M, 9) at pixel positions (n, M) relative to the start."""
    u = unknowns[:, :, None]
    s, moves = bounded_blur(u[:, _BLUR])
    dx, dy = fx - u[:, _X], fy - u[:, _Y]
    parts = []
    for normal in (_NORMAL_1, _NORMAL_2):
        cosine, sine = np.cos(u[:, normal]), np.sin(u[:, normal])
        z = (cosine * dx + sine * dy) / s
        turned = (cosine * dy - sine * dx) / s
        parts.append((2.0 * ndtr(z) - 1.0, 2.0 * _INV_SQRT2PI * np.exp(-0.5 * z * z), z, turned, cosine, sine))
    (e1, g1, z1, t1, c1, s1), (e2, g2, z2, t2, c2, s2) = parts
    px, py = fx / radius[:, None], fy / radius[:, None]
    light = 1.0 + u[:, _SLOPE_X] * px + u[:, _SLOPE_Y] * py
    plain = u[:, _MEAN] + u[:, _CONTRAST] * e1 * e2
    scale = u[:, _CONTRAST] * light
    columns = (
        -scale * (g1 * c1 * e2 + e1 * g2 * c2) / s,
        -scale * (g1 * s1 * e2 + e1 * g2 * s2) / s,
        scale * g1 * t1 * e2,
        scale * e1 * g2 * t2,
        -scale * (g1 * z1 * e2 + e1 * g2 * z2) / s * moves,
        light,
        e1 * e2 * light,
        plain * px,
        plain * py,
    )
    return plain * light, np.stack(columns, -1)


def _refused(fit: PatchFit, level: Array, radius: Array) -> NDArray[np.str_]:
    values = fit.values
    contrast = np.abs(values[:, _CONTRAST])
    with np.errstate(invalid="ignore"):
        misfit = np.sqrt(fit.chi2 / np.maximum(fit.freedom, 1.0)) * level
        clear = fit.converged & (contrast > 3.0 * level) & (misfit < 0.3 * contrast)
        crossing = np.abs(np.sin(values[:, _NORMAL_1] - values[:, _NORMAL_2])) > 0.2
        sharp = values[:, _BLUR] < 0.6 * radius
        near = np.hypot(values[:, _X], values[:, _Y]) < 2.5
    clear &= np.isfinite(fit.covariance[:, :2, :2]).all((1, 2))
    refused = np.where(clear & sharp & near, "", "no four squares that meet").astype("U40")
    refused[(refused == "") & ~crossing] = "seen too obliquely"
    return refused
