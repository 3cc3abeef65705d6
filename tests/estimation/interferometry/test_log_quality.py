"""Faults inserted into logs are found with their place and size; good logs have none."""

from __future__ import annotations

import numpy as np
import pytest

from tests.estimation.interferometry.bench import LEVELS, OWN_PAIRS, made_compliance, made_log
from tests.tolerance import assert_close
from truing.estimation.interferometry import log_quality as quality

TIME = 30.0 * np.arange(len(LEVELS))
COLUMNS = np.column_stack([np.ones(len(LEVELS)), TIME, LEVELS])  # zero, drift and response of a run
PAIRS = [*OWN_PAIRS, *OWN_PAIRS, *OWN_PAIRS]


def slopes(log) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Response per load of each run with its standard deviation, and equal numbers for equal axis and channel."""
    run = slice(None, None, len(LEVELS))
    value = np.linalg.lstsq(COLUMNS, log.reading.reshape(-1, len(LEVELS)).T, rcond=None)[0][2]
    sigma = log.sigma[run] * np.sqrt(np.linalg.inv(COLUMNS.T @ COLUMNS)[2, 2])
    return value, sigma, log.axis[run] * 6 + log.channel[run]


def test_a_good_log_has_no_findings() -> None:
    log = made_log(np.random.default_rng(7), PAIRS)
    value, sigma, kind = slopes(log)
    expected = np.diag(made_compliance())[kind // 7]
    readings = log.reading.reshape(-1, len(LEVELS))
    assert len(quality.signs_flipped(value, sigma, kind)) == 0
    assert len(quality.units_mistaken(value, sigma, expected)) == 0
    assert len(quality.steps_missing(log.run, log.step)) == 0
    assert len(quality.runs_cut_short(log.run, log.step, log.axis)) == 0
    assert not sum(len(quality.saturated(reading, LEVELS)) for reading in readings)


def test_a_run_of_the_other_sign_is_found_among_its_kind() -> None:
    log = made_log(np.random.default_rng(1), PAIRS)
    value, sigma, kind = slopes(log)
    assert len(quality.signs_flipped(value, sigma, kind)) == 0
    value[8] = -value[8]
    found = quality.signs_flipped(value, sigma, kind)
    assert list(found.where) == [8]
    assert_close(found.size, [-1.0], atol=0.02)


def test_two_runs_that_contradict_each_other_are_both_named_and_a_simulation_decides() -> None:
    two = quality.signs_flipped([2e-10, -2e-10], [1e-13, 1e-13], np.array([0, 0]))
    assert list(two.where) == [0, 1]
    decided = quality.signs_flipped([2e-10, -2e-10, 2.1e-10], [1e-13, 1e-13, 0.0], np.array([0, 0, 0]))
    assert list(decided.where) == [1]


def test_noise_and_real_differences_of_sign_are_no_flipped_sign() -> None:
    assert len(quality.signs_flipped([1e-13, -2e-13, 1e-13], [1e-13] * 3, np.zeros(3, int))) == 0
    assert len(quality.signs_flipped([2e-10, -2e-12, 2e-10], [1e-13] * 3, np.zeros(3, int))) == 0
    assert len(quality.signs_flipped([2e-10, np.nan], [1e-13, np.inf], np.zeros(2, int))) == 0


@pytest.mark.parametrize("factor", quality.UNIT_FACTORS)
def test_readings_in_another_unit_are_found_with_their_factor(factor: float) -> None:
    log = made_log(np.random.default_rng(2), OWN_PAIRS)
    value, sigma, _ = slopes(log)
    expected = np.diag(made_compliance())
    assert len(quality.units_mistaken(value, sigma, expected)) == 0
    value[4], sigma[4] = factor * value[4], factor * sigma[4]
    found = quality.units_mistaken(value, sigma, 1.15 * expected)
    assert list(found.where) == [4]
    assert_close(found.size, [factor], atol=0.0)


def test_steps_that_are_missing() -> None:
    run = np.array([0, 0, 0, 1, 1, 1, 2, 2, 2])
    step = np.array([1, 2, 5, 1, 2, 3, 2, 3, 4])
    found = quality.steps_missing(run, step)
    assert list(zip(found.where, found.size, strict=True)) == [(1, 2.0), (6, 1.0)]
    order = np.random.default_rng(1).permutation(9)
    shuffled = quality.steps_missing(run[order], step[order])
    assert sorted(order[shuffled.where]) == [1, 6]
    assert len(quality.steps_missing(run[3:6], step[3:6])) == 0
    assert len(quality.steps_missing(run[:0], step[:0])) == 0


def test_runs_that_end_early() -> None:
    run = np.repeat([3, 5, 9], [4, 4, 2])
    step = np.array([1, 2, 3, 4, 1, 2, 3, 4, 1, 2])
    found = quality.runs_cut_short(run, step, np.zeros(10, int))
    assert list(zip(found.where, found.size, strict=True)) == [(9, 2.0)]
    assert len(quality.runs_cut_short(run, step, run)) == 0


def test_signals_that_meet_a_wall() -> None:
    rng = np.random.default_rng(3)
    turning = np.round(500.0 * np.sin(rng.uniform(0, 2 * np.pi, 5000)) + rng.standard_normal(5000))
    assert len(quality.saturated(turning)) == 0
    clipped = np.clip(turning, -440.0, 900.0)
    found = quality.saturated(clipped)
    assert (found.where == np.flatnonzero(clipped == -440.0)).all()
    assert set(found.size) == {-440.0}
    smooth = 10.0 + 3e-3 * rng.standard_normal(80)
    assert len(quality.saturated(smooth)) == 0
    assert len(quality.saturated(np.minimum(smooth, 10.002))) == (smooth >= 10.002).sum()
    assert len(quality.saturated(np.zeros(10))) == 0


def test_a_load_held_or_repeated_is_no_wall_and_a_signal_that_stops_following_it_is() -> None:
    rng = np.random.default_rng(8)
    load = np.tile(LEVELS, 3)
    wrong = 0
    for _ in range(200):
        signal = np.round(1.1e-3 * load + 0.01 * rng.standard_normal(len(load)), 2)
        wrong += len(quality.saturated(signal, load)) > 0
        short = quality.saturated(np.minimum(signal, 7.0), load)
        assert set(load[short.where]) == {7e3, 9e3}
    assert wrong == 0


def test_surroundings_of_each_run() -> None:
    run = np.array([0, 0, 0, 1, 1, 2])
    found = quality.surroundings([20.0, np.nan, 20.5, 21.0, 20.2, np.nan], run)
    assert_close(found.first[:2], [20.0, 21.0], atol=0.0)
    assert_close(found.span[:2], [0.5, 0.8], atol=1e-12)
    assert_close(found.change[:2], [0.5, 0.8], atol=1e-12)
    assert_close(found.missing, [1 / 3, 0.0, 1.0], atol=1e-12)
    assert np.isnan(found.span[2])
    assert_close(quality.air_effect_m(-1e-6, 0.5, -1e-3), 0.501e-6, atol=1e-15)


def test_units_of_the_surroundings() -> None:
    assert list(quality.temperatures_out_of_reach([20.0, 293.0, np.nan, 68.0]).where) == [1, 3]
    assert list(quality.pressures_out_of_reach([101325.0, 1013.25, 760.0]).where) == [1, 2]
