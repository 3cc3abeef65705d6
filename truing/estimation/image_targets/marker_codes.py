"""Codes of square markers: read the cells of quadrangles and compare them with all codes of their families."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask

_ARUCO = {f"aruco{n}x{n}_{codes}": f"DICT_{n}X{n}_{codes}" for n in (4, 5, 6, 7) for codes in (50, 100, 250, 1000)}
_DICTIONARIES = {
    **_ARUCO,
    "aruco_original": "DICT_ARUCO_ORIGINAL",
    "aruco_mip_36h12": "DICT_ARUCO_MIP_36h12",
    **{f"apriltag{size}": f"DICT_APRILTAG_{size}" for size in ("16h5", "25h9", "36h10", "36h11")},
}
FAMILIES = tuple(_DICTIONARIES)
_CORRECTED = 0.3  # share of the bits that a family could correct; correcting all would turn chance patterns into codes
_BORDER_ERRORS = 0.35  # light cells tolerated in the border, as a share of the inner cells
_IN_CELL = np.array([0.25, 0.5, 0.75], np.float32)  # sample positions in a cell along each axis
_FLAT = 5.0  # standard deviation in grey levels below which all cells are alike
# Limit of unexplained variance: cells of a wrong size that give a code by chance leave one half; correct cells of the
# smallest detectable markers, two or three pixels wide, up to 0.36.
_UNCLEAR = 0.4
_MOST_ROWS = 32767  # rows of a point image in OpenCV
_ROUNDS = 10  # iterations of the split into dark and light cells


@dataclass(frozen=True)
class Codes:
    """Quadrangles read as codes: quadrangle (N,), family (N,) by number, code (N,), wrong bits (N,), index (N,) of the
    marker's first corner; and share (N,) of the grey variance that dark and light cells do not explain."""

    quad: NDArray[np.intp]
    family: Index
    code: Index
    errors: Index
    first: Index
    unclear: NDArray[np.float32]


def dictionary(family: str) -> Any:
    """Return the OpenCV dictionary of a family of ``FAMILIES``."""
    import cv2

    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, _DICTIONARIES[family]))


def codes_of(family: str) -> int:
    """Return the number of codes of a family, counted from 0."""
    return len(dictionary(family).bytesList)


@cache
def cells_across(family: str) -> int:
    """Return the number of cells along the edge of a family's markers, including the border."""
    return int(dictionary(family).markerSize) + 2


def read_codes(plain: NDArray[np.uint8], corners: Array, families: tuple[str, ...]) -> Codes:
    """Return the codes of quadrangles with corners (Q, 4, 2) in px, clockwise as seen, in an image (h, w)."""
    bits = {cells: _bits(plain, corners, cells) for cells in sorted({cells_across(name) for name in families})}
    readings = [_codes_of_family(*bits[cells_across(name)], name, number) for number, name in enumerate(families)]
    return Codes(*(np.concatenate([getattr(part, name) for part in readings]) for name in Codes.__dataclass_fields__))


def _codes_of_family(
    quad: NDArray[np.intp], bits: NDArray[np.float32], unclear: NDArray[np.float32], family: str, number: int
) -> Codes:
    """Return the quadrangles (B,) with bits (B, n), +1 or -1, that are codes of one family."""
    table, correctable = _code_bits(family)
    # If d of n bits differ, the product of two words of +1 and -1 is n - 2 d.
    product = bits @ table
    best = product.argmax(1) if len(bits) else np.empty(0, np.intp)
    errors = np.rint(0.5 * (bits.shape[1] - product[np.arange(len(bits)), best])).astype(np.int64)
    good = errors <= correctable
    code, turns = np.divmod(best[good].astype(np.int64), 4)
    return Codes(quad[good], np.full(len(code), number, np.int64), code, errors[good], -turns % 4, unclear[good])


@cache
def _code_bits(family: str) -> tuple[NDArray[np.float32], int]:
    """Return the bits (n, 4 K), +1 or -1, of K codes after 0 to 3 quarter turns to the left; and the number of wrong
    bits tolerated."""
    import cv2

    source = dictionary(family)
    size = source.markerSize
    codes = [
        cv2.aruco.Dictionary.getBitsFromByteList(source.bytesList[k : k + 1], size)
        for k in range(len(source.bytesList))
    ]
    bits = np.stack(codes).reshape(-1, size, size)
    turned = np.stack([np.rot90(bits, k, axes=(1, 2)) for k in range(4)], 1).reshape(-1, size * size)
    return np.ascontiguousarray(2.0 * turned.T - 1.0, np.float32), int(source.maxCorrectionBits * _CORRECTED)


