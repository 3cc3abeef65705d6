"""Compiled kernels of the adjustment: normal equations from rays, image by image, and elimination of small blocks.

The equations are those of `truing.estimation.bundle.camera`. A ray has two rows of 17 numbers: derivatives by point
(3), rotation of the image (3) and interior (10), and misclosure (1), whitened. The derivative by the image's centre is
the negative of that by the point and is not stored. The products of an image's rows are one matrix product; those with
a point are added one by one.

Own kernels are faster than libraries, which do not compute the covariance of all points (`python -m
benchmarks.bundle`). Importing this module imports numba; compiled code is cached on disk.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.compiled_code import compiled, inner
from truing.estimation import simd_arithmetic
from truing.estimation.bundle import kernel_arguments
from truing.estimation.bundle.kernel_arguments import CameraArrays, EquationArrays, RayArrays, StateArrays

INTERIOR, MISCLOSURE = 6, 16  # first columns of these parts of a row, after point and rotation
WIDTH = 17  # columns of a row
_SOURCES = (simd_arithmetic.__file__, kernel_arguments.__file__, __file__)
SUMMED_CAMERAS = 4  # up to this many cameras, sums of each point and camera are faster than scattered additions


@inner
def direct(X: NDArray, R: NDArray, point: NDArray, centre: NDArray) -> None:
    """Fill in the point (3) in camera axes."""
    a, b, c = point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
    for i in range(3):
        X[i] = R[0, i] * a + R[1, i] * b + R[2, i] * c


@inner
def image_point(interior: NDArray, radius: float, X: NDArray) -> tuple[float, float]:
    """Return image coordinates in px relative to the format's centre."""
    per = interior[0] / X[2]
    xi, eta = per * X[0], per * X[1]
    s, s0 = xi * xi + eta * eta, radius * radius
    p1, p2, p3 = s - s0, s * s - s0 * s0, s * s * s - s0 * s0 * s0
    radial = 1.0 + interior[3] * p1 + interior[4] * p2 + interior[5] * p3
    b1, b2 = interior[6], interior[7]
    x = (
        interior[1]
        + xi * radial
        + b1 * (s + 2.0 * xi * xi)
        + 2.0 * b2 * xi * eta
        + interior[8] * xi
        + interior[9] * eta
    )
    y = interior[2] + eta * radial + b2 * (s + 2.0 * eta * eta) + 2.0 * b1 * xi * eta
    return x, y


@inner
def put(row: NDArray, column: int, root: tuple[float, float, float], x: float, y: float) -> None:
    """Write the whitened derivatives of both coordinates into a column."""
    row[0, column] = root[0] * x + root[1] * y
    row[1, column] = root[2] * y


@inner
def linearised(row: NDArray, interior: NDArray, radius: float, X: NDArray, root: tuple[float, float, float]) -> None:
    """Fill in whitened derivatives (2, .) by the direction (in the columns of the point) and by the interior."""
    c, b1, b2 = interior[0], interior[6], interior[7]
    per = 1.0 / X[2]
    u, v = X[0] * per, X[1] * per
    xi, eta, per = c * u, c * v, c * per
    s, s0 = xi * xi + eta * eta, radius * radius
    p1, p2, p3 = s - s0, s * s - s0 * s0, s * s * s - s0 * s0 * s0
    radial = 1.0 + interior[3] * p1 + interior[4] * p2 + interior[5] * p3
    slope = 2.0 * (interior[3] + 2.0 * interior[4] * s + 3.0 * interior[5] * s * s)
    mixed = slope * xi * eta
    yx = mixed + 2.0 * b2 * xi + 2.0 * b1 * eta
    yy = radial + slope * eta * eta + 6.0 * b2 * eta + 2.0 * b1 * xi
    xx = root[0] * (radial + slope * xi * xi + 6.0 * b1 * xi + 2.0 * b2 * eta + interior[8]) + root[1] * yx
    xy = root[0] * (mixed + 2.0 * b1 * eta + 2.0 * b2 * xi + interior[9]) + root[1] * yy
    yx, yy = root[2] * yx, root[2] * yy
    row[0, 0], row[0, 1], row[0, 2] = xx * per, xy * per, -(xx * u + xy * v) * per
    row[1, 0], row[1, 1], row[1, 2] = yx * per, yy * per, -(yx * u + yy * v) * per
    row[0, 6], row[1, 6] = xx * u + xy * v, yx * u + yy * v
    put(row, 7, root, 1.0, 0.0)
    put(row, 8, root, 0.0, 1.0)
    put(row, 9, root, xi * p1, eta * p1)
    put(row, 10, root, xi * p2, eta * p2)
    put(row, 11, root, xi * p3, eta * p3)
    put(row, 12, root, s + 2.0 * xi * xi, 2.0 * xi * eta)
    put(row, 13, root, 2.0 * xi * eta, s + 2.0 * eta * eta)
    put(row, 14, root, xi, 0.0)
    put(row, 15, root, eta, 0.0)


