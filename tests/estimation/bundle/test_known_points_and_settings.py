"""Known points and principal distances of images: deviating ones are named, or reported as undetermined."""

from __future__ import annotations

import numpy as np
import pytest

from truing.estimation.bundle.image_stability import _settings
from truing.estimation.bundle.known_points import known_point_errors
from truing.estimation.rotation import exp_so3

SIGMA_M = 1e-5
SQUARE = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.5, 0.5, 0.0], [0.0, 0.5, 0.0]])
SOLID = np.random.default_rng(3).uniform(-0.3, 0.3, (8, 3))


def _errors(points: np.ndarray, off: dict[int, tuple[float, float, float]], seed: int = 0):
    """Rays see the points turned, shifted and scaled; some are known elsewhere."""
    rng, count = np.random.default_rng(seed), len(points)
    seen = 1.3 * points @ exp_so3(np.array([0.3, -0.2, 0.5])).T + [1.0, 2.0, 3.0] + rng.normal(0, SIGMA_M, (count, 3))
    known = points + rng.normal(0.0, SIGMA_M, (count, 3))
    for place, by in off.items():
        known[place] += by
    cov = np.broadcast_to(SIGMA_M**2 * np.eye(3), (count, 3, 3))
    return known_point_errors(seen, SIGMA_M**2 * np.eye(3 * count), known, cov)


def test_a_point_that_is_off_is_reported_with_its_error() -> None:
    found = _errors(SOLID, {2: (0.0, 0.003, 0.0)})
    assert found.resolved
    assert np.flatnonzero(found.wrong).tolist() == [2]
    assert np.all(np.abs(found.off_m[2] - [0.0, 0.003, 0.0]) < 5.0 * found.sigma_m[2])


def test_several_points_that_are_off_are_distinguished() -> None:
    found = _errors(SOLID, {2: (0.0, 0.003, 0.0), 5: (0.001, 0.0, -0.002), 7: (0.0, 0.0, 2e-4)})
    assert np.flatnonzero(found.wrong).tolist() == [2, 5, 7]


def test_the_corner_of_a_square_off_its_plane_is_not_identifiable() -> None:
    out_of_plane, within = _errors(SQUARE, {1: (0.0, 0.0, 0.003)}), _errors(SQUARE, {1: (0.003, 0.0, 0.0)})
    assert not out_of_plane.resolved
    assert not out_of_plane.wrong.any()
    assert out_of_plane.inflation > 100.0
    assert np.flatnonzero(within.wrong).tolist() == [1]


def test_good_known_points_are_seldom_called_wrong() -> None:
    found = [_errors(SOLID, {}, seed) for seed in range(200)]
    assert (
        sum(not one.resolved or bool(one.wrong.any()) for one in found) <= 2
    )  # expected: 0.4 by a level of 0.001 each
    squares = np.concatenate([one.T[np.isfinite(one.T)] for one in found])
    assert np.mean(squares) == pytest.approx(3.0, abs=0.3)


@pytest.mark.parametrize("changed", [[3], [1, 4, 7, 11, 15, 19], list(range(12, 24))])
def test_images_of_another_setting_are_found(changed: list[int]) -> None:
    rng = np.random.default_rng(1)
    common = 0.8 * np.ones((24, 24)) + 0.2 * np.eye(24)  # strongly correlated, as images of one pose are
    values = 4000.0 + rng.multivariate_normal(np.zeros(24), common)
    values[changed] += 12.0
    found = _settings(0, np.arange(24), values, [common])
    minority = changed if len(changed) < 12 else None
    apart = np.flatnonzero(found.setting > 0).tolist()
    assert apart == minority if minority else len(apart) == 12
    assert np.abs(np.abs(found.off_px[apart]) - 12.0).max() < 5.0


def test_defects_of_a_camera_model_are_not_taken_for_a_changed_setting() -> None:
    """Principal distances that scatter by many sigmas, image by image."""
    values = 4000.0 + np.random.default_rng(2).normal(0.0, 6.0, 24)
    found = _settings(0, np.arange(24), values, [np.eye(24)])
    assert found.p_value < 1e-6
    assert (found.setting > 0).sum() <= 1
