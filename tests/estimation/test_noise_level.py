"""Noise as declared is accepted within what the declaration is worth; noise far above it is not."""

from __future__ import annotations

import numpy as np
import pytest

from tests.tolerance import assert_between
from truing.estimation.noise_level import noise_level
from truing.estimation.whitening import Linearised, Whitened, whiten


def _fitted(level: float, seed: int) -> Whitened:
    rng = np.random.default_rng(seed)
    poses, rows, local, shared = 20, 30, 2, 3
    noise = level * rng.normal(size=(poses, rows))
    # Unknowns of which little is known beforehand, so that their priors add nothing to the level.
    by_local, by_shared = 1e3 * rng.normal(size=(poses, rows, local)), 1e3 * rng.normal(size=(poses, rows, shared))
    none = np.zeros((poses, local)), np.zeros(shared), np.zeros(0), np.zeros((0, shared))
    return whiten(
        Linearised(
            noise,
            by_local,
            by_shared,
            *none,
            np.ones((poses, rows), bool),
            np.zeros(local, bool),
            np.zeros(shared, bool),
        )
    )


@pytest.mark.parametrize("level", [0.8, 1.0, 1.3])
def test_the_ratio_covers_the_truth(level: float) -> None:
    found = [noise_level(_fitted(level, seed)) for seed in range(200)]
    pulls = np.array([(one.ratio - level) / one.sigma for one in found])
    assert_between(float(np.mean(pulls)), -0.3, 0.3, what="mean pull")  # four standard deviations of the mean
    assert_between(float(np.std(pulls)), 0.8, 1.2, what="spread of pulls")


def test_a_tenth_too_much_is_no_finding_and_a_half_is() -> None:
    assert noise_level(_fitted(1.1, 1)).p_value > 0.05
    assert noise_level(_fitted(1.5, 2)).p_value < 0.001
    assert noise_level(_fitted(0.5, 3)).p_value > 0.999
