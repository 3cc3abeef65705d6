"""Quadrature signals: ellipse fit and counted fringes, each with the stated uncertainty."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.tolerance import assert_between, assert_close
from truing.estimation.interferometry.quadrature import (
    EllipseStatus,
    corrected_phase,
    count_fringes,
    fit_ellipse,
    length_from_phase,
    length_per_turn,
    misstep_probability,
    phase_sigma,
    residual_radius,
    traced_arc,
    uncorrected_error,
)

TRUE = np.array([30.0, -12.0, 500.0, 430.0, 0.12])
SIGMA = 2.5
WAVELENGTH_M = 632.990577e-9
TURN = 2.0 * np.pi


def signals(phase: NDArray, values: NDArray = TRUE) -> NDArray:
    x0, y0, a, b, lag = values
    return np.stack([x0 + a * np.cos(phase), y0 + b * np.sin(phase + lag)], -1)


def noisy(seed: int, degrees: float, channels: int = 60, samples: int = 300) -> tuple[NDArray, NDArray]:
    rng = np.random.default_rng(seed)
    start = rng.uniform(0.0, 2.0 * np.pi, (channels, 1))
    phase = start + rng.uniform(0.0, np.radians(degrees), (channels, samples))
    return phase, signals(phase) + SIGMA * rng.standard_normal((channels, samples, 2))


def apart(found: NDArray, expected: NDArray) -> NDArray:
    return np.angle(np.exp(1j * (found - expected)))


@given(
    st.tuples(
        st.floats(-300, 300), st.floats(-300, 300), st.floats(100, 900), st.floats(100, 900), st.floats(-0.6, 0.6)
    ),
    st.integers(0, 2**31),
)
def test_without_noise_the_ellipse_and_the_phase_are_exact(shape: tuple[float, ...], seed: int) -> None:
    values = np.array(shape)
    phase = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, 40)
    fit = fit_ellipse(signals(phase, values))
    assert fit.ok.all()
    assert_close(fit.values[0], values, atol=1e-7)
    assert_close(apart(corrected_phase(signals(phase, values), fit.values[0]), phase), np.zeros(40), atol=1e-9)
    assert_close(residual_radius(signals(phase, values)[None], fit.values), [0.0], atol=1e-7)


@pytest.mark.slow
@given(st.floats(0.2, 5.0), st.tuples(st.floats(-500, 500), st.floats(-500, 500)), st.integers(0, 2**31))
def test_phases_do_not_know_the_gain_and_the_offsets(gain: float, offset: tuple[float, float], seed: int) -> None:
    _, seen = noisy(seed, 300.0, channels=1, samples=50)
    moved = gain * seen + np.array(offset)
    first, second = fit_ellipse(seen), fit_ellipse(moved)
    shift = apart(corrected_phase(moved, second.values), corrected_phase(seen, first.values))
    assert_close(shift, np.zeros_like(shift), atol=1e-7)
    assert_close(second.sigma, gain * first.sigma, atol=1e-7 * gain)


def test_signals_exchanged_turn_the_other_way() -> None:
    """The leading signal is a convention: after an exchange the phase is pi/2 minus itself, and the lag changes its
    sign."""
    phase, seen = noisy(5, 360.0, channels=3)
    first, second = fit_ellipse(seen), fit_ellipse(seen[..., ::-1])
    assert_close(second.values, first.values[:, [1, 0, 3, 2, 4]], atol=1e-5)
    turned = np.pi / 2.0 - first.values[:, 4:] - corrected_phase(seen, first.values)
    off = apart(corrected_phase(seen[..., ::-1], second.values), turned)
    assert_close(off, np.zeros_like(phase), atol=1e-7)


@given(st.integers(0, 2**31))
def test_the_phase_sigma_follows_the_covariance_of_the_ellipse(seed: int) -> None:
    """A covariance of one direction alone: the phase's sigma is how far it moves along it, and noise adds its own."""
    rng = np.random.default_rng(seed)
    along = rng.standard_normal(5) * [5.0, 5.0, 5.0, 5.0, 0.01]
    phase = rng.uniform(0.0, 2.0 * np.pi, 20)
    step = 1e-5
    ends = [corrected_phase(signals(phase), TRUE + way * step * along) for way in (1.0, -1.0)]
    moved = np.abs(apart(ends[0], ends[1])) / (2.0 * step)
    fit = replace(fit_ellipse(signals(phase)), covariance=np.outer(along, along)[None], sigma=np.zeros(1))
    assert_close(phase_sigma(fit, phase[None])[0], moved, atol=1e-8)
    noise = rng.standard_normal()
    shifted = [corrected_phase(signals(phase) + way * step * np.eye(2)[k], TRUE) for k in (0, 1) for way in (1.0, -1.0)]
    slopes = [apart(shifted[2 * k], shifted[2 * k + 1]) / (2.0 * step) for k in (0, 1)]
    alone = replace(fit, covariance=np.zeros((1, 5, 5)), sigma=np.abs([noise]))
    assert_close(phase_sigma(alone, phase[None])[0], np.abs(noise) * np.hypot(*slopes), atol=1e-8)


