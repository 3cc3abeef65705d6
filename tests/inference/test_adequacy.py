"""Tests of the final model as a whole keep their level, and detect effects that the model lacks."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from tests.tolerance import assert_between
from truing.inference.adequacy import Adequacy, AdequacyTest, MisfitKind, like_neighbours, noise_excess

EPOCHS, CHANNELS = 40, 6


def _worst(rest: np.ndarray, seed: int, **groups: np.ndarray) -> float:
    rng = np.random.default_rng(seed)
    columns = {"time_s": np.arange(EPOCHS) * 60.0, "inputs": rng.uniform(-1, 1, (EPOCHS, 3))}
    return Adequacy(tuple(like_neighbours(rest, columns, rng, **groups))).p_value


@pytest.mark.parametrize("tails", ["normal", "heavy"])
def test_white_noise_is_rejected_as_often_as_its_level_says(tails: str) -> None:
    rng = np.random.default_rng(1)
    draw = rng.standard_normal if tails == "normal" else lambda size: rng.standard_t(3, size)
    p_values = np.array([_worst(draw((EPOCHS, CHANNELS, 1)), seed) for seed in range(120)])
    assert 0.005 <= np.mean(p_values <= 0.05) <= 0.11
    assert np.min(p_values) > 1e-5


def test_p_values_of_white_noise_are_uniform_though_permutations_end_early() -> None:
    rng = np.random.default_rng(7)
    columns = {"time_s": np.arange(EPOCHS) * 60.0}
    rests = rng.standard_normal((400, EPOCHS, CHANNELS, 1))
    p_values = np.array([next(iter(like_neighbours(rest, columns, rng))).p_value for rest in rests])
    for level in (0.1, 0.3, 0.5, 0.8):
        assert_between(np.mean(p_values <= level), level - 0.075, level + 0.075)  # three standard deviations


def test_permutations_end_once_a_misfit_is_far_from_significant() -> None:
    rng = np.random.default_rng(8)
    drawn = []
    monitored = SimpleNamespace(permutation=lambda count: drawn.append(count) or rng.permutation(count))
    time = {"time_s": np.arange(EPOCHS) * 1.0}
    anticorrelated = (-1.0) ** np.arange(EPOCHS)[:, None, None] + 0.1 * rng.standard_normal((EPOCHS, CHANNELS, 1))
    course = np.linspace(-2.0, 2.0, EPOCHS)[:, None, None] + rng.standard_normal((EPOCHS, CHANNELS, 1))
    (test,) = like_neighbours(anticorrelated, time, monitored)
    assert test.p_value > 0.5
    assert len(drawn) < 50
    (test,) = like_neighbours(course, time, monitored)
    assert test.p_value < 1e-6
    assert len(drawn) >= 499


def test_a_slow_course_is_seen_along_time_and_not_along_inputs() -> None:
    rng = np.random.default_rng(2)
    time = np.linspace(0, 1, EPOCHS)
    course = np.sin(2 * np.pi * 1.5 * time)[:, None, None] * rng.uniform(1.0, 2.0, (1, CHANNELS, 1))
    columns = {"time_s": time, "inputs": rng.uniform(-1, 1, (EPOCHS, 3))}
    tests = {test.along: test for test in like_neighbours(course + rng.normal(size=course.shape), columns, rng)}
    assert tests["time_s"].p_value < 1e-6
    assert tests["time_s"].value > 0.2
    assert tests["inputs"].p_value > 1e-3


def test_missing_observations_and_constant_columns_are_left_alone() -> None:
    rng = np.random.default_rng(3)
    rest = np.where(rng.random((EPOCHS, CHANNELS, 1)) < 0.3, np.nan, rng.normal(size=(EPOCHS, CHANNELS, 1)))
    columns = {"time_s": np.arange(EPOCHS) * 1.0, "load": np.full(EPOCHS, 3.0), "gap": np.full(EPOCHS, np.nan)}
    assert [test.along for test in like_neighbours(rest, columns, rng)] == ["time_s"]
    assert not list(like_neighbours(rest[:5], {"time_s": np.arange(5.0)}, rng))


def test_permuting_whole_groups_keeps_their_common_offset_from_counting_as_misfit() -> None:
    rng = np.random.default_rng(4)
    groups = np.repeat(np.arange(8), 5)
    rest = rng.normal(size=(8, CHANNELS, 1))[groups] + rng.normal(size=(EPOCHS, CHANNELS, 1))
    assert _worst(rest, 4) < 1e-4
    assert _worst(rest, 4, groups=groups) > 0.01


def test_noise_far_above_the_declared_one_is_a_lack_of_fit_and_a_tenth_is_not() -> None:
    assert noise_excess(MisfitKind.INPUT_NOISE, 1.1, 100.0).p_value > 0.1
    assert noise_excess(MisfitKind.INPUT_NOISE, 1.8, 100.0).p_value < 1e-6
    assert noise_excess(MisfitKind.INPUT_NOISE, 1.8, 3.0).p_value > 0.05


def test_tests_are_corrected_for_kinds_and_for_columns() -> None:
    found = Adequacy(
        (
            AdequacyTest(MisfitKind.INPUT_NOISE, "", 1.3, 0.02),
            AdequacyTest(MisfitKind.LIKE_NEIGHBOURS, "time_s", 0.3, 0.01),
            AdequacyTest(MisfitKind.LIKE_NEIGHBOURS, "inputs", 0.1, 0.6),
        )
    )
    assert found.p_value == pytest.approx(0.04)
    assert found.worst is not None
    assert Adequacy(()).p_value == 1.0