@inner
def turned(row: NDArray, R: NDArray, point: NDArray, centre: NDArray) -> None:
    """Convert derivatives by the direction to those by the point, and fill in those by the rotation of the image."""
    a, b, c = point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
    for k in range(2):
        d0, d1, d2 = row[k, 0], row[k, 1], row[k, 2]
        p0 = d0 * R[0, 0] + d1 * R[0, 1] + d2 * R[0, 2]
        p1 = d0 * R[1, 0] + d1 * R[1, 1] + d2 * R[1, 2]
        p2 = d0 * R[2, 0] + d1 * R[2, 1] + d2 * R[2, 2]
        row[k, 0], row[k, 1], row[k, 2] = p0, p1, p2
        row[k, 3], row[k, 4], row[k, 5] = p1 * c - p2 * b, p2 * a - p0 * c, p0 * b - p1 * a


@inner
def add_to_point(sums: NDArray, row: NDArray, flat: NDArray, at: int, stride: int) -> None:
    """Add the products with the point to its sums (3, .), and those with the image to its rows starting at `at`."""
    for a in range(3):
        f, g = row[0, a], row[1, a]
        for b in range(WIDTH):
            sums[a, b] += f * row[0, b] + g * row[1, b]
        for b in range(3):
            flat[at + b * stride + a] -= f * row[0, b] + g * row[1, b]
            flat[at + (3 + b) * stride + a] += f * row[0, 3 + b] + g * row[1, 3 + b]


@inner
def add_to_sides(
    block: NDArray, sides: NDArray, row: NDArray, slot: NDArray, flat: NDArray, at: int, stride: int
) -> None:
    """Do as `add_to_point` and `put_points` for one ray, without sums per camera."""
    last = sides.shape[1] - 1
    for a in range(3):
        f, g = row[0, a], row[1, a]
        for b in range(3):
            block[a, b] += f * row[0, b] + g * row[1, b]
            flat[at + b * stride + a] -= f * row[0, b] + g * row[1, b]
            flat[at + (3 + b) * stride + a] += f * row[0, 3 + b] + g * row[1, 3 + b]
        for b in range(10):
            if slot[b] >= 0:
                sides[a, slot[b]] += f * row[0, INTERIOR + b] + g * row[1, INTERIOR + b]
        sides[a, last] += f * row[0, MISCLOSURE] + g * row[1, MISCLOSURE]


@inner
def put_points(sums: NDArray, slot: NDArray, blocks: NDArray, sides: NDArray) -> None:
    """Write the sums (C, p, 3, .) of all cameras into the blocks (p, 3, 3) of the points and their sides."""
    last = sides.shape[2] - 1
    for k in range(sums.shape[0]):
        for p in range(sums.shape[1]):
            for a in range(3):
                for b in range(3):
                    blocks[p, a, b] += sums[k, p, a, b]
                for b in range(10):
                    if slot[k, b] >= 0:
                        sides[p, a, slot[k, b]] += sums[k, p, a, INTERIOR + b]
                sides[p, a, last] += sums[k, p, a, MISCLOSURE]


@inner
def put_image(square: NDArray, block: NDArray, side: NDArray, slot: NDArray, common: NDArray) -> None:
    """Write an image's sums: block (6, 6), side (6, c + 1) by the common unknowns, and the common block."""
    last = common.shape[1] - 1
    for a in range(6):
        sign = -1.0 if a < 3 else 1.0
        for b in range(6):
            block[a, b] = square[a, b] if (a < 3) == (b < 3) else -square[a, b]
        for b in range(10):
            if slot[b] >= 0:
                side[a, slot[b]] = sign * square[a, INTERIOR + b]
        side[a, last] = sign * square[a, MISCLOSURE]
    for a in range(10):
        if slot[a] >= 0:
            for b in range(10):
                if slot[b] >= 0:
                    common[slot[a], slot[b]] += square[INTERIOR + a, INTERIOR + b]
            common[slot[a], last] += square[INTERIOR + a, MISCLOSURE]


