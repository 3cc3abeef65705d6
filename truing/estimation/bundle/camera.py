"""Camera model: from directions to image coordinates and back, with principal distance, principal point and distortion.

Frame of a camera: x to the right, y down, z forward, origin in the projection centre. Image coordinates are in pixels,
x to the right and y down, the centre of the first pixel at (0, 0). The centre of the format is (x_centre,
y_centre) = ((width - 1) / 2, (height - 1) / 2). A point at (X, Y, Z) in the camera's frame appears at (x, y):

    xi = c X / Z,   eta = c Y / Z,   r^2 = xi^2 + eta^2;
    radial = A1 (r^2 - R0^2) + A2 (r^4 - R0^4) + A3 (r^6 - R0^6);
    dx = B1 (r^2 + 2 xi^2) + 2 B2 xi eta,   dy = B2 (r^2 + 2 eta^2) + 2 B1 xi eta;
    x = x_centre + x0 + xi (1 + radial + C1) + C2 eta + dx;
    y = y_centre + y0 + eta (1 + radial) + dy.

The model is that of Brown (1971), with affinity C1 and shear C2. Balanced radial distortion is as in Luhmann et al.,
Close-Range Photogrammetry and 3D Imaging (3rd ed.), section 3.3.3. All functions take one point per row. Image
coordinates are analytic, so complex steps differentiate them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index

PARAMETERS = ("c", "x0", "y0", "A1", "A2", "A3", "B1", "B2", "C1", "C2")
UNITS = ("px", "px", "px", "px^-2", "px^-4", "px^-6", "px^-1", "px^-1", "1", "1")
_ROUNDS = 30  # iterations of Newton's method
_SETTLED_PX = 1e-9


@dataclass(frozen=True)
class Camera:
    """One camera: name, format in pixels, balancing radius R0 in pixels (0: unbalanced), pixel pitch in m if known, and
    which of the ten parameters are estimated."""

    name: str
    width_px: int
    height_px: int
    balancing_radius_px: float = 0.0
    pitch_m: float | None = None
    free: tuple[str, ...] = PARAMETERS

    @property
    def centre_px(self) -> Array:
        """Centre (2,) of the format in pixels."""
        return np.array([(self.width_px - 1) / 2, (self.height_px - 1) / 2])


def image_coordinates(interior: NDArray, centre: NDArray, radius: NDArray, X: NDArray) -> NDArray:
    """Return image coordinates (N, 2) in px of points X (N, 3) in camera axes.

    interior (N, 10), format centre (N, 2) and balancing radius (N,) of the cameras in px.
    """
    c, x0, y0, a1, a2, a3, b1, b2, c1, c2 = interior.T
    xi, eta = c * X[:, 0] / X[:, 2], c * X[:, 1] / X[:, 2]
    s, s0 = xi * xi + eta * eta, radius * radius
    radial = 1 + a1 * (s - s0) + a2 * (s**2 - s0**2) + a3 * (s**3 - s0**3)
    x = x0 + xi * radial + b1 * (s + 2 * xi * xi) + 2 * b2 * xi * eta + c1 * xi + c2 * eta
    y = y0 + eta * radial + b2 * (s + 2 * eta * eta) + 2 * b1 * xi * eta
    return centre + np.stack([x, y], -1)


def derivatives(interior: Array, radius: Array, X: Array) -> tuple[Array, Array]:
    """Return the derivatives of image coordinates by X (N, 2, 3) and by the interior (N, 2, 10)."""
    u, v, depth = X[:, 0] / X[:, 2], X[:, 1] / X[:, 2], X[:, 2]
    xi, eta = interior[:, 0] * u, interior[:, 0] * v
    s, s0 = xi * xi + eta * eta, radius * radius
    xx, xy, yx, yy = _slopes(interior, radius, xi, eta)
    per = interior[:, 0] / depth
    x = [xx * per, xy * per, -(xx * u + xy * v) * per]
    y = [yx * per, yy * per, -(yx * u + yy * v) * per]
    by_direction = np.stack([np.stack(x, -1), np.stack(y, -1)], 1)
    unit, none = np.ones_like(xi), np.zeros_like(xi)
    powers = [s - s0, s**2 - s0**2, s**3 - s0**3]
    of_x = [xx * u + xy * v, unit, none, *(xi * p for p in powers), s + 2 * xi * xi, 2 * xi * eta, xi, eta]
    of_y = [yx * u + yy * v, none, unit, *(eta * p for p in powers), 2 * xi * eta, s + 2 * eta * eta, none, none]
    return by_direction, np.stack([np.stack(of_x, -1), np.stack(of_y, -1)], 1)


def _slopes(interior: Array, radius: Array, xi: Array, eta: Array) -> tuple[Array, Array, Array, Array]:
    """Return the derivatives dx/dxi, dx/deta, dy/dxi, dy/deta (N,) of the distortion."""
    _, _, _, a1, a2, a3, b1, b2, c1, c2 = interior.T
    s, s0 = xi * xi + eta * eta, radius * radius
    radial = 1 + a1 * (s - s0) + a2 * (s * s - s0 * s0) + a3 * (s * s * s - s0 * s0 * s0)
    slope = 2 * (a1 + 2 * a2 * s + 3 * a3 * s * s)
    mixed = slope * xi * eta
    xx = radial + slope * xi * xi + 6 * b1 * xi + 2 * b2 * eta + c1
    yy = radial + slope * eta * eta + 6 * b2 * eta + 2 * b1 * xi
    return xx, mixed + 2 * b1 * eta + 2 * b2 * xi + c2, mixed + 2 * b2 * xi + 2 * b1 * eta, yy


def directions(cameras: Sequence[Camera], interior: Array, camera: Index, xy_px: Array) -> Array:
    """Return X/Z and Y/Z (N, 2) of image points xy_px (N, 2), each with its camera number (N,).

    Newton's method inverts the distortion, starting from the undistorted point; image points without convergence (the
    distortion folds over) are NaN. interior (C, 10) in the order of PARAMETERS.
    """
    centre = np.stack([c.centre_px for c in cameras])[camera]
    radius = np.array([c.balancing_radius_px for c in cameras])[camera]
    values = interior[camera]
    X = np.ones((len(xy_px), 3))
    X[:, :2] = (xy_px - centre - values[:, 1:3]) / values[:, :1]
    c = values[:, 0]
    with np.errstate(all="ignore"):  # points that do not converge may overflow
        for _ in range(_ROUNDS):
            off = xy_px - image_coordinates(values, centre, radius, X)
            xx, xy, yx, yy = _slopes(values, radius, c * X[:, 0], c * X[:, 1])
            step = np.stack([yy * off[:, 0] - xy * off[:, 1], xx * off[:, 1] - yx * off[:, 0]], 1)
            step /= (xx * yy - xy * yx)[:, None]
            X[:, :2] += step / c[:, None]
            if np.nanmax(np.abs(step), initial=0.0) < _SETTLED_PX:
                break
        off = xy_px - image_coordinates(values, centre, radius, X)
        xx, xy, yx, yy = _slopes(values, radius, c * X[:, 0], c * X[:, 1])
        converged = (np.abs(off).max(axis=1, initial=0.0) < 1e-6) & (xx * yy - xy * yx > 0)
    return np.where(converged[:, None], X[:, :2], np.nan)
