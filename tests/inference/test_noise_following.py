"""Noise that depends on an input is found and measured; uniform noise gives no finding."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from tests.tolerance import assert_between, assert_close
from truing.inference.noise import Driver, drivers, log_moments, merged_by_driver, noise_dependence, standardised

POSES, TARGETS = 40, 30
LEVEL = 0.01


def _drivers(rng: np.random.Generator) -> list[Driver]:
    columns = {"time_s": np.arange(POSES) * 240.0, "humidity": rng.uniform(40, 60, POSES)}
    return drivers(columns, rng.normal(size=(TARGETS, 3)), np.repeat([0, 1, 2], 10))


def _rest(rng: np.random.Generator, heavy: bool = False) -> NDArray:
    rest = rng.standard_t(5, (POSES, TARGETS, 3)) if heavy else rng.normal(size=(POSES, TARGETS, 3))
    rest[rng.random((POSES, TARGETS)) < 0.03] = np.nan
    return rest


def test_noise_that_follows_nothing_is_seldom_said_to_follow_something() -> None:
    rng = np.random.default_rng(1)
    said = [noise_dependence(_rest(rng, heavy=n % 2 == 1), _drivers(rng), 0.2) for n in range(100)]
    count = sum(found is not None for found in said)
    assert_between(count, 4, 35, what="campaigns of 100 that say so at a level of 20 %")


def test_noise_that_grows_with_a_column_is_traced_to_it() -> None:
    rng = np.random.default_rng(2)
    possible = _drivers(rng)
    humidity = possible[2].values[:, 0]
    growth = np.exp(0.25 * humidity)
    found = noise_dependence(_rest(rng) * growth[:, None, None], possible, LEVEL)
    assert found is not None
    assert found.driver.column == "humidity"
    assert_between(found.ratio, np.exp(0.5) - 3 * found.sigma, np.exp(0.5) + 3 * found.sigma, what="ratio")
    assert_close(found.factor[:, 0] / growth, np.full(POSES, 1.0), atol=0.15, what="weights")


def test_a_dependence_found_twice_on_one_quantity_is_one_dependence() -> None:
    """A dependence found after the first weighting multiplies it: the ratio is that of the extremes of both
    together."""
    rng = np.random.default_rng(2)
    possible = _drivers(rng)
    growth = np.exp(0.4 * possible[2].values[:, 0])
    rest = _rest(rng) * growth[:, None, None]
    first = noise_dependence(rest, possible, LEVEL)
    assert first is not None
    halved = replace(first, factor=np.sqrt(first.factor), ratio=np.sqrt(first.ratio), sigma=first.sigma / 2.0)
    one = merged_by_driver([halved, halved])
    assert len(one) == 1
    assert_close(one[0].factor, first.factor, atol=1e-12, what="weights")
    assert_between(one[0].ratio, 0.9 * first.ratio, 1.1 * first.ratio, what="ratio of the extremes")
    assert len(merged_by_driver([first, replace(first, driver=possible[0])])) == 2


def test_a_target_with_excess_scatter_is_named() -> None:
    rng = np.random.default_rng(3)
    rest = _rest(rng)
    rest[:, 17] *= 2.0
    found = noise_dependence(rest, _drivers(rng), LEVEL)
    assert found is not None
    assert found.driver.channels == (17,)
    assert_between(found.ratio, 1.5, 2.6, what="its noise over that of the others")


def test_standardised_residuals_have_unit_spread_after_a_fit() -> None:
    rng = np.random.default_rng(4)
    reported = np.broadcast_to(np.diag([0.3, 0.6, 1.0]), (4000, 1, 3, 3))
    rest = rng.normal(size=(4000, 1, 3)) * np.sqrt([0.3, 0.6, 1.0])
    assert_close(np.std(standardised(rest, reported), axis=(0, 1)), np.ones(3), atol=0.05, what="spread")
    assert np.isnan(standardised(rest, reported * 0.1)).all()


def test_numbers_show_their_noise_as_points_do() -> None:
    """One coordinate: little is said of noise that follows nothing; noise that doubles with the load is measured."""
    rng = np.random.default_rng(6)
    load = np.tile(np.concatenate([np.linspace(0, 1, 11), np.linspace(0.9, 0, 10)]), 6)
    possible = drivers({"fx_n": load}, np.zeros((4, 0)), np.arange(4))
    clean = [noise_dependence(rng.normal(size=(126, 4, 1)), possible, 0.2) for _ in range(100)]
    assert_between(sum(found is not None for found in clean), 4, 35, what="campaigns of 100 at a level of 20 %")
    growth = np.exp(0.7 * load)[:, None, None]
    found = [noise_dependence(rng.normal(size=(126, 4, 1)) * growth, possible, LEVEL) for _ in range(20)]
    reported = [one for one in found if one is not None and one.driver.column == "fx_n"]
    assert len(reported) >= 19  # 6.4 standard deviations are expected, 3.2 needed
    pulls = np.array([(one.ratio - np.exp(0.7)) / one.sigma for one in reported])
    assert_between(float(np.sqrt(np.mean(pulls**2))), 0.6, 1.5, what="pulls of the ratio")


@pytest.mark.parametrize(("size", "added"), [(1, 1.0), (2, 0.0), (3, 0.0)])
def test_moments_of_a_logarithm_are_its_integrals_over_chi_square(size: int, added: float) -> None:
    """Of the squares of ``size`` values; to that of a single value one is added."""
    q = stats.chi2(size)
    follows = q.expect(lambda square: square / (square + added))
    first, second = (q.expect(lambda square, n=n: np.log(square + added) ** n) for n in (1, 2))
    assert_close(log_moments(size), (follows, (second - first**2) / follows**2), atol=1e-6)
