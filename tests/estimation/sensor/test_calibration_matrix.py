"""The matrix from a forward fit propagates its errors, and wrenches scatter as stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.estimation.sensor.toy_sensor import RANGE, loads, sensor, squares
from tests.tolerance import assert_between, assert_close
from truing.estimation.sensor.calibrate import fit_calibration
from truing.estimation.sensor.calibration import CalibrationModel, UnreachedSignalsError, calibration_matrix, wrenches

FORWARD = CalibrationModel("errors in both", "forward")
STEP = 1e-30


def test_the_inverse_has_the_derivative_of_a_complex_step():
    rng = np.random.default_rng(0)
    toy = sensor(rng, channels=8)
    fit = fit_calibration(toy.table(rng, *loads(rng)), FORWARD)
    white = np.linalg.inv(toy.signal_cov)

    def inverse(A):
        return np.linalg.solve(A.T @ white @ A, A.T @ white)

    steps = np.eye(48).reshape(48, 8, 6)
    by = np.stack([inverse(fit.matrix + 1j * STEP * step).imag.ravel() / STEP for step in steps], axis=-1)
    found = calibration_matrix(fit, toy.signal_cov)
    size = np.sqrt(np.diag(found.covariance))
    expected = by @ fit.covariance @ by.T
    assert_close(found.value / RANGE[:, None], inverse(fit.matrix) / RANGE[:, None], atol=1e-12)
    assert_close(found.covariance / np.outer(size, size), expected / np.outer(size, size), atol=1e-9)


@pytest.mark.parametrize("channels", [6, 8])
@pytest.mark.parametrize("powers", ["linear", "squares"])
def test_wrenches_never_seen_before_scatter_as_they_say(channels, powers):
    total, rows = 0.0, 10
    for seed in range(20):
        rng = np.random.default_rng(seed)
        toy = sensor(rng, channels)
        bend = 0.02 * rng.normal(size=(channels, 6)) * 10.0 * (powers == "squares")
        applied, case = loads(rng)
        table = toy.table(rng, applied, case, (applied / RANGE) ** 2 @ bend.T)
        fit = fit_calibration(table, replace(FORWARD, powers=powers))
        fresh = rng.uniform(-1, 1, (rows, 6)) * RANGE
        signals = fresh @ toy.A.T + (fresh / RANGE) ** 2 @ bend.T + rng.normal(size=(rows, channels)) * toy.signal_sigma
        found = wrenches(fit, signals, np.empty((rows, 0)), toy.signal_cov)
        joint = found.joint.copy()
        joint[np.arange(rows), :, np.arange(rows)] += found.own
        total += squares(found.value - fresh, joint.reshape(6 * rows, -1))
        blocks = joint[np.arange(rows), :, np.arange(rows)]
        size = np.sqrt(np.einsum("nii->ni", blocks))
        assert_close(
            found.covariance / size[:, :, None] / size[:, None], blocks / size[:, :, None] / size[:, None], atol=1e-9
        )
    count = 6 * rows * 20
    assert_between(total, count - 4 * np.sqrt(2 * count), count + 4 * np.sqrt(2 * count), what="squared error")


def test_a_bent_sensor_is_inverted_exactly():
    rng = np.random.default_rng(4)
    toy = sensor(rng, channels=8)
    table = toy.table(rng, *loads(rng))
    fit = fit_calibration(table, replace(FORWARD, powers="products", zero="common"))
    fresh = rng.uniform(-1, 1, (10, 6)) * RANGE
    found = wrenches(fit, fit.predict(fresh, np.empty((10, 0))), np.empty((10, 0)), toy.signal_cov)
    assert_close(found.value / RANGE, fresh / RANGE, atol=1e-8)


def test_signals_that_no_load_gives_are_refused():
    rng = np.random.default_rng(6)
    toy = sensor(rng)
    applied, case = loads(rng)
    table = toy.table(rng, applied, case, 5.0 * (applied / RANGE) ** 2)
    fit = fit_calibration(table, replace(FORWARD, powers="squares"))
    with pytest.raises(UnreachedSignalsError):
        wrenches(fit, np.full((1, 6), -100.0), np.empty((1, 0)), toy.signal_cov)
