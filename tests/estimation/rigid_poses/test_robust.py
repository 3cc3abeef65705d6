"""Consensus of points: every kind of gross error, clean data, ambiguity, and invariance."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom, chi2

from tests.estimation.scatter import body, move, pose_error, random_motions, seeds, squared_pulls
from tests.tolerance import assert_close
from truing.estimation.rigid_poses import consensus_steps, robust, robust_kernel
from truing.estimation.rigid_poses.rigid import FitStatus
from truing.estimation.rigid_poses.robust import FALSE_ALARM, consensus
from truing.estimation.rigid_poses.umeyama import umeyama

SIGMA = 5e-6


def spoiled(rng, poses, points, bad, size=3e-3, shape=(1.0, 1.0, 1.0)):
    """Return survey, measured points, which of them are true, and the motions; errors of size in m."""
    x = body(rng, points) * shape
    R, t = random_motions(rng, poses)
    y = move(R, t, x) + SIGMA * rng.normal(size=(poses, points, 3))
    wrong = rng.permuted(np.arange(points) < np.full((poses, 1), bad), axis=1)
    return x, y + wrong[..., None] * size * rng.normal(size=y.shape), ~wrong, R, t


@pytest.mark.parametrize(
    ("points", "bad"), [(5, 1), (20, 4), (20, 10), (20, 16), (60, 48), (200, 100), (200, 190), (200, 196)]
)
def test_right_wherever_four_points_are_right(points, bad):
    trials = 300 if points <= 60 else 20
    x, y, true, *_ = spoiled(np.random.default_rng(points + bad), trials, points, bad)
    kept, status = consensus(x, y, None, SIGMA)
    assert np.count_nonzero((kept == true).all(-1)) >= 0.99 * trials
    assert np.count_nonzero(status == FitStatus.OK) >= 0.995 * trials


@pytest.mark.slow
def test_four_right_points_are_found_though_chance_joins_wrong_ones_to_some_of_them():
    x, y, true, *_ = spoiled(np.random.default_rng(15), 10_000, 20, 16)
    kept, status = consensus(x, y, None, SIGMA)
    # of 10 000 poses one meets chance agreements that are as good as the truth, or loses a point to FALSE_ALARM
    assert np.count_nonzero((true & ~kept).any(-1)) <= 4
    assert np.count_nonzero(status != FitStatus.OK) <= 4


@pytest.mark.parametrize("size", [200e-6, 1e-3, 0.1, 10.0])
def test_results_are_independent_of_the_size_of_gross_errors(size):
    x, y, true, *_ = spoiled(np.random.default_rng(1), 200, 20, 10, size)
    kept, _ = consensus(x, y, None, SIGMA)
    # an error that chance made as small as the noise cannot be distinguished from it, and bends nothing
    missed = kept & ~true
    assert (kept | ~true).all(-1).mean() >= 0.99
    assert missed.mean() <= 20 * (10 * SIGMA / size) ** 3


@pytest.mark.parametrize("share", [0.3, 0.5])
def test_errors_across_a_plane_change_no_distance_and_are_found_all_the_same(share):
    rng = np.random.default_rng(2)
    x, y, true, R, _ = spoiled(rng, 20, 20, round(20 * share), size=0.0, shape=(1.0, 1.0, 0.0))
    depth = rng.choice([-1.0, 1.0], true.shape) * rng.uniform(1e-3, 5e-3, true.shape)
    y += (~true * depth)[..., None] * R[:, None, :, 2]
    kept, status = consensus(x, y, None, SIGMA)
    assert (kept | ~true).all()
    assert (kept & ~true).mean() < 0.02
    assert (status == FitStatus.OK).all()


@pytest.mark.parametrize("points", [3, 4, 6, 20, 60])
def test_clean_poses_lose_a_point_as_rarely_as_stated(points):
    trials = 10_000 if points <= 20 else 2_000
    rng = np.random.default_rng(points)
    x, y, *_ = spoiled(rng, trials, points, 0)
    kept, _ = consensus(x, y, None, SIGMA)
    lost = np.count_nonzero(~kept.all(-1))
    assert lost <= binom.ppf(1 - 1e-4, trials, FALSE_ALARM)


@pytest.mark.parametrize("points", [4, 7, 30])
def test_studentised_residuals_are_chi_square_for_members_and_for_points_left_out(points):
    trials = 40_000 // points
    x, y, mask, *_ = spoiled(np.random.default_rng(14), trials, points, 0)
    members = np.broadcast_to(np.arange(points) > 0, mask.shape)
    clouds = consensus_steps.Clouds(np.broadcast_to(x, y.shape), y, mask, np.full(mask.shape, SIGMA), np.ones(trials))
    studentised, _ = consensus_steps.squared_residuals(clouds, members)
    for share in (0.5, 0.05):
        low, high = binom.ppf([1e-4, 1 - 1e-4], trials, share)
        # three members leave each other less than three degrees of freedom
        for k in (0, points // 2, points - 1) if points > 4 else (0,):
            assert low <= np.count_nonzero(studentised[:, k] > chi2.isf(share, 3)) <= high


def test_the_fit_to_what_is_kept_is_as_good_as_the_fit_to_the_true_points():
    x, y, true, R, t = spoiled(np.random.default_rng(3), 1000, 20, 10)
    kept, _ = consensus(x, y, None, SIGMA)
    errors = [pose_error(f.R, f.t, R, t) for f in (umeyama(x, y, kept), umeyama(x, y, true))]
    assert_close(np.mean(errors[0] ** 2) / np.mean(errors[1] ** 2), 1.0, atol=0.01)
    pulls = squared_pulls(errors[0], umeyama(x, y, kept, sigma=SIGMA).covariance)
    assert binom.ppf(1e-4, 1000, 0.95) <= np.count_nonzero(pulls < 12.591587243743977)


@given(seeds, st.integers(6, 25), st.floats(0.0, 0.7))
def test_results_are_independent_of_order_frames_and_unit_of_length(seed, points, share):
    rng = np.random.default_rng(seed)
    x, y, *_ = spoiled(rng, 4, points, int(share * points))
    kept, status = consensus(x, y, None, SIGMA)
    order = rng.permutation(points)
    shuffled, same = consensus(x[order], y[:, order], None, SIGMA)
    assert np.array_equal(shuffled, kept[:, order])
    assert np.array_equal(same, status)
    Q, s = random_motions(rng, 4)
    assert np.array_equal(consensus(x, move(Q, s, y), None, SIGMA)[0], kept)
    assert np.array_equal(consensus(1e3 * x, 1e3 * y, None, 1e3 * SIGMA)[0], kept)
    assert np.array_equal(consensus(x, y, None, SIGMA)[0], kept)
    one, _ = consensus(x, y[2], None, SIGMA)
    assert np.array_equal(one[0], kept[2])


def test_missing_points_are_never_kept_and_may_be_nan():
    rng = np.random.default_rng(4)
    x, y, true, *_ = spoiled(rng, 50, 20, 6)
    mask = rng.random(true.shape) < 0.8
    y[~mask] = np.nan
    kept, _ = consensus(x, y, mask, SIGMA)
    assert not (kept & ~mask).any()
    assert (kept == (true & mask)).all(-1).mean() >= 0.98


def test_each_point_is_assessed_by_its_own_sigma():
    rng = np.random.default_rng(5)
    x, y, *_ = spoiled(rng, 200, 20, 0)
    sigma = np.full((200, 20), SIGMA)
    sigma[:, ::3] *= 20
    y[:, ::3] += 20 * SIGMA * rng.normal(size=(200, 7, 3))
    assert consensus(x, y, None, sigma)[0].all(-1).mean() >= 0.98
    assert not consensus(x, y, None, SIGMA)[0].all(-1).any()


def mixed_batch(rng):
    """Return clouds, mask and sigma of poses of every kind: clean, spoiled, missing, degenerate, hopeless."""
    parts = [spoiled(rng, 40, 20, bad) for bad in (0, 2, 10, 15, 16, 20)]
    x = np.concatenate([np.repeat(part[0][None], 40, axis=0) for part in parts])
    y = np.concatenate([part[1] for part in parts])
    mask = rng.random(y.shape[:2]) < rng.choice([1.0, 0.9, 0.4, 0.1], (len(y), 1))
    mask[5:8] = True
    y[~mask] = np.nan
    x[5], x[6] = x[5, :1], np.linspace(0.0, 0.2, 20)[:, None] * [0.3, -0.5, 0.7]
    x[7] *= [1.0, 1.0, 1e-7]
    return x, y, mask, SIGMA * rng.uniform(1.0, 3.0, mask.shape)


@pytest.mark.slow
def test_compiled_code_finds_the_same(monkeypatch):
    x, y, mask, sigma = mixed_batch(np.random.default_rng(12))
    kept, status = consensus(x, y, mask, sigma)
    assert len(set(status)) >= 5
    monkeypatch.setattr(robust, "_MANY_POINTS", 0)
    monkeypatch.setattr(robust, "_MANY_PAIRS", 0)
    monkeypatch.setattr(consensus_steps, "same_distances", None)
    same_kept, same_status = consensus(x, y, mask, sigma)
    assert np.array_equal(same_kept, kept)
    assert list(same_status) == list(status)


def test_each_compiled_step_equals_the_plain_one():
    rng = np.random.default_rng(13)
    x, y, mask, sigma = mixed_batch(rng)
    clouds = consensus_steps.Clouds(x, np.where(mask[..., None], y, 0.0), mask, sigma, np.full(len(x), 20.0))
    members = mask & (rng.random(mask.shape) < 0.8)
    steps = (robust_kernel.squared_residuals(clouds, members), consensus_steps.squared_residuals(clouds, members))
    for fast, plain in zip(*steps, strict=True):
        assert np.array_equal(np.isfinite(fast), np.isfinite(plain))
        # where a point alone holds the pose, what is left of its residual is rounding over FLOOR
        relevant = mask & np.isfinite(plain) & (plain > 1e-3)
        assert np.count_nonzero(relevant) > 1000
        assert_close(fast[relevant] / plain[relevant], np.ones(np.count_nonzero(relevant)), atol=1e-3)
    graph, expected = robust_kernel.same_distances(clouds), consensus_steps.same_distances(clouds)
    assert np.array_equal(graph > 0, expected > 0)
    assert_close(graph, expected, atol=1e-6)
    seed, taken = graph.sum(-1).argmax(-1), rng.random(mask.shape) < 0.2
    assert np.array_equal(robust_kernel.grow(expected, seed, taken), consensus_steps.grow(expected, seed, taken))


def test_two_motions_with_equally_many_points_are_ambiguous_and_the_larger_group_wins():
    rng = np.random.default_rng(6)
    x, y, *_ = spoiled(rng, 10, 20, 0)
    y[:, 10:] += [2e-3, 0.0, 0.0]
    kept, status = consensus(x, y, None, SIGMA)
    assert (status == FitStatus.AMBIGUOUS).all()
    assert not kept.any()
    y[:, 10:12] -= [2e-3, 0.0, 0.0]
    kept, status = consensus(x, y, None, SIGMA)
    assert np.array_equal(kept, np.broadcast_to(np.arange(20) < 12, kept.shape))
    assert (status == FitStatus.OK).all()


def test_labels_exchanged_on_half_of_a_square_are_ambiguous():
    square = 0.2 * np.array([[1.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
    x = np.vstack([square, 0.5 * square + [0.0, 0.0, 0.1]])
    y = x.copy()
    y[4:] = y[[6, 7, 4, 5]]
    kept, status = consensus(x, y, None, SIGMA)
    assert status[0] == FitStatus.AMBIGUOUS
    assert not kept.any()


def test_a_mirror_image_keeps_all_distances_and_is_no_motion():
    x = body(np.random.default_rng(7), 12)
    kept, status = consensus(x, x * [1.0, 1.0, -1.0], None, SIGMA)
    assert status[0] != FitStatus.OK
    assert not kept.any()


def test_a_small_agreeing_group_is_named_only_if_it_is_the_only_one():
    rng = np.random.default_rng(8)
    x, y, true, *_ = spoiled(rng, 200, 3, 1)
    kept, status = consensus(x, y, None, SIGMA)
    assert (status == FitStatus.NO_CONSENSUS).all()
    assert (kept == true).all(-1).mean() >= 0.9
    x, y, *_ = spoiled(rng, 200, 20, 20)
    kept, status = consensus(x, y, None, SIGMA)
    assert (status == FitStatus.NO_CONSENSUS).all()
    assert (kept.sum(-1) <= 3).all()


def test_three_of_four_are_enough():
    x, y, true, *_ = spoiled(np.random.default_rng(9), 200, 4, 1)
    kept, status = consensus(x, y, None, SIGMA)
    assert ((kept == true).all(-1) & (status == FitStatus.OK)).mean() >= 0.98


def test_degenerate_poses_say_so_and_spoil_no_neighbour():
    rng = np.random.default_rng(10)
    x, y, *_ = spoiled(rng, 4, 8, 0)
    x = np.repeat(x[None], 4, axis=0)
    mask = np.ones((4, 8), bool)
    mask[1, 2:] = False
    x[2] = x[2, :1]
    x[3] = np.linspace(0.0, 0.2, 8)[:, None] * [0.3, -0.5, 0.7]
    kept, status = consensus(x, y, mask, SIGMA)
    assert list(status) == ["ok", "too-few-points", "coincident", "collinear"]
    assert kept[0].all()
    assert not kept[1:].any()


@pytest.mark.parametrize("sigma", [0.0, -1.0, np.nan])
def test_a_sigma_that_is_none_is_refused(sigma):
    x = body(np.random.default_rng(11), 6)
    with pytest.raises(ValueError, match="sigma: found a value that is not positive"):
        consensus(x, x, None, sigma)
