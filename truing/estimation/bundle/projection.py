"""Where a camera sees a point, and the exact derivatives of that by everything that is estimated.

The equations are those of `truing.estimation.bundle.camera`. All functions take rays by the row and are smooth, so that
a complex step differentiates them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.bundle.network import Array, Index, Network, State


@dataclass(frozen=True)
class Linearised:
    """Rays at a state: computed xy_px (N, 2) and their derivatives by_image (N, 2, 6) in the order (centre, theta),
    by_point (N, 2, 3), by_interior (N, 2, 10) of the ray's camera."""

    xy_px: Array
    by_image: Array
    by_point: Array
    by_interior: Array


def format_centres(network: Network) -> tuple[Array, Array]:
    """Return the centre of the format (C, 2) in px and the balancing radius (C,) in px of every camera."""
    cameras = network.cameras
    centres = np.array([camera.centre_px for camera in cameras]).reshape(-1, 2)
    return centres, np.array([camera.balancing_radius_px for camera in cameras])


def seen(state: State, image: Index, point: Index) -> Array:
    """Return the points (N, 3) in the axes of the cameras that see them, m."""
    return np.einsum("nji,nj->ni", state.R[image], state.points[point] - state.centre[image])


def image_coordinates(interior: NDArray, centre: NDArray, radius: NDArray, X: NDArray) -> NDArray:
    """Return image coordinates (N, 2) in px of points X (N, 3) in camera axes; interior (N, 10), centre (N, 2) and
    balancing radius (N,) of the cameras in px."""
    c, x0, y0, a1, a2, a3, b1, b2, c1, c2 = interior.T
    xi, eta = c * X[:, 0] / X[:, 2], c * X[:, 1] / X[:, 2]
    s, s0 = xi * xi + eta * eta, radius * radius
    radial = 1 + a1 * (s - s0) + a2 * (s**2 - s0**2) + a3 * (s**3 - s0**3)
    x = x0 + xi * radial + b1 * (s + 2 * xi * xi) + 2 * b2 * xi * eta + c1 * xi + c2 * eta
    y = y0 + eta * radial + b2 * (s + 2 * eta * eta) + 2 * b1 * xi * eta
    return centre + np.stack([x, y], -1)


def project(network: Network, state: State, image: Index, point: Index) -> Array:
    """Return image coordinates (N, 2) in px of points as seen in images; NaN where a point is not before its camera."""
    centre, radius = format_centres(network)
    camera = network.image_camera[image]
    X = seen(state, image, point)
    X[X[:, 2] <= 0] = np.nan
    return image_coordinates(state.interior[camera], centre[camera], radius[camera], X)


def linearise(network: Network, state: State, image: Index, point: Index) -> Linearised:
    """Return rays (N) and their derivatives; NaN where a point is not before its camera."""
    format_centre, radius = format_centres(network)
    camera = network.image_camera[image]
    interior, arm = state.interior[camera], state.points[point] - state.centre[image]
    X = np.einsum("nji,nj->ni", state.R[image], arm)
    X[X[:, 2] <= 0] = np.nan
    by_direction, by_interior = _derivatives(interior, radius[camera], X)
    by_point = np.einsum("nki,nji->nkj", by_direction, state.R[image])
    by_image = np.concatenate([-by_point, np.cross(by_point, arm[:, None])], -1)
    xy = image_coordinates(interior, format_centre[camera], radius[camera], X)
    return Linearised(xy, by_image, by_point, by_interior)


def _derivatives(interior: Array, radius: Array, X: Array) -> tuple[Array, Array]:
    """Return the derivatives of image coordinates by the direction (N, 2, 3) in camera axes and the interior."""
    c, _, _, a1, a2, a3, b1, b2, c1, c2 = interior.T
    u, v, depth = X[:, 0] / X[:, 2], X[:, 1] / X[:, 2], X[:, 2]
    xi, eta = c * u, c * v
    s, s0 = xi * xi + eta * eta, radius * radius
    radial = 1 + a1 * (s - s0) + a2 * (s**2 - s0**2) + a3 * (s**3 - s0**3)
    slope = 2 * (a1 + 2 * a2 * s + 3 * a3 * s**2)
    mixed = slope * xi * eta
    xx = radial + slope * xi * xi + 6 * b1 * xi + 2 * b2 * eta + c1
    xy = mixed + 2 * b1 * eta + 2 * b2 * xi + c2
    yx = mixed + 2 * b2 * xi + 2 * b1 * eta
    yy = radial + slope * eta * eta + 6 * b2 * eta + 2 * b1 * xi
    per = c / depth
    x = [xx * per, xy * per, -(xx * u + xy * v) * per]
    y = [yx * per, yy * per, -(yx * u + yy * v) * per]
    by_direction = np.stack([np.stack(x, -1), np.stack(y, -1)], 1)
    one, none = np.ones_like(xi), np.zeros_like(xi)
    powers = [s - s0, s**2 - s0**2, s**3 - s0**3]
    of_x = [xx * u + xy * v, one, none, *(xi * p for p in powers), s + 2 * xi * xi, 2 * xi * eta, xi, eta]
    of_y = [yx * u + yy * v, none, one, *(eta * p for p in powers), 2 * xi * eta, s + 2 * eta * eta, none, none]
    return by_direction, np.stack([np.stack(of_x, -1), np.stack(of_y, -1)], 1)
