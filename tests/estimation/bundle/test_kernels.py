"""Compiled sums are those of the derivatives, row by row."""

from __future__ import annotations

import numpy as np
import pytest

from tests.estimation.bundle.drawn_networks import disturbed, draw, noisy, uneven
from truing.estimation.bundle.network import linearise, project
from truing.estimation.bundle.normal_equations import (
    ArrayPool,
    equation_layout,
    normal_equations,
    observe,
    residuals,
    sum_of_squares,
)


@pytest.fixture(scope="module", params=[2, 5])
def observed(request):
    """Two poses, few or many cameras, an eighth of the rays missing."""
    rng = np.random.default_rng(1)
    network, truth = draw(
        rng, poses=2, images=5, points=9, cameras=request.param, free=("c", "x0", "A2", "B1", "C2"), bars=False
    )
    network = noisy(rng, uneven(rng, network))
    count = network.rays.count
    used = np.arange(count) % 8 != 3
    weights, factors = rng.uniform(0.3, 1, count), rng.uniform(0.5, 2, count)
    layout = equation_layout(network, used, False)
    return observe(network, layout, weights, factors), disturbed(rng, truth), (weights, factors)


def dense(observed, state):
    """Return all rows (2 n, u), the information (2 n, 2 n) and what is left of the measured (2 n,)."""
    network, layout = observed.network, observed.layout
    rays, rows = network.rays, layout.rays
    at = linearise(network, state, rays.image[rows], rays.point[rows])
    i, p, c = 6 * len(layout.images), 3 * len(layout.points), len(layout.common)
    found, information = np.zeros((len(rows), 2, i + p + c)), np.zeros((2 * len(rows),) * 2)
    for n in range(len(rows)):
        found[n, :, 6 * layout.ray_image[n] :][:, :6] = at.by_image[n]
        found[n, :, i + 3 * layout.ray_point[n] :][:, :3] = at.by_point[n]
        for element, place in enumerate(layout.interior[network.image_camera[rays.image[rows[n]]]]):
            if place >= 0:
                found[n, :, i + p + place] = at.by_interior[n, :, element]
        information[2 * n : 2 * n + 2, 2 * n : 2 * n + 2] = observed.rays[n]
    return found.reshape(2 * len(rows), -1), information, (rays.xy_px[rows] - at.xy_px).ravel()


def test_sums_are_those_of_the_rows(observed):
    observed, state, _ = observed
    ours = normal_equations(observed, state, ArrayPool())
    rows, information, v = dense(observed, state)
    normal, side = rows.T @ information @ rows, rows.T @ information @ v
    layout = observed.layout
    i, p = 6 * len(layout.images), 3 * len(layout.points)
    unit = np.sqrt(np.diagonal(normal))
    scaled = normal / np.outer(unit, unit)
    for n in range(len(layout.images)):
        own = slice(6 * n, 6 * n + 6)
        np.testing.assert_allclose(ours.images[n] / np.outer(unit[own], unit[own]), scaled[own, own], atol=1e-12)
    for n in range(len(layout.points)):
        own = slice(i + 3 * n, i + 3 * n + 3)
        np.testing.assert_allclose(ours.points[n] / np.outer(unit[own], unit[own]), scaled[own, own], atol=1e-12)
        by = ours.point_sides[n] / unit[own, None]
        np.testing.assert_allclose(by[:, :-1] / unit[i + p :], scaled[own, i + p :], atol=1e-12)
        np.testing.assert_allclose(by[:, -1], side[own] / unit[own], rtol=1e-9)
    for n in range(len(layout.images)):
        own = slice(6 * n, 6 * n + 6)
        by = ours.image_sides[n] / unit[own, None]
        np.testing.assert_allclose(by[:, :-1] / unit[i + p :], scaled[own, i + p :], atol=1e-12)
        np.testing.assert_allclose(by[:, -1], side[own] / unit[own], rtol=1e-9)
    for pose in range(2):
        images = np.arange(6 * layout.image_start[pose], 6 * layout.image_start[pose + 1])
        points = np.arange(3 * layout.point_start[pose], 3 * layout.point_start[pose + 1]) + i
        by = ours.between[pose] / np.outer(unit[images], unit[points])
        np.testing.assert_allclose(by, scaled[np.ix_(images, points)], atol=1e-12)
    common = ours.common / unit[i + p :, None]
    np.testing.assert_allclose(common[:, :-1] / unit[i + p :], scaled[i + p :, i + p :], atol=1e-12)
    np.testing.assert_allclose(common[:, -1], side[i + p :] / unit[i + p :], rtol=1e-9)
    np.testing.assert_allclose(ours.chi2, v @ information @ v, rtol=1e-12)
    np.testing.assert_allclose(sum_of_squares(observed, state), ours.chi2, rtol=1e-12)


def test_information_is_the_inverse_of_the_covariance_times_weights(observed):
    observed, _, (weights, factors) = observed
    rows = observed.layout.rays
    covariance = observed.network.rays.cov_px2[rows] * (factors / weights)[rows, None, None]
    np.testing.assert_allclose(observed.rays @ covariance, np.broadcast_to(np.eye(2), covariance.shape), atol=1e-12)


def test_residuals_are_those_of_the_projection(observed):
    observed, state, _ = observed
    network = observed.network
    v = network.rays.xy_px - project(network, state, network.rays.image, network.rays.point)
    np.testing.assert_allclose(residuals(network, state), v, rtol=0, atol=1e-9)
