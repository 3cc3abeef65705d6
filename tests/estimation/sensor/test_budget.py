"""The parts of a sensor's uncertainty budget add up to its covariances."""

from __future__ import annotations

import numpy as np
import pytest

from tests.estimation.sensor.toy_sensor import RANGE, loads, sensor
from tests.tolerance import assert_close
from truing.estimation.sensor.budget import (
    Calibrated,
    budget_of_loads,
    budget_of_matrix,
    coefficient_parts,
    rms_of_held_out,
)
from truing.estimation.sensor.calibrate import fit_calibration
from truing.estimation.sensor.calibration import CalibrationModel, calibration_matrix, wrenches
from truing.estimation.sensor.contenders import covariance_by_case, hold_out
from truing.estimation.uncertainty_budget import Source

MODEL = CalibrationModel("weighted", "forward", zero="common")


@pytest.fixture(scope="module")
def made() -> Calibrated:
    """Loads without error, so that signals alone make the coefficients uncertain."""
    rng = np.random.default_rng(11)
    true, case = loads(rng)
    table = sensor(rng, load=1e-9).table(rng, true, case)
    fit, signals = fit_calibration(table, MODEL), Source("signals", "B")
    parts = coefficient_parts(fit, table, signals)
    return Calibrated(None, table, fit, parts, covariance_by_case(table, MODEL), signals)  # type: ignore[arg-type]


def test_parts_of_the_matrix_add_up_to_its_covariance(made: Calibrated) -> None:
    value, reported = budget_of_matrix(made)
    whole = calibration_matrix(made.fit, made.table.signal_cov)
    assert_close(value, whole.value, atol=0.0)
    own = np.array([source != made.cases for source in reported.sources])
    variance = np.sum(reported.contributions[own] ** 2, axis=0)
    assert_close(variance / np.diag(whole.covariance), np.ones(value.size), atol=1e-6)


def test_loads_of_one_reading_have_the_covariance_of_their_wrenches(made: Calibrated) -> None:
    axes = np.arange(6)
    value, reported = budget_of_loads(made, np.diag(RANGE), axes)
    assert_close(value / RANGE, np.ones(6), atol=1e-9)
    none = np.zeros((6, 0))
    found = wrenches(made.fit, made.fit.predict(np.diag(RANGE), none), none, made.table.signal_cov)
    own = np.array([source != made.cases for source in reported.sources])
    variance = np.sum(reported.contributions[own] ** 2, axis=0)
    assert_close(variance / found.covariance[axes, axes, axes], np.ones(6), atol=1e-6)


def test_held_out_loads_err_by_their_root_mean_square(made: Calibrated) -> None:
    found = rms_of_held_out(made)
    assert found is not None
    assert_close(found[0], hold_out(made.table, MODEL).rms, atol=1e-9)
