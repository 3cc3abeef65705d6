"""Fringes counted up to the limit that noise sets, and slips found with their count."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.tolerance import assert_between, assert_close
from truing.estimation.interferometry.quadrature import (
    count_fringes,
    find_jump,
    find_slips,
    length_from_phase,
    length_per_turn,
    misstep_probability,
)

WAVELENGTH_M = 632.990577e-9
TURN = 2.0 * np.pi


def within_a_turn(phase: np.ndarray) -> np.ndarray:
    return np.angle(np.exp(1j * phase))


@given(st.lists(st.floats(-2.5, 2.5), min_size=3, max_size=60), st.floats(-10.0, 10.0), st.booleans())
def test_known_lengths_come_back_below_half_a_turn_a_step(steps: list[float], start: float, reverse: bool) -> None:
    true = start + np.cumsum(steps) * (-1.0 if reverse else 1.0)
    count = count_fringes(within_a_turn(true), 1e-3)
    assert_close(np.diff(count.phase), np.diff(true), atol=1e-9)
    assert not count.doubtful.any()
    length = length_from_phase(count.phase, WAVELENGTH_M)
    assert_close(np.diff(length), np.diff(true) / TURN * WAVELENGTH_M / 2.0, atol=1e-18)


@given(st.floats(-2.0, 2.0), st.floats(-1.5, 1.5))
def test_steady_motion_is_followed_beyond_half_a_turn(first: float, gain: float) -> None:
    """Whole turns a step, reached by changes of less than half a turn."""
    step = first + gain * np.arange(40)
    true = np.concatenate([[0.3], 0.3 + np.cumsum(step)])
    assert_close(np.diff(count_fringes(within_a_turn(true), 1e-3, steady=True).phase), step, atol=1e-8)


@pytest.mark.parametrize(("step", "sigma"), [(2.2, 0.4), (0.0, 1.2), (2.9, 0.3)])
def test_steps_go_wrong_as_often_as_noise_makes_them(step: float, sigma: float) -> None:
    rng = np.random.default_rng(11)
    n = 20000
    seen = np.stack([np.zeros(n), np.full(n, step)], -1) + sigma * rng.standard_normal((n, 2))
    found = count_fringes(within_a_turn(seen), sigma)
    wrong = np.abs(np.diff(found.phase) - np.diff(seen))[:, 0] > np.pi
    probability = float(misstep_probability(step, sigma))
    spread = 4.0 * np.sqrt(n * probability * (1.0 - probability))
    assert_between(float(wrong.sum()), n * probability - spread, n * probability + spread)
    assert found.doubtful[wrong, 1].mean() > 0.99


@pytest.mark.parametrize("steady", [False, True])
def test_the_risk_is_the_share_that_goes_wrong(steady: bool) -> None:
    """All steps, or changes of the step, up to half a turn are as likely."""
    rng = np.random.default_rng(12)
    sigma, n = 0.2, 40000
    last = rng.uniform(-np.pi, np.pi, n)
    true = np.stack([np.zeros(n), np.full(n, 0.4), 0.8 + last], -1) if steady else np.stack([np.zeros(n), last], -1)
    seen = true + sigma * rng.standard_normal(true.shape)
    found = count_fringes(within_a_turn(seen), sigma, steady=steady)
    wrong = np.abs(np.diff(found.phase) - np.diff(seen))[:, -1] > np.pi
    risk = found.risk[:, -1]
    for low, high in ((1e-3, 0.05), (0.05, 0.3), (0.3, 0.5)):
        some = (risk > low) & (risk <= high)
        spread = 4.0 * np.sqrt((risk[some] * (1.0 - risk[some])).sum())
        expected = risk[some].sum()
        assert_between(float(wrong[some].sum()), expected - spread, expected + spread)


def test_where_no_noise_is_left_every_count_is_right_and_none_doubtful() -> None:
    rng = np.random.default_rng(3)
    sigma, step = 0.1, 2.0
    assert float(misstep_probability(step, sigma)) < 1e-6
    true = np.cumsum(np.full((200, 100), step), axis=1)
    found = count_fringes(within_a_turn(true + sigma * rng.standard_normal(true.shape)), sigma)
    turns = np.round((found.phase - true) / TURN)
    assert (turns == turns[:, :1]).all()
    assert not found.doubtful.any()


def test_a_beam_that_was_broken_loses_the_count() -> None:
    phase = np.linspace(0.0, 9.0, 30)
    phase[11] = np.nan
    for steady in (False, True):
        found = count_fringes(within_a_turn(phase), 0.01, steady=steady)
        assert np.isfinite(found.phase[:11]).all()
        assert np.isnan(found.phase[11:]).all()
        assert found.doubtful[11]


def test_a_turn_is_half_a_wavelength_in_air() -> None:
    assert_close(length_per_turn(WAVELENGTH_M, 1.00027), WAVELENGTH_M / 1.00027 / 2.0, atol=1e-20)
    assert_close(length_per_turn(WAVELENGTH_M, passes=4), WAVELENGTH_M / 4.0, atol=1e-20)


QUANTUM = WAVELENGTH_M / 2.0
LOADS = np.concatenate([np.linspace(0, 9, 10), np.linspace(8, -9, 18), np.linspace(-8, 0, 9)])
DESIGN = np.stack([np.ones_like(LOADS), LOADS], -1)


def logs(seed: int, sigma: float, runs: int = 200) -> np.ndarray:
    noise = sigma * np.random.default_rng(seed).standard_normal((runs, len(LOADS)))
    return 2e-4 * LOADS + 3e-6 + noise


def test_a_slip_is_found_with_its_count_and_place() -> None:
    values = logs(1, 0.02e-6)
    counts = np.random.default_rng(2).choice([-3, -1, 1, 2], len(values))
    onsets = np.random.default_rng(3).integers(4, len(LOADS) - 4, len(values))
    slipped = values + QUANTUM * counts[:, None] * (np.arange(len(LOADS)) >= onsets[:, None])
    found = find_slips(slipped, 0.02e-6, DESIGN, QUANTUM)
    assert (found.count == counts).all()
    assert (found.onset == onsets).all()
    assert (found.detectable == 1).all()


def test_slips_are_seen_in_noise_no_more_often_than_stated() -> None:
    found = find_slips(logs(4, 0.3e-6), 0.3e-6, DESIGN, QUANTUM, false_alarm=0.05)
    assert (found.p_value <= 0.05).sum() <= 200 * 0.05 + 4 * np.sqrt(200 * 0.05)


def test_what_noise_hides_is_said_in_fringes() -> None:
    """With the noise of the format's example one fringe is lost in it, and the log says which count would show."""
    sigma = 0.5e-6
    detectable = int(find_slips(logs(5, sigma), sigma, DESIGN, QUANTUM).detectable[0])
    assert detectable > 1
    jump = QUANTUM * detectable * (np.arange(len(LOADS)) >= 18)
    hits = (find_slips(logs(6, sigma) + jump, sigma, DESIGN, QUANTUM).p_value <= 0.01).mean()
    assert_between(float(hits), 0.4, 0.999)


def test_a_jump_that_is_no_whole_number_is_no_slip() -> None:
    jump = 0.5 * QUANTUM * (np.arange(len(LOADS)) >= 18)
    values = logs(7, 0.01e-6) + jump
    assert (find_slips(values, 0.01e-6, DESIGN, QUANTUM).count == 0).all()
    found = find_jump(values, 0.01e-6, DESIGN)
    assert (found.p_value < 1e-6).all()
    assert_between(float((((found.size - 0.5 * QUANTUM) / found.sigma) ** 2).mean()), 0.6, 1.4)
    assert_close(np.nanstd(found.left), 0.01e-6, atol=0.001e-6)


def test_missing_readings_and_series_without_room_are_no_jumps() -> None:
    values = logs(8, 0.05e-6, runs=3)
    values[0, 5:9] = np.nan
    values[1, 2:] = np.nan
    found = find_jump(values, 0.05e-6, DESIGN)
    assert found.p_value[1] == 1.0
    assert np.isinf(found.sigma[1])
    assert np.isnan(found.left[0, 5:9]).all()
