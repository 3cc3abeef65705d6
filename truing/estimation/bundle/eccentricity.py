"""Eccentricity of circular targets: offset of the image ellipse's centre from the image of the circle's centre; and
normals of circles from their ellipses.

An ideal camera sees a circle about P, with unit normal n and radius r, in the directions v with v^T C v = 0:

    C = d^2 1 - d (n P^T + P n^T) + (P^T P - r^2) n n^T,        d = n^T P.

This cone cuts the image plane in an ellipse. The eccentricity is the offset of its centre from the image of P.
Distortion bends the ellipse; its centre is then that of the best-fitting ellipse. Directions are in camera axes. Dold
(dissertation, Univ. der Bundeswehr Muenchen, 1997) derives the same from the ellipse's extrema; the cone is that of
Kanatani, Geometric Computation for Machine Vision (1993), chapter 8.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.estimation.bundle.camera import image_coordinates
from truing.estimation.bundle.network import Network, NetworkState, format_centres, in_camera_axes, linearise

_ROUND = 12  # points of an ellipse that are distorted: the fit is then exact to fifth order


def eccentricity(interior: Array, centre: Array, balancing: Array, P: Array, n: Array, radius_m: Array) -> Array:
    """Return centre of the image ellipse minus image of the centre (N, 2), px, of circles about P (N, 3) in m.

    interior (N, 10), format centre (N, 2) and balancing radius (N,) of the cameras in px; unit normals n (N, 3) of
    either sign; P and n in camera axes. NaN if there is no ellipse: the camera lies in the circle's plane, or part of
    the circle is behind it.
    """
    ideal_centre, radius_1, radius_2 = _ideal_ellipses(P, n, radius_m)
    angle = 2 * np.pi * np.arange(_ROUND) / _ROUND
    cosine, sine = np.cos(angle), np.sin(angle)
    points = ideal_centre[:, None] + radius_1[:, None] * cosine[:, None] + radius_2[:, None] * sine[:, None]

    def distorted(directions: Array) -> Array:
        """Return image coordinates (N, k, 2) of undistorted directions (N, k, 2), at unit distance."""
        k = directions.shape[1]
        X = np.concatenate([directions, np.ones((*directions.shape[:2], 1))], -1).reshape(-1, 3)
        interiors, centres, balancing_radii = (np.repeat(v, k, axis=0) for v in (interior, centre, balancing))
        return image_coordinates(interiors, centres, balancing_radii, X).reshape(-1, k, 2)

    distorted_points = distorted(points)
    mean = distorted_points.mean(1)
    # conjugate radii of the distorted ellipse: its first harmonic
    basis = 2 / _ROUND * np.einsum("nki,jk->nij", distorted_points, np.stack([cosine, sine]))
    normalised = np.linalg.solve(basis[:, None], (distorted_points - mean[:, None])[..., None])[..., 0]
    # the first harmonic of the radius error is a shift of the centre
    radius_error = np.hypot(normalised[..., 0], normalised[..., 1]) - 1
    shift = 2 / _ROUND * radius_error @ np.stack([cosine, sine], 1)
    return mean + np.einsum("nij,nj->ni", basis, shift) - image_coordinates(interior, centre, balancing, P)


def _ideal_ellipses(P: Array, n: Array, radius_m: Array) -> tuple[Array, Array, Array]:
    """Return centres and two conjugate radii (N, 2) each of the images of circles at unit principal distance."""
    d = np.einsum("ni,ni->n", n, P)[:, None, None]
    nP = n[:, :, None] * P[:, None, :]
    squared_distance = (np.einsum("ni,ni->n", P, P) - radius_m**2)[:, None, None]
    C = d**2 * np.eye(3) - d * (nP + nP.swapaxes(1, 2)) + squared_distance * n[:, :, None] * n[:, None, :]
    is_in_front = np.abs(P[:, 2]) - radius_m * np.sqrt(np.maximum(1 - n[:, 2] ** 2, 0)) > 0
    has_image = (np.abs(d[:, 0, 0]) > 1e-9 * np.linalg.norm(P, axis=1)) & is_in_front & (P[:, 2] > 0)
    C = np.where(has_image[:, None, None], C, np.nan)
    A, b = C[:, :2, :2], C[:, :2, 2]
    centres = np.full((len(P), 2), np.nan)
    radii = np.full((len(P), 2, 2), np.nan)
    centres[has_image] = -np.linalg.solve(A[has_image], b[has_image][..., None])[..., 0]
    size = -(C[has_image, 2, 2] + np.einsum("ni,ni->n", b[has_image], centres[has_image]))
    values, vectors = np.linalg.eigh(A[has_image])
    radii[has_image] = vectors * np.sqrt(size[:, None] / values)[:, None, :]
    return centres, radii[..., 0], radii[..., 1]


def network_eccentricity(
    network: Network, state: NetworkState, image: Index, point: Index, normal: Array, radius_m: Array
) -> Array:
    """Return the eccentricities (N, 2) in px of rays (N) to circles; normals (P, 3) are in the frame of their pose,
    radii (P,) in m.

    NaN if normal or radius is NaN or there is no ellipse. Subtract it from the measured image point to get the image of
    the centre.
    """
    centre, balancing = format_centres(network)
    camera = network.image_camera[image]
    n = np.einsum("nji,nj->ni", state.R[image], normal[point])
    P, radius = in_camera_axes(state, image, point), radius_m[point]
    known = np.isfinite(n).all(1) & np.isfinite(radius) & np.isfinite(P).all(1)
    eccentricity_px = np.full((len(image), 2), np.nan)
    camera_of_ray = camera[known]
    eccentricity_px[known] = eccentricity(
        state.interior[camera_of_ray],
        centre[camera_of_ray],
        balancing[camera_of_ray],
        P[known],
        n[known],
        radius[known],
    )
    return eccentricity_px


@dataclass(frozen=True)
class Facing:
    """Orientation of circles: unit normals (P, 3) towards the cameras, in the frame of the pose.

    sigma_rad (P,): larger standard deviation of the direction; radius_m (P,): apparent radius. NaN if the images do not
    determine the normal uniquely.
    """

    normal: Array
    sigma_rad: Array
    radius_m: Array


_STEPS = 12
_CONVERGED_ANGLE = 1e-8  # rad
_UNIQUE_EXCESS = 9.0  # excess of the rival normal's sum of squares, in variances, for a unique normal


def facing(
    network: Network,
    state: NetworkState,
    image: Index,
    point: Index,
    semi_axes_px: Array,
    axis_angle_rad: Array,
    sigma_px: Array,
) -> Facing:
    """Return the normals of circles from their ellipses in images.

    Rays (N) with semi-axes (N, 2), angles (N,) of the major axes and sigma_px (N,) of a semi-axis; NaN ellipses are
    ignored. A circle much smaller than its distance has M M^T = r^2 J (1 - n n^T) J^T; J is the derivative of image
    coordinates by the point. One image leaves two normals, mirrored at the line of sight; the one that fits all images
    is refined by Gauss-Newton on normal and radius.
    """
    count = len(state.points)
    is_measured = np.isfinite(semi_axes_px).all(1) & np.isfinite(axis_angle_rad)
    image, point, sigma = image[is_measured], point[is_measured], sigma_px[is_measured]
    J = linearise(network, state, image, point).by_point
    Q = _shapes(semi_axes_px[is_measured], axis_angle_rad[is_measured])
    L = np.linalg.cholesky(J @ J.swapaxes(1, 2))
    E = np.linalg.solve(L, J)
    W = np.linalg.solve(L, np.linalg.solve(L, Q).swapaxes(1, 2))  # r^2 (1 - m m^T), m = E n
    weight = semi_axes_px[is_measured].mean(1) / (2 * sigma)  # of W / r^2
    n, r2, is_unique = _best_start(E, W, weight, point, count)
    n, r2, information = _refined(n, r2, E, W, weight, point)
    is_determined = is_unique & np.isfinite(n).all(1)
    sigma_rad = np.full(count, np.nan)
    sigma_rad[is_determined] = 1 / np.sqrt(np.maximum(np.linalg.eigvalsh(information[is_determined])[:, 0], 1e-300))
    to_cameras = np.zeros((count, 3))
    np.add.at(to_cameras, point, state.centre[image] - state.points[point])
    n = np.where(np.einsum("pi,pi->p", n, to_cameras)[:, None] < 0, -n, n)
    mask = is_determined[:, None]
    return Facing(np.where(mask, n, np.nan), sigma_rad, np.where(is_determined, np.sqrt(r2), np.nan))


def _shapes(semi_axes: Array, angle: Array) -> Array:
    """Return M M^T (N, 2, 2) of ellipses, where M maps the unit circle to the ellipse."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)
    return (R * semi_axes[:, None, :] ** 2) @ R.swapaxes(1, 2)


