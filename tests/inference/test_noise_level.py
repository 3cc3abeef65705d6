"""Declared noise is accepted within its own uncertainty; much larger noise is not."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from tests.tolerance import assert_between
from truing.inference.doubts import of_larger_noise
from truing.inference.linear_problem import Whitened, whiten
from truing.inference.linearised_model import LinearisedModel
from truing.inference.noise import NoiseLevel, noise_level
from truing.inference.observations import Observations


def _fitted(level: float, seed: int) -> Whitened:
    rng = np.random.default_rng(seed)
    poses, rows, local, shared = 20, 30, 2, 3
    noise = level * rng.normal(size=(poses, rows))
    # Unknowns of which little is known beforehand, so that their priors add nothing to the level.
    by_local, by_shared = 1e3 * rng.normal(size=(poses, rows, local)), 1e3 * rng.normal(size=(poses, rows, shared))
    none = np.zeros((poses, local)), np.zeros(shared), np.zeros(0), np.zeros((0, shared))
    return whiten(
        LinearisedModel(
            noise,
            by_local,
            by_shared,
            *none,
            np.ones((poses, rows), bool),
            np.zeros(local, bool),
            np.zeros(shared, bool),
        )
    )


def _level(level: float, seed: int) -> NoiseLevel:
    """Ten points a pose whose declared noise is that of the fit."""
    unit = np.tile(np.eye(3), (20, 10, 1, 1))
    measured = Observations(np.zeros((20, 10, 3)), unit, np.ones((20, 10), bool))
    return noise_level(_fitted(level, seed), measured, unit)


def test_the_level_is_over_what_was_declared_and_not_over_what_was_used() -> None:
    unit = np.tile(np.eye(3), (20, 10, 1, 1))
    used = Observations(np.zeros((20, 10, 3)), 4.0 * unit, np.ones((20, 10), bool))
    assert noise_level(_fitted(1.0, 4), used, unit).ratio == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize("level", [0.8, 1.0, 1.3])
def test_the_ratio_covers_the_truth(level: float) -> None:
    found = [_level(level, seed) for seed in range(200)]
    pulls = np.array([(one.ratio - level) / one.sigma for one in found])
    assert_between(float(np.mean(pulls)), -0.3, 0.3, what="mean pull")  # four standard deviations of the mean
    assert_between(float(np.std(pulls)), 0.8, 1.2, what="spread of pulls")


def test_a_tenth_too_much_is_no_finding_and_a_half_is() -> None:
    assert _level(1.1, 1).p_value > 0.05
    assert _level(1.5, 2).p_value < 0.001
    assert _level(0.5, 3).p_value > 0.999


def test_the_noise_level_of_a_target_is_estimated_apart_from_the_others() -> None:
    """Ten points a pose, the first with twice the noise: its own level is reported, and that of the others."""
    unit = np.tile(np.eye(3), (20, 10, 1, 1))
    whitened, measured = _fitted(1.0, 5), Observations(np.zeros((20, 10, 3)), unit, np.ones((20, 10), bool))
    quieter = unit.copy()
    quieter[:, 0] /= 4.0
    first = np.arange(10) == 0
    own, others = (noise_level(whitened, measured, quieter, targets) for targets in (first, ~first))
    assert_between(own.ratio, 2.0 - 4 * own.sigma, 2.0 + 4 * own.sigma, what="level of the first")
    assert_between(others.ratio, 1.0 - 4 * others.sigma, 1.0 + 4 * others.sigma, what="level of the others")


def test_an_effect_of_eight_amplitudes_is_significant_at_the_noise_that_was_found() -> None:
    """Squares of 66 with eight amplitudes are no chance at the declared noise, and chance at twice that noise."""
    null = SimpleNamespace(
        group_of=lambda kind, rank: rank,
        raw=lambda squares, rank, share: float(chi2.sf(squares, rank)),
        threshold=lambda group, level: level / 100.0,
    )
    candidate = SimpleNamespace(kind="unexplained", signature=SimpleNamespace(rank=8))
    steps: Any = {"drift": SimpleNamespace(round=SimpleNamespace(null=null), candidate=candidate)}
    own: Any = SimpleNamespace(cause=SimpleNamespace(key="drift"), signal_to_noise=66.0**0.5)
    other: Any = SimpleNamespace(cause=SimpleNamespace(key="named"), signal_to_noise=1.0)
    assert of_larger_noise(steps, [own, other], 0.7, 0.05) == set()  # noise below the declared one proves nothing
    assert of_larger_noise(steps, [own, other], 1.1, 0.05) == set()
    assert of_larger_noise(steps, [own, other], 2.0, 0.05) == {"drift"}
