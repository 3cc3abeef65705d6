"""Two surveys of one body: moved targets are named with their shift, and false alarms keep the stated rate."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, kstest

from tests.estimation.scatter import random_rotations
from truing.estimation.rigid_poses.later_survey import FALSE_ALARM, compare_surveys

NOISE = 5e-6


def two_surveys(rng, count, moved=None, noise=NOISE, anisotropic=True):
    """Points of a body half a metre wide, seen again in another frame; moved: target to shift (3,) in m."""
    x = rng.uniform(-0.25, 0.25, (count, 3))
    shift = np.zeros((count, 3))
    for target, by in (moved or {}).items():
        shift[target] = by
    R, t = random_rotations(rng, 1)[0], rng.uniform(-2.0, 2.0, 3)
    axes = np.array([1.0, 1.0, 2.0]) if anisotropic else np.ones(3)
    cov = np.broadcast_to(np.diag((NOISE * axes) ** 2), (count, 3, 3))
    before = x + noise * axes * rng.standard_normal((count, 3))
    after = (x + shift) @ R.T + t + noise * axes * rng.standard_normal((count, 3))
    return before, cov, after, cov


def compared(rng, count, moved=None, known=(), **how):
    return compare_surveys(*two_surveys(rng, count, moved, **how), np.isin(np.arange(count), known), FALSE_ALARM)


def test_targets_are_called_moved_no_more_often_than_the_stated_rate():
    rng, draws = np.random.default_rng(1), 180
    found = [compared(rng, count) for count in (4, 6, 12) for _ in range(draws // 3 + 1)]
    accused = sum(bool(one.moved.any()) for one in found)
    assert accused <= binom.isf(1e-4, len(found), FALSE_ALARM)
    reported = [one for one in found if not one.moved.any()]
    assert kstest([one.p_value[1] for one in reported], "uniform").pvalue > 1e-3
    by_scatter = sum(one.chi_square for one in reported) / sum(one.freedom for one in reported)
    assert abs(by_scatter - 1.0) < 4.0 * np.sqrt(2.0 / sum(one.freedom for one in reported))


@pytest.mark.parametrize(("count", "movers"), [(5, 1), (7, 2), (12, 4)])
def test_moved_targets_are_named_and_their_shift_agrees_with_its_sigma(count, movers):
    rng, pulls = np.random.default_rng(count), []
    for _ in range(20):
        moved = {target: 60.0 * NOISE * rng.choice([-1, 1], 3) for target in range(movers)}
        one = compared(rng, count, moved)
        assert set(np.flatnonzero(one.moved)) >= set(moved)
        for target, by in moved.items():
            d = one.shift[target] - by
            pulls.append(d @ np.linalg.solve(one.cov[target], d))
    assert kstest(pulls, "chi2", args=(3,)).pvalue > 1e-3


def test_noise_above_the_declared_one_rarely_makes_a_target_moved():
    rng = np.random.default_rng(5)
    accused = sum(bool(compared(rng, 12, noise=2.0 * NOISE).moved.any()) for _ in range(40))
    assert accused <= binom.isf(1e-3, 40, 0.05)  # the search for the unmoved trims a little by the declared noise


def test_the_place_of_a_target_in_the_first_frame_is_true_to_its_sigma():
    rng, pulls = np.random.default_rng(6), []
    for _ in range(30):
        before, cov, after, _ = two_surveys(rng, 6, {2: (1e-3, 0.0, -2e-3)}, anisotropic=False)
        one = compare_surveys(before, cov, after, cov, np.zeros(6, bool), FALSE_ALARM)
        at, spread = one.place(after[2][None], cov[2][None])
        d = at[0] - before[2] - one.shift[2]
        assert np.linalg.norm(d) < 1e-9  # two ways to the same place
        pulls.append(spread[0].trace())
    assert NOISE**2 * 3 < np.mean(pulls) < NOISE**2 * 9


def test_a_known_movement_counts_whatever_its_size():
    one = compared(np.random.default_rng(7), 6, known=(3,))
    assert list(np.flatnonzero(one.moved)) == [3]


def test_three_targets_that_disagree_show_nothing():
    one = compared(np.random.default_rng(8), 3, {0: (1e-3, 0.0, 0.0)})
    assert one.status != "ok"
    assert not one.moved.any()
    assert compared(np.random.default_rng(9), 2).status == "too-few-points"
