"""A model whose errors exceed what noise alone gives is incomplete, though no test of its residuals fails."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

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


def test_errors_of_a_fifth_above_the_floor_are_seen_whatever_the_unit() -> None:
    assert _rate(1.2, 0.0) > 0.9


def test_errors_within_a_tenth_of_the_floor_are_left_to_the_uncertainty_of_the_declared_noise() -> None:
    assert _rate(1.05, 0.0) < 0.2
