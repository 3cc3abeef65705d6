"""Squares, products and cubes of the inputs of a sensor, tested for significance next to its linear terms."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# p-value of a form: several forms are tested on every table, and a superfluous one only costs rows.
_UNLIKELY = 1e-6
_ROWS_PER_COLUMN = 4.0
_LEAST_SINGULAR = 1e-10  # share of the largest singular value below which one is zero

WithoutZeros = Callable[[NDArray], NDArray]
"""Values (N, K) less their mean by zero."""


def nonlinear_terms(inputs: NDArray) -> Iterator[NDArray]:
    """Yield further columns (N, Q) of inputs (N, M), scaled to one, each form including those before it: squares,
    products of two, cubes."""
    about = inputs - inputs.mean(0)
    size = np.abs(about).max(0, initial=0.0)
    x = about / np.where(size > 0.0, size, 1.0)
    first, second = np.triu_indices(x.shape[1])
    products = x[:, first] * x[:, second]
    for columns in (x**2, products, np.hstack([products, x**3])):
        yield columns - columns.mean(0)


def detected_form(
    linear: NDArray, inputs: NDArray, loads: NDArray, without_zeros: WithoutZeros, zeros: int
) -> int | None:
    """Return the index of the nonlinear form of inputs (N, M) that loads (N, W), in sigmas, significantly follow.

    The form is tested in addition to linear columns (N, C) and a number of zeros; None without a significant one. It
    needs at least four rows per column, and an F test.
    """
    from scipy.special import fdtrc

    rows, width = loads.shape
    best, before = None, residual_sum_of([linear], loads, without_zeros, zeros)
    for index, terms in enumerate(nonlinear_terms(inputs)):
        if rows < _ROWS_PER_COLUMN * (linear.shape[1] + terms.shape[1] + zeros):
            break
        after = residual_sum_of([linear, terms], loads, without_zeros, zeros)
        if (more := before.spare - after.spare) <= 0 or not after.squares > 0.0:
            continue
        ratio = (before.squares - after.squares) / more / after.mean_square
        if fdtrc(width * more, width * after.spare, ratio) < _UNLIKELY:
            best, before = index, after
    return best


@dataclass(frozen=True)
class ResidualSum:
    """The sum of squares of residuals, and its degrees of freedom."""

    squares: float
    spare: int

    @property
    def mean_square(self) -> float:
        """Squares per degree of freedom."""
        return self.squares / max(self.spare, 1)


def residual_sum_of(columns: list[NDArray], loads: NDArray, without_zeros: WithoutZeros, zeros: int) -> ResidualSum:
    """Return the residual sum of loads (N, W) after a least-squares fit to columns and a number of zeros."""
    columns_without_zeros, loads_without_zeros = without_zeros(np.hstack(columns)), without_zeros(loads)
    size = np.sqrt(np.sum(columns_without_zeros**2, 0))
    scaled = columns_without_zeros / np.where(size > 0.0, size, 1.0)
    values, _, rank, _ = np.linalg.lstsq(scaled, loads_without_zeros, _LEAST_SINGULAR)
    return ResidualSum(float(np.sum((loads_without_zeros - scaled @ values) ** 2)), len(loads) - zeros - int(rank))
