"""Deviating epochs are distinguished from single bad values and from heavy tails, at a known rate."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from truing.inference.deviating_epochs import p_values

LEVEL = 0.01
EPOCHS, VALUES, SIZE = 60, 4, 3


def _fitted(rest: np.ndarray, frame: int = 0) -> Any:
    """A fit without inputs, of unit noise, with these whitened residuals (B, K, d)."""
    whitened = SimpleNamespace(rest=rest.ravel(), problem=SimpleNamespace(local_value=np.zeros((len(rest), 0))))
    fit = SimpleNamespace(whitened=whitened, frames=SimpleNamespace(size=frame))
    measured = SimpleNamespace(is_observed=np.ones(rest.shape[:2], bool), size=rest.shape[2])
    return SimpleNamespace(
        fit=fit, measured=measured, noise_ratio=1.0, model=SimpleNamespace(unpredicted=np.zeros(0, bool))
    )


@pytest.mark.parametrize(("freedom", "most"), [(np.inf, 0.01), (5.0, 0.02)])
def test_noise_deviates_no_oftener_than_stated(freedom: float, most: float) -> None:
    """Also noise with the tails of Student's t, scaled to unit variance. 600 campaigns."""
    rng = np.random.default_rng(3)
    shape = (600, EPOCHS, VALUES, SIZE)
    noise = rng.normal(size=shape) if np.isinf(freedom) else rng.standard_t(freedom, shape) / np.sqrt(5.0 / 3.0)
    assert np.mean([np.min(p_values(_fitted(rest))) < LEVEL for rest in noise]) <= most


def test_one_bad_value_is_no_deviating_epoch_and_several_are() -> None:
    rest = np.random.default_rng(4).normal(size=(EPOCHS, VALUES, SIZE))
    rest[7, 2] += 50.0
    rest[9, :, 0] += 5.0
    assert np.flatnonzero(p_values(_fitted(rest)) < LEVEL).tolist() == [9]


def test_residuals_absorbed_by_a_free_frame_do_not_count() -> None:
    rest = np.random.default_rng(5).normal(size=(EPOCHS, VALUES, SIZE))
    assert np.all(p_values(_fitted(rest, frame=6)) <= p_values(_fitted(rest)))
    assert np.all(np.isnan(p_values(_fitted(rest[:, :1]))))
