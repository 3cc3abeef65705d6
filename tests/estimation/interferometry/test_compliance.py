"""Compliance from logs against the simulated one: unbiased, with correct uncertainty, and no false differences."""

from __future__ import annotations

import numpy as np
import pytest

from tests.estimation.interferometry.bench import ALL_PAIRS, LEVELS, OWN_PAIRS, Log, made_compliance, made_log
from tests.tolerance import assert_between, assert_close
from truing.estimation.interferometry.compliance import (
    Compliance,
    compare,
    fit_compliance,
    left_out_runs,
)
from truing.estimation.interferometry.platform_poses import drift_columns, platform_displacement, zero_columns
from truing.simulation.bench.six_upur.uncertain_sensor import compliance_covariance

TRUE = made_compliance()


def fitted(log: Log, **options: object) -> Compliance:
    return fit_compliance(log.wrench, log.displacement, log.covariance, log.run, **options)  # type: ignore[arg-type]


def test_all_entries_are_recovered_within_their_sigmas() -> None:
    """Every z of 36 entries over the seeds, and the joint chi-square, at the declared noise."""
    z, p = [], []
    for seed in range(12):
        found = compare(fitted(made_log(np.random.default_rng(seed), ALL_PAIRS)), TRUE)
        z.append(found.z.ravel())
        p.append(found.p_value)
        assert found.dof == 36
    total = float(np.sum(np.square(z)))
    assert_between(total, 432 - 4 * np.sqrt(864), 432 + 4 * np.sqrt(864))
    assert_between(float(np.mean(p)), 0.5 - 4 / np.sqrt(12 * 12), 0.5 + 4 / np.sqrt(12 * 12))


def test_entries_that_no_run_shows_are_unknown() -> None:
    found = fitted(made_log(np.random.default_rng(1), [*OWN_PAIRS, (2, 3)]))
    expected = np.eye(6, dtype=bool)
    expected[3, 2] = True
    assert (found.known == expected).all()
    assert (np.isnan(found.entries) == ~expected).all()
    assert (np.isinf(found.sigma) == ~expected).all()
    assert (np.isnan(compare(found, TRUE).z) == ~expected).all()
    assert compare(found, TRUE).dof == 7


def test_the_linear_model_holds_what_it_does_not_have_at_zero() -> None:
    found = fitted(made_log(np.random.default_rng(2), OWN_PAIRS), form="linear")
    off = ~np.eye(6, dtype=bool)
    assert found.known.all()
    assert (found.entries[off] == 0.0).all()
    assert (found.sigma[off] == 0.0).all()
    compared = compare(found, TRUE)
    assert compared.dof == 6
    assert np.isnan(compared.z[off]).all()


def test_loads_that_always_come_together_are_not_distinguished() -> None:
    """An eccentric load brings its moment along in proportion: their two columns are unknown, the others are not."""
    log = made_log(np.random.default_rng(3), [(2, c) for c in range(6)] + [(0, c) for c in range(6)])
    wrench = log.wrench.copy()
    wrench[:, 3] = 0.01 * wrench[:, 2]
    found = fit_compliance(wrench, log.displacement, log.covariance, log.run)
    assert found.known[:, 0].all()
    assert not found.known[:, [1, 2, 3, 4, 5]].any()


def test_drift_next_to_the_load_is_taken_out_of_the_compliance() -> None:
    """Drifts of some sigmas over a run bias entries that are fitted without them, and not those fitted with them."""
    squares, plain = 0.0, 0.0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        log = made_log(rng, [*OWN_PAIRS, (2, 3)])
        time = 60.0 * (log.step - 1.0)
        rate = 3e-9 * rng.standard_normal(7)[log.run]
        log.reading[:] += rate * time
        with_drift = fitted(log, beside=drift_columns(log.run, time))
        assert with_drift.known.sum() == 7
        squares += compare(with_drift, TRUE).chi_square
        plain += compare(fitted(log), TRUE).chi_square
    assert_between(squares, 42 - 4 * np.sqrt(84), 42 + 4 * np.sqrt(84))
    assert plain > 42 + 4 * np.sqrt(84)
    with pytest.raises(ValueError, match="matrix model"):
        fitted(log, form="linear", beside=drift_columns(log.run, time))