def _best_start(E: Array, W: Array, weight: Array, point: Index, count: int) -> tuple[Array, Array, Mask]:
    """Return normals (P, 3), squared radii (P,) and whether the normal is unique, out of the two candidates of each
    image."""
    values, vectors = np.linalg.eigh(W)
    m = vectors[:, :, 0] * np.sqrt(np.maximum(1 - values[:, 0] / values[:, 1], 0))[:, None]
    line_of_sight = np.cross(E[:, 0], E[:, 1])
    level = np.einsum("nki,nk->ni", E, m)
    depth = np.sqrt(np.maximum(1 - np.einsum("nk,nk->n", m, m), 0))[:, None] * line_of_sight
    n, r2 = np.full((count, 3), np.nan), np.full(count, np.nan)
    is_unique = np.zeros(count, bool)
    order = np.argsort(point, kind="stable")
    starts = np.searchsorted(point[order], np.arange(count + 1))
    for p in np.flatnonzero(np.diff(starts)):
        rays = order[starts[p] : starts[p + 1]]
        candidates = np.concatenate([depth[rays] + level[rays], depth[rays] - level[rays]])
        # start with the largest apparent radius: foreshortening only shrinks it
        size = np.median(values[rays, 1])
        residual = _residuals(candidates[:, None], np.full((1, 1), size), E[rays], W[rays], weight[rays])
        cost = np.square(residual).sum((1, 2))
        best = int(cost.argmin())
        n[p], r2[p] = candidates[best], size
        is_rival = np.abs(candidates @ candidates[best]) < np.cos(0.1)
        rival_cost = cost[is_rival].min(initial=np.inf)
        is_unique[p] = len(rays) > 1 and rival_cost - cost[best] > _UNIQUE_EXCESS
        if len(rays) > 1 and not is_rival.any():
            is_unique[p] = True
    return n, r2, is_unique


