"""Positions of a target over a campaign: one, several in turn, or none."""

from __future__ import annotations

import numpy as np
import pytest

from truing.estimation.rigid_poses.umeyama import umeyama
from truing.estimation.target_positions import (
    displaced_points,
    isolated_points,
    looseness,
    median_places,
    position_changes,
    spread_in_time,
)

SIGMA = 1e-5
ORDER = np.arange(20.0)


@pytest.fixture
def places() -> np.ndarray:
    return np.random.default_rng(1).normal(size=(20, 4, 3)) * SIGMA


@pytest.fixture
def known() -> np.ndarray:
    return np.random.default_rng(2).random((20, 4)) > 0.1


def test_a_target_that_stays_has_no_change_and_no_stray_point(places: np.ndarray, known: np.ndarray) -> None:
    assert position_changes(places, known, ORDER, SIGMA) == []
    assert not displaced_points(places, known, ORDER, SIGMA, []).any()
    assert not isolated_points(places, known, ORDER, SIGMA).any()


def test_a_change_is_found_at_its_pose_and_what_follows_is_not_astray(places: np.ndarray) -> None:
    known = np.ones((20, 4), bool)
    places[7:, 2] += [0.5, 0.0, 2.0]
    changes = position_changes(places, known, ORDER, SIGMA)
    assert changes == [(7, 2)]
    assert not displaced_points(places, known, ORDER, SIGMA, changes).any()


def test_time_is_counted_by_order_and_not_by_row(places: np.ndarray) -> None:
    known = np.ones((20, 4), bool)
    order = ORDER[::-1].copy()
    places[order >= 12, 1] += 0.1
    assert position_changes(places, known, order, SIGMA) == [(int(np.flatnonzero(order == 12)[0]), 1)]


def test_a_single_point_far_off_is_lonely_and_astray_and_no_change(places: np.ndarray) -> None:
    known = np.ones((20, 4), bool)
    places[9, 3] += 0.3
    assert position_changes(places, known, ORDER, SIGMA) == []
    for found in (isolated_points(places, known, ORDER, SIGMA), displaced_points(places, known, ORDER, SIGMA, [])):
        assert np.argwhere(found).tolist() == [[9, 3]]


def test_two_poses_elsewhere_are_too_few_for_a_place(places: np.ndarray) -> None:
    known = np.ones((20, 4), bool)
    places[9:11, 0] += 0.3
    assert position_changes(places, known, ORDER, SIGMA) == []
    assert np.argwhere(isolated_points(places, known, ORDER, SIGMA)).tolist() == [[9, 0], [10, 0]]


def test_a_target_elsewhere_in_every_pose_agrees_with_none(places: np.ndarray) -> None:
    known = np.ones((20, 4), bool)
    places[:, 1] += np.random.default_rng(3).normal(size=(20, 3))
    assert isolated_points(places, known, ORDER, SIGMA)[:, 1].all()


def test_the_spread_is_that_from_pose_to_pose(places: np.ndarray) -> None:
    known = np.ones((20, 4), bool)
    drifting = 5 * places + np.arange(20)[:, None, None] * 1e-6
    assert spread_in_time(drifting, known, ORDER, SIGMA) == pytest.approx(5 * SIGMA, rel=0.25)
    assert spread_in_time(places / 100, known, ORDER, SIGMA) == SIGMA


def test_no_mean_is_reported_for_unseen_targets(places: np.ndarray) -> None:
    known = np.ones((20, 4), bool)
    known[:, 2] = False
    middle = median_places(places, known)
    assert np.isnan(middle[2]).all()
    assert np.abs(middle[[0, 1, 3]]).max() < SIGMA


def test_a_place_is_as_loose_as_what_carries_it_leaves_it() -> None:
    """Points by which others are said to sit scatter as far as the body turns: against many draws of noise."""
    rng = np.random.default_rng(5)
    shape = np.array([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.0, 0.02, 0.0], [0.3, 0.1, 0.0], [0.01, 0.01, 0.0]])
    trusted = np.array([[True, True, True, False, False], [True, True, True, True, False]])
    loose = looseness(shape, trusted)
    assert (loose[trusted] == 1.0).all()
    for row, known in enumerate(trusted):
        moved = rng.normal(size=(4000, 5, 3)) * 1e-6
        fit = umeyama(shape, shape + moved, np.broadcast_to(known.astype(float), (4000, 5)))
        places = np.einsum("bji,bkj->bki", fit.R, shape + moved - fit.t[:, None]) - shape
        scatter = np.sqrt(np.mean(places**2, axis=(0, 2))) / 1e-6
        assert scatter[~known] == pytest.approx(loose[row, ~known], rel=0.05)


def test_a_loosely_known_target_counts_neither_as_lonely_nor_as_moved(places: np.ndarray) -> None:
    known, loose = np.ones((20, 4), bool), np.ones((20, 4))
    places[:, 2] *= 12.0
    loose[:, 2] = 12.0
    assert isolated_points(places, known, ORDER, SIGMA)[:, 2].any()
    assert not isolated_points(places, known, ORDER, SIGMA, loose).any()
    places[9:, 2] += 60 * SIGMA
    assert position_changes(places, known, ORDER, SIGMA, loose) == []
    places[9:, 2] += 1200 * SIGMA
    assert position_changes(places, known, ORDER, SIGMA, loose) == [(9, 2)]
