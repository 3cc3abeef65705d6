"""The exact comparison of two rates keeps its false-alarm rate, and detects a difference."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, fisher_exact

from tests.blind.two_rates import Pair, unlike
from tests.tolerance import assert_between, assert_close


@pytest.mark.parametrize(("first", "second"), [(7, 1), (3, 3), (0, 8), (5, 2)])
def test_for_one_size_the_comparison_of_rates_is_fishers_exact_test(first: int, second: int) -> None:
    expected = fisher_exact([[first, 8 - first], [second, 8 - second]]).pvalue
    assert_close(unlike([Pair(first, 8, second, 8)]), expected, atol=1e-9)


def test_equal_rates_are_called_different_no_more_often_than_the_level() -> None:
    """All outcomes of two sizes, each at a rate of its own."""
    level, wrong = 0.05, 0.0
    chance = [binom.pmf(np.arange(7), 6, rate) for rate in (0.3, 0.8)]
    for a, b, c, d in np.ndindex(7, 7, 7, 7):
        if unlike([Pair(a, 6, b, 6), Pair(c, 6, d, 6)]) <= level:
            wrong += chance[0][a] * chance[0][b] * chance[1][c] * chance[1][d]
    assert_between(wrong, 0.005, level, what="false alarms")


def test_small_differences_of_several_sizes_add_up() -> None:
    one = Pair(6, 10, 3, 10)
    assert unlike([one]) > 0.1
    assert unlike([one] * 8) < 1e-3
    assert unlike([one, Pair(3, 10, 6, 10)]) > 0.9
