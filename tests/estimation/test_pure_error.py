"""Pure error has the scatter and the interval that it says; the F test finds what a model leaves, and nothing else."""

from __future__ import annotations

import numpy as np
from scipy.stats import binom, kstest

from truing.estimation.repeatability import Squares, lack_of_fit, within_groups, within_runs

GROUPS = [np.array([0, 5, 10]), np.array([1, 6]), np.array([2, 7])]
DRAWS = 2000


def test_the_interval_of_pure_error_holds_as_often_as_it_says():
    rng = np.random.default_rng(1)
    values = 3.0 * rng.standard_normal((12, DRAWS)) + np.arange(12)[:, None] % 5  # poses 0, 5 and 10 are one
    found = within_groups(values, GROUPS)
    assert (found.freedom == 4).all()
    lower, upper = found.interval()
    inside = int(((lower < 3.0) & (upper > 3.0)).sum())
    assert binom.ppf(1e-4, DRAWS, 0.95) <= inside <= binom.ppf(1.0 - 1e-4, DRAWS, 0.95)
    assert kstest(found.square / 9.0, "chi2", args=(4,)).pvalue > 1e-3


def test_runs_repeat_each_other_but_for_their_zeros_and_steps_that_one_of_them_missed():
    rng, runs, steps = np.random.default_rng(2), 3, 6
    values = rng.standard_normal((runs * steps, DRAWS))
    values += (
        np.repeat(rng.standard_normal((runs, DRAWS)) * 50.0, steps, axis=0) + np.tile(np.arange(steps), runs)[:, None]
    )
    values[3, ::2] = np.nan
    found = within_runs(values, [np.arange(runs * steps).reshape(runs, steps)])
    assert set(found.freedom[::2]) == {(runs - 1) * (steps - 2)}
    assert set(found.freedom[1::2]) == {(runs - 1) * (steps - 1)}
    assert kstest(found.square[1::2], "chi2", args=(10,)).pvalue > 1e-3
    assert kstest(found.square[::2], "chi2", args=(8,)).pvalue > 1e-3


def left_by_a_line(curved):
    """What a line leaves of twelve values at five places, curved by so much."""
    rng = np.random.default_rng(3)
    x = np.arange(12) % 5 - 2.0
    values = rng.standard_normal((12, DRAWS)) + 7.0 * x[:, None] + curved * (x**2)[:, None]
    design = np.column_stack([np.ones(12), x])
    left = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
    groups = [np.flatnonzero(np.arange(12) % 5 == place) for place in range(5)]
    return lack_of_fit(Squares((left**2).sum(axis=0), np.full(DRAWS, 10.0)), within_groups(left, groups))


def test_a_right_model_is_held_wrong_as_often_as_chance_has_it_and_a_wrong_one_is_found():
    right = left_by_a_line(0.0)
    assert set(zip(right.of_fit, right.of_error, strict=True)) == {(3.0, 7.0)}
    assert kstest(right.p_value, "uniform").pvalue > 1e-3
    assert (left_by_a_line(2.0).p_value < 0.01).mean() > 0.95


def test_without_repeats_nothing_is_told():
    found = within_groups(np.zeros((4, 2)), [])
    assert np.isnan(found.sigma).all()
    assert np.isnan(found.interval()).all()
    assert np.isnan(lack_of_fit(Squares(np.ones(2), np.full(2, 3.0)), found).p_value).all()
