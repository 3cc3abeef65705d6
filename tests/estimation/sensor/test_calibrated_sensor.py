"""A calibrated sensor, also after writing and reading, gives wrenches with a correct covariance."""

from __future__ import annotations

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.estimation.sensor.toy_sensor import RANGE, ToySensor, loads, sensor
from tests.tolerance import assert_between
from truing.estimation.sensor.calibrated_sensor import CalibratedSensor, calibrated_sensor, sensor_from, sensor_text
from truing.estimation.sensor.calibration import CalibrationModel
from truing.estimation.sensor.contenders import hold_out
from truing.estimation.sensor.load_table import load_table

FORWARD = CalibrationModel("errors in both", "forward", zero="common")
DIRECT = CalibrationModel("weighted", "direct", zero="common")
REFERENCE_C = 20.0


def _calibrated(seed: int, model: CalibrationModel, is_tared: bool = False) -> tuple[ToySensor, CalibratedSensor]:
    rng = np.random.default_rng(seed)
    toy = sensor(rng, signal=1e-3)
    table = toy.table(rng, *loads(rng))
    return toy, calibrated_sensor(hold_out(table, model), table, REFERENCE_C, is_tared)


def _new(toy: ToySensor, seed: int, count: int = 200) -> tuple[NDArray, NDArray]:
    rng = np.random.default_rng(seed)
    true = rng.uniform(-0.9, 0.9, (count, 6)) * RANGE
    return true, true @ toy.A.T + rng.normal(size=(count, 6)) * toy.signal_sigma


@pytest.mark.slow
def test_wrenches_of_new_signals_err_as_much_as_their_covariance_says():
    squares = []
    for seed in range(20):
        toy, calibrated = _calibrated(seed, FORWARD)
        true, signals = _new(toy, 100 + seed)
        found = calibrated.wrench(signals)
        off = (found.value - true)[:, :, None]
        squares.append(np.swapaxes(off, 1, 2) @ np.linalg.solve(found.covariance, off))
    # rows of one campaign share the error of its calibration: 20 campaigns of about 6 numbers each
    assert_between(np.mean(squares) / 6, 0.75, 1.25, what="squares over freedom")


@pytest.mark.parametrize("model", [FORWARD, DIRECT, replace(FORWARD, powers="squares"), CalibrationModel()])
def test_a_sensor_read_from_its_text_gives_the_same(model: CalibrationModel):
    toy, calibrated = _calibrated(3, model)
    again = sensor_from(tomllib.loads(sensor_text(calibrated, {"calibration": model.name})))
    signals = _new(toy, 4)[1]
    np.testing.assert_array_equal(again.wrench(signals).value, calibrated.wrench(signals).value)
    np.testing.assert_array_equal(again.wrench(signals).covariance, calibrated.wrench(signals).covariance)


@pytest.mark.parametrize("model", [FORWARD, DIRECT, CalibrationModel()])
def test_a_linear_calibration_is_a_matrix_with_an_offset(model: CalibrationModel):
    toy, calibrated = _calibrated(5, model)
    signals = _new(toy, 6)[1]
    assert calibrated.offset is not None
    by_matrix = signals @ calibrated.matrix.value.T + calibrated.offset
    np.testing.assert_allclose(by_matrix, calibrated.wrench(signals).value, rtol=1e-9, atol=1e-6)


def test_models_without_a_matrix_have_no_offset():
    assert _calibrated(5, replace(FORWARD, powers="squares"))[1].offset is None
    assert _calibrated(5, FORWARD, is_tared=True)[1].offset is None


def test_a_tared_sensor_counts_from_unloaded_signals_and_says_how_little_few_of_them_show():
    toy, calibrated = _calibrated(7, CalibrationModel("errors in both", "forward"), is_tared=True)
    zero = np.linspace(-1.0, 1.0, 6)
    true, signals = _new(toy, 8)
    few, many = (calibrated.wrench(signals + zero, unloaded=np.tile(zero, (count, 1))) for count in (1, 10_000))
    np.testing.assert_allclose(few.value, many.value)
    assert np.all(np.abs(few.value - true) < 6 * few.sigma)
    assert np.all(few.sigma > many.sigma)
    with pytest.raises(ValueError, match="unloaded"):
        calibrated.wrench(signals)


def test_loads_beyond_the_calibration_are_marked():
    toy, calibrated = _calibrated(9, FORWARD)
    inside, beyond = 0.5 * calibrated.largest, 1.2 * calibrated.largest
    assert calibrated.wrench(np.array([inside, beyond]) @ toy.A.T).is_within.tolist() == [True, False]


def test_temperature_is_counted_from_its_reference():
    rng = np.random.default_rng(10)
    toy = sensor(rng, signal=1e-3)
    applied, case = loads(rng)
    warmth, drift = rng.uniform(-5, 5, len(applied)), rng.normal(size=6)
    plain = toy.table(rng, applied, case, warmth[:, None] * drift)
    table = load_table(
        plain.signals,
        plain.loads,
        case,
        covariates=warmth[:, None],
        signal_cov=toy.signal_cov,
        load_cov=toy.load_cov,
    ).named(covariates=["material_temperature"])
    calibrated = calibrated_sensor(hold_out(table, replace(FORWARD, drift=True)), table, REFERENCE_C, False)
    true, signals = _new(toy, 11)
    found = calibrated.wrench(signals + 3.0 * drift, covariates=[REFERENCE_C + 3.0])
    assert np.all(np.abs(found.value - true) < 6 * found.sigma)
    with pytest.raises(ValueError, match="material_temperature"):
        calibrated.wrench(signals)


def test_signals_of_another_shape_or_without_numbers_are_refused():
    calibrated = _calibrated(12, FORWARD)[1]
    for wrong in (np.zeros(5), np.zeros((3, 7)), np.full(6, np.nan)):
        with pytest.raises(ValueError, match="signals: found"):
            calibrated.wrench(wrong)


def test_a_damaged_text_is_refused():
    text = sensor_text(_calibrated(13, FORWARD)[1], {})
    document = tomllib.loads(text)
    for key in ("coefficients", "covariance", "signals"):
        broken = {name: value for name, value in document["calibration"].items() if name != key}
        with pytest.raises(ValueError, match="no calibrated sensor"):
            sensor_from({"calibration": broken})
    with pytest.raises(ValueError, match="no calibrated sensor"):
        sensor_from({"calibration": document["calibration"] | {"covariance": [[1.0]]}})
