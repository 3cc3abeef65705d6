"""Pure error against noise of known size, lack of fit, and repeatability by ISO 9283."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, kstest

from tests.tolerance import assert_between, assert_close
from truing.estimation.repeatability import (
    Squares,
    equal_scatter,
    lack_of_fit,
    orientation_repeatability,
    position_repeatability,
    position_sigma,
    residuals_from_lines,
    within_groups,
    within_runs,
)

GROUPS = [np.array([0, 5, 10]), np.array([1, 6]), np.array([2, 7])]
DRAWS = 2000


def test_the_interval_of_pure_error_holds_as_often_as_it_says():
    rng = np.random.default_rng(1)
    values = 3.0 * rng.standard_normal((12, DRAWS)) + np.arange(12)[:, None] % 5  # poses 0, 5 and 10 are one
    found = within_groups(values, GROUPS)
    assert (found.freedom == 4).all()
    lower, upper = found.interval()
    inside = int(((lower < 3.0) & (upper > 3.0)).sum())
    assert binom.ppf(1e-4, DRAWS, 0.95) <= inside <= binom.ppf(1.0 - 1e-4, DRAWS, 0.95)
    assert kstest(found.square / 9.0, "chi2", args=(4,)).pvalue > 1e-3


def test_runs_repeat_each_other_but_for_their_zeros_and_steps_that_one_of_them_missed():
    rng, runs, steps = np.random.default_rng(2), 3, 6
    values = rng.standard_normal((runs * steps, DRAWS))
    values += (
        np.repeat(rng.standard_normal((runs, DRAWS)) * 50.0, steps, axis=0) + np.tile(np.arange(steps), runs)[:, None]
    )
    values[3, ::2] = np.nan
    found = within_runs(values, [np.arange(runs * steps).reshape(runs, steps)])
    assert set(found.freedom[::2]) == {(runs - 1) * (steps - 2)}
    assert set(found.freedom[1::2]) == {(runs - 1) * (steps - 1)}
    assert kstest(found.square[1::2], "chi2", args=(10,)).pvalue > 1e-3
    assert kstest(found.square[::2], "chi2", args=(8,)).pvalue > 1e-3


def left_by_a_line(curved):
    """Residuals of a line through twelve values at five places, with a given curvature."""
    rng = np.random.default_rng(3)
    x = np.arange(12) % 5 - 2.0
    values = rng.standard_normal((12, DRAWS)) + 7.0 * x[:, None] + curved * (x**2)[:, None]
    design = np.column_stack([np.ones(12), x])
    left = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
    groups = [np.flatnonzero(np.arange(12) % 5 == place) for place in range(5)]
    return lack_of_fit(Squares((left**2).sum(axis=0), np.full(DRAWS, 10.0)), within_groups(left, groups))


def test_a_right_model_is_held_wrong_as_often_as_chance_has_it_and_a_wrong_one_is_found():
    right = left_by_a_line(0.0)
    assert set(zip(right.of_fit, right.of_error, strict=True)) == {(3.0, 7.0)}
    assert kstest(right.p_value, "uniform").pvalue > 1e-3
    assert (left_by_a_line(2.0).p_value < 0.01).mean() > 0.95


def test_without_repeats_nothing_is_reported():
    found = within_groups(np.zeros((4, 2)), [])
    assert np.isnan(found.sigma).all()
    assert np.isnan(found.interval()).all()
    assert np.isnan(lack_of_fit(Squares(np.ones(2), np.full(2, 3.0)), found).p_value).all()


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
@pytest.mark.slow
def test_intervals_contain_the_values_of_a_long_test(count):
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


def test_too_few_repeats_give_no_rp():
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


def test_zeros_of_runs_and_lines_in_drives_leave_the_noise_with_its_freedom():
    rng, runs, steps = np.random.default_rng(8), 4, 9
    run, drives = np.repeat(np.arange(runs), steps), rng.uniform(-1.0, 1.0, (runs * steps, 2))
    noise = rng.standard_normal((runs * steps, DRAWS))
    values = noise + 50.0 * rng.standard_normal(runs)[run, None] + drives @ rng.normal(size=(2, DRAWS))
    values[3] = np.nan
    fitted = run != 3
    left, found = residuals_from_lines(values, drives, run, fitted)
    assert np.isnan(left[3]).all()
    assert np.isnan(left[~fitted]).all()
    assert (found.freedom == 3 * steps - 1 - 3 - 2).all()
    assert kstest(found.square, "chi2", args=(found.freedom[0],)).pvalue > 1e-3
