"""The noise estimated from a photograph agrees with the rendered noise, whatever the scene shows."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from truing.estimation.image_targets.image_noise import estimate_noise


def steps(rng, read, gain, shape=(600, 800)):
    """Grey patches of many levels, with texture on a third of them."""
    level = np.kron(rng.uniform(20, 200, (6, 8)), np.ones((shape[0] // 6, shape[1] // 8)))
    level[: shape[0] // 3] += 25 * np.sin(np.arange(shape[1]) * 0.7)
    return level, level + np.sqrt(read**2 + gain * level) * rng.normal(size=shape)


@pytest.mark.parametrize(("read", "gain"), [(1.0, 0.0), (3.0, 0.0), (1.5, 0.05), (0.8, 0.2)])
def test_read_and_photon_noise_are_found_next_to_texture(read, gain):
    _, grey = steps(np.random.default_rng(3), read, gain)
    found = estimate_noise(np.clip(np.rint(grey), 0, 255).astype(np.uint8))
    for level in (40.0, 180.0):
        true = read**2 + gain * level + 1 / 12
        assert 0.8 < found.variance(np.array(level)) / true < 1.25
    assert found.correlation < 1.15


def test_noise_that_neighbours_share_is_known_to_count_more():
    rng = np.random.default_rng(4)
    smooth = gaussian_filter(rng.normal(size=(400, 600)), 0.6)
    grey = np.rint(100 + 3 * smooth / smooth.std() + np.arange(600) / 20).astype(np.uint8)
    assert 2.0 < estimate_noise(grey).correlation < 6.0
    white = np.rint(100 + 3 * rng.normal(size=(400, 600))).astype(np.uint8)
    assert estimate_noise(white).correlation < 1.1


def test_a_picture_that_shows_no_noise_has_that_of_rounding():
    assert estimate_noise(np.full((50, 50), 90, np.uint8)).read_var == pytest.approx(1 / 12)
    assert estimate_noise(np.zeros((3, 3), np.uint8)).read_var == pytest.approx(1 / 12)
