"""Combinations of parameters that are determined although no single one is."""

from __future__ import annotations

import numpy as np
import pytest

from tests.tolerance import assert_close
from truing.inference.determined import determined_combinations

# Three parameters with a wide prior, of which the data see only the sum of the first two.
SEEN = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
COVARIANCE = 100.0 * (np.eye(3) - np.outer(SEEN, SEEN)) + 0.04 * np.outer(SEEN, SEEN)


def test_the_sum_is_determined_where_its_terms_are_not() -> None:
    (found,) = determined_combinations(3.0 * SEEN, COVARIANCE)
    assert_close(found.coefficients, SEEN, atol=1e-9)
    assert_close([found.value, found.sigma], [3.0, 0.2], atol=1e-6)


def test_a_combination_is_listed_for_a_parameter_that_is_not_determined_alone() -> None:
    assert not determined_combinations(np.array([2.0, 2.0, 100.0]), COVARIANCE)  # the third is ten sigmas from zero


def test_combinations_do_not_depend_on_the_order_of_the_parameters() -> None:
    order = [2, 0, 1]
    (found,) = determined_combinations((3.0 * SEEN)[order], COVARIANCE[np.ix_(order, order)])
    assert_close(found.coefficients, SEEN[order], atol=1e-9)


def test_chance_alone_makes_a_combination_in_at_most_one_of_twenty_campaigns() -> None:
    rng = np.random.default_rng(4)
    shape = rng.normal(size=(12, 12))
    covariance = shape @ shape.T
    drawn = rng.multivariate_normal(np.zeros(12), covariance, 400)
    share = np.mean([bool(determined_combinations(values, covariance)) for values in drawn])
    assert 0.01 < share < 0.08  # 0.05, and three standard deviations of 400 draws


@pytest.mark.parametrize("size", [0, 1])
def test_fewer_than_two_parameters_have_no_combination(size: int) -> None:
    assert determined_combinations(np.full(size, 9.0), np.eye(size)) == []
