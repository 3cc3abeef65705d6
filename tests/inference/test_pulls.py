"""Pulls are standard normal and their sum is chi-square exactly if model and priors are right."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import kstest

from truing.inference.pulls import pulls

PARAMETERS, ROWS, DRAWS = 8, 12, 2000
UNLUCKY = 1e-3


@pytest.fixture(scope="module")
def problem():
    """A linear problem with correlated parameters, some of which the data hardly determine."""
    rng = np.random.default_rng(5)
    prior = np.diag(rng.uniform(0.5, 2.0, PARAMETERS) ** 2)
    jacobian = rng.normal(size=(ROWS, PARAMETERS)) @ np.diag([20.0, 20.0, 20.0, 20.0, 5.0, 5.0, 0.3, 0.0])
    jacobian[:, 1] += 0.98 * jacobian[:, 0]
    posterior = np.linalg.inv(np.linalg.inv(prior) + jacobian.T @ jacobian)
    return prior, jacobian, posterior


def drawn(problem, count, prior_scale=1.0, seed=7):
    prior, jacobian, posterior = problem
    rng = np.random.default_rng(seed)
    for _ in range(count):
        truth = prior_scale * np.sqrt(np.diag(prior)) * rng.normal(size=PARAMETERS)
        shift = posterior @ jacobian.T @ (jacobian @ truth + rng.normal(size=ROWS))
        yield pulls(shift, prior, posterior)


def test_one_wrong_prior_is_found_with_its_size(problem):
    """Its square is what the sum of all pulls loses, and its offset is the error of that prior."""
    prior, jacobian, posterior = problem
    wrong = 40.0 * np.eye(PARAMETERS)[2] * np.sqrt(np.diag(prior))
    found = pulls(posterior @ jacobian.T @ (jacobian @ wrong), prior, posterior)
    assert np.nanargmax(np.abs(found.pull)) == 2
    assert abs(found.offset[2] / wrong[2] - 1.0) < 1e-9
    assert np.nanargmax(found.explained) == 2
    assert found.chi_square - found.explained[2] < 1e-6 * found.chi_square


def test_pulls_are_unit_normal_and_their_sum_a_chi_square(problem):
    found = list(drawn(problem, DRAWS))
    reported = found[0].identifiable
    assert reported.sum() == 6
    assert np.isnan(found[0].pull[~reported]).all()
    each = np.array([one.pull[reported] for one in found])
    assert all(kstest(column, "norm").pvalue > UNLUCKY for column in each.T)
    assert 0 < found[0].freedom <= reported.sum()
    assert kstest([one.p_value for one in found], "uniform").pvalue > UNLUCKY
    within = np.mean([one.lower <= one.chi_square <= one.upper for one in found])
    assert abs(within - 0.95) < 3.3 * np.sqrt(0.95 * 0.05 / DRAWS)


def test_parts_beyond_their_tolerances_leave_the_band(problem):
    assert np.mean([one.chi_square > one.upper for one in drawn(problem, 200, prior_scale=4.0)]) > 0.9


def test_results_are_independent_of_units(problem):
    prior, jacobian, posterior = problem
    shift = posterior @ jacobian.T @ np.linspace(-3, 3, ROWS)
    scale = np.geomspace(1e-3, 1e3, PARAMETERS)
    turned = np.outer(scale, scale)
    a, b = pulls(shift, prior, posterior), pulls(shift * scale, prior * turned, posterior * turned)
    np.testing.assert_allclose(a.pull, b.pull, rtol=1e-6)
    np.testing.assert_allclose(a.chi_square, b.chi_square, rtol=1e-6)


def test_data_without_information_give_no_pull():
    nothing = pulls(np.zeros(3), np.eye(3), 0.99 * np.eye(3))
    assert np.isnan(nothing.pull).all()
    assert (nothing.freedom, nothing.p_value) == (0, 1.0)


@pytest.mark.parametrize("wrong", [0.0, 20.0])
def test_a_number_that_two_parameters_share_is_tested_though_neither_is_identifiable(wrong):
    """The data determine the sum of two lengths: each prior loses just less than half of its variance."""
    prior, sigma = np.eye(2), 0.05
    jacobian = np.ones((1, 2)) / sigma
    posterior = np.linalg.inv(prior + jacobian.T @ jacobian)
    rng, found = np.random.default_rng(3), []
    for _ in range(DRAWS):
        truth = rng.normal(size=2) + np.array([wrong, 0.0])
        found.append(pulls(posterior @ jacobian.T @ (jacobian @ truth + rng.normal(size=1)), prior, posterior))
    assert (found[0].freedom, found[0].identifiable.any()) == (1, False)
    if wrong:
        assert all(one.chi_square > one.upper for one in found)
        assert abs(np.mean([one.offset[0] for one in found]) / wrong - 1.0) < 0.02
    else:
        assert kstest([one.p_value for one in found], "uniform").pvalue > UNLUCKY