@compiled(*_SOURCES)
def accumulate(rays: RayArrays, cameras: CameraArrays, state: StateArrays, equations: EquationArrays) -> float:
    """Fill the normal equations and return the weighted sum of squares, infinite if a point is behind its camera."""
    most = 0
    for i in range(len(cameras.of_image)):
        most = max(most, rays.first[i + 1] - rays.first[i])
    rows, square, X = np.zeros((2 * most, WIDTH)), np.zeros((WIDTH, WIDTH)), np.zeros(3)
    several = len(cameras.interior) > SUMMED_CAMERAS
    sums = np.zeros((0 if several else len(cameras.interior), len(state.points), 3, WIDTH))
    slot, flat, total = equations.slot, equations.flat, 0.0
    for i in range(len(cameras.of_image)):
        k, start, stride = cameras.of_image[i], rays.first[i], equations.stride[i]
        interior, radius = cameras.interior[k], cameras.radius[k]
        for n in range(start, rays.first[i + 1]):
            p, first_entry = rays.point[n], equations.first_entry[n]
            row = rows[2 * (n - start) : 2 * (n - start) + 2]
            direct(X, state.R[i], state.points[p], state.centre[i])
            if not X[2] > 0.0:
                return np.inf
            root = rays.roots[n, 0], rays.roots[n, 1], rays.roots[n, 2]
            linearised(row, interior, radius, X, root)
            turned(row, state.R[i], state.points[p], state.centre[i])
            x, y = image_point(interior, radius, X)
            middle = cameras.format_centre[k]
            put(row, MISCLOSURE, root, rays.xy[n, 0] - middle[0] - x, rays.xy[n, 1] - middle[1] - y)
            if several:
                add_to_sides(equations.points[p], equations.point_sides[p], row, slot[k], flat, first_entry, stride)
            else:
                add_to_point(sums[k, p], row, flat, first_entry, stride)
        rows_of_image = rows[: 2 * (rays.first[i + 1] - start)]
        np.dot(rows_of_image.T, rows_of_image, square)
        put_image(square, equations.images[i], equations.image_sides[i], slot[k], equations.common)
        total += square[MISCLOSURE, MISCLOSURE]
    put_points(sums, slot, equations.points, equations.point_sides)
    return total


@compiled(*_SOURCES)
def weighted_squares(rays: RayArrays, cameras: CameraArrays, state: StateArrays) -> float:
    """Return the weighted sum of squares only."""
    X = np.zeros(3)
    total = 0.0
    for i in range(len(cameras.of_image)):
        k = cameras.of_image[i]
        for n in range(rays.first[i], rays.first[i + 1]):
            direct(X, state.R[i], state.points[rays.point[n]], state.centre[i])
            if not X[2] > 0.0:
                return np.inf
            x, y = image_point(cameras.interior[k], cameras.radius[k], X)
            middle = cameras.format_centre[k]
            a, b = rays.xy[n, 0] - middle[0] - x, rays.xy[n, 1] - middle[1] - y
            u, v = rays.roots[n, 0] * a + rays.roots[n, 1] * b, rays.roots[n, 2] * b
            total += u * u + v * v
    return total


@compiled(*_SOURCES)
def image_points(image: NDArray, point: NDArray, cameras: CameraArrays, state: StateArrays, xy: NDArray) -> None:
    """Fill in image coordinates (N, 2) in px of points, NaN for a point that is not in front of its camera."""
    X = np.zeros(3)
    for n in range(len(image)):
        i = image[n]
        k = cameras.of_image[i]
        direct(X, state.R[i], state.points[point[n]], state.centre[i])
        xy[n, 0] = xy[n, 1] = np.nan
        if X[2] > 0.0:
            x, y = image_point(cameras.interior[k], cameras.radius[k], X)
            xy[n, 0], xy[n, 1] = cameras.format_centre[k, 0] + x, cameras.format_centre[k, 1] + y


@inner
def lower_root(block: NDArray, damping: float, lower: NDArray) -> bool:
    """Fill in the Cholesky factor of a block with its diagonal times 1 + damping; return whether it exists."""
    for i in range(len(block)):
        for j in range(i + 1):
            value = block[i, j]
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
    """Fill in the inverse of a lower triangle."""
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
    """Fill in the product of a lower triangle (d, d) and rows (d, w)."""
    for i in range(len(root)):
        target = product[i]
        target[:] = 0.0
        for j in range(i + 1):
            f, source = root[i, j], rows[j]
            for b in range(len(target)):
                target[b] += f * source[b]


@compiled(*_SOURCES)
def forward(
    block: NDArray,
    rows: NDArray,
    sides: NDArray,
    damping: float,
    root: NDArray,
    reduced: NDArray,
    reduced_sides: NDArray,
) -> bool:
    """Fill in the inverse Cholesky factors (b, d, d) of damped blocks and their products (b d, .) with rows and sides.

    Returns whether all blocks are positive definite.
    """
    count, d, _ = block.shape
    lower = np.zeros((d, d))
    for n in range(count):
        if not lower_root(block[n], damping, lower):
            return False
        invert_lower(lower, root[n])
        at = slice(n * d, n * d + d)
        lower_times(root[n], rows[at], reduced[at])
        lower_times(root[n], sides[at], reduced_sides[at])
    return True


@compiled(*_SOURCES)
def mirror(square: NDArray) -> None:
    """Copy the upper triangle of a matrix (n, n) onto the lower one, tile by tile."""
    n, tile = len(square), 16
    for first in range(0, n, tile):
        for second in range(0, first + 1, tile):
            for i in range(first, min(first + tile, n)):
                for j in range(second, min(second + tile, i)):
                    square[i, j] = square[j, i]
