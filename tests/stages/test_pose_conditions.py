"""Conditions of each pose besides its points: direction, size and order of the actuators' movements."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

from tests.tolerance import assert_close
from truing.simulation.inputs import (
    APPROACH,
    ORDER,
    RATE,
    STOPPED,
    STOPS,
    approach,
    fading_sum,
    histories,
    order_in_time,
)
from truing.simulation.mechanisms.extended_model import some_of
from truing.stages.common.pose_conditions import pose_conditions

TIME = np.array([30.0, 0.0, 10.0, 20.0])  # so that the second pose was the first
READINGS = np.array([[3.0], [1.0], [2.0], [2.0000001]])


def test_poses_are_ranked_in_time_those_without_last() -> None:
    assert order_in_time(TIME, 4).tolist() == [3, 0, 1, 2]
    assert order_in_time(np.array([5.0, np.nan, 1.0]), 3).tolist() == [1, 2, 0]
    assert order_in_time(None, 3).tolist() == [0, 1, 2]


def test_the_direction_of_approach_is_that_of_the_last_movement_worth_the_name() -> None:
    down = np.array([[1.0], [3.0], [2.0], [2.0000001]])
    assert approach(down, TIME, 1e-3)[:, 0].tolist() == [-1.0, 1.0, -1.0, -1.0]


def test_effects_of_movements_decay() -> None:
    assert_close(fading_sum(READINGS, TIME, 0.0)[:, 0], np.array([1.0, 0.0, 1.0, 0.0]), atol=1e-6, what="last, m")
    assert_close(fading_sum(READINGS, TIME, 0.5)[:, 0], np.array([1.25, 0.0, 1.0, 0.5]), atol=1e-6, what="lately, m")


def dragged(readings: np.ndarray, slack: float) -> np.ndarray:
    """A sledge with friction behind a spring: it follows a reading as soon as that is ``slack`` ahead of it."""
    place, found = readings[0], []
    for reading in readings:
        place = min(max(place, reading - slack), reading + slack)
        found.append(place)
    return np.array(found)


def test_friction_with_memory_is_a_sum_of_stops() -> None:
    rng = np.random.default_rng(4)
    readings, order = rng.uniform(-1.0, 1.0, (60, 2)), rng.permutation(60).astype(float)
    in_time = np.argsort(order)
    for own in range(2):
        slack = np.array(STOPS) * np.ptp(readings[:, own])
        for k in range(len(STOPS)):
            lag = readings[in_time, own] - dragged(readings[in_time, own], slack[k])
            assert_close(histories(readings, order)[in_time, own, k] * slack[k], lag, atol=1e-12, what="lag")


def test_every_numeric_column_is_a_covariate_and_poses_keep_their_names() -> None:
    table = pa.table(
        {
            "pose": [7, 8, 9],
            "role": ["reference", "calibration", "verification"],
            "time_s": [0.0, 60.0, 120.0],
            "rho1_mm": [10.0, 11.0, 9.0],
            "humidity_pct": [40.0, 41.0, 43.0],
            "remark": ["", "windy", ""],
        }
    )
    found = pose_conditions(table, (7, 8, 9), 1, 1e-6)
    assert set(found.covariates) == {"time_s", "humidity_pct", "order", "approach", "last step", "memory", *STOPPED}
    assert_close(found.readings[:, 0], np.array([0.010, 0.011, 0.009]), atol=1e-12, what="readings, m")
    part = some_of(found, np.array([False, True, True]))
    assert part.poses == (8, 9)
    assert part.span_s == (0.0, 120.0)
    assert part.covariates["order"].tolist() == [1, 2]


@pytest.mark.parametrize(("step_s", "is_timed"), [(1.0, False), (60.0, True)])
def test_numbers_of_rows_order_the_poses_and_are_no_seconds(step_s: float, is_timed: bool) -> None:
    count = 40
    table = pa.table(
        {
            "pose": np.arange(count),
            "role": ["calibration"] * count,
            "time_s": step_s * np.arange(count),
            "rho1_mm": np.linspace(1.0, 3.0, count) ** 2,
        }
    )
    covariates = pose_conditions(table, tuple(range(count)), 1, 1e-6).covariates
    assert ("time_s" in covariates, RATE in covariates) == (is_timed, is_timed)
    assert covariates[ORDER].tolist() == list(range(count))
    assert covariates[APPROACH][1:, 0].tolist() == [1.0] * (count - 1)
