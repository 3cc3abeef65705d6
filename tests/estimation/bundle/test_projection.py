"""Derivatives of the projection are exact, and the projection agrees with another formulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.estimation.bundle.drawn_networks import RADIUS, draw
from truing.estimation.bundle.camera import image_coordinates
from truing.estimation.bundle.network import format_centres, in_camera_axes, linearise, project
from truing.estimation.rotation import exp_so3

STEP = 1e-30


@pytest.fixture(scope="module")
def drawn():
    return draw(np.random.default_rng(5), images=4, points=8)


def test_the_projection_is_that_of_the_tangent_plane(drawn):
    network, state = drawn
    rays = network.rays
    np.testing.assert_allclose(project(network, state, rays.image, rays.point), rays.xy_px, rtol=0, atol=1e-9)


def test_a_point_behind_the_camera_is_not_seen(drawn):
    network, state = drawn
    behind = replace(state, points=state.points + 100 * state.R[0, :, 2] * [-1, -1, -1])
    assert np.isnan(project(network, behind, np.array([0]), np.array([0]))).all()


def stepped(network, state, **changes):
    """Return the imaginary part of the rays' coordinates per step."""
    moved = replace(state, **changes)
    rays = network.rays
    camera = network.image_camera[rays.image]
    X = in_camera_axes(moved, rays.image, rays.point)
    centre, _ = format_centres(network)
    xy = image_coordinates(moved.interior[camera], centre[camera], np.full(rays.count, RADIUS), X)
    return xy.imag / STEP


@pytest.mark.parametrize("column", range(3))
def test_derivatives_by_the_point(drawn, column):
    network, state = drawn
    at = linearise(network, state, network.rays.image, network.rays.point)
    by = stepped(network, state, points=state.points + 1j * STEP * np.eye(3)[column])
    np.testing.assert_allclose(at.by_point[..., column], by, rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("column", range(6))
def test_derivatives_by_the_image(drawn, column):
    network, state = drawn
    at = linearise(network, state, network.rays.image, network.rays.point)
    unit = 1j * STEP * np.eye(6)[column]
    by = stepped(network, state, centre=state.centre + unit[:3], R=exp_so3(unit[3:]) @ state.R)
    np.testing.assert_allclose(at.by_image[..., column], by, rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("column", range(10))
def test_derivatives_by_the_interior(drawn, column):
    network, state = drawn
    at = linearise(network, state, network.rays.image, network.rays.point)
    by = stepped(network, state, interior=state.interior + 1j * STEP * np.eye(10)[column])
    np.testing.assert_allclose(at.by_interior[..., column], by, rtol=1e-12, atol=1e-12 * np.abs(by).max())
