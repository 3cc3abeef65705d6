"""Rotations: exponential, logarithm and left Jacobian of SO(3).

A rotation is a matrix (..., 3, 3) inside the code and a rotation vector (..., 3), in rad, in tables. The tangent is
that of the parent frame: ``R <- exp(theta) R``. All functions accept any batch shape, real or complex. They avoid norms
and ``arctan2``, so that complex steps can differentiate them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

# Taylor coefficients in x = |theta|^2, used below x = 1/4, with a truncation error under 1e-16.
_SERIES_BELOW = 0.25
_SINC = (1.0, -1 / 6, 1 / 120, -1 / 5040, 1 / 362880, -1 / 39916800, 1 / 6227020800)
_COSC = (1 / 2, -1 / 24, 1 / 720, -1 / 40320, 1 / 3628800, -1 / 479001600, 1 / 87178291200)
_SINC3 = (1 / 6, -1 / 120, 1 / 5040, -1 / 362880, 1 / 39916800, -1 / 6227020800)
_COTC = (1 / 12, 1 / 720, 1 / 30240, 1 / 1209600, 1 / 47900160, 691 / 1307674368000, 1 / 74724249600)
_ATANC_BELOW = 0.01
_ATANC = (1.0, -1 / 3, 1 / 5, -1 / 7, 1 / 9, -1 / 11, 1 / 13, -1 / 15)


def skew(v: NDArray) -> NDArray:
    """Return the matrix ``[v]x`` (..., 3, 3) with ``[v]x w = v x w`` of vectors v (..., 3)."""
    v = np.asarray(v)
    result = np.zeros((*v.shape, 3), v.dtype)
    _put_skew(v, result)
    return result


def _put_skew(v: NDArray, found: NDArray) -> None:
    """Fill the off-diagonal elements of ``[v]x`` (..., 3, 3)."""
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    found[..., 0, 1], found[..., 0, 2], found[..., 1, 2] = -z, y, -x
    found[..., 1, 0], found[..., 2, 0], found[..., 2, 1] = z, -y, x


def rigid_motions(points: NDArray) -> NDArray:
    """Return the derivative (..., 3, 6) of points (..., 3) by a small motion (t, theta) of their body about the
    origin."""
    result = np.zeros((*points.shape, 6), np.result_type(points, float))
    put_rigid_motions(points, result)
    return result


def put_rigid_motions(points: NDArray, found: NDArray) -> None:
    """Fill an array of zeros (..., 3, 6) with the derivatives of `rigid_motions`."""
    found[..., [0, 1, 2], [0, 1, 2]] = 1.0
    _put_skew(-points, found[..., 3:])


def exp_so3(theta: NDArray) -> NDArray:
    """Return the rotation (..., 3, 3) of rotation vectors theta (..., 3) in rad (Rodrigues)."""
    theta = _floating(theta)
    x = _squared_norm(theta)
    return _polynomial(theta, _by_series(x, _SINC, _sinc), _by_series(x, _COSC, _cosc))


def left_jacobian_so3(theta: NDArray) -> NDArray:
    """Return J (..., 3, 3) with ``exp(theta + d) = exp(J d) exp(theta)`` to first order, theta (..., 3).

    Barfoot, State Estimation for Robotics (2017), eq. 7.77b.
    """
    theta = _floating(theta)
    x = _squared_norm(theta)
    return _polynomial(theta, _by_series(x, _COSC, _cosc), _by_series(x, _SINC3, _sinc3))


def inverse_left_jacobian_so3(theta: NDArray) -> NDArray:
    """Return the inverse (..., 3, 3) of the left Jacobian, for theta (..., 3) in rad shorter than 2 pi.

    Barfoot (2017), eq. 7.76b.
    """
    theta = _floating(theta)
    x = _squared_norm(theta)
    return _polynomial(theta, np.full_like(x, -0.5), _by_series(x, _COTC, _cotc))


def euler_axes(angles: NDArray, order: str) -> NDArray:
    """Return the rotation axes (N, 3, 3), in the parent frame, of three Euler angles (N, 3), rad: one column per
    angle."""
    inner = order if order.isupper() else order[::-1]  # intrinsic angles: the first one rotates the axes of the others
    angles_in_order = angles if order.isupper() else angles[:, ::-1]
    R = np.broadcast_to(np.eye(3), (len(angles), 3, 3))
    axes = []
    for number, axis in enumerate(inner.upper()):
        unit = np.eye(3)["XYZ".index(axis)]
        axes.append(R @ unit)
        R = R @ exp_so3(angles_in_order[:, number, None] * unit)
    stacked = np.stack(axes, axis=-1)
    return stacked if order.isupper() else stacked[:, :, ::-1]


def log_so3(R: NDArray) -> NDArray:
    """Return the rotation vector (..., 3), in rad and not longer than pi, of rotations R (..., 3, 3).

    Uses the unit quaternion from the largest of its four products (Shepperd, J. Guidance and Control 1 (1978) 223),
    which keeps full precision near 0 and near pi. At pi one of the two vectors is returned.
    """
    q = _quaternion(_floating(R))
    w, v = q[..., 0], q[..., 1:]
    return _angle_over_sine(w, _squared_norm(v))[..., None] * v


def _angle_over_sine(w: NDArray, x: NDArray) -> NDArray:
    """Return ``2 atan2(s, w) / s`` of the half angle's cosine w >= 0 and squared sine ``x = s^2``."""
    small = x.real < _ATANC_BELOW * w.real
    w_small, x_small = np.where(small, w, 1.0), np.where(small, x, 0.0)
    s = np.sqrt(np.where(small, 1.0, x))
    below = s.real < w.real
    ratio = np.where(below, s, w) / np.where(below, w, s)
    half = np.where(below, np.arctan(ratio), np.pi / 2 - np.arctan(ratio))
    return 2 * np.where(small, _horner(_ATANC, x_small / w_small**2) / w_small, half / s)


