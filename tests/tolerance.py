"""Comparison of numbers with stated tolerances, for all tests."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


def assert_close(actual: ArrayLike, expected: ArrayLike, *, atol: float, what: str = "value") -> None:
    """Fail unless `actual` has the shape of `expected` and lies within `atol` of it everywhere.

    `atol` is absolute and in the unit of the values; it is given by every caller, because a tolerance
    follows from rounding (some 1e-12 of the largest number involved) or from the noise, never from a habit.
    """
    left, right = np.asarray(actual, dtype=float), np.asarray(expected, dtype=float)
    assert left.shape == right.shape, f"{what}: shape {left.shape}, expected {right.shape}"
    error = np.abs(left - right)
    assert np.all(error <= atol), f"{what}: off by {np.nanmax(error, initial=0.0):.3e}, allowed {atol:.3e}"


def assert_between(value: float, low: float, high: float, *, what: str = "value") -> None:
    """Fail unless `low <= value <= high`: the two-sided bound that a recovery from noise has to meet."""
    assert low <= value <= high, f"{what}: {value:.6g} is not between {low:.6g} and {high:.6g}"
