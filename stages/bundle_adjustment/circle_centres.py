"""Centres of circles' images brought to the images of the circles' centres, by which way the adjusted circles face."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from stages.bundle_adjustment.rays_as_network import ImagePoints, NamedNetwork
from truing.estimation.bundle.eccentricity import facing, network_eccentricity
from truing.estimation.bundle.network import Network, State

Array = NDArray[np.float64]


def eccentricities(
    named: NamedNetwork, table: ImagePoints, state: State, used: NDArray[np.bool_], radius_m: Array
) -> tuple[Array, Array]:
    """By how much the centre of each ray's ellipse is off (N, 2) in px; 0 where no ellipse was measured, or the
    ellipses of its point leave open which way it faces. And the radii (P,) in m that the ellipses show, NaN without.

    used (N,): rays whose ellipses are believed; radius_m (P,) of circles, NaN where not known.
    """
    rays = named.network.rays
    axes = np.where(used[:, None], table.semi_axes_px[named.row], np.nan)
    if not np.isfinite(axes).all(axis=1).any():
        return np.zeros((rays.count, 2)), np.full(len(state.points), np.nan)
    sigma = np.sqrt(np.einsum("nii->n", rays.cov_px2) / 2)
    found = facing(named.network, state, rays.image, rays.point, axes, table.angle_rad[named.row], sigma)
    radius = np.where(np.isfinite(radius_m), radius_m, found.radius_m)
    off = network_eccentricity(named.network, state, rays.image, rays.point, found.normal, radius)
    no_ellipse = np.isnan(table.semi_axes_px[named.row]).any(axis=1, keepdims=True)
    return np.where(no_ellipse | ~np.isfinite(off), 0.0, off), found.radius_m


def without_eccentricity(network: Network, off_px: Array) -> Network:
    """The network with its rays through the circles' centres."""
    return replace(network, rays=replace(network.rays, xy_px=network.rays.xy_px - off_px))
