"""A declared noise of an axis that is far too large is reported; effects of the axis do not trigger this."""

from __future__ import annotations

import numpy as np
import pytest

from truing.stages.quality.axis_checks import noise_of_rows

COMMAND = np.tile(np.linspace(-1.0, 1.0, 20), 2)
DIRECTION = np.repeat([1.0, -1.0], 20)
NOISE = 1e-5


def _verdicts(declared: float, effect: np.ndarray | float = 0.0, times: int = 200) -> np.ndarray:
    rng = np.random.default_rng(8)
    drawn = (effect + rng.normal(scale=NOISE, size=40) for _ in range(times))
    return np.array([noise_of_rows("load", COMMAND, DIRECTION, own, declared).verdict for own in drawn])


def test_a_noise_declared_many_times_too_large_is_reported_and_the_right_one_is_not() -> None:
    assert set(_verdicts(70.0 * NOISE)) == {"warn"}
    assert set(_verdicts(4.0 * NOISE)) == {"warn"}
    assert set(_verdicts(NOISE)) == {"pass"}
    assert np.mean(_verdicts(1.5 * NOISE, times=2000) == "warn") < 1e-3 + 4.0 * np.sqrt(1e-3 / 2000)


@pytest.mark.parametrize("size", [1e-4, 1e-2])
def test_effects_of_the_axis_never_make_the_declared_noise_look_too_large(size: float) -> None:
    backlash, wave = size * DIRECTION, size * np.sin(7.0 * COMMAND)
    assert set(_verdicts(NOISE, backlash + wave)) == {"pass"}


def test_value_is_the_scatter_over_the_declared_noise() -> None:
    rng = np.random.default_rng(9)
    command, direction = np.linspace(0.0, 1.0, 4000), np.ones(4000)
    found = noise_of_rows("load", command, direction, rng.normal(scale=NOISE, size=4000), 10.0 * NOISE)
    assert found.value == pytest.approx(0.1, rel=0.1)


def test_few_rows_coarse_readings_and_no_declared_noise_are_not_evaluated() -> None:
    rng = np.random.default_rng(10)
    own = rng.normal(scale=NOISE, size=40)
    coarse = np.round(own / NOISE) * NOISE
    assert noise_of_rows("load", COMMAND[:10], DIRECTION[:10], own[:10], NOISE).verdict == "not evaluated"
    assert noise_of_rows("load", COMMAND, DIRECTION, coarse, NOISE).verdict == "not evaluated"
    assert noise_of_rows("load", COMMAND, DIRECTION, own, 0.0).verdict == "not evaluated"
