"""Sensor calibrations recover the truth within their covariance, are independent of units, and report missing data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.estimation.sensor.toy_sensor import RANGE, ToySensor, loads, sensor, squares
from tests.tolerance import assert_between, assert_close
from truing.estimation.sensor.calibrate import UndeterminedCalibrationError, fit_calibration
from truing.estimation.sensor.calibration import CalibrationModel, calibration_matrix
from truing.estimation.sensor.load_table import load_table

seeds = st.integers(0, 2**32 - 1)
BOTH = CalibrationModel("errors in both")
DRAWS = 20


def _made(seed, channels=6, **noise):
    rng = np.random.default_rng(seed)
    toy = sensor(rng, channels, **noise)
    applied, case = loads(rng)
    return rng, toy, applied, case


def test_least_squares_is_the_printed_formula():
    rng, toy, applied, case = _made(0)
    table = toy.table(rng, applied, case)
    V, F = table.signals.T, table.loads.T
    found = fit_calibration(table)
    printed = F @ V.T @ np.linalg.inv(V @ V.T)
    assert_close(found.matrix / RANGE[:, None], printed / RANGE[:, None], atol=1e-12)


@pytest.mark.parametrize(
    ("model", "noise"),
    [
        (CalibrationModel(), {"signal": 1e-9}),
        (CalibrationModel("weighted"), {"signal": 1e-9}),
        (CalibrationModel("weighted", "forward"), {"load": 1e-12}),
        (BOTH, {}),
        (replace(BOTH, direction="forward"), {}),
        (replace(BOTH, zero="common"), {}),
        (replace(BOTH, zero="case"), {}),
    ],
    ids=lambda value: value.name if isinstance(value, CalibrationModel) else "",
)
def test_the_matrix_is_recovered_within_its_covariance(model, noise):
    total = 0.0
    for seed in range(DRAWS):
        rng, toy, applied, case = _made(seed, **noise)
        more = {"none": 0.0, "common": rng.normal(size=6), "case": rng.normal(size=(24, 6))[case]}[model.zero]
        found = calibration_matrix(fit_calibration(toy.table(rng, applied, case, more), model))
        total += squares(found.value - np.linalg.inv(toy.A), found.covariance)
    # a sum of chi-squares of 36 degrees of freedom; least squares knows its noise from 114 rows only
    mean, spread = 36 * DRAWS * (114 / 112 if model.estimator == "least squares" else 1.0), np.sqrt(2 * 36 * DRAWS)
    assert_between(total, mean - 4 * spread, mean + 4 * spread, what="squared error in sigmas")


def test_noise_is_found_as_declared():
    total, freedom = 0.0, 0.0
    for seed in range(DRAWS):
        rng, toy, applied, case = _made(seed)
        found = fit_calibration(toy.table(rng, applied, case), BOTH)
        total, freedom = total + found.chi_square, freedom + found.dof
    assert_between(total / freedom, *(1 + np.array([-4, 4]) * np.sqrt(2 / freedom)), what="chi-square over freedom")


def test_noise_in_the_signals_pulls_least_squares_towards_zero_and_errors_in_both_not():
    """By G C (V V^T / N + C)^-1, C the covariance of one row's signals: the classical attenuation."""
    plain, both = np.zeros((6, 6)), np.zeros((6, 6))
    rng, toy, applied, case = _made(3, signal=0.5)
    true = applied @ toy.A.T
    G = np.linalg.inv(toy.A)
    expected = -G @ toy.signal_cov @ np.linalg.inv(true.T @ true / len(true) + toy.signal_cov)
    error = 0.0
    for _ in range(DRAWS):
        table = toy.table(rng, applied, case)
        plain += (fit_calibration(table).matrix - G) / DRAWS
        found = fit_calibration(table, BOTH)
        both += (found.matrix - G) / DRAWS
        error = found.sigma / np.sqrt(DRAWS)
    assert np.all(np.abs(plain - expected) < 5 * error)
    assert np.all(np.abs(both) < 5 * error)
    assert np.abs(expected / error).max() > 7  # so the first two lines are no matter of course


@given(seeds)
@settings(max_examples=10)
def test_with_errors_in_both_the_two_directions_are_one(seed):
    rng, toy, applied, case = _made(seed)
    table = toy.table(rng, applied, case)
    direct = calibration_matrix(fit_calibration(table, BOTH))
    forward = calibration_matrix(fit_calibration(table, replace(BOTH, direction="forward")))
    assert np.max(np.abs(direct.value - forward.value) / direct.sigma) < 1e-3  # both settle to 1e-5 of a sigma
    assert_close(forward.sigma / direct.sigma, np.ones((6, 6)), atol=1e-4)


