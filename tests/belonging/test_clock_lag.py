"""Test of two clocks: a common lag of all readings is found, and other effects are not mistaken for a lag."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.belonging.test_relations import _motion
from truing.belonging.reading_tests import relate_readings
from truing.belonging.relation import RelationState, RelationTest, SlipKind
from truing.report.belonging import slip_words

COUNT, PACE_S = 150, 0.5
TIME = PACE_S * np.arange(COUNT)
CYCLES = np.array([5.0, 6.3, 7.1, 8.2, 5.6, 6.9])


def _path(time_s: np.ndarray) -> np.ndarray:
    """Readings (B, 6) of a smooth motion of 3 mm at any times."""
    phase = 2.0 * np.pi * CYCLES / (COUNT * PACE_S)
    return 3e-3 * np.sin(phase * time_s[:, None] + np.arange(6.0))


def _relation(change=lambda readings: readings, *, timed: bool = True) -> RelationTest:
    motion, names = _motion(_path(TIME), change)
    found = relate_readings(replace(motion, time_s=TIME if timed else None), names)
    return next(test for test in found if test.relation == "readings-against-poses")


@pytest.mark.parametrize("lag_s", [0.05, -0.03])
def test_the_lag_is_found_with_its_sign_and_size(lag_s: float) -> None:
    found = _relation(lambda readings: readings + _path(TIME - lag_s) - _path(TIME))
    assert found.state is RelationState.FAILS
    (slip,) = found.slips
    assert slip.kind is SlipKind.LATE
    assert abs(slip.offset - lag_s) < 0.1 * abs(lag_s)
    assert ("late by" in slip_words(slip)) == (lag_s > 0.0)


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda r: r, id="nothing"),
        pytest.param(lambda r: 0.01 + 1.02 * (r - 0.01), id="gains 2 % off"),
        pytest.param(lambda r: r + 2e-5 * np.sign(np.gradient(r, axis=0)), id="lost motion"),
        pytest.param(lambda r: r + 2e-5 * np.sin(r / 1e-4), id="a periodic error"),
        pytest.param(lambda r: r + 2e-5 * TIME[:, None] / TIME[-1], id="drift"),
    ],
)
def test_physics_is_no_lag(change) -> None:
    assert all(slip.kind is not SlipKind.LATE for slip in _relation(change).slips)


def test_settling_at_poses_in_any_order_is_no_lag() -> None:
    steps = np.random.default_rng(2).uniform(-3e-3, 3e-3, (COUNT, 6))
    motion, names = _motion(steps, lambda r: r + 0.01 * np.diff(r, axis=0, prepend=r[:1]))
    found = relate_readings(replace(motion, time_s=TIME), names)
    assert all(slip.kind is not SlipKind.LATE for test in found for slip in test.slips)


def test_without_times_nothing_is_said_of_them() -> None:
    found = _relation(lambda readings: readings + _path(TIME - 0.05) - _path(TIME), timed=False)
    assert all(slip.kind is not SlipKind.LATE for slip in found.slips)
