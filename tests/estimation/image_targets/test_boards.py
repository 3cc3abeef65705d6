"""Corners of boards: numbering independent of the attitude, no bias, and scatter as the covariance states."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from tests.estimation.image_targets.planes import board_pattern, exposed, homography, plane_picture, through
from tests.tolerance import assert_between, assert_close
from truing.estimation.image_targets import boards
from truing.estimation.image_targets.boards import BoardPlan, measure_board
from truing.estimation.image_targets.image_noise import ImageNoise

NOISE = ImageNoise(2.0**2 + 1 / 12, 0.0)
CHESS = BoardPlan("plate", "chessboard", columns=6, rows=5)
CHARUCO = BoardPlan("plate", "charuco", columns=4, rows=3, family="aruco4x4_50", marker_share=0.7)
SIZE, DRAWS = 170, 10


def seen(plan, turn, reach, size):
    """Four corners of a board, turned and tilted."""
    shape = np.array([plan.columns + 1.0, plan.rows + 1.0])
    square = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * shape / np.hypot(*shape)
    c, s = np.cos(turn), np.sin(turn)
    tilt = np.array([1.04, 0.95, 1.0, 1.08])[:, None]
    return reach * (square * [1.0, 0.85]) @ np.array([[c, s], [-s, c]]) * tilt + size / 2 + [0.31, -0.17]


def corners(plan, H):
    row, column = np.divmod(np.arange(plan.columns * plan.rows), plan.columns)
    return through(H, np.column_stack([(column + 1) / (plan.columns + 1), (row + 1) / (plan.rows + 1)]))


def test_corners_are_where_they_are_with_the_scatter_that_they_state():
    H = homography(seen(CHESS, 0.4, 140.0, SIZE))
    light = plane_picture(board_pattern(6, 5), H, SIZE, 0.7)
    rng = np.random.default_rng(1)
    found = [measure_board(exposed(light, rng), CHESS, NOISE) for _ in range(DRAWS)]
    assert all(one.number.tolist() == list(range(30)) for one in found)
    errors = np.array([one.xy_px for one in found]) - corners(CHESS, H)
    cov, mean = np.mean([one.cov_px2 for one in found], axis=0), errors.mean(0)
    noise = np.mean(np.einsum("nii->ni", cov)) / DRAWS
    assert_close(mean, np.zeros_like(mean), atol=0.02 + 4.0 * np.sqrt(noise))
    assert_between(float(np.mean(mean**2) - noise), -1.0, 0.01**2, what="mean square of what noise does not explain")
    z2 = np.einsum("dni,nij,dnj->", errors - mean, np.linalg.inv(cov), errors - mean)
    freedom = (DRAWS - 1) * mean.size
    assert_between(z2 / freedom, *(chi2.ppf([1e-4, 1 - 1e-4], freedom) / freedom), what="scatter over the stated one")


@pytest.mark.parametrize("turn", [1.7, 3.3, 5.0])
def test_numbers_stay_however_the_board_is_turned(turn):
    H = homography(seen(CHESS, turn, 140.0, SIZE))
    grey = exposed(plane_picture(board_pattern(6, 5), H, SIZE, 0.6), np.random.default_rng(2))
    found = measure_board(grey, CHESS, NOISE)
    assert_close(found.xy_px, corners(CHESS, H)[found.number], atol=0.1)
    assert len(found.number) == 30


def test_a_board_with_markers_is_known_by_a_part_of_it():
    H = homography(seen(CHARUCO, 2.0, 200.0, 220))
    light = plane_picture(board_pattern(4, 3, "aruco4x4_50", 0.7), H, 220, 0.6, fine=5)
    light[:, :70] = 1.0
    found = measure_board(exposed(light, np.random.default_rng(3)), CHARUCO, NOISE)
    truth = corners(CHARUCO, H)
    whole = np.flatnonzero(truth[:, 0] > 110)
    assert set(whole.tolist()) <= set(found.number.tolist()) < set(range(12))
    assert_close(found.xy_px, truth[found.number], atol=0.15)


def test_no_board_no_corners():
    for plan in (CHESS, CHARUCO):
        found = measure_board(np.random.default_rng(4).integers(0, 255, (60, 80)).astype(np.uint8), plan, NOISE)
        assert len(found.number) == len(found.xy_px) == len(found.cov_px2) == 0


def test_a_large_image_is_searched_smaller_and_measured_at_the_whole(monkeypatch):
    H = homography(seen(CHESS, 0.4, 140.0, SIZE))
    grey = exposed(plane_picture(board_pattern(6, 5), H, SIZE, 0.7), np.random.default_rng(5))
    monkeypatch.setattr(boards, "_SEARCHED", grey.size // 2)
    found = measure_board(grey, CHESS, NOISE)
    assert_close(found.xy_px, corners(CHESS, H), atol=0.02 + 4.0 * float(np.sqrt(found.cov_px2.max())))