@given(seeds, st.floats(1e-3, 1e3), st.floats(1e-3, 1e3), st.sampled_from([CalibrationModel(), BOTH]))
@settings(max_examples=10)
def test_results_are_independent_of_units(seed, unit_of_signals, unit_of_loads, model):
    rng, toy, applied, case = _made(seed)
    table = toy.table(rng, applied, case)
    other = load_table(
        table.signals * unit_of_signals,
        table.loads * unit_of_loads,
        case,
        signal_cov=toy.signal_cov * unit_of_signals**2,
        load_cov=toy.load_cov * unit_of_loads**2,
    )
    one, two = fit_calibration(table, model), fit_calibration(other, model)
    factor = unit_of_loads / unit_of_signals
    assert np.max(np.abs(two.matrix / factor - one.matrix) / one.sigma) < 1e-4
    assert_close(two.sigma / factor / one.sigma, np.ones((6, 6)), atol=1e-5)


@given(seeds)
@settings(max_examples=10)
def test_mixing_the_channels_mixes_the_columns_back(seed):
    rng, toy, applied, case = _made(seed)
    table = toy.table(rng, applied, case)
    mix = np.linalg.qr(rng.normal(size=(6, 6)))[0] @ np.diag(rng.uniform(0.5, 2.0, 6))
    mixed = replace(table, signals=table.signals @ mix.T, signal_cov=mix @ toy.signal_cov @ mix.T)
    for model in (CalibrationModel(), BOTH):
        one, two = fit_calibration(table, model), fit_calibration(mixed, model)
        assert np.max(np.abs(two.matrix @ mix - one.matrix) / one.sigma) < 1e-3


def test_weights_distinguish_sure_rows_from_unsure_ones():
    ratio = 0.0
    for seed in range(DRAWS):
        rng, toy, applied, case = _made(seed, signal=1e-9)
        size = np.where(case % 2, 10.0, 1.0)
        cov = size[:, None, None] ** 2 * toy.load_cov
        table = toy.table(rng, applied, case)
        noisy = applied + (table.loads - applied) * size[:, None]
        uneven = replace(table, loads=noisy, load_cov=cov)
        error = [
            fit_calibration(uneven, CalibrationModel(e)).matrix - np.linalg.inv(toy.A)
            for e in ("weighted", "least squares")
        ]
        ratio += np.log(np.sum((error[0] / RANGE[:, None]) ** 2) / np.sum((error[1] / RANGE[:, None]) ** 2)) / DRAWS
    # variances 1/(60 + 60/100) against (60 + 60 100)/120^2 of the same design: a factor of 25
    assert_between(np.exp(ratio), 1 / 40, 1 / 15, what="squared error, weighted over plain")


def test_temperature_is_distinguished_from_load_where_it_is_a_term():
    total = 0.0
    for seed in range(DRAWS):
        rng, toy, applied, case = _made(seed)
        warm = rng.uniform(-3.0, 3.0, len(applied))
        gain, drift = 1e-3 * rng.normal(size=6), 0.05 * rng.normal(size=6)
        more = warm[:, None] * (applied @ toy.A.T * gain + drift)
        table = replace(toy.table(rng, applied, case, more), covariates=warm[:, None], covariate_names=("dT",))
        found = fit_calibration(table, replace(BOTH, direction="forward", drift=True, gain=True))
        truth = np.concatenate([toy.A, drift[:, None], toy.A * gain[:, None]], axis=1)
        assert found.terms.labels[6:8] == ("dT", "dT fx")
        total += squares(found.matrix - truth, found.covariance)
    count = 6 * 13 * DRAWS
    assert_between(total, count - 4 * np.sqrt(2 * count), count + 4 * np.sqrt(2 * count), what="squared error")


def test_a_prior_leads_from_no_term_to_all_of_it():
    rng, toy, applied, case = _made(1)
    table = toy.table(rng, applied, case)
    squared = replace(BOTH, powers="squares", direction="forward")
    free, tight, linear = (
        fit_calibration(table, model)
        for model in (squared, replace(squared, shrink=1e-9), replace(squared, powers="linear"))
    )
    loose = fit_calibration(table, replace(squared, shrink=1e6))
    assert np.max(np.abs(loose.matrix - free.matrix) / free.sigma) < 1e-3
    assert np.max(np.abs(tight.matrix[:, :6] - linear.matrix) / linear.sigma) < 1e-3


