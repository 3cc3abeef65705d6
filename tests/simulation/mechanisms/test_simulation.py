"""A simulated campaign has the noise, survey and faults of its layout, and the hidden effects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.simulation.mechanisms.telescope import MATRIX, sample_model
from tests.tolerance import assert_between
from truing.estimation.rigid_poses.umeyama import umeyama
from truing.simulation.cause import Effect
from truing.simulation.drawn_campaigns import CampaignLayout, DrawnPoints, draw_campaign
from truing.simulation.targets import BASE

POSES, SIGMA = 30, 5e-6


def _layout(**changes: object) -> CampaignLayout:
    model = sample_model(np.random.default_rng(3), POSES)
    count = len(model.targets.body)
    covariance = np.broadcast_to(np.eye(3) * SIGMA**2, (POSES, count, 3, 3))
    return replace(CampaignLayout(model, covariance, np.ones((POSES, count), bool)), **changes)


def _drawn(layout: CampaignLayout, seed: int = 1, effects: tuple[Effect, ...] = ()) -> DrawnPoints:
    return draw_campaign(layout, effects, np.random.default_rng(seed))


def test_the_same_seed_draws_the_same_and_another_another() -> None:
    layout = _layout()
    assert np.array_equal(_drawn(layout).points, _drawn(layout).points)
    assert not np.array_equal(_drawn(layout).points, _drawn(layout, seed=2).points)


def test_points_scatter_about_their_body_as_survey_and_points_are_noisy() -> None:
    layout = _layout()
    on_base = layout.model.targets.body == BASE
    drawn = _drawn(layout)
    fit = umeyama(drawn.survey[on_base], drawn.points[:, on_base])
    mean = np.mean(fit.residuals(drawn.survey[on_base], drawn.points[:, on_base]), 0)
    rest = fit.residuals(drawn.survey[on_base] + mean, drawn.points[:, on_base])
    freedom = 3 * on_base.sum() - 6
    level = np.sqrt(np.sum(rest**2) / (POSES - 1) / freedom)
    assert_between(level, 0.9 * SIGMA, 1.1 * SIGMA, what="noise of points about the shape that they show")
    assert np.sqrt(np.mean(mean**2)) > SIGMA  # the survey has noise of its own


def test_attachments_were_surveyed_where_the_drawn_platform_has_them() -> None:
    layout = _layout()
    model, own = layout.model, layout.model.targets.at_attachment
    away = np.concatenate([(_drawn(layout, seed).survey - model.known.shape)[own].ravel() for seed in range(40)])
    expected = np.hypot(model.known.geometry["b"], 0.0)
    assert_between(np.sqrt(np.mean(away**2)), 0.9 * expected, 1.1 * expected, what="tolerance of b")


def test_points_are_grossly_wrong_as_often_as_asked_for() -> None:
    fine, wrong = _drawn(_layout()), _drawn(_layout(gross=0.1))
    far = np.linalg.norm(wrong.points - fine.points, axis=-1) > 20 * SIGMA
    assert_between(far.mean(), 0.07, 0.13, what="share of gross errors")


def test_a_hidden_effect_moves_the_points_that_it_moves_and_no_others() -> None:
    layout = _layout()
    values = np.zeros(36)
    values[0] = 0.05
    plain, hidden = _drawn(layout), _drawn(layout, effects=(Effect(MATRIX, values),))
    moved = np.abs(hidden.points - plain.points).max((0, 2))
    on_base = layout.model.targets.body == BASE
    assert moved[on_base].max() < 1e-12
    assert moved[~on_base].max() > 1e-6


def test_frames_that_are_given_are_kept() -> None:
    layout = _layout(rotations=np.broadcast_to(np.eye(3), (POSES, 3, 3)))
    drawn = _drawn(layout)
    on_base = layout.model.targets.body == BASE
    fit = umeyama(drawn.survey[on_base], drawn.points[:, on_base])
    assert np.abs(fit.R - np.eye(3)).max() < 1e-3


def test_readings_out_of_reach_are_refused() -> None:
    layout = _layout()
    conditions = replace(layout.model.conditions, readings=layout.model.conditions.readings + np.linspace(0, 5, 6))
    with pytest.raises(ValueError, match="within the declared tolerances"):
        _drawn(replace(layout, model=layout.model.at(conditions)))
