"""Of points rejected by the fit of poses, gross errors are left out; exchanged labels and moved targets are kept."""

from __future__ import annotations

import numpy as np
import pytest

from truing.estimation.labels.point_selection import select_points
from truing.estimation.rigid_poses.points import PointResiduals, PosePoints, with_declared_noise

POSES, SIGMA = 14, 1e-5
SHAPE = np.array([[0, 0, 0], [0.4, 0, 0], [0, 0.3, 0], [0, 0, 0.5], [0.4, 0.3, 0], [0.2, 0.1, 0.4], [0.1, 0.3, 0.2]])
NAMES = tuple(f"P{k}" for k in range(len(SHAPE)))


@pytest.fixture
def measured() -> np.ndarray:
    """Points (B, T, 3), m, of a body that stays where it is."""
    return SHAPE + SIGMA * np.random.default_rng(3).normal(size=(POSES, *SHAPE.shape))


def _selection(points: np.ndarray, excluded: tuple[int, int] | None = None):
    is_observed = np.ones(points.shape[:2], bool)
    cov = np.broadcast_to(np.eye(3) * SIGMA**2, (*points.shape, 3))
    values = points - SHAPE
    rejected = np.linalg.norm(values, axis=-1) > 10.0 * SIGMA
    by_person = np.zeros_like(is_observed)
    if excluded is not None:
        by_person[excluded] = True
    found = PosePoints(tuple(range(POSES)), NAMES, points, cov, is_observed)
    return select_points(PointResiduals(values, rejected, by_person), found, SHAPE, np.arange(float(POSES)))


def test_a_point_that_is_off_alone_is_a_gross_error(measured: np.ndarray) -> None:
    measured[6, 2] += 0.01
    judged = _selection(measured)
    assert np.argwhere(~judged.kept).tolist() == [[6, 2]]
    assert judged.exchanges == []


def test_exchanged_labels_are_reported_and_their_points_kept(measured: np.ndarray) -> None:
    measured[5, [1, 4]] = measured[5, [4, 1]]
    judged = _selection(measured)
    assert judged.kept.all()
    assert [(exchange.pose, {exchange.first, exchange.second}) for exchange in judged.exchanges] == [(5, {1, 4})]


def test_a_target_that_was_moved_is_kept_where_it_went(measured: np.ndarray) -> None:
    measured[8:, 3] += [0.002, 0.0, 0.001]
    assert _selection(measured).kept.all()


def test_points_excluded_by_a_person_stay_excluded(measured: np.ndarray) -> None:
    assert np.argwhere(~_selection(measured, (2, 1)).kept).tolist() == [[2, 1]]


def test_the_declared_noise_holds_for_points_without_their_own() -> None:
    own = np.diag([1e-10, 2e-10, 3e-10])
    found = with_declared_noise(np.stack([own, np.zeros((3, 3)), np.full((3, 3), np.nan)]), 2e-5)
    assert np.array_equal(found, np.stack([own, *[np.eye(3) * 2e-5**2] * 2]))
