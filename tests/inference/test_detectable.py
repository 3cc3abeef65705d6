"""The power that linear theory promises is what an F test of simulated residuals has."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import f

from tests.tolerance import assert_between
from truing.inference.detectable import Rule, Sight, per_scale

DRAWS = 40_000


@dataclass(frozen=True)
class _Named:
    subject: str = ""


@pytest.mark.parametrize("rank", [1, 6, 36])
@pytest.mark.parametrize("ratio", [0.0, 3.0, 6.0, 9.0])
def test_power_is_that_of_the_test_on_simulated_residuals(rank: int, ratio: float) -> None:
    rng, left, threshold = np.random.default_rng(rank), 200, 1e-3
    along = rng.standard_normal((DRAWS, rank))
    along[:, 0] += ratio
    noise = rng.chisquare(left, DRAWS) / left
    found = float(np.mean(f.sf(np.sum(along**2, 1) / rank / noise, rank, left) <= threshold))
    promised = float(Rule(rank, left + rank, threshold).power(np.array(ratio)))
    sigma = np.sqrt(max(promised * (1 - promised), threshold) / DRAWS)
    assert_between(found, promised - 4 * sigma, promised + 4 * sigma, what="power")


def test_a_pattern_in_no_particular_direction_is_seen_by_its_strengths() -> None:
    rng = np.random.default_rng(1)
    loadings, _ = np.linalg.qr(rng.standard_normal((6, 6)))
    found = per_scale(np.full(6, 2.0), loadings)
    assert np.allclose(found, 2.0 * np.sqrt(6))  # root mean square one, so the length is the root of six
    assert per_scale(np.array([3.0]), np.array([[1.0]])) == pytest.approx([3.0])


def test_the_smallest_size_has_the_power_that_was_asked_for_and_grows_with_it() -> None:
    rng = np.random.default_rng(2)
    sight = Sight(_Named(), "any", Rule(4, 300.0, 1e-5), rng.uniform(1.0, 6.0, 64))
    sizes = [sight.smallest(power) for power in (0.5, 0.8, 0.95)]
    assert sizes == sorted(sizes)
    for size, power in zip(sizes, (0.5, 0.8, 0.95), strict=True):
        assert sight.power(size) == pytest.approx(power, abs=1e-6)


def test_one_parameter_needs_the_signal_that_its_threshold_asks_for() -> None:
    """Normal noise that is all but known: the quantile of the threshold plus that of the power."""
    from scipy.stats import norm

    sight = Sight(_Named(), "any", Rule(1, 1e7, 1e-5), np.array([1.0]))
    assert sight.smallest(0.8) == pytest.approx(norm.isf(0.5e-5) + norm.ppf(0.8), rel=1e-3)


@pytest.mark.parametrize("sight", [Sight(_Named(), "any", Rule(0, 1.0, 0.03), np.array([0.0]))])
def test_what_no_direction_shows_is_not_found_at_any_size(sight: Sight) -> None:
    assert sight.smallest() is None


def test_what_shows_in_half_of_the_directions_only_is_not_found_with_four_fifths() -> None:
    half = np.concatenate([np.zeros(32), np.full(32, 5.0)])
    assert Sight(_Named(), "any", Rule(2, 100.0, 1e-4), half).smallest(0.8) is None
