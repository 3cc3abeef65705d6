"""Errors added to a series are reported by class and size; noise alone stays below the limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.tolerance import assert_between, assert_close
from truing.estimation.sensor.error_classes import AxisSeries, ErrorClass, creep, error_classes, reading_sigma

AXIS, FULL = 2, 9e3
ONCE = np.array([0.0, 1, 3, 5, 7, 9, 7, 5, 3, 1, 0]) * 1e3  # Table 3 of the force-sensor paper, from an unloaded zero
LOAD = np.concatenate([ONCE, -ONCE] * 3)
CYCLE = np.repeat(np.arange(6), 11)
SHARE = LOAD / FULL


def _series(
    rng: np.random.Generator, sigma: float = 1.0, more: np.ndarray | float = 0.0, cross: float = 0.0
) -> AxisSeries:
    reading = np.zeros((len(LOAD), 6))
    reading[:, AXIS] = LOAD + more
    reading[:, 0] = cross * LOAD
    reading += sigma * rng.normal(size=reading.shape) + rng.normal(size=(6, 6))[CYCLE] * 50.0  # zeros of the cycles
    return AxisSeries(LOAD, reading, AXIS, CYCLE, np.full(6, sigma), np.full(6, FULL))


def _falling() -> np.ndarray:
    return ~_series(np.random.default_rng(0)).is_loading


def _named(series: AxisSeries) -> dict[tuple[str, int], ErrorClass]:
    return {(one.name, one.component): one for one in error_classes(series)}


BEND = 0.004 * FULL * SHARE * np.abs(SHARE)
LOOP = 0.003 * FULL * 4 * SHARE * (1 - np.abs(SHARE)) * _falling()
CASES = {
    "nonlinearity": BEND,
    "hysteresis": LOOP,
    "zero return": 0.002 * FULL * (np.tile(np.arange(11), 6) == 10),
    "repeatability": 0.002 * FULL * np.abs(SHARE) * (CYCLE == 4),
}


@pytest.mark.parametrize("name", CASES)
def test_an_error_is_found_by_its_name_and_size(name):
    expected = {
        # of the odd bend a line through zero takes away the best it can, weighted by the five levels of either sign
        "nonlinearity": _left_of_bend(),
        "hysteresis": 0.003 * 4 * (5 / 9) * (4 / 9),
        "zero return": 0.002,
        "repeatability": 0.002,
    }[name]
    found = _named(_series(np.random.default_rng(1), more=CASES[name]))[name, AXIS]
    assert abs(found.value - expected) < 4 * found.sigma
    assert found.value > 2 * found.limit


def _left_of_bend() -> float:
    share = np.array([1, 3, 5, 7, 9]) / 9
    curve = 0.004 * share**2
    return float(np.abs(curve - share * (share @ curve) / (share @ share)).max())


def test_crosstalk_is_reported_for_the_component_that_shows_it():
    found = _named(_series(np.random.default_rng(2), cross=0.01))
    assert abs(found["crosstalk", 0].value - 0.01) < 4 * found["crosstalk", 0].sigma
    assert found["crosstalk", 1].value < 2 * found["crosstalk", 1].limit
    assert ("crosstalk", AXIS) not in found


def test_a_cubic_takes_a_bend_that_a_line_does_not():
    found = _named(_series(np.random.default_rng(3), more=0.004 * FULL * SHARE**3))
    assert found["nonlinearity", AXIS].value > 5 * found["nonlinearity", AXIS].limit
    assert found["interpolation", AXIS].value < 2 * found["interpolation", AXIS].limit


def test_noise_alone_seldom_exceeds_its_limits():
    rng, draws = np.random.default_rng(4), 100
    exceeded: dict[str, int] = {}
    for _ in range(draws):
        for one in error_classes(_series(rng)):
            if one.component in (1, AXIS):
                exceeded[one.name] = exceeded.get(one.name, 0) + (one.value > one.limit)
    assert len(exceeded) == 6
    # at most 0.05 by construction: 5 of 100, and 13 once in a thousand times
    assert max(exceeded.values()) <= 13
    assert sum(exceeded.values()) > 6  # nor are the limits far too wide: some 20 of 700


@given(st.integers(0, 100), st.floats(1e-4, 1e4))
@settings(max_examples=10)
def test_shares_do_not_depend_on_units(seed, unit):
    one = _series(np.random.default_rng(seed), more=BEND + LOOP)
    two = AxisSeries(one.load * unit, one.reading * unit, AXIS, CYCLE, one.sigma * unit, one.full_scale * unit)
    for a, b in zip(error_classes(one), error_classes(two), strict=True):
        assert_close([b.value, b.sigma, b.limit, b.load / unit], [a.value, a.sigma, a.limit, a.load], atol=1e-9 * FULL)


def test_results_are_independent_of_the_zeros_of_cycles():
    one = _series(np.random.default_rng(5), more=BEND)
    other = AxisSeries(LOAD, one.reading + 1e3 * CYCLE[:, None], AXIS, CYCLE, one.sigma, one.full_scale)
    for a, b in zip(error_classes(one), error_classes(other), strict=True):
        assert b.value == pytest.approx(a.value, abs=1e-12)


def test_the_noise_of_a_reading_is_found_from_repeats():
    found = reading_sigma(_series(np.random.default_rng(6), sigma=3.0, more=BEND + LOOP))
    freedom = 66 - 21 - 4  # 22 kinds of step share the cycles' zeros twice over
    assert_between(float(np.sqrt(np.mean(found**2))), *(3.0 * (1 + np.array([-4, 4]) / np.sqrt(12 * freedom))))


def test_a_rising_series_has_no_error_classes_that_need_a_return():
    up = AxisSeries(ONCE[:6], ONCE[:6, None] * np.eye(6)[AXIS], AXIS, np.zeros(6, int), np.ones(6), np.full(6, FULL))
    assert {one.name for one in error_classes(up)} == {"nonlinearity", "interpolation", "crosstalk"}
    with pytest.raises(ValueError, match="cycle 0: found no unloaded reading"):
        error_classes(AxisSeries(ONCE[1:6], np.zeros((5, 6)), AXIS, np.zeros(5, int), np.ones(6), np.ones(6)))


def test_creep_is_the_change_between_two_times():
    time = np.arange(0.0, 400.0, 20.0)
    reading = 1000.0 + 5.0 * (1 - np.exp(-time / 60.0))
    found = creep(time, reading, sigma=0.1, full_scale=1000.0)
    expected = 5e-3 * (np.exp(-30 / 60) - np.exp(-300 / 60))
    assert found.value == pytest.approx(expected, abs=5e-5)  # of a chord over 20 s
    # each end the mean of two readings or one: between 1 and sqrt(2) of the noise
    assert 1e-4 <= found.sigma <= np.sqrt(2) * 1e-4
    assert found.value > found.limit
    with pytest.raises(ValueError, match="from 0 to 200 s, expected 30 to 300 s"):
        creep(time[:11], reading[:11], 0.1, 1000.0)


def test_a_load_that_is_held_stays_on_its_branch():
    load = np.array([0.0, 1, 1, 2, 2, 1, 1, 0, 0, -1, -1, 0])
    held = AxisSeries(load, np.zeros((12, 6)), AXIS, np.zeros(12, int), np.ones(6), np.ones(6))
    assert held.is_loading.tolist() == [True] * 5 + [False] * 4 + [True] * 2 + [False]
