"""Errors that the points of a pose share are separated from those of single points."""

from __future__ import annotations

import numpy as np

from tests.tolerance import assert_close
from truing.estimation.bundle.ray_statistics import shared_errors

POINTS = np.random.default_rng(1).normal(0.0, 0.2, (20, 3))


def test_a_common_scale_is_the_one_pattern_next_to_points_by_themselves() -> None:
    arms = POINTS - POINTS.mean(0)
    scale = 2e-5 * arms.reshape(-1, 1)
    shift = np.tile(1e-3 * np.eye(3), (len(POINTS), 1))  # a datum's: no error of points against each other
    covariance = 1e-12 * np.eye(60) + scale @ scale.T + shift @ shift.T
    found = shared_errors(covariance, POINTS, 6)
    assert found.patterns.shape == (20, 3, 1)
    again = found.patterns.reshape(-1, 1)
    assert_close(again @ again.T, scale @ scale.T, atol=2e-3 * np.abs(scale @ scale.T).max())
    assert np.linalg.eigvalsh(found.own).min() > 0.5e-12
    assert np.linalg.eigvalsh(found.own).max() < 1.5e-12


def test_points_by_themselves_share_nothing() -> None:
    assert shared_errors(1e-12 * np.eye(60), POINTS, 6).patterns.shape[-1] == 0
