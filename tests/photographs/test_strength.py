"""Strength of effects in rays: zero for what an adjustment absorbs, otherwise proportional to the size."""

from __future__ import annotations

import numpy as np
import pytest

from tests.blind.generator.schedule import random_moves
from tests.photographs.hidden import AirGradient, UnstableCamera, WarmBar
from tests.photographs.rays import Shooting
from tests.photographs.stations import Round
from tests.photographs.strength import RayMeasure
from tests.photographs.surveyed import SurveyMeasure

MEASURE = RayMeasure(Shooting(stations=Round(count=5)), random_moves(4, 0, np.random.default_rng(3)), 5)


def test_a_camera_change_before_all_poses_has_no_strength() -> None:
    assert MEASURE.strength(UnstableCamera("c", jump_px=0.3, from_pose=1)) < 0.02


def test_an_even_gradient_and_bars_that_grow_alike_show_nothing() -> None:
    assert MEASURE.strength(AirGradient(per_m=1e-5)) < 0.05
    assert MEASURE.strength(WarmBar(1e-4)) < 0.15 * MEASURE.strength(WarmBar(1e-4, "S"))


def test_strength_is_in_proportion_to_the_size() -> None:
    small, large = (MEASURE.strength(UnstableCamera("c", jump_px=size, from_pose=3)) for size in (0.1, 0.2))
    assert large == pytest.approx(2 * small, rel=0.01)


def test_against_the_survey_bodies_show_what_rays_do_not() -> None:
    against = SurveyMeasure(MEASURE.shooting, MEASURE.moves, MEASURE.seed)
    small, large = (against.strength(AirGradient(per_m=size)) for size in (1e-4, 2e-4))
    assert large == pytest.approx(2 * small, rel=0.02)
    assert small > 5 * MEASURE.strength(AirGradient(per_m=1e-4))
    assert against.strength(WarmBar(1e-4)) > 5 * MEASURE.strength(WarmBar(1e-4))
