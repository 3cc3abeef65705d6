"""A model whose errors exceed what noise alone gives is incomplete, though no test of its residuals fails."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from truing.inference.noise import NOISE_PRIOR_FREEDOM
from truing.inference.prediction import NoiseFloor, is_beyond_floor

EPOCHS, CHANNELS = 60, 2
FLOOR = np.array([1e-3, 2e-5])  # m and rad: channels of different units


def _is_beyond(rng: np.random.Generator, factor: float = 1.0, shared: float = 0.0) -> bool:
    """Errors of ``factor`` times the floor; of their variance, epochs share the part ``shared``."""
    own = rng.normal(size=(EPOCHS, CHANNELS, 3))
    common = rng.normal(size=(EPOCHS, 1, 1))
    gap = factor * FLOOR[:, None] * (np.sqrt(1.0 - shared) * own + np.sqrt(shared) * common)
    error = SimpleNamespace(gap=gap, is_observed=np.ones((EPOCHS, CHANNELS), bool), measured=SimpleNamespace(size=3))
    return is_beyond_floor(error, NoiseFloor(FLOOR**2, np.full(CHANNELS, EPOCHS)))  # type: ignore[arg-type]


def _rate(factor: float, shared: float, trials: int = 400) -> float:
    rng = np.random.default_rng(3)
    return float(np.mean([_is_beyond(rng, factor, shared) for _ in range(trials)]))


def test_noise_alone_is_hardly_ever_called_more_also_where_epochs_share_it() -> None:
    assert _rate(1.0, 0.0) < 0.02
    assert _rate(1.0, 0.9) < 0.025


def test_errors_of_two_fifths_above_the_floor_are_seen_whatever_the_unit() -> None:
    assert _rate(1.4, 0.0) > 0.9


def test_noise_that_was_declared_wrong_by_a_tenth_is_no_missing_effect() -> None:
    """One standard deviation of what declared noise is known to; at two, one campaign in five may be doubted."""
    assert _rate(1.1, 0.0) == 0.0
    assert _rate(1.2, 0.0) < 0.2


def test_noise_declared_as_well_as_it_is_known_to_be_is_called_too_large_once_in_a_hundred_campaigns() -> None:
    rng = np.random.default_rng(4)
    declared = np.sqrt(NOISE_PRIOR_FREEDOM / rng.chisquare(NOISE_PRIOR_FREEDOM, 2000))
    assert 0.004 < np.mean([_is_beyond(rng, float(factor)) for factor in declared]) < 0.017
