"""Repeatability by ISO 9283: the standard's own sums, intervals that hold the truth, and groups that scatter alike."""

from __future__ import annotations

import numpy as np
import pytest

from tests.tolerance import assert_between, assert_close
from truing.estimation.repeatability import (
    equal_scatter,
    orientation_repeatability,
    position_repeatability,
    position_sigma,
)


def test_rp_is_the_mean_distance_and_three_standard_deviations():
    points = np.array([[0.0, 0, 0], [3, 0, 0], [0, 4, 0], [0, 0, 5], [1, 1, 1]])
    distance = np.linalg.norm(points - points.mean(0), axis=1)
    found = position_repeatability(points, np.random.default_rng(0))
    assert_close(found.value, distance.mean() + 3.0 * distance.std(ddof=1), atol=1e-12)
    assert found.low < found.value < found.high
    angles = np.array([[1.0, 0, 0], [2, 0, 1], [3, 1, 0], [4, 0, 0], [5, 0, 0]])
    assert_close(orientation_repeatability(angles)[0].value, 3.0 * np.sqrt(2.5), atol=1e-12)


def test_figures_are_independent_of_place_and_direction_and_proportional_to_size():
    rng = np.random.default_rng(1)
    points = rng.normal(size=(8, 3))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    one = position_repeatability(points, np.random.default_rng(2))
    other = position_repeatability(5.0 * points @ turn + 100.0, np.random.default_rng(2))
    assert_close(other.value, 5.0 * one.value, atol=1e-9)
    assert_close(position_sigma(5.0 * points @ turn + 100.0).high, 5.0 * position_sigma(points).high, atol=1e-9)


@pytest.mark.parametrize("count", [5, 30])
def test_intervals_hold_what_a_long_test_gives(count):
    spread, draws = np.diag([1.0, 0.5, 0.2]), 200
    rng = np.random.default_rng(count)
    distance = np.linalg.norm(rng.standard_normal((200000, 3)) @ spread, axis=1)
    truth = distance.mean() + 3.0 * distance.std()
    held = 0
    for _ in range(draws):
        found = position_repeatability(rng.standard_normal((count, 3)) @ spread, rng)
        held += found.low <= truth <= found.high
    # 95 % of 200, and five standard deviations of the count: intervals of few repeats are not too narrow
    assert held / draws > 0.95 - 5.0 * np.sqrt(0.95 * 0.05 / draws)


def test_too_few_repeats_tell_no_rp():
    with pytest.raises(ValueError, match="at least 5"):
        position_repeatability(np.zeros((4, 3)), np.random.default_rng(0))
    with pytest.raises(ValueError, match="at least 5"):
        orientation_repeatability(np.zeros((2, 3)))


def test_groups_of_one_scatter_are_alike_and_one_that_is_thirty_times_as_wide_is_named():
    rng = np.random.default_rng(3)
    freedom = np.array([27.0, 27.0, 27.0])
    alike = [equal_scatter(rng.chisquare(freedom), freedom).p_value for _ in range(1000)]
    assert_between(np.mean(np.array(alike) < 0.05), 0.02, 0.09)
    for scatter, worst, others in (((1.0, 30.0, 1.0), 1, 1.0), ((30.0, 30.0, 1.0), None, 21.0)):
        found = equal_scatter(rng.chisquare(freedom) * np.square(scatter), freedom)
        assert found.p_value < 1e-9
        assert worst is None or found.worst == worst
        assert_between(found.others, 0.6 * others, 1.5 * others)
    assert equal_scatter([1.0], [3.0]) is None
    assert equal_scatter([1.0, 0.0], [3.0, 0.0]) is None
