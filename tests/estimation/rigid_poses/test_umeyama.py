"""The closed-form motion: invariance, weights, missing points, degenerate sets, covariance."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.estimation.scatter import (
    body,
    move,
    pose_error,
    random_motions,
    random_rotations,
    seeds,
    squared_pulls,
)
from tests.tolerance import assert_close
from truing.estimation.rigid_poses.rigid import FitStatus
from truing.estimation.rigid_poses.umeyama import umeyama, umeyama_misfit

SIGMA = 5e-6


def noisy_pairs(rng, poses=6, points=8, noise=1e-3):
    x = body(rng, points)
    R, t = random_motions(rng, poses)
    return x, move(R, t, x) + noise * rng.normal(size=(poses, points, 3)), R, t


@given(seeds, st.integers(3, 12))
def test_recovers_an_exact_motion(seed, points):
    rng = np.random.default_rng(seed)
    x, y, R, _ = noisy_pairs(rng, points=points, noise=0.0)
    fit = umeyama(x, y)
    assert_close(fit.R, R, atol=2e-12 / np.linalg.svd(x - x.mean(0))[1][1])
    assert_close(fit.apply(x), y, atol=1e-13)
    assert fit.ok.all()


@given(seeds)
def test_a_motion_of_the_measured_cloud_moves_the_pose(seed):
    rng = np.random.default_rng(seed)
    x, y, _, _ = noisy_pairs(rng)
    Q, s = random_motions(rng, 6)
    fit, moved = umeyama(x, y, sigma=SIGMA), umeyama(x, move(Q, s, y), sigma=SIGMA)
    assert_close(moved.R, Q @ fit.R, atol=1e-12)
    assert_close(moved.t, np.einsum("bij,bj->bi", Q, fit.t) + s, atol=1e-12)
    turned = Q @ fit.covariance[:, 3:, 3:] @ np.swapaxes(Q, 1, 2)
    assert_close(moved.covariance[:, 3:, 3:], turned, atol=1e-12 * np.abs(turned).max())
    assert_close(moved.rms, fit.rms, atol=1e-14)


@given(seeds)
def test_results_are_independent_of_point_order_and_unit_of_length(seed):
    rng = np.random.default_rng(seed)
    x, y, _, _ = noisy_pairs(rng)
    w = rng.uniform(0.5, 2.0, y.shape[:2])
    fit = umeyama(x, y, w, sigma=SIGMA)
    order = rng.permutation(len(x))
    shuffled = umeyama(x[order], y[:, order], w[:, order], sigma=SIGMA)
    assert_close(shuffled.t, fit.t, atol=1e-12)
    in_mm = umeyama(1e3 * x, 1e3 * y, 1e-6 * w, sigma=1e3 * SIGMA)
    assert_close(in_mm.R, fit.R, atol=1e-12)
    assert_close(in_mm.t, 1e3 * fit.t, atol=1e-9)
    units = np.array([1e3] * 3 + [1.0] * 3)
    rounding = 1e-9 * np.abs(fit.covariance).max()
    assert_close(in_mm.covariance / np.outer(units, units), fit.covariance, atol=rounding)


@given(seeds)
def test_exchanging_the_clouds_inverts_the_motion(seed):
    x, y, _, _ = noisy_pairs(np.random.default_rng(seed))
    there, back = umeyama(x, y), umeyama(y, x)
    assert_close(back.R, np.swapaxes(there.R, 1, 2), atol=1e-12)
    assert_close(back.t, -np.einsum("bji,bj->bi", there.R, there.t), atol=1e-12)


@given(seeds)
def test_no_small_change_of_the_pose_fits_better(seed):
    rng = np.random.default_rng(seed)
    x, y, _, _ = noisy_pairs(rng, poses=1)
    w = rng.uniform(0.1, 3.0, len(x))
    fit = umeyama(x, y, w)

    def cost(R, t):
        return np.sum(w[:, None] * (y[0] - x @ R.T - t) ** 2)

    best = cost(fit.R[0], fit.t[0])
    for Q in random_rotations(rng, 20):
        near = np.eye(3) + 1e-3 * (Q - Q.T)
        U, _, Vt = np.linalg.svd(near)
        assert cost(U @ Vt @ fit.R[0], fit.t[0] + 1e-4 * Q[0]) > best


def test_a_weight_of_two_counts_as_two_points_and_zero_as_none():
    rng = np.random.default_rng(3)
    x, y, _, _ = noisy_pairs(rng)
    w = np.ones(len(x))
    w[2], w[5] = 2.0, 0.0
    weighted = umeyama(x, y, w)
    index = [0, 1, 2, 2, 3, 4, 6, 7]
    assert_close(weighted.R, umeyama(x[index], y[:, index]).R, atol=1e-12)
    assert (weighted.n_used == 7).all()


def test_a_missing_point_may_be_nan_and_a_used_one_may_not():
    rng = np.random.default_rng(4)
    x, y, _, _ = noisy_pairs(rng)
    y[1, 3] = np.nan
    w = np.ones(y.shape[:2])
    with pytest.raises(ValueError, match="target: found a non-finite point"):
        umeyama(x, y, w)
    w[1, 3] = 0.0
    keep = [0, 1, 2, 4, 5, 6, 7]
    assert_close(umeyama(x, y, w).t[1], umeyama(x[keep], y[1, keep]).t, atol=1e-12)


@pytest.mark.parametrize(
    ("source", "target", "weight", "message"),
    [
        (np.zeros((4, 2)), np.zeros((4, 3)), None, r"source: found shape \(4, 2\)"),
        (np.zeros((4, 3)), np.zeros((5, 3)), None, "found 4 source and 5 target points"),
        (np.zeros((4, 3)), np.zeros((4, 3)), [-1, 1, 1, 1], "negative"),
    ],
)
def test_broken_input_is_refused_by_name(source, target, weight, message):
    with pytest.raises(ValueError, match=message):
        umeyama(source, target, weight)


@given(seeds)
def test_planar_points_half_turns_and_mirror_images_never_give_a_reflection(seed):
    rng = np.random.default_rng(seed)
    flat = body(rng, 6) * [1.0, 1.0, 0.0]
    half_turn = np.diag([1.0, -1.0, -1.0])
    solid = body(rng, 6)
    targets = np.stack([flat @ half_turn, flat * [1.0, -1.0, 1.0]])
    assert_close(umeyama(flat, targets).R, np.stack([half_turn, half_turn]), atol=1e-9)
    assert_close(np.linalg.det(umeyama(solid, solid * [1.0, 1.0, -1.0]).R), 1.0, atol=1e-12)


def test_two_single_clouds_give_one_motion_and_a_batch_of_one_a_batch():
    rng = np.random.default_rng(11)
    x = body(rng, 6)
    y = x @ random_motions(rng, 1)[0][0].T + [0.1, 0.2, 0.3]
    one, batch = umeyama(x, y, sigma=SIGMA), umeyama(x[None], y, sigma=SIGMA)
    assert one.R.shape == (3, 3)
    assert one.covariance.shape == (6, 6)
    assert one.status == FitStatus.OK
    assert_close(one.R, batch.R[0], atol=0.0)
    assert_close(one.apply(x), y, atol=1e-12)
    assert_close(one.residuals(x, y), np.zeros((6, 3)), atol=1e-12)
    assert umeyama(x, y, np.ones((4, 6))).R.shape == (4, 3, 3)


def test_a_mirrored_regular_body_fits_in_several_attitudes_and_says_so():
    octahedron = np.vstack([np.eye(3), -np.eye(3)])
    assert umeyama(octahedron, -octahedron).status == FitStatus.AMBIGUOUS


@pytest.mark.parametrize("offset", [0.0, 1.0, 1e3])
def test_degenerate_entries_have_a_status_and_spoil_no_neighbour(offset):
    rng = np.random.default_rng(5)
    x = np.repeat(body(rng, 6)[None], 5, axis=0)
    w = np.ones(x.shape[:2])
    w[1, 2:] = 0.0
    x[2] = x[2, :1]
    x[3] = np.linspace(-0.2, 0.2, 6)[:, None] * np.array([0.3, -0.5, 0.7])
    w[4] = 0.0
    R, t = random_motions(rng, 5)
    fit = umeyama(x + offset, move(R, t + offset, x), w, sigma=SIGMA)
    assert list(fit.status) == ["ok", "too-few-points", "coincident", "collinear", "too-few-points"]
    assert np.isfinite(fit.R[0]).all()
    for numbers in (fit.R, fit.t, fit.scale, fit.covariance, fit.rms, fit.scale_sigma):
        assert np.isnan(numbers[1:]).all()
    assert all(FitStatus(s).remedy for s in fit.status)


def test_nearly_collinear_points_still_give_numbers_with_their_large_covariance():
    rng = np.random.default_rng(6)
    x = np.linspace(-0.025, 0.025, 6)[:, None] * [0.0, 0.0, 1.0] + 1e-3 * rng.normal(size=(6, 3)) * [1, 1, 0]
    fit = umeyama(x, x, sigma=SIGMA)
    assert fit.ok
    assert fit.covariance[5, 5] > 50 * fit.covariance[3, 3]


@given(seeds)
def test_scale_is_found_and_its_share_of_uncertainty_is_stated(seed):
    rng = np.random.default_rng(seed)
    x, y, R, _ = noisy_pairs(rng, noise=0.0)
    fit = umeyama(x, 1.001 * y, with_scale=True, sigma=SIGMA)
    assert_close(fit.scale, np.full(6, 1.001), atol=1e-12)
    assert_close(fit.R, R, atol=1e-9)
    fixed = umeyama(x, y, sigma=SIGMA)
    assert (np.linalg.eigvalsh(fit.covariance - fixed.covariance)[:, -1] > 0).all()


@pytest.mark.parametrize("with_scale", [False, True])
@pytest.mark.parametrize("noise_on", ["target", "both"])
def test_the_95_percent_ellipsoid_covers_95_percent(with_scale, noise_on):
    from scipy.stats import binom, chi2

    trials = 20_000
    rng = np.random.default_rng(7)
    x = body(rng, 7)
    R, t = random_motions(rng, trials)
    y = move(R, t, x) + SIGMA * rng.normal(size=(trials, 7, 3))
    both = noise_on == "both"
    survey = x + SIGMA * both * rng.normal(size=(trials, 7, 3))
    fit = umeyama(survey, y, rng.uniform(0.3, 3.0, 7), with_scale=with_scale, sigma=SIGMA * np.sqrt(1 + both))
    inside = squared_pulls(pose_error(fit.R, fit.t, R, t), fit.covariance) < chi2.ppf(0.95, 6)
    low, high = binom.ppf([1e-4, 1 - 1e-4], trials, 0.95)
    assert low <= inside.sum() <= high
    if with_scale:
        assert np.std((fit.scale - 1) / fit.scale_sigma) == pytest.approx(1.0, abs=4 / np.sqrt(2 * trials))


def test_without_sigma_the_scatter_of_the_residuals_takes_its_place():
    rng = np.random.default_rng(8)
    trials = 4000
    x = body(rng, 9)
    R, t = random_motions(rng, trials)
    y = move(R, t, x) + SIGMA * rng.normal(size=(trials, 9, 3))
    ratio = umeyama(x, y).covariance[:, 0, 0] / umeyama(x, y, sigma=SIGMA).covariance[:, 0, 0]
    freedom = 3 * 9 - 6
    assert ratio.mean() == pytest.approx(1.0, abs=4 * np.sqrt(2 / freedom / trials))


@pytest.mark.parametrize("with_scale", [False, True])
def test_the_misfit_alone_is_that_of_the_whole_fit(with_scale):
    rng = np.random.default_rng(9)
    x, y, _, _ = noisy_pairs(rng)
    weight = rng.uniform(0.3, 3.0, y.shape[:2])
    weight[1, 2:] = 0.0  # too few points
    fit = umeyama(x, y, weight, with_scale=with_scale)
    rms, scale = umeyama_misfit(x, y, weight, with_scale=with_scale)
    np.testing.assert_array_equal(rms, fit.rms)
    np.testing.assert_array_equal(scale, fit.scale)
    assert np.isnan(rms).tolist() == [False, True, False, False, False, False]


def test_agrees_with_the_worked_example_of_eight_points_on_a_cylinder():
    turn, height = 2.3999632297286533, 6.25
    angle = turn * np.arange(8)
    x = 1e-3 * np.stack([np.cos(angle), np.sin(angle), 3.125 + height * np.arange(8)], axis=1)
    fit = umeyama(x, x, sigma=SIGMA)
    expected = 1e-8 * np.array(
        [
            [1.581065292251302, 0.03688958555619074, -4.488225218474728],
            [0.03688958555619074, 1.5427471915903457, -2.726435257586499],
            [-4.488225218474728, -2.726435257586499, 329.86929092392198],
        ]
    )
    assert_close(fit.covariance[3:, 3:], expected, atol=1e-16)
