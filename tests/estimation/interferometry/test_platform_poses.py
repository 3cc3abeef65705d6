"""Six components from single channels: measured values, their uncertainty, and unknown components."""

from __future__ import annotations

import numpy as np
import pytest

from tests.estimation.interferometry.bench import ALL_PAIRS, LEVELS, OWN_PAIRS, Log, made_log
from tests.tolerance import assert_between, assert_close
from truing.estimation.interferometry.platform_poses import (
    PlatformDisplacement,
    drift_columns,
    platform_displacement,
    zero_columns,
)
from truing.estimation.interferometry.recorded_steps import angular_rows, linear_rows


def joined(log: Log, rows: np.ndarray | None = None) -> PlatformDisplacement:
    """Cases: a step of an axis, in whichever run; zeros: one per run."""
    rows = np.eye(6)[log.channel] if rows is None else rows
    case = log.axis * len(LEVELS) + log.step - 1
    return platform_displacement(rows, log.reading, log.sigma, case, zero_columns(log.run), log.sigma[:: len(LEVELS)])


def test_errors_of_six_components_follow_their_covariance() -> None:
    total, freedom, off = 0.0, 0, []
    for seed in range(12):
        log = made_log(np.random.default_rng(seed), ALL_PAIRS)
        found = joined(log)
        assert found.known.all()
        error = found.value - _truth(log)
        off.append(np.einsum("ki,ki->k", error, np.linalg.solve(found.covariance, error[..., None])[..., 0]))
        total, freedom = total + found.chi_square, freedom + found.dof
    squares = np.array(off)
    # cases of an axis share their zeros, so the mean over the steps of an axis counts as one draw of six components
    by_axis = squares.reshape(12, 6, len(LEVELS)).mean(2)
    assert_between(float(by_axis.mean()), 6 - 4 * np.sqrt(12 / 72), 6 + 4 * np.sqrt(12 / 72))
    assert freedom == 0  # every reading is the only one of its component and case
    assert_close(total, 0.0, atol=1e-6)


def _truth(log: Log) -> np.ndarray:
    case = log.axis * len(LEVELS) + log.step - 1
    out = np.empty((case.max() + 1, 6))
    out[case] = log.truth
    return out


def test_channels_never_measured_stay_unknown() -> None:
    log = made_log(np.random.default_rng(1), OWN_PAIRS)
    found = joined(log)
    own = np.repeat(np.eye(6, dtype=bool), len(LEVELS), axis=0)
    assert (found.known == own).all()
    assert (np.isnan(found.value) == ~own).all()
    variance = np.einsum("kii->ki", found.covariance)
    assert (np.isinf(variance) == ~own).all()
    # a reading's own noise, and that of the zero it counts from
    assert_close(variance[own] / (2.0 * log.sigma**2), np.ones(own.sum()), atol=1e-9)
    assert (found.covariance[:, ~np.eye(6, dtype=bool)] == 0.0).all()


def test_cases_share_the_error_of_their_zero() -> None:
    found = joined(made_log(np.random.default_rng(2), OWN_PAIRS))
    same_axis, other_axis = found.between(3, 5), found.between(3, 30)
    assert_close(same_axis[0, 0], (0.5e-6) ** 2, atol=1e-18)
    assert_close(other_axis, np.zeros((6, 6)), atol=1e-30)


def test_beams_off_the_axes_are_resolved_and_one_alone_is_not() -> None:
    """Six beams with arms give six components; a linear beam with an arm and no angle gives none by itself."""
    rng = np.random.default_rng(3)
    beams = np.repeat(np.eye(3), 2, axis=0)
    arms = np.array([[0, 0.2, 0], [0, -0.2, 0], [0, 0, 0.2], [0, 0, -0.2], [0.2, 0, 0], [-0.2, 0, 0]])
    rows = linear_rows(beams, arms)
    truth = np.array([1e-4, -2e-4, 3e-5, 1e-4, 2e-4, -5e-5])
    errors = []
    for _ in range(300):
        zeros = 1e-6 * rng.standard_normal(6)
        reading = rows @ truth + zeros + 1e-6 * rng.standard_normal(6)
        found = platform_displacement(rows, reading, 1e-6, np.zeros(6, int), np.eye(6), 1e-6)
        assert found.known.all()
        error = found.value[0] - truth
        errors.append(error @ np.linalg.solve(found.covariance[0], error))
    assert_between(float(np.sum(errors)), 1800 - 4 * np.sqrt(3600), 1800 + 4 * np.sqrt(3600))
    alone = platform_displacement(rows[4:5], reading[4:5], 1e-6, np.zeros(1, int), np.ones((1, 1)), 1e-6)
    assert not alone.known[0, [2, 4]].any()
    with_angle = np.concatenate([rows[4:5], angular_rows([[0.0, 1.0, 0.0]])])
    both = platform_displacement(with_angle, reading[:2], 1e-6, np.zeros(2, int), np.eye(2), 1e-6)
    assert list(np.flatnonzero(both.known[0])) == [2, 4]


