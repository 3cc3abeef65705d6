"""Gross errors of readings are found, also at the ends of a run; ordinary behaviour of sensors is not rejected."""

from __future__ import annotations

import numpy as np
import pytest

from tests.estimation.interferometry.bench import ALL_PAIRS, Log, made_log
from truing.estimation.interferometry.run_curves import RunCurves, run_curves


def _curves(log: Log, extra: np.ndarray | float = 0.0, declared: bool = True) -> RunCurves:
    """Curves of a log with something added to its readings (N,)."""
    reading, sigma = np.full((2, len(log.reading), 6), np.nan)
    at = np.arange(len(log.reading)), log.channel
    reading[at] = log.reading + extra
    sigma[at] = log.sigma if declared else np.nan
    return run_curves(log.wrench, 60.0 * log.step, log.run, reading, sigma)


def test_good_readings_stay() -> None:
    """Of 6048 readings 0.4 are expected to be rejected; three or more once in a hundred times."""
    out = sum(int(_curves(made_log(np.random.default_rng(seed), ALL_PAIRS)).rejected.sum()) for seed in range(8))
    assert out < 3


@pytest.mark.parametrize("step", [0, 5, 10, 15, 20])
def test_a_gross_error_is_found_wherever_it_stands(step: int) -> None:
    """Also at the largest load, which no other reading of its run shares: there the curve would follow it."""
    log = made_log(np.random.default_rng(1), ALL_PAIRS)
    wrong = (log.step == step + 1) & (log.run % 3 == 0)
    found = _curves(log, np.where(wrong, 60.0 * log.sigma, 0.0))
    assert (found.rejected.any(axis=1) == wrong).all()


def test_a_jump_that_lasts_is_no_gross_error() -> None:
    log = made_log(np.random.default_rng(2), ALL_PAIRS)
    jumped = np.where((log.step > 15) & (log.run < 6), 30.0 * log.sigma, 0.0)
    assert not _curves(log, jumped).rejected.any()


def test_nonlinearity_of_a_sensor_is_no_gross_error() -> None:
    """Asymmetry, a bend, a clearance and a loop, each of a hundred sigmas."""
    log = made_log(np.random.default_rng(3), ALL_PAIRS)
    share = log.wrench[np.arange(len(log.axis)), log.axis] / 9e3
    back = (np.roll(np.abs(share), 1) > np.abs(share)) & (log.step > 1)
    for shape in (np.abs(share), share**3, np.sign(share), back * np.abs(share) * (1 - np.abs(share)) * np.sign(share)):
        assert not _curves(log, 100.0 * log.sigma * shape).rejected.any()


def test_noise_that_was_not_declared_is_found() -> None:
    log = made_log(np.random.default_rng(5), ALL_PAIRS)
    found = _curves(log, declared=False)
    true = np.array([log.sigma[log.channel == k][0] for k in range(6)])
    # 6 runs with 14 readings to spare: sigma to 8 %
    assert np.abs(np.nanmedian(found.sigma, axis=0) / true - 1.0).max() < 0.32


def test_too_few_readings_for_a_curve_are_left_alone() -> None:
    load, reading = np.zeros((4, 6)), np.full((4, 6), np.nan)
    load[:, 2], reading[:, 2] = [0.0, 1.0, 2.0, 3.0], [0.0, 1.0, 50.0, 3.0]
    found = run_curves(load, np.arange(4.0), np.zeros(4, np.int64), reading, np.ones((4, 6)))
    assert np.isnan(found.residual).all()
    assert not found.rejected.any()
