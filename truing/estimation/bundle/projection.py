"""Where a camera sees a point, and the exact derivatives of that by everything that is estimated.

The equations are those of `truing.estimation.bundle.camera`; all functions take rays by the row.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.estimation.bundle.camera import derivatives, image_coordinates
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
    by_direction, by_interior = derivatives(interior, radius[camera], X)
    by_point = np.einsum("nki,nji->nkj", by_direction, state.R[image])
    by_image = np.concatenate([-by_point, np.cross(by_point, arm[:, None])], -1)
    xy = image_coordinates(interior, format_centre[camera], radius[camera], X)
    return Linearised(xy, by_image, by_point, by_interior)
