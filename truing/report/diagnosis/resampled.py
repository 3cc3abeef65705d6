"""Roots of mean squares with the interval that drawing poses, or runs, again gives."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from truing.report.numbers import plain

# Resampled campaigns behind an interval, and from how many poses or runs on there is one.
_DRAWS, _FEWEST = 2000, 3


def rms_with_interval(rms: ArrayLike, rng: np.random.Generator, counts: ArrayLike | None = None) -> str:
    """``4.1 (3.2 to 5.0)``: over the rms of N poses or runs, each of so many readings (one where it is not said)."""
    sizes = np.asarray(rms, dtype=float)
    weights = np.ones(len(sizes)) if counts is None else np.asarray(counts, dtype=float)
    known = np.isfinite(sizes)
    squares, weights = weights[known] * sizes[known] ** 2, weights[known]
    if not len(squares):
        return "–"
    said = plain(float(np.sqrt(squares.sum() / weights.sum())))
    if len(squares) < _FEWEST:
        return said
    chosen = rng.integers(0, len(squares), (_DRAWS, len(squares)))
    drawn = np.sqrt(squares[chosen].sum(axis=1) / weights[chosen].sum(axis=1))
    low, high = np.quantile(drawn, [0.025, 0.975])
    return f"{said} ({plain(float(low))} to {plain(float(high))})"
