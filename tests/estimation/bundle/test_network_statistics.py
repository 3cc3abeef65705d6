"""Geometry of a network, against values computed by hand."""

import numpy as np
import pytest

from truing.estimation.bundle.camera import Camera
from truing.estimation.bundle.network import Bars, KnownPoints, Network, NetworkState, Rays
from truing.estimation.bundle.network_statistics import (
    camera_coverage,
    intersections,
    residual_regions,
)
from truing.estimation.quality import holm_adjusted

CAMERAS = (Camera("left", 100, 100),)


def network(image, point, xy, images, points):
    cov = np.broadcast_to(np.eye(2), (len(image), 2, 2))
    rays = Rays(np.array(image), np.array(point), np.array(xy, float), cov, np.zeros(len(image), int))
    zeros = np.zeros(images, int)
    return Network(CAMERAS, zeros, zeros, np.zeros(points, int), rays, Bars.none(), KnownPoints.none())


def test_rays_angles_and_condition_of_points():
    centre = np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 0, np.sqrt(3)]])
    state = NetworkState(
        np.zeros((1, 10)), np.zeros((3, 3, 3)), centre, np.array([[0, 0, 0], [0, 0, -1.0], [5, 5, 5]]), []
    )
    made = network([0, 1, 2, 0, 1, 2], [0, 0, 1, 1, 1, 2], np.zeros((6, 2)), 3, 3)
    found = intersections(made, state, np.ones(made.rays.count, bool))
    assert found.rays.tolist() == [2, 3, 1]
    assert found.largest_angle == pytest.approx([np.pi, np.pi / 2, 0.0])
    assert found.condition[0] == np.inf  # both rays on one line
    assert found.condition[2] == np.inf
    across = sum((np.eye(3) - np.outer(d, d)) / r**2 for d, r in directions_to(centre, state.points[1]))
    values = np.linalg.eigvalsh(across)
    assert found.condition[1] == pytest.approx(np.sqrt(values[2] / values[0]))
    fewer = intersections(made, state, np.array([1, 0, 1, 1, 1, 1], bool))
    assert fewer.rays.tolist() == [1, 3, 1]


def directions_to(centres, point):
    for centre in centres:
        d = point - centre
        yield d / np.linalg.norm(d), np.linalg.norm(d)


def test_coverage_of_the_format():
    corners = [[0, 0], [99, 0], [99, 99], [0, 99]]
    made = network([0, 0, 0, 0, 1, 1], [0, 1, 2, 3, 0, 1], [*corners, [10, 10], [12, 10]], 2, 4)
    whole = camera_coverage(made, np.ones(6, bool), per_side=2)
    assert whole.rays.tolist() == [6]
    assert whole.cells.tolist() == [1.0]
    assert whole.hull == pytest.approx([0.99**2])
    alone = camera_coverage(made, np.array([0, 0, 0, 0, 1, 1], bool), per_side=2)
    assert alone.cells.tolist() == [0.25]
    assert alone.hull.tolist() == [0.0]
    dropped = camera_coverage(made, np.array([1, 1, 1, 0, 0, 0], bool), per_side=2)
    assert dropped.hull[0] == pytest.approx(0.99**2 / 2)


def test_residuals_that_a_region_has_in_common_are_found():
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, 99, (2000, 2))
    made = network(np.zeros(2000, int), np.arange(2000), xy, 1, 2000)
    residuals = rng.normal(0, 1.0, (2000, 2))
    cofactor = np.broadcast_to(np.eye(2), (2000, 2, 2))
    assert residual_regions(made, residuals, cofactor).p_value.min() > 0.01
    corner = (xy > 79.5).all(axis=1)
    residuals[corner] += [0.8, -0.5]
    found = residual_regions(made, residuals, cofactor)
    worst = np.argmin(found.p_value)
    assert found.p_value[worst] < 1e-4
    assert (found.row[worst], found.column[worst]) == (4, 4)
    assert found.mean_px[worst] == pytest.approx([0.8, -0.5], abs=0.4)
    residuals[corner] = np.nan
    left = residual_regions(made, residuals, cofactor)
    assert not ((left.row == 4) & (left.column == 4)).any()


def test_p_values_are_adjusted_for_their_number():
    assert holm_adjusted(np.array([0.01, 0.04, 0.03])) == pytest.approx([0.03, 0.06, 0.06])
