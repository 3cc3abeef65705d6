"""Gross errors by what a fit leaves: a point far outside its own target's spread, whatever effect widens that."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Times the spread; three unit normals are longer than this once in some 1e6 points.
_GROSS = 5.5
_MEDIAN_LENGTH = 1.538  # of three unit normals
_ENOUGH = 8  # points of a target that give a spread of its own


def gross_errors(rest: NDArray, seen: NDArray) -> NDArray:
    """Return which points (B, K) are grossly wrong, from whitened residuals rest (B, K, 3).

    A target's spread is its median length over the poses, and at least that of unit noise; a target that was seen in
    few poses takes the median over all targets.
    """
    length = np.where(seen, np.sqrt(np.sum(rest**2, -1)), np.nan)
    if not seen.any():
        return np.zeros(seen.shape, bool)
    common = np.nanmedian(length)
    own = np.array([np.nanmedian(column) if np.isfinite(column).any() else common for column in length.T])
    spread = np.where(seen.sum(0) >= _ENOUGH, own, np.maximum(own, common)) / _MEDIAN_LENGTH
    return np.nan_to_num(length) > _GROSS * np.maximum(spread, 1.0)
