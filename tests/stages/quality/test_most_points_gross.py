"""A declared noise far too small, or a survey in another scale, is reported as such, not as gross errors."""

from __future__ import annotations

import numpy as np
import pytest

from truing.arrays import Array
from truing.estimation.rigid_poses.points import PosePoints, SurveyPoints
from truing.estimation.rotation import exp_so3
from truing.quality.bodies import BodyView, PoseSurroundings, body_view, with_most_points
from truing.stages.quality.check import FAIL, NOT_EVALUATED, PASS
from truing.stages.quality.target_checks import noise_size

POSES, TARGETS, DECLARED_M = 20, 10, 5e-6


def _body(factor: float, *, survey_of: Array | None = None, gross: float = 0.0, seed: int = 4) -> BodyView:
    """A body whose points and survey scatter by a factor times the declared noise; survey_of: the survey is of these
    points instead; gross: share of points that lie a millimetre away."""
    rng = np.random.default_rng(seed)
    names = tuple(f"T{k}" for k in range(TARGETS))
    place = rng.uniform(-0.2, 0.2, (TARGETS, 3)) if survey_of is None else survey_of
    true = np.random.default_rng(seed).uniform(-0.2, 0.2, (TARGETS, 3))
    R, t = exp_so3(0.3 * rng.normal(size=(POSES, 3))), rng.normal(size=(POSES, 1, 3))
    points = true @ R.transpose(0, 2, 1) + t + factor * DECLARED_M * rng.normal(size=(POSES, TARGETS, 3))
    points += 1e-3 * (rng.random((POSES, TARGETS, 1)) < gross) * rng.normal(size=(POSES, TARGETS, 3))
    place = place + factor * DECLARED_M * rng.normal(size=place.shape)
    cov = DECLARED_M**2 * np.eye(3)
    around = PoseSurroundings(tuple(range(POSES)), np.arange(POSES) * 60.0, np.zeros((POSES, 0)), (), None)
    survey = SurveyPoints(names, place, np.tile(cov, (TARGETS, 1, 1)), np.zeros(TARGETS, np.int64))
    is_observed = np.ones((POSES, TARGETS), bool)
    measured = PosePoints(around.poses, names, points, np.tile(cov, (POSES, TARGETS, 1, 1)), is_observed)
    return with_most_points(body_view("body", survey, measured, around, is_surveyed=True), around)


@pytest.mark.parametrize("factor", [12.0, 100.0, 1000.0])
def test_a_declared_noise_that_is_too_small_is_reported_with_its_factor(factor: float) -> None:
    body = _body(factor)
    assert body.noise_factor == pytest.approx(factor, rel=0.15)
    assert body.gross_share < 0.02
    row = noise_size([body], ())
    assert (row.verdict, row.value) == (FAIL, body.noise_factor)


@pytest.mark.parametrize(("factor", "gross"), [(1.0, 0.0), (2.0, 0.0), (6.0, 0.0), (1.0, 0.3)])
def test_noise_near_the_declared_one_and_gross_errors_change_nothing(factor: float, gross: float) -> None:
    body = _body(factor, gross=gross)
    assert body.noise_factor == 1.0
    assert noise_size([body], ()).verdict != FAIL


@pytest.mark.parametrize("slip", ["mirrored", "other names", "inches"])
def test_a_wrong_survey_is_no_noise(slip: str) -> None:
    place = np.random.default_rng(4).uniform(-0.2, 0.2, (TARGETS, 3))
    other = {"mirrored": place * [1, 1, -1], "other names": np.roll(place, 1, axis=0), "inches": place * 25.4}
    body = _body(1.0, survey_of=other[slip])
    assert body.noise_factor == 1.0
    assert noise_size([body], ()).verdict == NOT_EVALUATED


@pytest.mark.parametrize("scale", [0.995, 0.9998, 1.0003, 1.001, 1.01])
def test_a_survey_in_another_scale_is_no_noise_and_leaves_no_gross_errors(scale: float) -> None:
    place = np.random.default_rng(4).uniform(-0.2, 0.2, (TARGETS, 3))
    body = _body(1.0, survey_of=place / scale)
    assert body.survey_scale == pytest.approx(scale, abs=2e-5)
    assert (body.noise_factor, body.gross_share) == (1.0, 0.0)
    assert noise_size([body], ()).verdict == PASS