def _quaternion(R: NDArray) -> NDArray:
    """Return unit quaternions (..., 4), scalar first and not negative, of rotations R (..., 3, 3)."""
    a, b, c = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    wx, wy, wz = R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]
    xy, xz, yz = R[..., 0, 1] + R[..., 1, 0], R[..., 0, 2] + R[..., 2, 0], R[..., 1, 2] + R[..., 2, 1]
    products = (
        1 + a + b + c,
        wx,
        wy,
        wz,
        wx,
        1 + a - b - c,
        xy,
        xz,
        wy,
        xy,
        1 - a + b - c,
        yz,
        wz,
        xz,
        yz,
        1 - a - b + c,
    )
    outer = np.stack(products, axis=-1).reshape(*R.shape[:-2], 4, 4)
    largest = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1).real, axis=-1)
    q = np.take_along_axis(outer, largest[..., None, None], axis=-2)[..., 0, :]
    q = q / np.sqrt(_squared_norm(q)[..., None])
    return np.where(q[..., :1].real < 0, -q, q)


def _polynomial(theta: NDArray, first: NDArray, second: NDArray) -> NDArray:
    """Return ``I + first [theta]x + second [theta]x^2``."""
    K = skew(theta)
    return np.eye(3) + first[..., None, None] * K + second[..., None, None] * (K @ K)


def _by_series(x: NDArray, series: tuple[float, ...], closed: Callable[[NDArray], NDArray]) -> NDArray:
    small = x.real < _SERIES_BELOW
    if small.all():
        return _horner(series, x)
    return np.where(small, _horner(series, np.where(small, x, 0.0)), closed(np.sqrt(np.where(small, 1.0, x))))


def _sinc(t: NDArray) -> NDArray:
    return np.sin(t) / t


def _cosc(t: NDArray) -> NDArray:
    return 2 * np.sin(t / 2) ** 2 / t**2


def _sinc3(t: NDArray) -> NDArray:
    return (t - np.sin(t)) / t**3


def _cotc(t: NDArray) -> NDArray:
    return (1 - (t / 2) * np.cos(t / 2) / np.sin(t / 2)) / t**2


def _horner(coefficients: tuple[float, ...], x: NDArray) -> NDArray:
    value = np.full_like(x, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        value = value * x + coefficient
    return value


def _squared_norm(v: NDArray) -> NDArray:
    return np.sum(v * v, axis=-1)


def _floating(values: NDArray) -> NDArray:
    values = np.asarray(values)
    return values if np.iscomplexobj(values) else values.astype(np.float64, copy=False)