def _residuals(n: Array, r2: Array, E: Array, W: Array, weight: Array) -> Array:
    """Return weighted residuals (..., N, 3) of normals (..., N or 1, 3) and squared radii (..., N or 1)."""
    m = np.einsum("nki,...ni->...nk", E, np.broadcast_to(n, (*n.shape[:-2], len(E), 3)))
    V = W / r2[..., None, None]
    x, y = m[..., 0], m[..., 1]
    parts = (V[..., 0, 0] - 1 + x * x, np.sqrt(2) * (V[..., 0, 1] + x * y), V[..., 1, 1] - 1 + y * y)
    return np.stack(parts, -1) * weight[:, None]


def _refined(n: Array, r2: Array, E: Array, W: Array, weight: Array, point: Index) -> tuple[Array, Array, Array]:
    """Return least-squares normals and squared radii, and the information (P, 2, 2) of the normals' directions."""
    count = len(n)
    for _ in range(_STEPS):
        tangent = _tangents(n)
        T, N = tangent[point], n[point]
        m, by_tangent = np.einsum("nki,ni->nk", E, N), np.einsum("nki,nij->nkj", E, T)
        r = _residuals(N, r2[point], E, W, weight)
        x, y = m[:, :1], m[:, 1:]
        by_normal = np.stack(
            [
                2 * x * by_tangent[:, 0],
                np.sqrt(2) * (x * by_tangent[:, 1] + y * by_tangent[:, 0]),
                2 * y * by_tangent[:, 1],
            ],
            1,
        )
        V = W / r2[point][:, None, None]
        by_log_size = -np.stack([V[:, 0, 0], np.sqrt(2) * V[:, 0, 1], V[:, 1, 1]], 1)
        D = np.concatenate([by_normal, by_log_size[..., None]], -1) * weight[:, None, None]
        normal, rhs = np.zeros((count, 3, 3)), np.zeros((count, 3))
        np.add.at(normal, point, np.einsum("nki,nkj->nij", D, D))
        np.add.at(rhs, point, -np.einsum("nki,nk->ni", D, r))
        damped = normal + (1e-9 + 1e-6 * np.trace(normal, axis1=1, axis2=2))[:, None, None] * np.eye(3)
        step = np.clip(np.linalg.solve(damped, rhs[..., None])[..., 0], -0.3, 0.3)
        n = n + np.einsum("pij,pj->pi", tangent, step[:, :2])
        n = n / np.linalg.norm(n, axis=1, keepdims=True)
        r2 = r2 * np.exp(step[:, 2])
        if not np.nanmax(np.abs(step), initial=0.0) > _CONVERGED_ANGLE:
            break
    size = np.where(normal[:, 2, 2] > 0, normal[:, 2, 2], 1.0)
    reduced = normal[:, :2, :2] - normal[:, :2, 2:] * normal[:, 2:, :2] / size[:, None, None]
    return n, r2, reduced


def _tangents(n: Array) -> Array:
    """Return two orthonormal vectors (P, 3, 2) perpendicular to normals."""
    least = np.eye(3)[np.abs(np.nan_to_num(n)).argmin(1)]
    first = np.cross(n, least)
    first = first / np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(n, first)], -1)
