"""Gross errors are found; points displaced by an effect are not rejected."""

from __future__ import annotations

import numpy as np

from truing.inference.screening import gross_errors


def test_gross_errors_are_taken_out_and_little_else() -> None:
    rng = np.random.default_rng(1)
    rest, is_observed = rng.normal(size=(40, 50, 3)), rng.random((40, 50)) > 0.05
    wrong = np.zeros(is_observed.shape, bool)
    wrong[rng.integers(0, 40, 20), rng.integers(0, 50, 20)] = True
    found = gross_errors(np.where(wrong[..., None], rest + 12.0, rest), is_observed)
    assert (found == (wrong & is_observed)).all()


def test_a_target_that_moves_with_an_effect_is_kept() -> None:
    rng = np.random.default_rng(2)
    rest = rng.normal(size=(40, 10, 3))
    rest[:, 3] += 20.0 * rng.uniform(-1, 1, (40, 1))
    rest[20:, 5] += 15.0
    assert not gross_errors(rest, np.ones((40, 10), bool)).any()


def test_without_observations_there_are_no_gross_errors() -> None:
    assert not gross_errors(np.zeros((2, 3, 3)), np.zeros((2, 3), bool)).any()


def test_readings_are_screened_by_the_scatter_of_their_run() -> None:
    """An effect in one run of ten widens the scatter of that run, not of the channel; a gross error deviates
    clearly."""
    rng = np.random.default_rng(3)
    load = np.tile(np.concatenate([np.linspace(-1, 1, 11), np.linspace(0.8, -1, 10)]), 10)
    run = np.repeat(np.arange(10), 21)
    rest = rng.normal(size=(210, 2, 1))
    rest[run == 4, 0, 0] += 30.0 * load[run == 4]
    rest[100, 1] += 12.0
    zeros, is_observed = run[:, None] * 2 + np.arange(2), rng.random((210, 2)) > 0.05
    is_observed[100, 1] = True
    axes, order = np.ones((210, 2, 1, 1)), np.arange(210.0)
    assert gross_errors(rest, is_observed, axes, order)[run == 4, 0].any()
    assert np.argwhere(gross_errors(rest, is_observed, axes, order, zeros)).tolist() == [[100, 1]]
