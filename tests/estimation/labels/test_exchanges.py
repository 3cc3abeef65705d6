"""Exchanged labels are found among gross errors and in bodies with few targets; right labels stay."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.tolerance import assert_close
from truing.estimation.labels.exchanges import Exchange, exchanges, residuals_after_exchange

POSES, NOISE_M = 12, 5e-6


def _body(rng: np.random.Generator, count: int) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Shape (T, 3), points in frames of their own (B, T, 3), rotations and residuals along the body's axes."""
    shape = rng.uniform(-0.1, 0.1, (count, 3))
    turn = np.linalg.qr(rng.normal(size=(POSES, 3, 3)))[0]
    turn *= np.linalg.det(turn)[:, None, None]
    residual = rng.normal(0.0, NOISE_M, (POSES, count, 3))
    return shape, (shape + residual) @ np.swapaxes(turn, 1, 2) + rng.normal(size=(POSES, 1, 3)), turn, residual


def _exchange(points: NDArray, residual: NDArray, shape: NDArray, one: Exchange) -> None:
    pair, other = [one.first, one.second], [one.second, one.first]
    points[one.pose, pair] = points[one.pose, other]
    residual[one.pose, pair] = residual[one.pose, other] + shape[other] - shape[pair]


@pytest.mark.parametrize("count", [4, 5, 12])
def test_exchanges_are_found_and_no_others(count: int) -> None:
    rng = np.random.default_rng(count)
    shape, points, _, residual = _body(rng, count)
    hidden = [Exchange(2, 0, 3), Exchange(7, 1, 2)]
    right = residual.copy()
    for one in hidden:
        _exchange(points, residual, shape, one)
    if count < 6:  # no pose of few targets can be found with two of them exchanged
        residual[[2, 7]] = np.nan
    is_observed = np.ones((POSES, count), bool)
    found = exchanges(residual, points, is_observed, shape, NOISE_M)
    assert sorted(found, key=lambda one: one.pose) == hidden
    again, anew = residuals_after_exchange(residual, points, is_observed, shape, found)
    assert anew.any() == (count < 6)
    assert_close(again, right, atol=4e-5, what="residuals once exchanged, m")


def test_gross_errors_are_no_exchanges_and_hide_none() -> None:
    rng = np.random.default_rng(5)
    shape, points, turn, residual = _body(rng, 12)
    for pose in range(POSES):
        for target in rng.choice(12, 2, replace=False):
            way = rng.normal(size=3) * 1e-3
            residual[pose, target] += way
            points[pose, target] += turn[pose] @ way
    one = Exchange(
        4, *sorted(rng.choice(np.flatnonzero(np.linalg.norm(residual[4], axis=-1) < 1e-4), 2, False).tolist())
    )
    _exchange(points, residual, shape, one)
    assert exchanges(residual, points, np.ones((POSES, 12), bool), shape, NOISE_M) == [one]


def test_in_a_pose_of_few_targets_with_labels_exchanged_a_moved_one_is_still_reported() -> None:
    rng = np.random.default_rng(8)
    shape, points, turn, residual = _body(rng, 4)
    shift = np.array([3e-4, -2e-4, 1e-4])
    points[3, 1] += turn[3] @ shift
    _exchange(points, residual, shape, Exchange(3, 0, 2))
    is_observed = np.ones((POSES, 4), bool)
    found = exchanges(np.full_like(residual, np.nan), points, is_observed, shape, NOISE_M)
    assert found == [Exchange(3, 0, 2)]
    right, _ = residuals_after_exchange(residual, points, is_observed, shape, found)
    assert_close(right[3, 1], shift, atol=8e-5, what="its shift, m")
    assert_close(right[3, [0, 2, 3]], np.zeros((3, 3)), atol=4e-5, what="the others, m")


def test_few_targets_with_a_gross_error_are_not_called_exchanged() -> None:
    rng = np.random.default_rng(6)
    shape, points, _, residual = _body(rng, 4)
    points[:, 1] += rng.normal(size=(POSES, 3)) * 2e-3
    assert exchanges(np.full_like(residual, np.nan), points, np.ones((POSES, 4), bool), shape, NOISE_M) == []
