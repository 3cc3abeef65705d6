"""Loops of known width are recovered from steps without fixed drives, under any drift."""

from __future__ import annotations

import numpy as np
import pytest

from tests.tolerance import assert_between, assert_close
from truing.estimation.sensor.loops import loops

TIME = np.linspace(0.25, 6.25, 997)
DRIVE = np.sin(2 * np.pi * TIME)
WIDTH = np.array([0.2, -0.1])


def _response(noise: float = 0.0) -> np.ndarray:
    """Ellipses that open by WIDTH (rising less falling) at zero drive, and a drift."""
    rng = np.random.default_rng(0)
    rising = np.cos(2 * np.pi * TIME)
    clean = DRIVE[:, None] + rising[:, None] * WIDTH / 2 + 0.3 * TIME[:, None]
    return clean + noise * rng.normal(size=clean.shape)


def test_the_width_is_found_and_a_drift_is_not():
    found = loops(DRIVE, _response(), 0.0)
    assert len(found.step) == 10
    assert_close(found.gap, np.tile(WIDTH, (10, 1)), atol=2e-4)  # of a chord between steps


def test_the_mean_scatters_by_its_sigma():
    found = loops(DRIVE, _response(0.01), 0.0, least=0.2)
    assert_between(float(np.max(np.abs(found.mean - WIDTH / 2 / (found.amplitude.mean(0))) / found.sigma)), 0.0, 5.0)
    assert_between(float(found.sigma.mean() * 2 * found.amplitude.mean()), 0.002, 0.008)


def test_to_and_fro_about_the_level_is_no_loop():
    jitter = DRIVE + 0.03 * np.random.default_rng(1).normal(size=len(DRIVE))
    assert len(loops(jitter, _response(), 0.0, least=0.3).step) == 10
    assert len(loops(jitter, _response(), 0.0).step) > 10


def test_a_drive_that_never_returns_has_no_loop():
    with pytest.raises(ValueError, match=r"found 1 crossings of 0\.5"):
        loops(TIME / 6, _response(), 0.5)
