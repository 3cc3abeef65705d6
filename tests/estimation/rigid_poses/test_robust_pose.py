"""The default pose: efficient without gross errors, correct with them, and with a correct covariance."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.estimation.scatter import body, move, pose_error, random_motions, seeds, squared_pulls
from tests.tolerance import assert_close
from truing.estimation.rigid_poses.rigid import FitStatus
from truing.estimation.rigid_poses.robust_pose import (
    robust_pose,
    robust_poses,
    scatter_of_lengths,
    sigma_from_distances,
    squared_residuals,
)
from truing.estimation.rigid_poses.umeyama import umeyama

SIGMA = 5e-6


def isotropic(*shape, sigma=SIGMA):
    return np.broadcast_to(sigma**2 * np.eye(3), (*shape, 3, 3))


def campaign(rng, poses, points, outliers=0, size=2e-3, sigma=SIGMA):
    """x, y, R, t and which points are gross errors (B, N), of a size of millimetres in any direction."""
    x = body(rng, points)
    R, t = random_motions(rng, poses)
    y = move(R, t, x) + sigma * rng.normal(size=(poses, points, 3))
    bad = np.argsort(rng.uniform(size=(poses, points))) < outliers
    return x, y + bad[..., None] * size * rng.normal(size=y.shape), R, t, bad


def estimate(x, y, **options):
    poses, points = y.shape[:2]
    return robust_pose(
        x, y, np.zeros((points, 3, 3)), isotropic(poses, points), np.ones((poses, points), bool), **options
    )


@pytest.mark.parametrize("points", [6, 20])
@pytest.mark.slow
def test_without_gross_errors_it_is_within_2_percent_of_the_bound(points):
    """The bound itself, not its estimate: the mean square is known to 0.7 % from 3 x 16 000 numbers."""
    rng = np.random.default_rng(51)
    x, y, R, t, _ = campaign(rng, 16_000, points)
    fit, kept = estimate(x, y)
    assert fit.ok.all()
    bound = umeyama(x, move(R, t, x), sigma=SIGMA).covariance
    error = pose_error(fit.R, fit.t, R, t)
    for part in (slice(0, 3), slice(3, 6)):
        stated = np.trace(bound[:, part, part], axis1=1, axis2=2).mean()
        assert np.mean(np.sum(error[:, part] ** 2, axis=1)) / stated == pytest.approx(1.0, abs=0.02)
    assert (~kept).sum(axis=1).mean() < 5e-4


@pytest.mark.parametrize("outliers", [4, 10, 14, 16])
def test_up_to_80_percent_of_gross_errors_in_20_points_are_survived(outliers):
    x, y, R, t, bad = campaign(np.random.default_rng(52 + outliers), 1000, 20, outliers)
    fit, kept = estimate(x, y)
    oracle = umeyama(x, y, ~bad)
    right = fit.ok & np.all(kept | bad, axis=1)
    right[fit.ok] &= np.linalg.norm((fit.t - oracle.t)[fit.ok], axis=-1) < 2 * SIGMA
    assert right.mean() >= 0.99
    error = np.sum(pose_error(fit.R, fit.t, R, t)[right, :3] ** 2)
    assert error / np.sum(pose_error(oracle.R, oracle.t, R, t)[right, :3] ** 2) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("outliers", [0, 3])
def test_the_95_percent_ellipsoid_covers_95_percent(outliers):
    from scipy.stats import binom, chi2

    trials = 10_000
    x, y, R, t, _ = campaign(np.random.default_rng(53), trials, 10, outliers)
    fit, _ = estimate(x, y)
    assert fit.ok.all()
    inside = np.sum(squared_pulls(pose_error(fit.R, fit.t, R, t), fit.covariance) < chi2.ppf(0.95, 6))
    low, high = binom.ppf([1e-4, 1 - 1e-4], trials, 0.95)
    assert 0.93 * trials < low <= inside <= high < 0.97 * trials


@given(seeds, st.integers(0, 8))
def test_results_are_independent_of_frames_order_and_unit(seed, outliers):
    rng = np.random.default_rng(seed)
    x, y, _, _, _ = campaign(rng, 3, 12, outliers)
    fit, kept = estimate(x, y)
    Q, s = random_motions(rng, 3)
    order = rng.permutation(12)
    moved, same = robust_pose(
        1e3 * x[order],
        1e3 * move(Q, s, y[:, order]),
        np.zeros((12, 3, 3)),
        isotropic(3, 12, sigma=1e3 * SIGMA),
        np.ones((3, 12), bool),
    )
    np.testing.assert_array_equal(same, kept[:, order])
    np.testing.assert_array_equal(moved.status, fit.status)
    assert_close(moved.R[fit.ok], (Q @ fit.R)[fit.ok], atol=1e-9)


def test_it_is_deterministic_and_an_entry_does_not_depend_on_its_neighbours():
    x, y, _, _, _ = campaign(np.random.default_rng(54), 6, 12, 5)
    fit, kept = estimate(x, y)
    for b in range(6):
        one, alone = estimate(x, y[b : b + 1])
        assert_close(one.t[0], fit.t[b], atol=1e-12)
        np.testing.assert_array_equal(alone[0], kept[b])


def test_studentised_residuals_of_kept_and_left_out_points_are_chi_square():
    x, y, _, _, _ = campaign(np.random.default_rng(55), 8000, 6)
    used = np.ones((8000, 6), bool)
    used[:, 0] = False
    fit = umeyama(x, y, used, sigma=SIGMA)
    squared = squared_residuals(fit, x, y, np.zeros((6, 3, 3)), isotropic(8000, 6), used)
    assert_close(squared.mean(axis=0), np.full(6, 3.0), atol=6 * np.sqrt(6 / 8000))


def test_a_point_that_a_person_keeps_is_kept():
    x, y, _, _, bad = campaign(np.random.default_rng(56), 20, 10, 1, size=1e-4)
    _, without = estimate(x, y)
    fit, kept = estimate(x, y, always_used=bad)
    assert not without[bad].any()
    assert kept.all()
    assert_close(fit.t, umeyama(x, y).t, atol=1e-12)


def test_no_agreement_has_a_status_and_no_numbers():
    rng = np.random.default_rng(57)
    x, y, _, _, _ = campaign(rng, 50, 8, 8)
    fit, kept = estimate(x, y)
    assert not fit.ok.any()
    assert np.isnan(fit.R).all()
    assert set(fit.status) <= {FitStatus.NO_CONSENSUS, FitStatus.AMBIGUOUS}
    assert kept.sum(axis=1).max() <= 3


@pytest.mark.parametrize("factor", [3.0, 12.0])
def test_noise_declared_too_low_is_found_and_costs_no_point(factor):
    x, y, _, _, _ = campaign(np.random.default_rng(58), 60, 9, sigma=factor * SIGMA)
    fit, kept, ratio = robust_poses(x, y, np.zeros((9, 3, 3)), isotropic(60, 9), np.ones((60, 9), bool))
    assert ratio == pytest.approx(factor, rel=0.2)
    assert kept.mean() > 0.999
    assert fit.ok.all()


def test_a_flexing_body_of_three_points_keeps_its_poses_and_still_loses_gross_errors():
    """Scatter with long tails: every tenth pose flexes five times as much as the others."""
    rng = np.random.default_rng(62)
    x, y, _, _, _ = campaign(rng, 400, 3)
    flexing = rng.uniform(size=400) < 0.1
    y[flexing] += 5 * SIGMA * rng.normal(size=(flexing.sum(), 3, 3))
    y[7, 1] += 5e-3
    fit, kept, ratio = robust_poses(x, y, np.zeros((3, 3, 3)), isotropic(400, 3), np.ones((400, 3), bool))
    assert 1.2 < ratio < 6.0
    assert fit.ok.mean() > 0.97
    assert not fit.ok[7]
    assert list(kept[7]) == [True, False, True]


def test_gross_errors_in_every_tenth_pose_of_three_points_do_not_widen_the_noise():
    rng = np.random.default_rng(63)
    x, y, _, _, _ = campaign(rng, 400, 3)
    wrong = np.flatnonzero(rng.uniform(size=400) < 0.1)
    y[wrong, 0] += 3e-3 * rng.normal(size=(len(wrong), 3))
    fit, _, ratio = robust_poses(x, y, np.zeros((3, 3, 3)), isotropic(400, 3), np.ones((400, 3), bool))
    assert ratio == 1.0
    assert not fit.ok[wrong].any() or fit.ok[wrong].mean() < 0.05


def test_many_gross_errors_are_not_taken_for_noise():
    x, y, _, _, bad = campaign(np.random.default_rng(59), 40, 20, 14)
    _, kept, ratio = robust_poses(x, y, np.zeros((20, 3, 3)), isotropic(40, 20), np.ones((40, 20), bool))
    assert ratio < 1.2
    assert not kept[bad].any()


def test_distances_show_noise_that_nobody_declared():
    rng = np.random.default_rng(60)
    x, y, _, _, bad = campaign(rng, 200, 10, 1)
    assert sigma_from_distances(x, y, ~bad) == pytest.approx(SIGMA, rel=0.05)
    # every fifth pair holds a gross error: the median is then the 62nd percentile of what noise alone does
    assert sigma_from_distances(x, y, ~bad | True) == pytest.approx(1.3 * SIGMA, rel=0.05)
    assert sigma_from_distances(x, y, np.zeros((200, 10), bool)) == 0.0


def test_a_moving_target_is_identified_by_its_scatter():
    rng = np.random.default_rng(61)
    x, y, R, _, _ = campaign(rng, 200, 10)
    y[:, 3] += np.einsum("bij,bj->bi", R, 60e-6 * rng.normal(size=(200, 1)) * [0, 0, 1.0])
    fit, _, _ = robust_poses(x, y, np.zeros((10, 3, 3)), isotropic(200, 10), np.ones((200, 10), bool))
    length = np.linalg.norm(y - fit.apply(x), axis=-1)
    tau = scatter_of_lengths(length, np.full(length.shape, SIGMA**2), np.broadcast_to(fit.ok[:, None], length.shape))
    assert tau[3] == pytest.approx(60e-6, rel=0.25)
    assert np.delete(tau, 3).max() < 2 * SIGMA
