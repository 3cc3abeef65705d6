"""From image coordinates back to directions in the camera's frame: distortion undone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from truing.estimation.bundle.camera import Camera
from truing.estimation.bundle.network import Array, Index

_ROUNDS = 30
_SETTLED_PX = 1e-9


def directions(cameras: Sequence[Camera], interior: Array, camera: Index, xy_px: Array) -> Array:
    """Return X/Z and Y/Z (N, 2) of image points xy_px (N, 2), each taken by one of the cameras (N,) by number.

    Distortion is undone by Newton's method from the undistorted place; image points where it does not settle (a
    distortion that folds over) are NaN. interior (C, 10) in the order of camera.PARAMETERS.
    """
    centre = np.stack([c.centre_px for c in cameras])[camera]
    radius = np.array([c.balancing_radius_px for c in cameras])[camera]
    values = interior[camera]
    wanted = xy_px - centre - values[:, 1:3]
    ideal = wanted.copy()
    with np.errstate(all="ignore"):  # what overflows has not settled
        for _ in range(_ROUNDS):
            there, slope = distorted(values, radius, ideal)
            step = _solve2(slope, wanted - there)
            ideal = ideal + step
            if np.nanmax(np.abs(step), initial=0.0) < _SETTLED_PX:
                break
        off = np.abs(distorted(values, radius, ideal)[0] - wanted).max(axis=1, initial=0.0)
        folded = ~(off < 1e-6) | ~(np.linalg.det(distorted(values, radius, ideal)[1]) > 0)
    ideal[folded] = np.nan
    return ideal / values[:, :1]


def distorted(values: Array, radius_px: Array, ideal_px: Array) -> tuple[Array, Array]:
    """Return ideal image coordinates (N, 2), from the principal point, with distortion, and the derivative (N, 2, 2).

    values (N, 10) interior parameters, radius_px (N,) balancing radius; equations in `camera`.
    """
    A1, A2, A3, B1, B2, C1, C2 = values[:, 3:].T
    xi, eta = ideal_px.T
    q, q0 = xi**2 + eta**2, radius_px**2
    radial = A1 * (q - q0) + A2 * (q**2 - q0**2) + A3 * (q**3 - q0**3)
    rise = 2 * (A1 + 2 * A2 * q + 3 * A3 * q**2)  # d radial / d xi = rise xi
    there = np.stack(
        [
            xi * (1 + radial + C1) + B1 * (q + 2 * xi**2) + 2 * B2 * xi * eta + C2 * eta,
            eta * (1 + radial) + B2 * (q + 2 * eta**2) + 2 * B1 * xi * eta,
        ],
        axis=1,
    )
    cross = rise * xi * eta + 2 * B1 * eta + 2 * B2 * xi
    slope = np.empty((len(xi), 2, 2))
    slope[:, 0, 0] = 1 + radial + rise * xi**2 + C1 + 6 * B1 * xi + 2 * B2 * eta
    slope[:, 0, 1] = cross + C2
    slope[:, 1, 0] = cross
    slope[:, 1, 1] = 1 + radial + rise * eta**2 + 6 * B2 * eta + 2 * B1 * xi
    return there, slope


def _solve2(A: Array, b: Array) -> Array:
    det = A[:, 0, 0] * A[:, 1, 1] - A[:, 0, 1] * A[:, 1, 0]
    top = A[:, 1, 1] * b[:, 0] - A[:, 0, 1] * b[:, 1]
    return np.stack([top, A[:, 0, 0] * b[:, 1] - A[:, 1, 0] * b[:, 0]], axis=1) / det[:, None]