@pytest.mark.parametrize("degrees", [360.0, 180.0, 150.0])
def test_errors_are_those_that_the_covariance_states(degrees: float) -> None:
    phase, seen = noisy(round(degrees), degrees)
    fit = fit_ellipse(seen)
    assert fit.ok.all()
    z = (fit.values - TRUE) / np.sqrt(np.einsum("bii->bi", fit.covariance))
    for k in range(5):
        assert_between(float((z[:, k] ** 2).sum()), 60 - 4 * np.sqrt(120), 60 + 4 * np.sqrt(120), what=f"parameter {k}")
    freedom = 60 * 295
    assert_between(float((fit.sigma**2).mean() / SIGMA**2), *(1 + s * 4 * np.sqrt(2 / freedom) for s in (-1, 1)))
    off = apart(corrected_phase(seen, fit.values), phase) / phase_sigma(fit, phase)
    # the 300 phases of a channel share the errors of its ellipse: only the channels are independent
    assert_between(float((off**2).mean()), 1 - 4 * np.sqrt(2 / 60), 1 + 4 * np.sqrt(2 / 60))


def test_a_short_arc_says_so_before_it_misleads() -> None:
    """From a third of a fringe the correction holds within its sigma; from a quarter on it is not given."""
    for degrees in (330.0, 120.0, 90.0, 45.0, 10.0):
        _, seen = noisy(7, degrees, channels=12)
        fit = fit_ellipse(seen)
        assert fit.ok.all() if degrees >= 120.0 else not fit.ok.any()
        if degrees >= 120.0:  # the widest of 300 gaps, and the noise at the ends
            assert_between(float(np.degrees(fit.arc).mean()), 0.97 * degrees, degrees + 1.5)
        assert (fit.phase_sigma[fit.ok] <= 0.05).all()
        if degrees < 120.0:
            assert set(fit.status) <= {EllipseStatus.SHORT_ARC, EllipseStatus.NO_ELLIPSE}
    assert "whole fringe" in EllipseStatus.SHORT_ARC.remedy


def test_points_in_one_place_and_on_a_line_are_no_ellipse() -> None:
    t = np.linspace(-1.0, 1.0, 50)
    line, still = np.stack([3.0 * t, 2.0 * t], -1), np.zeros((50, 2))
    assert not fit_ellipse(np.stack([line, still])).ok.any()


def test_few_samples_say_so() -> None:
    _, seen = noisy(4, 360.0, channels=2)
    kept = np.zeros(seen.shape[:2], bool)
    kept[0, :9] = kept[1, :40] = True
    assert list(fit_ellipse(seen, kept).status) == [EllipseStatus.FEW_SAMPLES, EllipseStatus.OK]
    assert "ten or more" in EllipseStatus.FEW_SAMPLES.remedy


def test_samples_left_out_and_missing_ones_take_no_part() -> None:
    _, seen = noisy(3, 360.0, channels=2)
    spoilt = seen.copy()
    spoilt[:, ::7] += 300.0
    spoilt[0, 1] = np.nan
    kept = np.ones(seen.shape[:2], bool)
    kept[:, ::7] = False
    kept[0, 1] = False
    fit, clean = fit_ellipse(spoilt, kept), fit_ellipse(seen, kept)
    assert_close(fit.values, clean.values, atol=1e-9)
    assert residual_radius(seen, fit.values, kept)[0] < 1.3 * SIGMA


def test_the_arctangent_alone_errs_as_heydemann_says() -> None:
    """An offset errs once a fringe by offset / amplitude, unequal gains twice by half their ratio less one."""
    phase = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    for values, size in (((5.0, 0, 500, 500, 0), 0.01), ((0, 0, 500.0, 490.0, 0), 0.0101), ((0, 0, 1, 1, 0.02), 0.01)):
        found = np.abs(uncorrected_error(np.array([values], float), phase)).max()
        assert_between(found, 0.97 * size, 1.03 * size)


def test_arc_is_a_turn_less_the_widest_gap() -> None:
    phase = np.radians([[350.0, 10.0, 30.0, 355.0], [0.0, 90.0, 180.0, 270.0], [1.0, 2.0, 3.0, 4.0]])
    used = np.array([[True] * 4, [True] * 4, [False] * 4])
    assert_close(np.degrees(traced_arc(phase, used)), [40.0, 270.0, 0.0], atol=1e-9)


def within_a_turn(phase: np.ndarray) -> np.ndarray:
    return np.angle(np.exp(1j * phase))


@given(st.lists(st.floats(-2.5, 2.5), min_size=3, max_size=60), st.floats(-10.0, 10.0), st.booleans())
def test_known_lengths_are_recovered_below_half_a_turn_per_step(
    steps: list[float], start: float, reverse: bool
) -> None:
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


def test_with_little_noise_every_fringe_count_is_right_and_none_doubtful() -> None:
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
