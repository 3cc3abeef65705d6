"""Compiled kernels of intersections: the points of all rays, point by point."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.compiled_code import compiled, inner
from truing.estimation import simd_arithmetic
from truing.estimation.bundle import kernel_arguments
from truing.estimation.bundle.kernel_arguments import RayPairs, SortedRays

_SOURCES = (simd_arithmetic.__file__, kernel_arguments.__file__, __file__)
_PARALLEL = 1e-9  # least 1 - cos of the angle of two rays
_SINGULAR = 1e-12  # least determinant of a matrix of trace one


@inner
def solve3(A: NDArray, b: NDArray, x: NDArray, least: float) -> bool:
    """Fill in the solution (3,) of a symmetric system; return whether its determinant exceeds the least."""
    c00 = A[1, 1] * A[2, 2] - A[1, 2] * A[1, 2]
    c01 = A[0, 2] * A[1, 2] - A[0, 1] * A[2, 2]
    c02 = A[0, 1] * A[1, 2] - A[0, 2] * A[1, 1]
    determinant = A[0, 0] * c00 + A[0, 1] * c01 + A[0, 2] * c02
    if not determinant > least:
        return False
    c11, c12 = A[0, 0] * A[2, 2] - A[0, 2] * A[0, 2], A[0, 1] * A[0, 2] - A[0, 0] * A[1, 2]
    c22 = A[0, 0] * A[1, 1] - A[0, 1] * A[0, 1]
    x[0] = (c00 * b[0] + c01 * b[1] + c02 * b[2]) / determinant
    x[1] = (c01 * b[0] + c11 * b[1] + c12 * b[2]) / determinant
    x[2] = (c02 * b[0] + c12 * b[1] + c22 * b[2]) / determinant
    return True


@inner
def seen_from(R: NDArray, centre: NDArray, X: NDArray, u: NDArray) -> None:
    """Fill in the point (3,) in camera axes."""
    a, b, c = X[0] - centre[0], X[1] - centre[1], X[2] - centre[2]
    for i in range(3):
        u[i] = R[0, i] * a + R[1, i] * b + R[2, i] * c


@compiled(*_SOURCES)
def try_pairs(
    line: NDArray, rays: SortedRays, pairs: RayPairs, tolerance_px: float, best: NDArray, cost: NDArray
) -> None:
    """Replace the best point (P, 3) and its cost (P,), a sum of bounded squares, where a pair of rays gives a better.

    line (n, 3): unit vectors along the rays.
    """
    A, b, X, u = np.zeros((3, 3)), np.zeros(3), np.zeros(3), np.zeros(3)
    for m in range(len(pairs.point)):
        p, i, j = pairs.point[m], pairs.one[m], pairs.other[m]
        cosine = line[i, 0] * line[j, 0] + line[i, 1] * line[j, 1] + line[i, 2] * line[j, 2]
        if not 1.0 - abs(cosine) > _PARALLEL:
            continue
        for k in range(3):
            b[k] = 0.0
            for q in range(3):
                A[k, q] = (2.0 if k == q else 0.0) - line[i, k] * line[i, q] - line[j, k] * line[j, q]
                alone = 1.0 if k == q else 0.0
                b[k] += (alone - line[i, k] * line[i, q]) * rays.centre[i, q]
                b[k] += (alone - line[j, k] * line[j, q]) * rays.centre[j, q]
        if not solve3(A, b, X, 0.0):
            continue
        total = 0.0
        for n in range(rays.first[p], rays.first[p + 1]):
            seen_from(rays.R[n], rays.centre[n], X, u)
            square = 1.0
            if u[2] > 0.0:
                x = (u[0] / u[2] - rays.direction[n, 0]) * rays.scale[n] / tolerance_px
                y = (u[1] / u[2] - rays.direction[n, 1]) * rays.scale[n] / tolerance_px
                square = min(1.0, x * x + y * y)
            total += square
        if total < cost[p]:
            cost[p] = total
            for k in range(3):
                best[p, k] = X[k]


@compiled(*_SOURCES)
def refine_steps(rays: SortedRays, weight: NDArray, steps: int, X: NDArray) -> None:
    """Improve points (P, 3) by Gauss-Newton steps on their rays' image coordinates, weighted (n,)."""
    N, b, x, u = np.zeros((3, 3)), np.zeros(3), np.zeros(3), np.zeros(3)
    J = np.zeros((2, 3))
    for p in range(len(X)):
        for _ in range(steps):
            N[:], b[:] = 0.0, 0.0
            for n in range(rays.first[p], rays.first[p + 1]):
                if not weight[n] > 0.0:
                    continue
                seen_from(rays.R[n], rays.centre[n], X[p], u)
                per = rays.scale[n] / u[2]
                a0, a1 = u[0] / u[2], u[1] / u[2]
                v0, v1 = (rays.direction[n, 0] - a0) * rays.scale[n], (rays.direction[n, 1] - a1) * rays.scale[n]
                if not (np.isfinite(per) and np.isfinite(a0) and np.isfinite(a1)):
                    continue
                for k in range(3):
                    J[0, k] = (rays.R[n, k, 0] - rays.R[n, k, 2] * a0) * per
                    J[1, k] = (rays.R[n, k, 1] - rays.R[n, k, 2] * a1) * per
                for k in range(3):
                    b[k] += weight[n] * (J[0, k] * v0 + J[1, k] * v1)
                    for q in range(3):
                        N[k, q] += weight[n] * (J[0, k] * J[0, q] + J[1, k] * J[1, q])
            size = N[0, 0] + N[1, 1] + N[2, 2]
            if not (size > 0.0 and solve3(N, b, x, _SINGULAR * size * size * size)):
                continue
            for k in range(3):
                X[p, k] += x[k]