def test_a_ridge_takes_the_shortest_way_through_channels_that_repeat_one_another():
    rng, toy, applied, case = _made(2)
    table = toy.table(rng, applied, case)
    doubled = load_table(np.concatenate([table.signals] * 2, axis=1), table.loads, case)
    found = fit_calibration(doubled, CalibrationModel(ridge=100.0)).matrix
    assert_close(found[:, :6] / RANGE[:, None], found[:, 6:] / RANGE[:, None], atol=1e-8)
    alone = fit_calibration(table).matrix
    assert_close((found[:, :6] + found[:, 6:]) / RANGE[:, None], alone / RANGE[:, None], atol=1e-4)


def test_eight_channels_are_calibrated_forwards():
    total = 0.0
    for seed in range(DRAWS):
        rng, toy, applied, case = _made(seed, channels=8)
        table = toy.table(rng, applied, case)
        found = fit_calibration(table, replace(BOTH, direction="forward"))
        total += squares(found.matrix - toy.A, found.covariance)
    count = 48 * DRAWS
    assert_between(total, count - 4 * np.sqrt(2 * count), count + 4 * np.sqrt(2 * count), what="squared error")


def _table(change=lambda loads: loads, channels=lambda signals: signals, noise=False):
    rng, toy, applied, case = _made(5)
    applied = change(applied)
    signals = channels(applied @ toy.A.T)
    cov = np.eye(signals.shape[1]) * 0.02**2
    signals = signals + rng.normal(size=signals.shape) * 0.02 * noise
    return load_table(signals, applied, case, signal_cov=cov if noise else None)


def _never(axis):
    return lambda loads: loads * (np.arange(6) != axis)


def _with_arm(loads):
    loads = loads.copy()
    loads[:, 3] = -0.15 * loads[:, 1]
    return loads


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (_table(_never(5)), "mz is zero in all rows; apply loads"),
        (_table(_with_arm), "only fy .* mx is determined"),
        (_table(channels=lambda v: np.column_stack([v, v[:, 2]])), "only v3 . v7 is determined"),
        (_table(channels=lambda v: v * (np.arange(6) != 3)), "V V.T is singular.*v4 is zero in all rows"),
        (_table(channels=lambda v: v[:, :5] @ np.eye(5, 6)), "v6 is zero in all rows"),
        (_table(channels=lambda v: np.column_stack([v, v[:, :2]]), noise=True), "6 independent signals in 8 channels"),
        (_table().rows(np.arange(6)), "6 rows for 6 terms"),
    ],
)
def test_missing_inputs_are_named(table, words):
    with pytest.raises(UndeterminedCalibrationError, match=words):
        fit_calibration(table)


@pytest.mark.parametrize(
    ("model", "words"),
    [
        (CalibrationModel("weighted"), "covariance of the loads"),
        (CalibrationModel("weighted", "forward"), "covariance of the signals"),
        (CalibrationModel(drift=True), "needs a covariate"),
    ],
)
def test_an_estimator_without_its_inputs_is_refused_by_name(model, words):
    with pytest.raises(ValueError, match=words):
        fit_calibration(_table(), model)


def test_bad_tables_are_refused():
    rng = np.random.default_rng(0)
    values = rng.normal(size=(20, 6))
    hole = values.copy()
    hole[[3, 17], 2] = np.nan
    with pytest.raises(ValueError, match=r"loads: found no value in 2 rows \(from 0: 3, 17\)"):
        load_table(values, hole)
    with pytest.raises(ValueError, match="signal 'v1' twice"):
        load_table(values, values).named(["v1"] * 6)
    with pytest.raises(ValueError, match="19 of loads"):
        load_table(values, values[1:])
    with pytest.raises(ValueError, match=r"signal_cov: found shape \(5, 5\)"):
        load_table(values, values, signal_cov=np.eye(5))


def test_loads_that_are_exactly_known_may_be_fitted_with_errors_in_both():
    rng, toy, applied, case = _made(7, load=0.0)
    exact = ToySensor(toy.A, toy.signal_sigma, np.zeros(6))
    table = exact.table(rng, applied, case)
    both = calibration_matrix(fit_calibration(table, BOTH))
    forward = calibration_matrix(fit_calibration(table, CalibrationModel("weighted", "forward")), toy.signal_cov)
    assert np.max(np.abs(both.value - forward.value) / both.sigma) < 1e-3
    with pytest.raises(ValueError, match="exactly known"):
        fit_calibration(table, CalibrationModel("weighted"))


def test_signals_that_are_exactly_known_are_no_noise():
    rng, toy, applied, case = _made(8, signal=0.0)
    found = fit_calibration(toy.table(rng, applied, case), BOTH)
    plain = fit_calibration(toy.table(rng, applied, case), CalibrationModel("weighted"))
    assert_close(found.sigma / plain.sigma, np.ones((6, 6)), atol=1e-9)
