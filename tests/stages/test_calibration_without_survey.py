"""Legs are known in the frames of base and platform: points without their survey calibrate nothing."""

from __future__ import annotations

import pyarrow as pa
import pytest

from tests.sentences import assert_says
from truing.schemas.mechanism import MechanismSection
from truing.stages.common.missing_data import why_no_calibration

CONFIGURATIONS = {"configurations": pa.table({"pose": [1]})}
SURVEYED = {**CONFIGURATIONS, "survey": pa.table({"body": ["base"]})}
LEGS = MechanismSection(type="6-pus")


@pytest.mark.parametrize("body", ["base", "platform"])
def test_points_of_a_machine_on_legs_need_the_survey_of_their_targets(body: str) -> None:
    assert_says(why_no_calibration(LEGS, CONFIGURATIONS, [body]), "needs the survey", "targets.csv")
    assert why_no_calibration(LEGS, SURVEYED, [body]) == ""


def test_poses_that_were_measured_as_such_need_no_survey() -> None:
    assert why_no_calibration(LEGS, CONFIGURATIONS, []) == ""
    assert "survey" not in why_no_calibration(LEGS, {}, [])
    assert why_no_calibration(LEGS, CONFIGURATIONS, ["tripod"]) == ""


def test_all_that_is_missing_is_named_at_once() -> None:
    assert_says(why_no_calibration(LEGS, {}, ["base"]), "targets.csv", "configurations")
