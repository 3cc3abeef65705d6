"""Geometry of a network: rays per point and image, intersection angles, coverage of the format, residuals by region.

All functions take plain arrays and treat all points, images and rays at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.estimation.bundle.growing import format_cells
from truing.estimation.bundle.network import Network, NetworkState
from truing.estimation.bundle.orientation import sums
from truing.estimation.quality import holm_adjusted


@dataclass(frozen=True)
class Intersections:
    """Intersection geometry per point (P,): number of rays, largest angle (rad) between two of them, and condition.

    The condition is the uncertainty along the worst direction over that along the best one, inf if undetermined.
    """

    rays: Index
    largest_angle: Array
    condition: Array


def intersections(network: Network, state: NetworkState, used: Mask) -> Intersections:
    """Return the intersection geometry of each point from the used rays (N,).

    The condition is the square root of the ratio of the extreme eigenvalues of sum(1 - d d^T) / distance^2.
    """
    rays = network.rays
    image, point = rays.image[used], rays.point[used]
    d = state.points[point] - state.centre[image]
    distance = np.linalg.norm(d, axis=1, keepdims=True)
    d = d / distance
    weighted_projector = (np.eye(3) - d[:, :, None] * d[:, None, :]) / distance[:, :, None] ** 2
    count = len(network.point_pose)
    values = np.linalg.eigvalsh(sums(point, weighted_projector, count))
    with np.errstate(divide="ignore", invalid="ignore"):
        condition = np.sqrt(values[:, 2] / values[:, 0])
    is_undetermined = ~(values[:, 0] > 1e-12 * values[:, 2])
    return Intersections(
        np.bincount(point, minlength=count),
        _largest_angles(point, d, count),
        np.where(is_undetermined, np.inf, condition),
    )


def _largest_angles(point: Index, d: Array, count: int) -> Array:
    """Return the largest angle (P,) between two unit vectors d (N, 3) of a point; 0 for a single ray."""
    order = np.argsort(point, kind="stable")
    point, d = point[order], d[order]
    count_of_point = np.bincount(point, minlength=count)
    first = np.cumsum(count_of_point) - count_of_point
    least_cosine = np.ones(count)
    # Pairs each ray with the one `step` places on, and so covers all pairs.
    for step in range(1, int(count_of_point.max(initial=1))):
        partner = np.arange(len(point)) + step
        has_partner = partner < (first + count_of_point)[point]
        cosine = np.einsum("ni,ni->n", d[has_partner], d[partner[has_partner]])
        np.minimum.at(least_cosine, point[has_partner], cosine)
    return np.arccos(np.clip(least_cosine, -1.0, 1.0))


@dataclass(frozen=True)
class Coverage:
    """Coverage of the format of each camera (C): rays (C,), share of its cells (C,) with any, and area of their convex
    hull (C,) as a share of the format."""

    rays: Index
    cells: Array
    hull: Array


def camera_coverage(network: Network, used: Mask, per_side: int = 5) -> Coverage:
    """Return the coverage of each camera's format by the used rays (N,) of all its images."""
    from scipy.spatial import ConvexHull, QhullError

    camera, size = _cameras(network, used)
    xy, count = network.rays.xy_px[used], len(network.cameras)
    cells = np.unique(np.stack([camera, format_cells(xy, size[:, 0], size[:, 1], per_side)]), axis=1)[0]
    hull = np.zeros(count)
    for number in range(count):
        members = camera == number
        if members.sum() > 2:
            try:
                hull[number] = ConvexHull(xy[members] / size[members]).volume  # in the plane, `volume` is the area
            except QhullError:  # points on one line
                continue
    share = np.bincount(cells, minlength=count) / per_side**2
    return Coverage(np.bincount(camera, minlength=count), share, hull)


def _cameras(network: Network, used: Mask) -> tuple[Index, Array]:
    """Return the camera number (n,) of the used rays (N,), and the width and height (n, 2) in px of its format."""
    camera = network.image_camera[network.rays.image[used]]
    return camera, np.array([[c.width_px, c.height_px] for c in network.cameras], float).reshape(-1, 2)[camera]


@dataclass(frozen=True)
class ResidualRegions:
    """Residuals by region of the format: camera, row and column (G,), rays (G,), mean_px (G, 2).

    chi2 (G,) has two degrees of freedom; p_value (G,) of no systematic residual is adjusted for the number of regions
    (Holm).
    """

    camera: Index
    row: Index
    column: Index
    rays: Index
    mean_px: Array
    chi2: Array
    p_value: Array


def residual_regions(network: Network, residuals_px: Array, cofactor_px2: Array, per_side: int = 5) -> ResidualRegions:
    """Return the mean of residuals (N, 2) and its test per region of each camera's format.

    cofactor_px2 (N, 2, 2): covariance of the residuals. Correlation between rays is neglected, which makes the test
    slightly conservative, since estimated parameters absorb common parts. Unused rays have residual NaN.
    """
    from scipy.special import chdtrc

    used: Mask = np.all(np.isfinite(residuals_px), axis=1)
    camera, size = _cameras(network, used)
    cell = format_cells(network.rays.xy_px[used], size[:, 0], size[:, 1], per_side)
    number = camera * per_side**2 + cell
    region_count = len(network.cameras) * per_side**2
    rays = np.bincount(number, minlength=region_count)
    index = np.flatnonzero(rays)
    mean = sums(number, residuals_px[used], region_count)[index] / rays[index, None]
    cov = sums(number, cofactor_px2[used], region_count)[index] / rays[index, None, None] ** 2
    chi2 = np.einsum("gi,gi->g", mean, np.linalg.solve(cov, mean[..., None])[..., 0])
    camera_of_region, cell = np.divmod(index, per_side**2)
    p_value = holm_adjusted(chdtrc(2, chi2))
    return ResidualRegions(camera_of_region, cell // per_side, cell % per_side, rays[index], mean, chi2, p_value)
