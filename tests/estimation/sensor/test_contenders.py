"""Held-out load cases distinguish a real term from an overfitted one; rows of the same case cannot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.estimation.sensor.toy_sensor import RANGE, loads, sensor
from tests.tolerance import assert_between
from truing.estimation.sensor.calibrate import UndeterminedCalibrationError, fit_calibration
from truing.estimation.sensor.calibration import CalibrationModel, calibration_matrix
from truing.estimation.sensor.contenders import choose_calibration, covariance_by_case, hold_out
from truing.estimation.sensor.load_table import LoadTable, load_table

LINEAR = CalibrationModel("errors in both", "forward")
SQUARES = replace(LINEAR, powers="squares")
PLAIN = CalibrationModel()
PLAIN_PRODUCTS = CalibrationModel(powers="products")


def _table(seed: int, bend: float = 0.0, cases: int = 16, steps: int = 4, **noise: float) -> LoadTable:
    rng = np.random.default_rng(seed)
    toy = sensor(rng, **noise)
    applied, case = loads(rng, cases, steps)
    return toy.table(rng, applied, case, bend * (applied / RANGE) ** 2 @ rng.normal(size=(6, 6)))


def test_errors_of_predictions_follow_their_declared_sigma():
    squares, freedom = 0.0, 0.0
    for seed in range(5):
        for model in (LINEAR, replace(LINEAR, zero="case"), PLAIN):
            noise = {"signal": 1e-9} if model is PLAIN else {}
            found = hold_out(_table(seed, **noise), model)
            squares, freedom = squares + found.squares.sum(), freedom + found.freedom.sum()
    # the noise of the plain fits is itself estimated, from some 54 rows
    spread = np.sqrt(2 / freedom)
    assert_between(squares / freedom, 1 - 5 * spread, 1.05 + 5 * spread, what="squares over freedom")


def _tared(seed: int, up: int = 6, sigma: float = 0.005) -> LoadTable:
    """Signals less the mean of each run's two unloaded readings; each axis is loaded up and down in two runs."""
    rng = np.random.default_rng(seed)
    course = np.concatenate([np.linspace(0.0, 1.0, up), np.linspace(1.0, 0.0, up)[1:]])
    run = np.repeat(np.arange(12), len(course))
    applied = np.zeros((len(run), 6))
    applied[np.arange(len(run)), run // 2] = np.tile(course, 12) * np.where(run % 2, -1.0, 1.0)
    response = np.eye(6) + 0.3 * rng.normal(size=(6, 6))
    signal = applied @ response.T + sigma * rng.normal(size=applied.shape)
    unloaded = (applied == 0.0).all(axis=1)
    zero = np.array([signal[unloaded & (run == number)].mean(axis=0) for number in range(12)])
    table = load_table(signal - zero[run], applied, run, signal_cov=sigma**2 * np.eye(6), load_cov=np.zeros((6, 6)))
    return replace(table, zeros=run, zero_share=np.where(unloaded, 0.0, np.sqrt(0.5)))


def test_held_out_runs_miss_by_the_errors_of_their_zeros_too():
    model = CalibrationModel("weighted", "forward")
    tables = [_tared(seed) for seed in range(8)]
    predictions = [hold_out(table, model) for table in tables]
    squares, freedom = (sum(getattr(one, name).sum() for one in predictions) for name in ("squares", "freedom"))
    assert freedom == 8 * 12 * 10 * 6
    assert_between(squares / freedom, 1 - 5 * np.sqrt(2 / freedom), 1 + 5 * np.sqrt(2 / freedom), what="ratio")


def test_common_errors_of_zeros_widen_the_matrix():
    model = CalibrationModel("weighted", "forward")
    truth = []
    for seed in range(30):
        table = _tared(seed)
        rng = np.random.default_rng(seed)
        response = np.eye(6) + 0.3 * rng.normal(size=(6, 6))
        fit = fit_calibration(table, model)
        deviation = (fit.matrix - response).ravel()
        truth.append(deviation @ np.linalg.solve(fit.covariance, deviation) / 36)
    assert_between(float(np.mean(truth)), 0.85, 1.15, what="squared normalised errors")


def test_a_zero_of_every_case_leaves_one_row_less():
    table = _table(0)
    assert np.all(hold_out(table, LINEAR).freedom == 24)
    assert np.all(hold_out(table, replace(LINEAR, zero="case")).freedom == 18)


@pytest.mark.slow
def test_a_bend_is_chosen_where_there_is_one_and_only_there():
    chosen = {
        bend: [choose_calibration(_table(seed, bend), [LINEAR, SQUARES]).choice.chosen for seed in range(5)]
        for bend in (0.0, 0.1)
    }
    assert sum(chosen[0.0]) <= 1
    assert sum(chosen[0.1]) == 5


def test_the_choice_of_model_needs_no_declared_noise():
    for bend, expected in ((0.0, 0), (0.2, 1)):
        table = replace(_table(3, bend, cases=40, signal=1e-3), signal_cov=None, load_cov=None)
        models = [PLAIN, CalibrationModel(powers="squares")]
        assert choose_calibration(table, models).choice.chosen == expected


def test_a_split_by_rows_falls_for_terms_learnt_by_heart_and_one_by_cases_does_not():
    """Poses of a sensor whose signals hold something that no load explains, the same in every row of a pose."""
    rng = np.random.default_rng(0)
    toy = sensor(rng)
    applied, case = loads(rng, 40, 1)
    of_pose = 0.8 * rng.normal(size=(40, 6))
    again = np.repeat(np.arange(40), 5)
    signals = (applied @ toy.A.T + of_pose)[again] + 1e-3 * rng.normal(size=(200, 6))
    by_case = load_table(signals, applied[again], case[again])
    by_row = replace(by_case, case=rng.permutation(200) % 40)
    models = [PLAIN, PLAIN_PRODUCTS]
    fooled, honest = choose_calibration(by_row, models), choose_calibration(by_case, models)
    assert fooled.choice.chosen == 1
    assert honest.choice.chosen == 0
    promised = np.mean((fooled.contenders[1].rms / RANGE) ** 2) / np.mean((honest.contenders[1].rms / RANGE) ** 2)
    assert promised < 0.1


def test_a_case_without_which_nothing_is_determined_is_named():
    rng = np.random.default_rng(1)
    toy = sensor(rng)
    applied, case = loads(rng, 10, 3)
    applied[case != 7, 5] = 0.0
    table = load_table(applied @ toy.A.T, applied, case)
    with pytest.raises(UndeterminedCalibrationError, match=r"without case 7.*mz is zero"):
        hold_out(table, PLAIN)


def test_a_fit_with_hardly_a_row_to_spare_is_never_chosen():
    table = replace(_table(2, cases=30, steps=1), signal_cov=None, load_cov=None)
    made = choose_calibration(table, [PLAIN, PLAIN_PRODUCTS])
    assert made.choice.chosen == 0
    assert made.contenders[1].log_density == -np.inf


def test_a_model_that_the_loads_do_not_determine_does_not_contend():
    table = replace(_table(4, cases=4, steps=5), signal_cov=None, load_cov=None)
    made = choose_calibration(table, [PLAIN_PRODUCTS, PLAIN])
    assert made.chosen.fit.model is PLAIN
    assert "15 rows for 27 terms" in made.refused[PLAIN_PRODUCTS.name]
    with pytest.raises(UndeterminedCalibrationError, match="15 rows for 27 terms"):
        choose_calibration(table, [PLAIN_PRODUCTS])


def test_errors_that_a_case_shares_are_seen_from_case_to_case():
    """Pulls of the entries of G_B, rms: 1 where sigmas are honest; jackknives of 24 cases scatter and are cautious."""
    plain, by_case = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        toy = sensor(rng, signal=1e-3)
        applied, case = loads(rng, 24, 8)
        shared = 5e-3 * RANGE * rng.normal(size=(24, 6))[case]
        table = toy.table(rng, applied, case)
        table = replace(table, loads=table.loads + shared)
        truth = np.linalg.inv(toy.A)
        fit = calibration_matrix(fit_calibration(table, PLAIN))
        found = covariance_by_case(table, PLAIN)
        plain.append(np.mean(((fit.value - truth) / fit.sigma) ** 2))
        by_case.append(np.mean(((found.value - truth) / found.sigma) ** 2))
    assert_between(float(np.sqrt(np.mean(by_case))), 0.75, 1.2, what="pull by cases")
    assert np.sqrt(np.mean(plain)) > 2.0  # of eight rows that share an error


def test_a_case_of_one_row_has_no_zero_of_its_own():
    with pytest.raises(ValueError, match="case 0: found 1 row"):
        hold_out(_table(0, cases=60, steps=1), replace(LINEAR, zero="case"))
