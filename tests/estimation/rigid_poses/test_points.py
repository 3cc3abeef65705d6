"""Targets that define the frame of a body, and residuals of its points in the axes of the body."""

from __future__ import annotations

import numpy as np
import pytest

from tests.tolerance import assert_close
from truing.estimation.rigid_poses.points import FittedPoints, PosePoints, SurveyPoints
from truing.estimation.rotation import exp_so3


def survey(leg: list[int]) -> SurveyPoints:
    count = len(leg)
    names = tuple(f"t{k}" for k in range(count))
    return SurveyPoints(names, np.zeros((count, 3)), np.zeros((count, 3, 3)), np.array(leg))


@pytest.mark.parametrize(
    ("leg", "frame"),
    [
        ([0, 0, 0, 1, 2], [True, True, True, False, False]),
        ([0, 0, 1, 2, 3], [True] * 5),  # two are too few: the attachments make the frame too
        ([0, 0, 0], [True] * 3),
        ([0, 0], [True] * 2),
        ([1, 2, 3], [True] * 3),
    ],
)
def test_targets_away_from_the_legs_make_the_frame_where_there_are_enough(leg: list[int], frame: list[bool]) -> None:
    assert survey(leg).frame.tolist() == frame


def test_noise_turns_with_the_body_and_a_pose_without_a_fit_is_not_turned() -> None:
    rng = np.random.default_rng(3)
    root = rng.normal(size=(2, 4, 3, 3))
    cov = root @ np.swapaxes(root, -1, -2)
    points = PosePoints((1, 2), tuple("abcd"), np.zeros((2, 4, 3)), cov, np.ones((2, 4), bool))
    R = exp_so3(rng.normal(size=(2, 3)))
    t = np.zeros((2, 3))
    R[1], t[1] = np.nan, np.nan
    found = FittedPoints(points, np.zeros((2, 4, 3)), np.ones((2, 4), bool), R, t)
    assert_close(found.noise[0], R[0].T @ cov[0] @ R[0], atol=1e-12)
    assert_close(found.noise[1], cov[1], atol=1e-12)