def test_a_regressor_proportional_to_a_load_leaves_its_compliance_unknown() -> None:
    log = made_log(np.random.default_rng(9), OWN_PAIRS)
    found = fitted(log, beside=log.wrench[:, 2:3] * 1e-4)
    assert not found.known[:, 2].any()
    assert list(np.flatnonzero(found.known.ravel())) == [0, 7, 21, 28, 35]


def test_a_zero_that_is_known_shows_what_a_free_one_does_not() -> None:
    log = made_log(np.random.default_rng(4), [(2, 2)])
    held = LEVELS == 9e3
    part = (log.wrench[held], log.displacement[held], log.covariance[held], log.run[held])
    zero = np.diag([0.5e-6] * 3 + [1e-6] * 3) ** 2
    assert not fit_compliance(*part).known.any()
    known = fit_compliance(*part, zero_covariance=zero)
    assert known.known.sum() == 1
    assert abs(compare(known, TRUE).z[2, 2]) < 4.0


def test_the_way_by_six_components_is_the_same_as_by_channels() -> None:
    """Joined to platform displacements first, readings give the same compliance, zeros and all."""
    log = made_log(np.random.default_rng(5), ALL_PAIRS)
    case = log.axis * len(LEVELS) + log.step - 1
    sigma = np.array([0.5e-6] * 3 + [1e-6] * 3)
    zeros = zero_columns(log.run)
    joined = platform_displacement(np.eye(6)[log.channel], log.reading, log.sigma, case, zeros, log.sigma[::21])
    wrench = np.zeros((len(joined.value), 6))
    wrench[case] = log.wrench
    own = joined.covariance - np.stack([joined.between(k, k) for k in range(len(joined.value))])
    axis = np.repeat(np.arange(6), len(LEVELS))
    by_case = fit_compliance(wrench, joined.value, own, axis, zero_covariance=np.diag(sigma**2))
    by_channel = fitted(log, zero_covariance=np.diag(sigma**2))
    assert_close(by_case.entries / by_channel.sigma, by_channel.entries / by_channel.sigma, atol=1e-6)
    assert_close(by_case.sigma / by_channel.sigma, np.ones((6, 6)), atol=1e-6)


def test_a_stiffer_axis_is_seen_and_a_simulation_that_is_unsure_explains_it() -> None:
    changed = TRUE * 0.97
    found = fitted(made_log(np.random.default_rng(6), ALL_PAIRS, changed))
    assert compare(found, TRUE).p_value < 1e-9
    assert_close(np.diag(compare(found, TRUE).ratio), np.full(6, 0.97), atol=2e-3)
    unsure = compare(found, TRUE, compliance_covariance(-TRUE[None], 0.03))
    assert unsure.p_value > 1e-3
    assert_between(abs(unsure.z[0, 0]), 0.8, 1.2)
    one_axis = TRUE.copy()
    one_axis[2, 2] *= 0.8
    found = fitted(made_log(np.random.default_rng(7), ALL_PAIRS, one_axis))
    compared = compare(found, TRUE, compliance_covariance(-TRUE[None], 0.03))
    assert compared.p_value < 1e-9
    assert np.nanargmax(np.abs(compare(found, TRUE).z)) == 14


def test_runs_are_predicted_by_the_others_where_these_show_what_is_asked() -> None:
    """Each pair of axis and channel is run three times: left out in turn, by refitting, and in one go."""
    log = made_log(np.random.default_rng(10), [pair for pair in OWN_PAIRS for _ in range(3)])
    variance = np.where(np.isfinite(log.displacement), log.sigma[:, None] ** 2, np.inf)
    left = left_out_runs(log.wrench, log.displacement, variance, log.run)
    for run in (0, 7, 17):
        out = log.run == run
        others = fit_compliance(*(part[~out] for part in (log.wrench, log.displacement, log.covariance, log.run)))
        k = log.channel[out][0]
        missed = log.reading[out] - log.wrench[out][:, k] * others.entries[k, k]
        assert_close(left[out, k] / log.sigma[out], (missed - missed.mean()) / log.sigma[out], atol=1e-6)
    alone = made_log(np.random.default_rng(10), OWN_PAIRS)
    variance = np.where(np.isfinite(alone.displacement), 1.0, np.inf)
    assert np.isnan(left_out_runs(alone.wrench, alone.displacement, variance, alone.run)).all()
