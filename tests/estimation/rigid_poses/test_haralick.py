"""The reweighted robust pose: kernel, invariance, breakdown, and efficiency."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from tests.estimation.scatter import body, move, pose_error, random_motions, seeds, squared_pulls
from tests.tolerance import assert_close
from truing.estimation.rigid_poses.haralick import (
    TUNING,
    biweight_efficiency,
    haralick,
    residual_scale,
    tukey_biweight,
)
from truing.estimation.rigid_poses.umeyama import umeyama

SIGMA = 5e-6


def campaign(rng, poses, points, outliers=0, size=1e-3):
    x = body(rng, points)
    R, t = random_motions(rng, poses)
    y = move(R, t, x) + SIGMA * rng.normal(size=(poses, points, 3))
    y[:, :outliers] += size * rng.uniform(0.5, 1.0, (poses, outliers, 3))
    return x, y, R, t


def test_the_tuning_constant_gives_95_percent_efficiency():
    assert biweight_efficiency(TUNING) == pytest.approx(0.95, abs=1e-4)
    assert biweight_efficiency(50.0) == pytest.approx(1.0, abs=1e-4)


@given(seeds)
def test_the_unit_of_length_changes_no_weight(seed):
    x, y, _, _ = campaign(np.random.default_rng(seed), 4, 8, outliers=1)
    fit, weight = haralick(x, y, SIGMA, SIGMA)
    in_mm, weight_mm = haralick(1e3 * x, 1e3 * y, 1e3 * SIGMA, 1e3 * SIGMA)
    assert_close(weight_mm, weight, atol=1e-6)
    assert_close(in_mm.t, 1e3 * fit.t, atol=1e-9)


def test_kernel_is_one_at_zero_and_zero_from_its_constant_on():
    assert_close(tukey_biweight(np.array([0.0, 2.0, 4.0, 9.0]), 4.0), [1.0, 0.5625, 0.0, 0.0], atol=1e-15)


@given(seeds)
def test_moving_the_measured_cloud_and_its_order_changes_no_weight(seed):
    rng = np.random.default_rng(seed)
    x, y, _, _ = campaign(rng, 4, 9, outliers=2)
    fit, weight = haralick(x, y, SIGMA, SIGMA)
    Q, s = random_motions(rng, 4)
    order = rng.permutation(9)
    moved, same = haralick(x[order], move(Q, s, y[:, order]), SIGMA, SIGMA)
    assert_close(same, weight[:, order], atol=1e-6)
    assert_close(moved.R, Q @ fit.R, atol=1e-9)


@pytest.mark.parametrize("points", [6, 20])
def test_clean_noise_costs_about_five_percent_and_the_ellipsoid_covers(points):
    from scipy.stats import chi2

    rng = np.random.default_rng(11)
    trials = 6000
    x, y, R, t = campaign(rng, trials, points)
    robust, _ = haralick(x, y, 0.0, SIGMA)
    plain = umeyama(x, y, sigma=SIGMA)
    assert robust.ok.mean() > 0.999
    errors = [pose_error(f.R[robust.ok], f.t[robust.ok], R[robust.ok], t[robust.ok]) for f in (plain, robust)]
    efficiency = np.mean(np.sum(errors[0][:, :3] ** 2, -1)) / np.mean(np.sum(errors[1][:, :3] ** 2, -1))
    assert 0.94 < efficiency < 0.99
    inside = squared_pulls(errors[1], robust.covariance[robust.ok]) < chi2.ppf(0.95, 6)
    assert 0.94 < inside.mean() < 0.98


def test_gross_errors_lose_their_weight_and_leave_the_pose_alone():
    rng = np.random.default_rng(12)
    x, y, R, t = campaign(rng, 500, 20, outliers=4)
    robust, weight = haralick(x, y, 0.0, SIGMA)
    assert (weight[:, :4] == 0).mean() > 0.99
    clean = umeyama(x[4:], y[:, 4:], sigma=SIGMA)
    error = np.sum(pose_error(robust.R, robust.t, R, t)[:, :3] ** 2, -1)
    floor = np.sum(pose_error(clean.R, clean.t, R, t)[:, :3] ** 2, -1)
    assert 0.95 < np.median(error) / np.median(floor) < 1.25


def test_noise_of_both_clouds_counts_and_noise_of_none_is_refused():
    rng = np.random.default_rng(13)
    x, y, _, _ = campaign(rng, 2, 8)
    both, _ = haralick(x, y, SIGMA, SIGMA)
    measured, _ = haralick(x, y, 0.0, SIGMA * np.sqrt(2))
    assert_close(both.covariance, measured.covariance, atol=1e-18)
    with pytest.raises(ValueError, match="noise of 0"):
        haralick(x, y, 0.0, 0.0)


def test_missing_points_and_unusable_entries():
    rng = np.random.default_rng(14)
    x, y, _, _ = campaign(rng, 3, 8)
    weight = np.ones((3, 8))
    weight[0, 2], weight[1, 2:] = 0.0, 0.0
    y[0, 2] = np.nan
    fit, robust = haralick(x, y, SIGMA, SIGMA, weight)
    assert list(fit.status) == ["ok", "too-few-points", "ok"]
    assert robust[0, 2] == 0
    assert not robust[1].any()
    assert (fit.iterations[[0, 2]] > 0).all()


def test_scale_of_residuals_is_one_where_they_scatter_as_declared():
    rng = np.random.default_rng(15)
    x, y, _, _ = campaign(rng, 4000, 12)
    length = np.linalg.norm(y - umeyama(x, y).apply(x), axis=-1) / SIGMA
    assert np.mean(residual_scale(length, np.ones_like(length, bool))) == pytest.approx(1.0, abs=0.03)
