"""Scatter is named where errors are larger in one place, but not for a few large errors or a systematic pattern."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tests.tolerance import assert_between
from truing.inference.heavy_tails import has_heavy_tails, is_of_place, p_value_of_repeats

STEPS, CHANNELS, RUN = 119, 6, 17
CAMPAIGNS = 30


def _noise(rng: np.random.Generator) -> NDArray:
    return rng.normal(size=(STEPS, CHANNELS, 1))


def _runs() -> NDArray:
    return np.arange(STEPS) // RUN


def _noisiest(rest: NDArray) -> NDArray:
    """The run whose errors are largest, as a search would choose it."""
    size = [np.mean(rest[_runs() == run] ** 2) for run in range(STEPS // RUN)]
    return np.broadcast_to((_runs() == int(np.argmax(size)))[:, None], rest.shape[:2])


def _named_places(draws: list[NDArray]) -> int:
    return sum(is_of_place(rest, _noisiest(rest), STEPS // RUN) for rest in draws)


def test_a_run_that_is_noisier_is_named() -> None:
    rng = np.random.default_rng(1)
    own = np.where(_runs() == 3, 2.0, 1.0)[:, None, None]
    assert_between(_named_places([_noise(rng) * own for _ in range(CAMPAIGNS)]), CAMPAIGNS - 2, CAMPAIGNS, what="named")


def test_loads_with_heavy_tails_are_no_noisy_run() -> None:
    rng = np.random.default_rng(2)
    pattern = rng.normal(size=(CHANNELS, 1))
    draws = [_noise(rng) + 2.0 * rng.standard_t(1.8, (STEPS, 1, 1)) * pattern for _ in range(CAMPAIGNS)]
    assert_between(_named_places(draws), 0, 2, what="named")


def test_outliers_of_single_channels_are_no_noisy_run() -> None:
    rng = np.random.default_rng(3)
    draws = [
        _noise(rng) + 8.0 * rng.normal(size=(STEPS, CHANNELS, 1)) * (rng.random((STEPS, CHANNELS, 1)) < 0.03)
        for _ in range(CAMPAIGNS)
    ]
    assert_between(_named_places(draws), 0, 2, what="named")


def test_evidence_of_a_chosen_stretch_is_reduced_by_the_number_of_stretches() -> None:
    """Of many stretches of equal noise one is noisy by chance; one that is noisier is named all the same."""
    rng, length = np.random.default_rng(6), 12
    stretches = [np.broadcast_to((abs(np.arange(STEPS) - at) < length / 2)[:, None], (STEPS, 1)) for at in range(STEPS)]

    def named(size: float, tried: int) -> int:
        found = 0
        for _ in range(CAMPAIGNS):
            rest = rng.normal(size=(STEPS, 1, 1)) * np.where(stretches[STEPS // 2], size, 1.0)[..., None]
            own = max(stretches, key=lambda one: float(np.mean(rest[one] ** 2)))
            found += is_of_place(rest, own, tried)
        return found

    assert_between(named(1.0, STEPS), 0, 1, what="named by chance")
    assert_between(named(1.0, 1), 4, CAMPAIGNS, what="named if the choice were free")
    assert_between(named(4.0, STEPS), CAMPAIGNS - 3, CAMPAIGNS, what="named where there is one")


def test_an_input_that_scatters_at_all_epochs_is_compared_with_the_others() -> None:
    rng = np.random.default_rng(4)
    own = np.ones((STEPS, CHANNELS), bool) & (np.arange(CHANNELS) == 2)
    assert is_of_place(_noise(rng) * np.where(own, 3.0, 1.0)[..., None], own, CHANNELS)
    heavy = rng.standard_t(1.5, (STEPS, CHANNELS, 1))
    assert not is_of_place(heavy, own, CHANNELS)


def test_errors_that_return_with_a_command_are_no_scatter() -> None:
    rng = np.random.default_rng(5)
    up = np.arange(9)
    command = np.tile(np.concatenate([up, up[-2::-1]]), STEPS // RUN)
    own = np.broadcast_to((_runs() == 2)[:, None], (STEPS, CHANNELS)) & (np.arange(CHANNELS) == 1)
    random = [p_value_of_repeats(3.0 * _noise(rng), own, command) for _ in range(400)]
    assert_between(float(np.mean(np.array(random) < 0.05)), 0.02, 0.09, what="share of p below 5 %")
    jumps = np.where(command % 2, 4.0, -4.0)[:, None, None]
    assert p_value_of_repeats(_noise(rng) + jumps, own, command) < 1e-3
    assert p_value_of_repeats(_noise(rng), own, np.arange(STEPS)) == 1.0, "nothing is repeated"


def test_heavy_tails_are_told_from_normal_errors() -> None:
    rng = np.random.default_rng(7)
    normal = [_noise(rng) for _ in range(CAMPAIGNS)]
    heavy = [rng.standard_t(1.8, (STEPS, CHANNELS, 1)) for _ in range(CAMPAIGNS)]
    told = [sum(has_heavy_tails(rest, _noisiest(rest)) for rest in draws) for draws in (normal, heavy)]
    assert told == [0, CAMPAIGNS]
