"""An axis recorded in motion: late readings are named, and not mistaken for lost motion."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

from tests.tolerance import assert_close
from truing.inference.selection import CauseDiagnosis
from truing.schemas.campaign import read_campaign
from truing.schemas.settings_text import parsed_toml
from truing.simulation.axis.causes import AxisScene
from truing.simulation.axis.reading_lag import AxisReadingLag
from truing.simulation.axis.rows import LINEAR, Axis, AxisRows
from truing.stages.diagnosis.search import assembled_data, search_causes

SETTINGS = """
[campaign]
name = "axis"
kind = "photogrammetry"
[mechanism]
type = "axis"
kind = "linear"
command = "command_mm"
[noise]
measured_mm = 0.0005
"""
LAG_S, BACKLASH_MM, SIGMA_MM = 4e-4, 1.5e-3, 5e-4
STEP_MM = 5.0
EACH_WAY = np.arange(0.0, 201.0, STEP_MM)


def _swept(speeds: tuple[float, ...], rest_s: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, command in mm and its rate, up and down at each speed, mm/s; a second before each way."""
    time, command, rate, now = [], [], [], 0.0
    for speed in speeds:
        for way in (1, -1):
            time.append(now + np.arange(len(EACH_WAY)) * (STEP_MM / speed + rest_s))
            command.append(EACH_WAY[::way])
            rate.append(np.full(len(EACH_WAY), 0.0 if rest_s else way * speed))
            now = time[-1][-1] + 1.0
    return np.concatenate(time), np.concatenate(command), np.concatenate(rate)


def _diagnosed(speeds: tuple[float, ...], lag_s: float, backlash_mm: float) -> CauseDiagnosis:
    time, command, rate = _swept(speeds)
    measured = command - lag_s * rate - backlash_mm * np.sign(rate)
    measured = measured + np.random.default_rng(2).normal(0.0, SIGMA_MM, len(command))
    columns = {"time_s": time, "command_mm": command, "measured_mm": measured}
    rows = {"pose": np.arange(len(time)), "role": ["calibration"] * len(time), **columns}
    settings = read_campaign(parsed_toml(SETTINGS))
    return search_causes(assembled_data({"configurations": pa.table(rows)}, settings), settings, lambda *_: None)


def _of_verdict(diagnosis: CauseDiagnosis, verdict: str) -> dict[str, tuple[float, float]]:
    """First parameter of each cause with a verdict, SI, and its standard deviation."""
    return {
        own.cause.id: (float(own.values[0]), float(np.sqrt(own.covariance[0, 0])))
        for own in diagnosis.verdicts
        if own.verdict == verdict
    }


def _rows(time: np.ndarray, command_mm: np.ndarray) -> AxisRows:
    return AxisRows.of(range(len(time)), time, 1e-3 * command_mm, 0.0)


def test_the_rate_in_motion_is_that_of_each_way_and_gives_its_direction() -> None:
    time, command, rate = _swept((5.0, 15.0, 25.0))
    rows = _rows(time, command)
    assert_close(rows.rate, 1e-3 * rate, atol=1e-9)
    assert np.array_equal(rows.direction, np.sign(rate))


@pytest.mark.parametrize("time_is_known", [False, True])
def test_an_axis_at_rest_or_without_times_has_no_lag(time_is_known: bool) -> None:
    time, command, _ = _swept((5.0, 15.0), rest_s=3.0)
    rows = _rows(time if time_is_known else np.arange(len(time)), command)
    assert not rows.rate.any()
    assert not AxisReadingLag().candidates(AxisScene(Axis(LINEAR, ("measured",)), rows))


def test_all_encoders_may_be_late_or_one_of_several() -> None:
    rows = _rows(*_swept((15.0, 25.0))[:2])
    found = AxisReadingLag().candidates(AxisScene(Axis(LINEAR, ("motor", "measured")), rows))
    assert [cause.subject for cause in found] == ["", "encoder motor", "instrument"]


def test_a_lag_is_named_with_its_size_next_to_lost_motion() -> None:
    found = _of_verdict(_diagnosed((5.0, 15.0, 25.0), LAG_S, BACKLASH_MM), "found")
    assert set(found) == {"reading-lag", "lost-motion"}
    for cause, size in (("reading-lag", LAG_S), ("lost-motion", 1e-3 * BACKLASH_MM)):
        value, sigma = found[cause]
        assert abs(value - size) < 4.0 * sigma < size


def test_at_one_speed_a_lag_and_lost_motion_are_not_distinguished() -> None:
    diagnosis = _diagnosed((15.0, 15.0), LAG_S, 0.0)
    reported = {**_of_verdict(diagnosis, "found"), **_of_verdict(diagnosis, "indistinguishable")}
    assert {"reading-lag", "lost-motion"} <= set(reported)
    assert _of_verdict(diagnosis, "indistinguishable")


def test_without_a_lag_none_is_found() -> None:
    found = _of_verdict(_diagnosed((5.0, 15.0, 25.0), 0.0, BACKLASH_MM), "found")
    assert set(found) == {"lost-motion"}
