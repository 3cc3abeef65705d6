"""Elimination of small blocks, compiled: their Cholesky factors, inverted, and what these make of the rows beside them.

Importing this module imports numba; compiled code is kept in numba's cache on disk.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.estimation import lane_arithmetic
from truing.estimation.lane_arithmetic import compiled, inner


@inner
def lower_root(own: NDArray, damping: float, lower: NDArray) -> bool:
    """Fill the Cholesky factor of a block whose diagonal is enlarged by a part of it; return whether there is one."""
    for i in range(len(own)):
        for j in range(i + 1):
            value = own[i, j]
            if i == j:
                value *= 1.0 + damping
            for k in range(j):
                value -= lower[i, k] * lower[j, k]
            if i > j:
                lower[i, j] = value / lower[j, j]
            elif value > 0.0:
                lower[i, i] = np.sqrt(value)
            else:
                return False
    return True


@inner
def invert_lower(lower: NDArray, root: NDArray) -> None:
    """Fill the inverse of a lower triangle."""
    for i in range(len(lower)):
        for j in range(i + 1, len(lower)):
            root[i, j] = 0.0
        for j in range(i + 1):
            value = 1.0 if i == j else 0.0
            for k in range(j, i):
                value -= lower[i, k] * root[k, j]
            root[i, j] = value / lower[i, i]


@inner
def lower_times(root: NDArray, rows: NDArray, product: NDArray) -> None:
    """Fill the product of a lower triangle (d, d) with rows (d, w)."""
    for i in range(len(root)):
        target = product[i]
        target[:] = 0.0
        for j in range(i + 1):
            f, source = root[i, j], rows[j]
            for b in range(len(target)):
                target[b] += f * source[b]


@compiled(lane_arithmetic.__file__, __file__)
def forward(
    own: NDArray, rows: NDArray, sides: NDArray, damping: float, root: NDArray, reduced: NDArray, reduced_sides: NDArray
) -> bool:
    """Fill the inverse (b, d, d) of the Cholesky factor of blocks whose diagonal is enlarged by a part of it, and its
    products (b d, .) with their rows and sides; return whether all of them are positive definite."""
    count, d, _ = own.shape
    lower = np.zeros((d, d))
    for n in range(count):
        if not lower_root(own[n], damping, lower):
            return False
        invert_lower(lower, root[n])
        at = slice(n * d, n * d + d)
        lower_times(root[n], rows[at], reduced[at])
        lower_times(root[n], sides[at], reduced_sides[at])
    return True


@compiled(lane_arithmetic.__file__, __file__)
def mirror(square: NDArray) -> None:
    """Copy the upper triangle of a matrix (n, n) onto the lower one, tile by tile."""
    n, tile = len(square), 16
    for first in range(0, n, tile):
        for second in range(0, first + 1, tile):
            for i in range(first, min(first + tile, n)):
                for j in range(second, min(second + tile, i)):
                    square[i, j] = square[j, i]
