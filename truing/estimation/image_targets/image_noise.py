"""The noise of a photograph, from itself: read noise, photon noise, and how far neighbouring pixels share theirs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_TILE = 8
_TILES = 6000  # of those that cover the picture, so many are looked at
_BINS = 8  # of grey levels
_QUIETEST = 0.25  # share of the tiles of a bin that is taken to show nothing
# What that quantile of a tile's mean square is in white noise of variance one, and what the sum of autocorrelations is.
_QUANTILE = 0.697
_WHITE_SUM = 0.717
_ROUNDING = 1 / 12  # variance of a whole number that was a real one, grey levels^2


@dataclass(frozen=True)
class ImageNoise:
    """Variance of a pixel, read_var + gain * grey level, in grey levels^2; correlation: by which factor the variance
    of a mean over many pixels exceeds that of independent ones (1: white noise)."""

    read_var: float
    gain: float
    correlation: float = 1.0

    def variance(self, grey: Array) -> Array:
        """Return the variance of pixels of grey levels of any shape."""
        return self.read_var + self.gain * np.maximum(grey, 0.0)


def estimate_noise(grey: NDArray) -> ImageNoise:
    """Return the noise of a grey image (h, w), from the quietest tiles of every range of grey levels.

    The second mixed difference takes away what is linear in either direction (Immerkaer, Computer Vision and Image
    Understanding 64 (1996) 300). Tiles with a pixel at either end of the range are left out: clipping hides noise.
    """
    tiles = _sample(grey)
    low, high = tiles.min((1, 2)), tiles.max((1, 2))
    tiles = tiles[(low > 0) & (high < grey.max())]
    if len(tiles) < 8:
        return ImageNoise(_ROUNDING, 0.0)
    second = np.diff(tiles, n=2, axis=1)
    power = np.square(np.diff(second, n=2, axis=2)).mean((1, 2)) / 36
    level = tiles.mean((1, 2))
    order = np.argsort(level)
    bins = [part for part in np.array_split(order, _BINS) if len(part) >= 8] or [order]
    limits = [np.quantile(power[part], _QUIETEST) for part in bins]
    variance = np.array(limits) / _QUANTILE
    read, gain = _line(np.array([level[part].mean() for part in bins]), variance)
    quiet = np.concatenate([part[power[part] <= limit] for part, limit in zip(bins, limits, strict=True)])
    return ImageNoise(max(read, _ROUNDING), gain, _correlation(tiles[quiet]))


def _sample(grey: NDArray) -> Array:
    """Return tiles (n, 8, 8), evenly over the image; none of an image smaller than a tile."""
    rows, columns = grey.shape[0] // _TILE, grey.shape[1] // _TILE
    stride = max(1, -(-rows * columns // _TILES))
    row, column = np.divmod(np.arange(0, rows * columns, stride), max(columns, 1))
    inside = np.arange(_TILE)
    at = (row * _TILE)[:, None, None] + inside[:, None], (column * _TILE)[:, None, None] + inside
    return grey[at].astype(np.float64)


def _line(level: Array, variance: Array) -> tuple[float, float]:
    """Return read variance and gain, neither negative, of variances (B,) over levels (B,): a share of each counts."""
    scale = 1 / np.maximum(variance, _ROUNDING)
    A = np.stack([scale, level * scale], 1)
    (read, gain), *_ = np.linalg.lstsq(A, variance * scale, rcond=None)
    if gain < 0 or len(level) < 3:
        return float(np.average(variance, weights=scale**2)), 0.0
    if read < 0:
        return 0.0, float(np.average(variance / np.maximum(level, 1e-9), weights=(level * scale) ** 2))
    return float(read), float(gain)


def _correlation(tiles: Array) -> float:
    """Return the sum of autocorrelations up to one pixel away, at least 1, of tiles (n, 8, 8) without their planes."""
    centred = np.arange(_TILE) - (_TILE - 1) / 2
    norm = _TILE * np.square(centred).sum()
    flat = tiles - tiles.mean((1, 2), keepdims=True)
    for direction in (centred[:, None], centred[None, :]):
        flat = flat - (flat * direction).sum((1, 2), keepdims=True) / norm * direction
    products = [
        2 * np.mean(flat[:, 1:] * flat[:, :-1]),
        2 * np.mean(flat[:, :, 1:] * flat[:, :, :-1]),
        2 * np.mean(flat[:, 1:, 1:] * flat[:, :-1, :-1]),
        2 * np.mean(flat[:, 1:, :-1] * flat[:, :-1, 1:]),
    ]
    power = np.mean(np.square(flat))
    return float(max(1.0, (1 + sum(products) / power) / _WHITE_SUM)) if power > 0 else 1.0
