"""Exchanged rows of signals without exchanged readings, and the reverse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.tolerance import assert_close
from truing.estimation.interferometry.recorded_steps import RecordedSteps
from truing.simulation.bench.causes.rows_exchanged import RowsExchanged, SignalsExchanged, confirmed_by_readings
from truing.simulation.bench.load_steps import LoadSteps, ReadingState
from truing.simulation.bench.six_upur.uncertain_sensor import UncertainSensor

COMPLIANCE = np.diag([2e-7, 2e-7, 3e-8, 4e-7, 4e-7, 3e-7])
ONE = RowsExchanged(((1, 2), (1, 4)), ("fx", "fy"))


def _steps(read_under: np.ndarray, load: np.ndarray) -> RecordedSteps:
    count = len(load)
    return RecordedSteps(
        (1,),
        np.zeros(count, int),
        np.arange(count),
        np.arange(count) * 60.0,
        load,
        read_under @ COMPLIANCE,
        np.full((count, 6), 1e-7),
        np.ones((count, 6)),
        np.zeros(count, bool),
        {},
    )


@pytest.mark.parametrize("loads_are_right", [True, False])
def test_readings_show_whose_rows_were_exchanged(loads_are_right: bool) -> None:
    load = np.random.default_rng(1).uniform(-5e3, 5e3, (6, 6))
    applied = load.copy()
    if not loads_are_right:
        applied[[2, 4], :2] = load[[4, 2], :2]
    found = confirmed_by_readings((ONE,), _steps(applied, load), UncertainSensor(None, None, COMPLIANCE))
    assert [type(one) for one in found] == [SignalsExchanged if loads_are_right else RowsExchanged]
    assert found[0].settings() == ONE.settings()


def test_signals_in_each_other_s_row_are_exchanged_and_readings_stay() -> None:
    rng = np.random.default_rng(2)
    readings = rng.normal(size=(6, 8))
    channels = ("dx", "dy", "dz", "rx", "ry", "rz", "v1", "v2")
    steps = LoadSteps(
        np.ones(6, int), np.arange(6), np.arange(6.0), np.zeros((6, 6)), np.ones(6), {}, channels, np.ones(8),
        np.zeros((6, 6)), np.zeros((6, 2)), 6.3e-7,
    )  # fmt: skip
    state = ReadingState(steps, np.zeros((6, 6)), np.zeros((6, 6, 0)), readings)
    cause = SignalsExchanged(ONE.rows, ONE.components)
    right = readings.copy()
    right[[2, 4], 6:] = readings[[4, 2], 6:]
    assert_close(readings + cause.moved(state, np.zeros(0)), right, atol=1e-15)
    assert_close(cause.passed_on(readings[..., None], state, np.zeros(0))[..., 0], right, atol=1e-15)
    elsewhere = replace(cause, rows=((7, 2), (7, 4)))
    assert_close(elsewhere.moved(state, np.zeros(0)), np.zeros((6, 8)), atol=0.0)