def test_readings_that_say_the_same_twice_are_averaged_and_assessed() -> None:
    rng = np.random.default_rng(4)
    chi_square, freedom, error = 0.0, 0, []
    for _ in range(200):
        zeros = 1e-6 * rng.standard_normal(2)
        reading = np.repeat(zeros, 8) + np.tile(np.arange(8) * 1e-5, 2) + 1e-6 * rng.standard_normal(16)
        case, zero = np.tile(np.arange(8), 2), np.repeat(np.arange(2), 8)
        rows = np.tile(np.eye(6)[2], (16, 1))
        found = platform_displacement(rows, reading, 1e-6, case, zero_columns(zero), 1e-6)
        chi_square, freedom = chi_square + found.chi_square, freedom + found.dof
        error.append((found.value[3, 2] - 3e-5) / np.sqrt(found.covariance[3, 2, 2]))
    assert freedom == 200 * 8
    assert_between(chi_square, freedom - 4 * np.sqrt(2 * freedom), freedom + 4 * np.sqrt(2 * freedom))
    assert_between(float(np.sum(np.square(error))), 200 - 80, 200 + 80)


def test_drifts_count_from_the_first_reading_of_their_run() -> None:
    found = drift_columns(np.array([0, 1, 0, 1, 1]), [100.0, 7.0, 130.0, 9.0, 5.0])
    assert_close(found, [[0, 0], [0, 2], [30, 0], [0, 4], [0, 0]], atol=0.0)


def test_drift_is_taken_out_where_loads_come_back_and_is_stated_where_they_do_not() -> None:
    """A load met on both ways is one case: its drift is found. A case of its own for every step leaves the drift to
    what is known of it, and nothing known is an error."""
    rng = np.random.default_rng(6)
    rate, time = 3e-9, 60.0 * np.arange(len(LEVELS))
    run, levels = np.zeros(len(LEVELS), int), np.unique(LEVELS, return_inverse=True)[1]
    shared = np.column_stack([zero_columns(run), drift_columns(run, time)])
    rows = np.tile(np.eye(6)[2], (len(LEVELS), 1))
    squares, of_rate = [], []
    for _ in range(200):
        zero = 0.5e-6 * rng.standard_normal()
        reading = 2e-10 * LEVELS + zero + rate * time + 0.5e-6 * rng.standard_normal(len(LEVELS))
        found = platform_displacement(rows, reading, 0.5e-6, levels, shared, [0.5e-6, np.inf])
        assert found.dof == len(LEVELS) - 11 - 1
        error = found.value[:, 2] - 2e-10 * np.unique(LEVELS)
        squares.append(error[7] ** 2 / found.covariance[7, 2, 2])
        of_rate.append((found.shared[1] - rate) ** 2 / found.shared_covariance[1, 1])
    for total in (sum(squares), sum(of_rate)):
        assert_between(total, 200 - 80, 200 + 80)
    each = np.arange(len(LEVELS))
    known = platform_displacement(rows, reading, 0.5e-6, each, shared, [0.5e-6, 5e-9])
    late = np.sqrt(known.covariance[-1, 2, 2])
    assert_close(late, np.sqrt(2 * 0.5e-6**2 + (5e-9 * time[-1]) ** 2), atol=1e-12)
    with pytest.raises(ValueError, match="finite shared_sigma"):
        platform_displacement(rows, reading, 0.5e-6, each, shared, [0.5e-6, np.inf])


def test_missing_readings_and_shapes() -> None:
    log = made_log(np.random.default_rng(5), [(2, 2)])
    log.reading[4] = np.nan
    case = log.step - 1
    found = platform_displacement(np.eye(6)[log.channel], log.reading, log.sigma, case, zero_columns(log.run), 0.5e-6)
    assert not found.known[4].any()
    with pytest.raises(ValueError, match=r"expected \(N, 6\)"):
        platform_displacement(np.eye(6)[:, :3], log.reading[:6], 1e-6, case[:6], zero_columns(log.run[:6]), 1e-6)
