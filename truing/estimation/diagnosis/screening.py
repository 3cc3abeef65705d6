"""Gross errors by what a fit leaves: a point far outside its own target's spread, whatever effect widens that."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.estimation.diagnosis.in_time import alone_in_time

# Unit normals are longer than the limit once in some 1e6 points.
_BY_CHANCE = 1.2e-6
_ENOUGH = 8  # points of a target that give a spread of its own


def gross_errors(
    rest: NDArray,
    seen: NDArray,
    axes: NDArray | None = None,
    order: NDArray | None = None,
    zeros: NDArray | None = None,
) -> NDArray:
    """Return which points (B, K) are grossly wrong, from whitened residuals rest (B, K, d).

    A target's spread is its median length over the poses, and at least that of unit noise; a target that was seen in
    few poses takes the median over all targets. Where ``axes`` (B, K, d, d) tell how whitened residuals follow shifts
    along the body's own axes (m), and ``order`` (B,) the poses' ranks in time, a point that agrees with its neighbours
    in time is right: its target was moved. Readings (d = 1) with the same number in ``zeros`` (B, K) count as a target
    of their own: an effect widens the runs that show it, and not what else the same channel read.
    """
    if zeros is not None:
        return _by_run(rest, seen, axes, order, zeros)
    far = _far(rest, seen)
    if axes is None or order is None or not far.any():
        return far
    known = seen & (np.abs(np.linalg.det(axes)) > 0)
    values = np.linalg.solve(np.where(known[..., None, None], axes, np.eye(rest.shape[-1])), rest[..., None])[..., 0]
    return far & alone_in_time(np.where(known[..., None], values, np.nan), order, far, 0.0)


def least_gross(size: int) -> float:
    """Return the length of a whitened residual (d coordinates) from which on a point of ordinary spread is gross."""
    from scipy.special import chdtri

    return float(np.sqrt(chdtri(size, _BY_CHANCE)))


def _by_run(rest: NDArray, seen: NDArray, axes: NDArray | None, order: NDArray | None, zeros: NDArray) -> NDArray:
    """Return the gross errors (B, K) where every run's readings of a channel stand for a target."""
    step, channel = np.nonzero(seen & (zeros >= 0))
    in_time = np.lexsort((step if order is None else order[step], zeros[step, channel]))
    step, channel = step[in_time], channel[in_time]
    group = np.unique(zeros[step, channel], return_inverse=True)[1]
    place = np.arange(len(group)) - np.searchsorted(group, group)
    shape = (int(place.max(initial=-1)) + 1, int(group.max(initial=-1)) + 1)
    known = np.zeros(shape, bool)
    known[place, group] = True
    values = np.zeros((*shape, 1))
    values[place, group] = rest[step, channel]
    unit = np.ones((*shape, 1, 1))
    if axes is not None:
        unit[place, group] = axes[step, channel]
    wrong = np.zeros(seen.shape, bool)
    if known.any():
        in_run = None if order is None else np.arange(shape[0])
        wrong[step, channel] = gross_errors(values, known, None if axes is None else unit, in_run)[place, group]
    return wrong


def _far(rest: NDArray, seen: NDArray) -> NDArray:
    length, limit = lengths(rest, seen)
    return np.asarray(np.nan_to_num(length) > limit)


def lengths(rest: NDArray, seen: NDArray) -> tuple[NDArray, NDArray]:
    """Return the lengths (B, K) of whitened residuals rest (B, K, d), NaN where unseen, and the limits (K,) on them."""
    length = np.where(seen, np.sqrt(np.sum(rest**2, -1)), np.nan)
    if not seen.any():
        return length, np.full(seen.shape[1], np.inf)
    from scipy.special import chdtri

    size = rest.shape[-1]
    gross, middle = np.sqrt(chdtri(size, [_BY_CHANCE, 0.5]))
    common = np.nanmedian(length)
    own = np.array([np.nanmedian(column) if np.isfinite(column).any() else common for column in length.T])
    spread = np.where(seen.sum(0) >= _ENOUGH, own, np.maximum(own, common)) / middle
    return length, gross * np.maximum(spread, 1.0)
