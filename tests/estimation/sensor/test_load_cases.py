"""Chosen loads: within limits, at the theoretical bound where it is known, and as good as the subsequent fit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.estimation.sensor.toy_sensor import RANGE, sensor
from tests.tolerance import assert_close
from truing.estimation.sensor.calibrate import fit_calibration
from truing.estimation.sensor.calibration import CalibrationModel
from truing.estimation.sensor.load_cases import (
    LoadLimits,
    bench_loads,
    choose_loads,
    corner_loads,
    load_efficiency,
    predicted_sigma,
    verification_loads,
)

LIMITS = LoadLimits(RANGE)
FULL = np.array([1.0])
seeds = st.integers(0, 2**32 - 1)


def test_all_loads_at_once_reach_what_hadamard_allows():
    """Terms of size one at most: det of N rows is at most N^7, by orthogonal columns of signs alone."""
    found = choose_loads(corner_loads(LIMITS), 16, LIMITS, rng=np.random.default_rng(0))
    assert found.upper == pytest.approx(7 * np.log(16), abs=1e-5)
    assert found.efficiency == pytest.approx(1.0, abs=1e-5)
    assert_close(np.abs(found.loads / RANGE), np.ones((16, 6)), atol=1e-9)


def test_one_axis_at_a_time_is_best_where_no_more_can_be_loaded():
    candidates = bench_loads(LIMITS, np.array([0.1, 0.3, 0.5, 0.7, 0.9, 1.0]), 1)
    found = choose_loads(candidates, 24, LIMITS, rng=np.random.default_rng(0))
    share = found.loads / RANGE
    assert_close(np.sort(np.abs(share), axis=1)[:, -1], np.ones(24), atol=1e-9)
    assert_close(np.sum(share**2, 0), np.full(6, 4.0), atol=1e-9)
    assert found.efficiency == pytest.approx(1.0, abs=1e-5)


@pytest.mark.slow
@given(seeds)
@settings(max_examples=15)
def test_no_loads_within_the_limits_beat_the_bound_of_the_corners(seed):
    rng = np.random.default_rng(seed)
    legs = rng.normal(size=(6, 6)) / RANGE
    limits = LoadLimits(RANGE, legs, np.full(6, 1.2))
    drawn = limits.region.draw(30, rng) * RANGE
    assert np.all(np.abs(drawn) <= RANGE * (1 + 1e-9))
    assert np.all(np.abs(drawn @ legs.T) <= 1.2 * (1 + 1e-6))
    assert 0.0 < load_efficiency(drawn, corner_loads(limits), limits).efficiency <= 1.0


@given(seeds, st.floats(1e-3, 1e3))
@settings(max_examples=10)
def test_results_are_independent_of_units(seed, unit):
    rng = np.random.default_rng(seed)
    given_loads = rng.uniform(-1, 1, (20, 6)) * RANGE
    one = load_efficiency(given_loads, corner_loads(LIMITS), LIMITS)
    other = LoadLimits(RANGE * unit)
    two = load_efficiency(given_loads * unit, corner_loads(other), other)
    assert two.efficiency == pytest.approx(one.efficiency, rel=1e-9)


def test_the_paper_s_loading_is_worth_a_fraction_of_the_best():
    """Table 3 for every axis: rows of shares s_k on one axis each, so det is known in closed form."""
    shares = np.array([1, 3, 5, 7, 9, 7, 5, 3, 1, 0]) / 9
    steps = np.concatenate([np.outer(np.r_[shares, -shares], one) for one in np.eye(6)])
    found = load_efficiency(steps * RANGE, corner_loads(LIMITS), LIMITS)
    expected = (120 * (2 * shares @ shares) ** 6) ** (1 / 7) / 120
    assert found.efficiency == pytest.approx(expected, rel=1e-6)
    assert 0.05 < found.efficiency < 0.1


def test_bench_loads_have_few_components_within_the_legs_limits():
    legs = np.ones((1, 6)) / RANGE
    limits = LoadLimits(RANGE, legs, np.array([1.5]))
    found = bench_loads(limits, FULL, 2)
    assert np.all(np.count_nonzero(found, axis=1) <= 2)
    assert np.abs(found @ legs.T).max() == pytest.approx(1.5)


def test_the_choice_for_a_bent_sensor_needs_loads_between():
    candidates = bench_loads(LIMITS, np.array([0.5, 1.0]), 2)
    rng = np.random.default_rng(0)
    bent = choose_loads(candidates, 60, LIMITS, powers="squares", rng=rng)
    assert bent.efficiency > 0.98
    assert (
        load_efficiency(
            choose_loads(corner_loads(LIMITS), 60, LIMITS, rng=rng).loads, candidates, LIMITS, powers="squares"
        ).efficiency
        == 0.0
    )


def test_the_predicted_sigma_is_the_one_that_the_fit_finds():
    rng = np.random.default_rng(3)
    toy = sensor(rng, channels=8)
    found = choose_loads(corner_loads(LIMITS), 24, LIMITS, rng=rng)
    table = toy.table(rng, found.loads, np.arange(24))
    table = type(table)(**{**vars(table), "loads": found.loads})
    fit = fit_calibration(table, CalibrationModel("weighted", "forward", zero="common"))
    predicted = predicted_sigma(found.loads, toy.signal_sigma, LIMITS)
    assert_close(predicted / fit.sigma, np.ones((8, 6)), atol=1e-9)


def test_too_few_loads_are_refused():
    with pytest.raises(ValueError, match="found 6 loads, expected at least 7"):
        choose_loads(corner_loads(LIMITS), 6, LIMITS, rng=np.random.default_rng(0))


@pytest.mark.parametrize("at_once", [1, 2, 6])
def test_loads_for_verification_lie_within_the_range_with_so_many_components_at_once(at_once: int) -> None:
    found = verification_loads(LIMITS, 400, at_once, np.random.default_rng(2))
    assert found.shape == (400, 6)
    assert np.all(np.abs(found) <= RANGE)
    assert np.all(np.count_nonzero(found, axis=1) == at_once)
    assert np.all(np.count_nonzero(found, axis=0) > 0)
