"""Two campaigns of one linear machine: no false changes, and a changed number is named."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import kstest

from truing.inference.changes import compare

NUMBERS, ROWS = 10, 40


@pytest.fixture(scope="module")
def designs():
    """Rows of two campaigns that determine most numbers well, two only together and one hardly."""
    rng = np.random.default_rng(4)
    made = []
    for _ in range(2):
        rows = rng.normal(size=(ROWS, NUMBERS)) * np.geomspace(30.0, 3.0, NUMBERS)
        rows[:, 7] = rows[:, 6] + 0.02 * rows[:, 7]
        rows[:, 9] *= 0.02
        made.append(rows)
    return made


def campaigns(designs, rng, change=None):
    """Both estimates with their covariances; the second machine differs by ``change``."""
    truth = rng.normal(size=NUMBERS)
    found = []
    for rows, own in zip(designs, (truth, truth if change is None else truth + change), strict=True):
        covariance = np.linalg.inv(rows.T @ rows + np.eye(NUMBERS))
        found += [covariance @ rows.T @ (rows @ own + rng.normal(size=ROWS)), covariance]
    return compare(*found, np.eye(NUMBERS))


def test_differences_over_their_sigma_are_unit_normal(designs):
    rng = np.random.default_rng(1)
    found = [campaigns(designs, rng) for _ in range(800)]
    z = np.array([one.difference / one.sigma for one in found])
    assert all(kstest(column, "norm").pvalue > 1e-3 for column in z.T)
    squares, freedom = np.array([one.chi_square for one in found]).T
    assert len(set(freedom)) == 1
    assert kstest(squares, "chi2", (freedom[0],)).pvalue > 1e-3
    assert np.mean([one.changed() != () for one in found]) < 0.02


def test_the_number_that_changed_is_named_and_no_other(designs):
    rng = np.random.default_rng(2)
    for place in range(6):
        change = 1.0 * (np.arange(NUMBERS) == place)
        found = [campaigns(designs, rng, change) for _ in range(20)]
        assert sum(one.changed() == (place,) for one in found) >= 18
        sizes, sigmas = np.array([one.sizes((place,)) for one in found])[..., 0].T
        assert np.abs((sizes - 1.0) / sigmas).max() < 4.5


def test_one_of_two_confounded_numbers_is_named_as_changed_with_the_other_as_alternative(designs):
    rng = np.random.default_rng(3)
    change = 1.0 * (np.arange(NUMBERS) == 6)
    named = [campaigns(designs, rng, change).changed() for _ in range(20)]
    assert all(len(one) == 1 and one[0] in (6, 7) for one in named)
    found = campaigns(designs, rng, change)
    (named,) = found.changed()
    assert found.alternatives_to((named,)) == ((13 - named,),)


def test_another_machine_is_reported_as_such():
    rng = np.random.default_rng(5)
    rows = rng.normal(size=(80, 40)) * 30.0
    covariance = np.linalg.inv(rows.T @ rows + np.eye(40))
    before, now = (covariance @ rows.T @ rows @ rng.normal(size=40) for _ in range(2))
    assert compare(before, covariance, now, covariance, np.eye(40)).changed() is None


def test_an_estimate_wider_than_what_was_known_before_leaves_no_negative_variance(designs):
    """Sigmas are enlarged for the noise, also where the data contain no information."""
    rng = np.random.default_rng(6)
    found = []
    for rows in designs:
        reported = rows * (np.arange(NUMBERS) != 9)
        covariance = np.linalg.inv(reported.T @ reported + np.eye(NUMBERS)) * 1.05**2
        found += [covariance @ reported.T @ rng.normal(size=ROWS), covariance]
    compared = compare(*found, np.eye(NUMBERS))
    assert np.linalg.eigvalsh(compared.covariance).min() > 0.0
    assert np.abs(compared.difference / compared.sigma).max() < 4.0
