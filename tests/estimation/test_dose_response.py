"""Rates and their bounds, and the size that is found with a probability, from few draws."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import beta, norm

from truing.estimation.dose_response import rate_bounds, size_found

FACTORS = np.array([0.5, 0.7, 1.0, 1.4, 2.0])


@pytest.mark.parametrize(("found", "count"), [(0, 8), (3, 8), (8, 8), (57, 60)])
def test_bounds_of_a_rate_are_the_exact_ones(found: int, count: int) -> None:
    lower, upper = rate_bounds(found, count)
    assert lower == pytest.approx(0.0 if found == 0 else beta.ppf(0.025, found, count - found + 1))
    assert upper == pytest.approx(1.0 if found == count else beta.ppf(0.975, found + 1, count - found))


@pytest.mark.parametrize("power", [0.5, 0.8, 0.95])
@pytest.mark.parametrize("slope", [2.0, 5.0])
@pytest.mark.parametrize("off", [0.6, 1.0, 1.7])
def test_many_draws_give_the_size_whatever_theory_expected(power: float, slope: float, off: float) -> None:
    sizes, expected = 3e-4 * FACTORS, 3e-4 * off
    counts = np.full(5, 100_000)
    reached = np.round(counts * norm.cdf(slope * np.log(sizes / 3e-4)))
    reported = size_found(sizes, reached, counts, expected, power)
    truth = 3e-4 * np.exp(norm.ppf(power) / slope)
    assert reported.value == pytest.approx(truth, rel=0.03)  # half a step of the grid, either way
    assert reported.lower <= reported.value <= reported.upper


def test_intervals_of_few_draws_cover_the_truth_at_the_stated_rate() -> None:
    rng, covered, trials = np.random.default_rng(1), 0, 400
    for _ in range(trials):
        slope, middle = np.exp(rng.uniform(np.log(2.0), np.log(8.0))), np.exp(rng.uniform(-0.5, 0.5))
        found = rng.binomial(8, norm.cdf(slope * np.log(FACTORS / middle)))
        reported = size_found(FACTORS, found, np.full(5, 8), 1.0, 0.8)
        covered += reported.lower <= middle * np.exp(norm.ppf(0.8) / slope) <= reported.upper
    assert covered / trials > 0.9
