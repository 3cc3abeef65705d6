"""Branches of a load, and the difference between loading and unloading."""

from __future__ import annotations

import numpy as np

from tests.estimation.interferometry.bench import LEVELS
from tests.tolerance import assert_between, assert_close
from truing.estimation.interferometry.load_run import branch_gap, branches, widest_gaps

SIGMA = 0.5e-6


def test_branches_follow_the_load() -> None:
    load = [0, 0, 1, 2, 2, 1, 0, -1, -2, -1, 1, 0]
    assert list(branches(load)) == [0, 0, 1, 1, 1, -1, -1, 1, 1, -1, 1, -1]


def test_the_gap_between_the_ways_is_the_hysteresis() -> None:
    rng = np.random.default_rng(5)
    share = np.abs(LEVELS) / 9e3
    readings = 2e-10 * LEVELS + (branches(LEVELS) < 0) * 6e-6 * 4.0 * share * (1.0 - share) * np.sign(LEVELS)
    gaps = [branch_gap(LEVELS, readings + SIGMA * rng.standard_normal(len(LEVELS)), SIGMA) for _ in range(100)]
    part = np.abs(gaps[0].load) / 9e3
    assert set(np.abs(gaps[0].load)) == {1e3, 3e3, 5e3, 7e3}
    expected = 6e-6 * 4.0 * part * (1.0 - part)
    off = np.array([(g.gap - expected) / g.sigma for g in gaps])
    total = float((off**2).sum())
    assert_between(total, off.size - 4 * np.sqrt(2 * off.size), off.size + 4 * np.sqrt(2 * off.size))
    assert_close(gaps[0].sigma, np.full(8, SIGMA * np.sqrt(2.0)), atol=1e-12)


def test_gaps_are_reported_for_runs_that_load_one_axis_only() -> None:
    """Run 0 loads x and returns with 2 um, run 1 loads x and y together and gives no gap of either."""
    size, run = len(LEVELS), np.repeat([0, 1], len(LEVELS))
    load = np.zeros((2 * size, 6))
    load[:, 0] = np.tile(LEVELS, 2)
    load[size:, 1] = LEVELS
    reading = np.full((2 * size, 6), np.nan)
    reading[:, 3] = np.where(branches(LEVELS) < 0, 2e-6, 0.0)[np.tile(np.arange(size), 2)]
    reading[size:, 3] *= 50.0
    found = widest_gaps(load, run, reading, np.full(reading.shape, SIGMA))
    assert set(found) == {(0, 3)}
    gap, chance = found[0, 3]
    assert abs(abs(gap) - 2e-6) < 1e-12
    assert chance < 1e-3
