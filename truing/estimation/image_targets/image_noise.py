"""Noise of a photograph estimated from the image: read noise, photon noise, correlation of neighbouring pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array

_TILE = 8
_TILES = 6000  # largest number of tiles that are evaluated
_BINS = 8  # of grey levels
_QUIETEST = 0.25  # share of the tiles of a bin that are assumed to show no object
# In the quietest tiles of white noise of variance one: mean power of the second difference, and sum of
# autocorrelations.
_QUIET_POWER, _WHITE_SUM = 0.781, 0.666
_AGREEING = 1.35  # factor between the variance of a range of grey levels and the line
_ROUNDING = 1 / 12  # variance of rounding to whole grey levels, grey levels^2


@dataclass(frozen=True)
class ImageNoise:
    """Variance of a pixel, read_var + gain * grey level, in grey levels^2.

    correlation: variance of a mean over many pixels relative to independent pixels (1: white noise).
    """

    read_var: float
    gain: float
    correlation: float = 1.0

    def variance(self, grey: Array) -> Array:
        """Return the variance of pixels for grey levels of any shape."""
        return self.read_var + self.gain * np.maximum(grey, 0.0)


def estimate_noise(grey: NDArray) -> ImageNoise:
    """Return the noise of a grey image (h, w), from the quietest tiles of every range of grey levels.

    The second mixed difference removes linear gradients (Immerkaer, Computer Vision and Image Understanding 64 (1996)
    300). Tiles with a pixel at either end of the range are excluded: clipping hides noise.
    """
    tiles = _sample(grey)
    low, high = tiles.min((1, 2)), tiles.max((1, 2))
    tiles = tiles[(low > 0) & (high < grey.max())]
    if len(tiles) < 8:
        return ImageNoise(_ROUNDING, 0.0)
    flat = _without_planes(tiles)
    uneven = np.square(flat).mean((1, 2))
    power = np.square(np.diff(np.diff(tiles, n=2, axis=1), n=2, axis=2)).mean((1, 2)) / 36
    level = tiles.mean((1, 2))
    bins = [part for part in np.array_split(np.argsort(level), _BINS) if len(part) >= 8] or [np.arange(len(level))]
    quiet = [part[uneven[part] <= np.quantile(uneven[part], _QUIETEST)] for part in bins]
    levels = np.array([level[part].mean() for part in quiet])
    variance = np.array([power[part].mean() for part in quiet]) / _QUIET_POWER
    noise = ImageNoise(*_line(levels, variance))
    quietest = np.argsort(uneven / noise.variance(level))[: max(len(tiles) // 10, 8)]
    return replace(noise, correlation=_correlation(flat[quietest]))


def _sample(grey: NDArray) -> Array:
    """Return tiles (n, 8, 8) spread evenly over the image; none if the image is smaller than a tile."""
    rows, columns = grey.shape[0] // _TILE, grey.shape[1] // _TILE
    stride = max(1, -(-rows * columns // _TILES))
    row, column = np.divmod(np.arange(0, rows * columns, stride), max(columns, 1))
    inside = np.arange(_TILE)
    at = (row * _TILE)[:, None, None] + inside[:, None], (column * _TILE)[:, None, None] + inside
    return grey[at].astype(np.float64)


def _line(level: Array, variance: Array) -> tuple[float, float]:
    """Return read variance and gain, neither negative, of variances (B,) over levels (B,). Objects in the image raise
    the variance of some ranges of grey levels. The line through one or two ranges that most ranges agree with is taken,
    and of those the lowest."""
    i, j = np.triu_indices(len(level))
    rise = np.where(i == j, 1.0, level[j] - level[i])
    gain = np.where(i == j, 0.0, (variance[j] - variance[i]) / np.where(rise == 0, 1.0, rise))
    read = variance[i] - gain * level[i]
    fair = (gain >= 0) & (read >= 0)
    line = read[fair, None] + gain[fair, None] * level
    agrees = np.abs(np.log(np.maximum(variance, 1e-9) / np.maximum(line, 1e-9))) < np.log(_AGREEING)
    best = np.lexsort((line.mean(1), -agrees.sum(1)))[0]
    chosen = agrees[best] if agrees[best].any() else np.ones(len(level), bool)
    scale = 1 / np.maximum(variance[chosen], _ROUNDING)
    A = np.stack([scale, level[chosen] * scale], 1)
    (mean_read, mean_gain), *_ = np.linalg.lstsq(A, variance[chosen] * scale, rcond=None)
    if chosen.sum() > 2 and mean_read >= 0 and mean_gain >= 0:
        return max(float(mean_read), _ROUNDING), float(mean_gain)
    return max(float(read[fair][best]), _ROUNDING), float(gain[fair][best])


def _without_planes(tiles: Array) -> Array:
    """Return tiles (n, 8, 8) minus their means and slopes."""
    centred = np.arange(_TILE) - (_TILE - 1) / 2
    norm = _TILE * np.square(centred).sum()
    flat = tiles - tiles.mean((1, 2), keepdims=True)
    for direction in (centred[:, None], centred[None, :]):
        flat = flat - (flat * direction).sum((1, 2), keepdims=True) / norm * direction
    return flat


def _correlation(flat: Array) -> float:
    """Return the sum of autocorrelations up to one pixel away, at least 1, of tiles (n, 8, 8) without their planes."""
    products = [
        2 * np.mean(flat[:, 1:] * flat[:, :-1]),
        2 * np.mean(flat[:, :, 1:] * flat[:, :, :-1]),
        2 * np.mean(flat[:, 1:, 1:] * flat[:, :-1, :-1]),
        2 * np.mean(flat[:, 1:, :-1] * flat[:, :-1, 1:]),
    ]
    power = float(np.mean(np.square(flat)))
    return max(1.0, float(1 + sum(products) / power) / _WHITE_SUM) if power > 0 else 1.0
