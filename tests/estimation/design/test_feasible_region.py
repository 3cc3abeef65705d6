"""Regions between limits: corners against the closed form, even spreading, projection, forbidden boxes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.tolerance import assert_close
from truing.estimation.design.feasible_region import FeasibleRegion

NONE = np.empty((0, 3))
seeds = st.integers(0, 2**32 - 1)


def region(half=(1.0, 1.0, 1.0), lower=NONE, upper=NONE, bend=0.0):
    """Two coordinates and their sum, bent a little, as the limited quantities."""

    def quantities(x):
        u, v = x.T
        values = np.stack([u + bend * u * v, v + bend * u * u, u + v], -1)
        one, zero = np.ones_like(u), np.zeros_like(u)
        slopes = [[one + bend * v, bend * u], [2 * bend * u, one], [one, one]]
        return values, np.moveaxis(np.array(slopes), 2, 0) + 0 * zero[:, None, None]

    return FeasibleRegion(2, quantities, np.array(half), np.asarray(lower, float), np.asarray(upper, float))


def as_set(points):
    return sorted(tuple(point) for point in np.round(points, 9) + 0.0)


def test_corners_of_a_hexagon():
    assert as_set(region().corners()) == as_set(np.array([[-1, 0], [-1, 1], [0, -1], [0, 1], [1, -1], [1, 0]]))


def test_an_absent_limit_is_none():
    assert as_set(region((1, 2, np.inf)).corners()) == as_set(np.array([[-1, -2], [-1, 2], [1, -2], [1, 2]]))


@given(st.floats(-0.05, 0.05))
def test_corners_of_bent_limits_lie_on_two_of_them(bend):
    found = region(bend=bend)
    values = np.abs(found.quantities(found.corners())[0])
    assert values.max() <= 1 + 1e-9
    assert_close(np.sort(values, -1)[:, 1:], np.ones((6, 2)), atol=1e-8)


def test_a_forbidden_box_leaves_the_corners_of_the_parts_next_to_it():
    found = region((1, 1, np.inf), [[0.5, 0.2, -np.inf]], [[np.inf, np.inf, np.inf]])
    beside = [[-1, -1], [-1, 1], [0.5, 1], [0.5, -1]]
    below = [[-1, -1], [1, -1], [1, 0.2], [-1, 0.2]]
    assert set(as_set(found.corners())) == set(as_set(np.array(beside + below, float)))
    assert found.allowed(found.corners()).all()
    assert not found.allowed(np.array([[0.6, 0.3], [1.0, 1.0]])).any()


@given(seeds)
def test_points_are_spread_evenly(seed):
    found = region((1.0, 1.0, 0.5))
    x = found.draw(2000, np.random.default_rng(seed))
    assert found.excess(x).max() <= 1 + 1e-9
    # the strip |u + v| <= 1/2 of the square has the area 1.75; a quarter disc about its middle is pi / 64
    share = np.mean(np.sum(x**2, -1) <= 1 / 16)
    expected = np.pi / 16 / 1.75
    assert share == pytest.approx(expected, abs=6 * np.sqrt(expected / 2000))
    assert_close(x.mean(0), np.zeros(2), atol=6 * 0.6 / np.sqrt(2000))


@given(seeds)
def test_projection_is_the_nearest_point(seed):
    rng = np.random.default_rng(seed)
    found = region()
    x = rng.normal(0, 2, (5, 2))
    nearest = found.project(x, np.zeros((5, 2)))
    assert found.excess(nearest).max() <= 1 + 1e-9
    # of a convex set: no point of it lies beyond the plane through the nearest point
    inside = found.draw(200, rng)
    beyond = np.einsum("bi,bni->bn", x - nearest, inside[None] - nearest[:, None])
    assert beyond.max() <= 1e-7


def test_forbidden_regions_that_cover_everything_are_refused():
    with pytest.raises(ValueError, match="forbidden regions that do not cover"):
        region(lower=[[-2, -np.inf, -np.inf]], upper=[[2, np.inf, np.inf]]).draw(5, np.random.default_rng(0))
