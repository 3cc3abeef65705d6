"""Vectors and matrices in SIMD lanes: the same small arithmetic on sixteen problems at once, for compiled code.

A register is a row of `LANES` numbers in one flat array. The compiler vectorises a loop over the lanes that calls only
these functions. 3x3 matrices are tuples of rows. Importing this module imports numba.
"""

from __future__ import annotations

from numpy.typing import NDArray

from truing.compiled_code import inner

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]

LANES = 16
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@inner
def get9(lane: NDArray, row: int, j: int) -> Matrix:
    k = row * LANES + j
    return (
        (lane[k], lane[k + LANES], lane[k + 2 * LANES]),
        (lane[k + 3 * LANES], lane[k + 4 * LANES], lane[k + 5 * LANES]),
        (lane[k + 6 * LANES], lane[k + 7 * LANES], lane[k + 8 * LANES]),
    )


@inner
def put9(lane: NDArray, row: int, j: int, m: Matrix) -> None:
    k = row * LANES + j
    lane[k], lane[k + LANES], lane[k + 2 * LANES] = m[0]
    lane[k + 3 * LANES], lane[k + 4 * LANES], lane[k + 5 * LANES] = m[1]
    lane[k + 6 * LANES], lane[k + 7 * LANES], lane[k + 8 * LANES] = m[2]


@inner
def get6(lane: NDArray, row: int, j: int) -> Matrix:
    """Return a symmetric matrix stored as xx xy xz yy yz zz."""
    k = row * LANES + j
    xx, xy, xz = lane[k], lane[k + LANES], lane[k + 2 * LANES]
    yy, yz, zz = lane[k + 3 * LANES], lane[k + 4 * LANES], lane[k + 5 * LANES]
    return (xx, xy, xz), (xy, yy, yz), (xz, yz, zz)


@inner
def put6(lane: NDArray, row: int, j: int, m: Matrix) -> None:
    k = row * LANES + j
    lane[k], lane[k + LANES], lane[k + 2 * LANES] = m[0]
    lane[k + 3 * LANES], lane[k + 4 * LANES], lane[k + 5 * LANES] = m[1][1], m[1][2], m[2][2]


@inner
def get3(lane: NDArray, row: int, j: int) -> Vector:
    k = row * LANES + j
    return lane[k], lane[k + LANES], lane[k + 2 * LANES]


@inner
def add9(lane: NDArray, row: int, j: int, m: Matrix) -> None:
    put9(lane, row, j, combine(1.0, get9(lane, row, j), 1.0, m))


@inner
def add6(lane: NDArray, row: int, j: int, m: Matrix) -> None:
    put6(lane, row, j, combine(1.0, get6(lane, row, j), 1.0, m))


@inner
def add3(lane: NDArray, row: int, j: int, v: Vector) -> None:
    k = row * LANES + j
    lane[k] += v[0]
    lane[k + LANES] += v[1]
    lane[k + 2 * LANES] += v[2]


@inner
def point3(points: NDArray, n: int, field: int, j: int) -> Vector:
    """Return three fields of point n in lane j."""
    k = field * LANES + j
    return points[n, k], points[n, k + LANES], points[n, k + 2 * LANES]


@inner
def dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inner
def cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inner
def mix(a: float, u: Vector, b: float, v: Vector) -> Vector:
    """Return ``a u + b v`` of vectors u, v."""
    return a * u[0] + b * v[0], a * u[1] + b * v[1], a * u[2] + b * v[2]


@inner
def scale(a: float, u: Vector) -> Vector:
    return a * u[0], a * u[1], a * u[2]


@inner
def outer(u: Vector, v: Vector) -> Matrix:
    return scale(u[0], v), scale(u[1], v), scale(u[2], v)


@inner
def combine(a: float, m: Matrix, b: float, n: Matrix) -> Matrix:
    """Return ``a m + b n`` of matrices m, n."""
    return mix(a, m[0], b, n[0]), mix(a, m[1], b, n[1]), mix(a, m[2], b, n[2])


@inner
def resized(a: float, m: Matrix) -> Matrix:
    return scale(a, m[0]), scale(a, m[1]), scale(a, m[2])


@inner
def transpose(m: Matrix) -> Matrix:
    return (m[0][0], m[1][0], m[2][0]), (m[0][1], m[1][1], m[2][1]), (m[0][2], m[1][2], m[2][2])


@inner
def rows_times(m: Matrix, n: Matrix) -> Matrix:
    """Return ``m n^T``: every row of m with every row of n."""
    return apply(n, m[0]), apply(n, m[1]), apply(n, m[2])


@inner
def times(m: Matrix, n: Matrix) -> Matrix:
    return rows_times(m, transpose(n))


@inner
def apply(m: Matrix, v: Vector) -> Vector:
    return dot(m[0], v), dot(m[1], v), dot(m[2], v)


@inner
def skew(v: Vector) -> Matrix:
    return (0.0, -v[2], v[1]), (v[2], 0.0, -v[0]), (-v[1], v[0], 0.0)


@inner
def information(s: Matrix) -> Matrix:
    """Return ``tr(s) I - s``: the information of second moments s about a rotation."""
    return (
        (s[1][1] + s[2][2], -s[0][1], -s[0][2]),
        (-s[1][0], s[0][0] + s[2][2], -s[1][2]),
        (-s[2][0], -s[2][1], s[0][0] + s[1][1]),
    )


@inner
def cofactors(m: Matrix) -> Matrix:
    return cross(m[1], m[2]), cross(m[2], m[0]), cross(m[0], m[1])


@inner
def inverse(m: Matrix) -> Matrix:
    """Return the inverse of a symmetric matrix."""
    k = cofactors(m)
    per = 1.0 / dot(m[0], k[0])
    return resized(per, k)
