"""Gross errors that stay from one pose on are those of a target that was moved."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.sentences import assert_says
from truing.stages.quality.check import CampaignLimits
from truing.stages.quality.target_checks import gross_errors

POSES, TARGETS, ONSET = 40, 3, 17


def _message(gross: np.ndarray) -> str:
    points = SimpleNamespace(is_observed=np.ones((POSES, TARGETS), bool), poses=[f"p{k}" for k in range(POSES)])
    survey = SimpleNamespace(targets=["A", "B", "C"])
    body: Any = SimpleNamespace(name="tool", why_no_positions="", points=points, gross=gross, survey=survey)
    body.framed = np.ones(POSES, bool)
    return next(iter(gross_errors(body, CampaignLimits("photogrammetry", {})))).message


def test_the_pose_is_named_from_which_gross_errors_stay() -> None:
    gross = np.zeros((POSES, TARGETS), bool)
    gross[np.arange(ONSET, POSES), np.arange(ONSET, POSES) % TARGETS] = True  # of any target, as three targets allow
    gross[ONSET + 4] = False
    assert_says(_message(gross), "22 of the 23 poses from p17 on", "0 of the 17 before", "moved or replaced")


@pytest.mark.parametrize("share", [0.05, 0.5])
def test_gross_errors_that_come_and_go_name_no_pose(share: float) -> None:
    gross = np.random.default_rng(4).random((POSES, TARGETS)) < share
    assert "moved or replaced" not in _message(gross)


def test_many_gross_errors_of_one_target_are_reported_as_a_target_that_moves() -> None:
    gross = np.zeros((POSES, TARGETS), bool)
    gross[np.random.default_rng(5).permutation(POSES)[:16], 1] = True
    gross[3, 0] = True
    assert_says(_message(gross), "17 of 120 readings are as far off as gross errors", "16 of them at 1 of 3 targets")
    anywhere = np.random.default_rng(6).random((POSES, TARGETS)) < 0.14
    assert_says(_message(anywhere), "readings are gross errors")


def test_many_gross_errors_of_whole_poses_are_reported_as_noisier_poses() -> None:
    gross = np.zeros((POSES, TARGETS), bool)
    gross[3::5] = True
    gross[0, 1] = True
    assert_says(_message(gross), "25 of 120 readings are as far off as gross errors", "8 of 40 poses", "may be noisier")
    single = np.zeros((POSES, TARGETS), bool)
    single[np.arange(25), np.arange(25) % TARGETS] = True
    assert_says(_message(single[np.random.default_rng(2).permutation(POSES)]), "25 of 120 readings are gross errors")