def _bits(
    plain: NDArray[np.uint8], corners: Array, cells: int
) -> tuple[NDArray[np.intp], NDArray[np.float32], NDArray[np.float32]]:
    """Return the quadrangles (B,) with a dark border and clear cells, their inner cells (B, n), +1 if light, else -1;
    and the share (B,) of grey variance that dark and light cells do not explain."""
    grey, variance = _cell_greys(plain, corners, cells)
    light = _light_cells(grey)
    inner = light.reshape(-1, cells, cells)[:, 1:-1, 1:-1]
    border = light.sum(1) - inner.sum((1, 2))
    quad = np.flatnonzero((variance > _FLAT**2) & (border <= int(_BORDER_ERRORS * (cells - 2) ** 2)))
    unclear = np.float32(1.0) - _between_class_variance(grey[quad], light[quad]) / variance[quad]
    quad, unclear = quad[unclear < _UNCLEAR], unclear[unclear < _UNCLEAR]
    inner = inner[quad].reshape(len(quad), (cells - 2) ** 2)
    return quad, np.where(inner, np.float32(1.0), np.float32(-1.0)), unclear


def _between_class_variance(grey: NDArray[np.float32], light: Mask) -> NDArray[np.float32]:
    """Return the variance (Q,) between the two classes of cells (Q, n)."""
    share = light.mean(1, dtype=np.float32)
    contrast = grey.mean(1, where=light) - grey.mean(1, where=~light)
    return np.asarray(share * (np.float32(1.0) - share) * contrast**2, np.float32)


def _cell_greys(
    plain: NDArray[np.uint8], corners: Array, cells: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the mean grey values (Q, cells * cells) of the cells' inner parts minus the quadrangle's mean, row by row
    from the first corner; and the variance (Q,) of the samples."""
    import cv2

    parts = len(_IN_CELL)
    at = ((np.arange(cells, dtype=np.float32)[:, None] + _IN_CELL) / np.float32(cells)).ravel()
    grey = np.empty((len(corners), len(at), len(at)), np.float32)
    most = _MOST_ROWS // len(at)
    for first in range(0, len(corners), most):
        x, y = _grid_in_quadrangles(corners[first : first + most], at)
        sampled = cv2.remap(plain, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        grey[first : first + most] = sampled.reshape(-1, len(at), len(at))
    flat = grey.reshape(len(corners), len(at) ** 2)
    flat -= flat.mean(1, keepdims=True)
    variance = np.einsum("qn,qn->q", flat, flat) / np.float32(flat.shape[1])
    weight = np.kron(np.eye(cells, dtype=np.float32), np.full((parts, 1), 1.0 / parts, np.float32))
    return (weight.T @ (grey @ weight)).reshape(len(corners), cells * cells), variance


def _grid_in_quadrangles(corners: Array, at: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return columns and rows (Q * m, m) in px of m x m points of the unit square, mapped to quadrangles (Q, 4, 2). The
    homography has a closed form (Heckbert, Fundamentals of Texture Mapping, 1989, 2.2.3)."""
    p0, p1, p2, p3 = np.moveaxis(corners, 1, 0)
    one, two, rest = p1 - p2, p3 - p2, p0 - p1 + p2 - p3
    area = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]
    g = ((rest[:, 0] * two[:, 1] - rest[:, 1] * two[:, 0]) / area)[:, None]
    h = ((one[:, 0] * rest[:, 1] - one[:, 1] * rest[:, 0]) / area)[:, None]
    across, down = p1 - p0 + g * p1, p3 - p0 + h * p3

    def plane(a: Array, b: Array, c: Array) -> NDArray[np.float32]:
        along = (a[:, None] * at + c[:, None]).astype(np.float32)
        return along[:, None, :] + (b[:, None] * at).astype(np.float32)[:, :, None]

    lower = plane(g[:, 0], h[:, 0], np.ones(len(corners)))
    x, y = (plane(across[:, k], down[:, k], p0[:, k]) / lower for k in range(2))
    return x.reshape(-1, len(at)), y.reshape(-1, len(at))


def _light_cells(grey: NDArray[np.float32]) -> Mask:
    """Return the mask of light cells (Q, n): above the middle between the means of dark and light."""
    total, count = grey.sum(1), grey.shape[1]
    light = grey > 0.5 * (grey.min(1) + grey.max(1))[:, None]
    for _ in range(_ROUNDS):
        number = light.sum(1)
        above = np.einsum("qn,qn->q", grey, light, dtype=np.float32)
        high = above / np.maximum(number, 1)
        low = (total - above) / np.maximum(count - number, 1)
        again = grey > (0.5 * (low + high))[:, None]
        if (again == light).all():
            break
        light = again
    return light
