"""A gross error is isolated in time; a displaced target is not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tests.tolerance import assert_between
from truing.inference.screening import alone_in_time, gross_errors

POSES, TARGETS, NOISE_M = 40, 20, 5e-6


def _noise(rng: np.random.Generator) -> NDArray:
    values = rng.normal(0.0, NOISE_M, (POSES, TARGETS, 3))
    values[rng.random((POSES, TARGETS)) < 0.05] = np.nan
    return values


def _hit(values: NDArray, rng: np.random.Generator, share: float = 0.03) -> NDArray:
    """Gross errors of 0.1 to 5 mm in a share of the points; which (B, T)."""
    wrong = (rng.random(values.shape[:2]) < share) & np.isfinite(values).all(-1)
    way = rng.normal(size=values.shape)
    way *= (np.exp(rng.uniform(np.log(1e-4), np.log(5e-3), wrong.shape)) / np.linalg.norm(way, axis=-1))[..., None]
    values += np.where(wrong[..., None], way, 0.0)
    return wrong


def test_gross_errors_are_alone_and_nothing_else_is() -> None:
    rng = np.random.default_rng(1)
    values, order = _noise(rng), rng.permutation(POSES).astype(float)
    wrong = _hit(values, rng)
    alone = alone_in_time(values, order, np.zeros(wrong.shape, bool))
    assert (alone == wrong).all()


def test_a_moved_target_is_not_alone_however_late_although_others_suspect_it() -> None:
    rng = np.random.default_rng(2)
    values, order = _noise(rng), rng.permutation(POSES).astype(float)
    suspect = np.zeros((POSES, TARGETS), bool)
    for target, first in ((3, 33), (4, 20), (5, 4)):
        late = order >= first
        values[late, target] += 3e-4 * np.array([1.0, -1.0, 0.5])
        suspect[late, target] = True
    wrong = _hit(values, rng, 0.02)
    alone = alone_in_time(values, order, suspect | wrong)
    assert_between(float((alone & ~wrong).sum()), 0, 2, what="right points called alone")
    assert_between(float((alone & wrong).sum() / wrong.sum()), 0.9, 1.0, what="share of gross errors reported")


def test_three_poses_before_a_target_was_moved_are_enough() -> None:
    """The one in the middle has one neighbour on either side, and not two on one."""
    values = np.random.default_rng(7).normal(0.0, NOISE_M, (7, 2, 3))
    values[3:, 0] += [3e-3, 0.0, 4e-3]
    values[5, 1] += 2e-3
    alone = alone_in_time(values, np.arange(7.0), np.arange(7)[:, None] >= [3, 5])
    assert np.argwhere(alone).tolist() == [[5, 1]]


def test_a_point_where_it_is_expected_is_kept_next_to_neighbours_that_are_not() -> None:
    rng = np.random.default_rng(6)
    values = 1e-6 * rng.normal(size=(POSES, 1, 3))
    values[[7, 8, 9, 11, 12, 13]] += np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])[:, None, None] * 1e-3
    alone = alone_in_time(values, np.arange(POSES) * 1.0, np.zeros((POSES, 1), bool))
    assert not alone[10, 0]
    assert alone[8, 0]


def test_a_target_that_moves_in_all_poses_is_not_alone_in_time() -> None:
    rng = np.random.default_rng(3)
    values = _noise(rng)
    values[:, 7] += 1e-4 * rng.uniform(-1, 1, (POSES, 1))
    assert not alone_in_time(values, np.arange(POSES) * 1.0, np.zeros((POSES, TARGETS), bool)).any()


def test_after_a_fit_a_target_moved_late_is_kept_and_a_gross_error_is_not() -> None:
    rng = np.random.default_rng(4)
    turn = np.linalg.qr(rng.normal(size=(POSES, TARGETS, 3, 3)))[0]
    axes, order, is_observed = turn / NOISE_M, np.arange(POSES) * 1.0, rng.random((POSES, TARGETS)) > 0.05
    rest = rng.normal(size=(POSES, TARGETS, 3))
    rest[35:, 6] += (
        axes[35:, 6]
        @ np.array(
            [
                6e-5,
                0.0,
                3e-5,
            ]
        )[:, None]
    )[..., 0]
    rest[12, 8] += 30.0
    is_observed[12, 8] = True
    found = gross_errors(rest, is_observed, axes, order)
    assert found[12, 8]
    assert found.sum() == 1
    assert gross_errors(rest, is_observed)[35:, 6].any()  # each pose for itself, they would be gross
