"""The maximum-likelihood pose: derivative, limiting cases, invariance, and efficiency."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

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
from truing.estimation.rigid_poses.likelihood import _normal_equations, _PointPairs, maximum_likelihood
from truing.estimation.rigid_poses.rigid import FitStatus
from truing.estimation.rigid_poses.umeyama import umeyama
from truing.estimation.rotation import exp_so3

SIGMA = 5e-6


def depth_noise(rng, shape, ratio=6.0):
    """Covariances (*shape, 3, 3) of SIGMA across and `ratio` times that along a random line of sight."""
    sight = random_rotations(rng, int(np.prod(shape)))[:, 0].reshape(*shape, 3)
    along = sight[..., :, None] * sight[..., None, :]
    return SIGMA**2 * (np.eye(3) + (ratio**2 - 1) * along)


def draw(rng, cov):
    return np.einsum("...ij,...j->...i", np.linalg.cholesky(cov), rng.normal(size=cov.shape[:-1]))


def trials(rng, poses, points, both=True):
    x = body(rng, points)
    C_y = depth_noise(rng, (poses, points))
    C_x = depth_noise(rng, (points,)) if both else np.zeros((points, 3, 3))
    R, t = random_motions(rng, poses)
    y = move(R, t, x) + draw(rng, C_y)
    survey = x + draw(rng, np.broadcast_to(C_x, (poses, points, 3, 3))) if both else np.broadcast_to(x, y.shape)
    return survey, y, C_x, C_y, R, t


@given(seeds)
def test_gradient_is_exact(seed):
    rng = np.random.default_rng(seed)
    x, y, C_x, C_y, R, t = trials(rng, 3, 6)
    R = exp_so3(1e-4 * rng.normal(size=(3, 3))) @ R
    C_x = np.broadcast_to(C_x, C_y.shape)
    _, gradient, _ = _normal_equations(_PointPairs(x, y, C_x, C_y, np.ones((3, 6), bool)), R, t)

    def cost(p, turned):
        r = y - x @ np.swapaxes(turned, 1, 2) - p[:, None]
        S = C_y + turned[:, None] @ C_x @ np.swapaxes(turned, 1, 2)[:, None]
        return np.sum(r * np.linalg.solve(S, r[..., None])[..., 0], axis=(1, 2)) / 2

    h = 1e-30
    for k, e in enumerate(np.eye(6)):
        step = 1j * h * e
        derivative = cost(t + step[:3], exp_so3(step[3:]) @ R).imag / h
        assert_close(gradient[:, k], derivative, atol=1e-9 * np.abs(gradient).max())


@given(seeds)
def test_isotropic_noise_is_umeyama_without_iterating(seed):
    rng = np.random.default_rng(seed)
    x, y, _, _, _, _ = trials(rng, 4, 7)
    variance = rng.uniform(0.5, 4.0, (4, 7)) * SIGMA**2
    fit = maximum_likelihood(x, y, SIGMA**2 * np.eye(3), variance[..., None, None] * np.eye(3))
    sigma = np.sqrt(variance + SIGMA**2)
    plain = umeyama(x, y, 1 / sigma**2, sigma=sigma)
    assert (fit.iterations == 0).all()
    assert_close(fit.R, plain.R, atol=1e-12)
    assert_close(fit.covariance, plain.covariance, atol=1e-9 * plain.covariance.max())


@given(seeds)
def test_nearly_isotropic_noise_iterates_to_the_same_pose(seed):
    rng = np.random.default_rng(seed)
    x, y, _, _, _, _ = trials(rng, 4, 7)
    C = SIGMA**2 * np.diag([1.0, 1.0, 1.0 + 1e-7])
    fit, plain = maximum_likelihood(x, y, C, C), umeyama(x, y, sigma=SIGMA * np.sqrt(2))
    assert (fit.iterations > 0).all()
    assert_close(fit.t, plain.t, atol=1e-5 * SIGMA)
    assert_close(fit.covariance, plain.covariance, atol=1e-3 * plain.covariance.max())


@given(seeds)
def test_moving_either_frame_moves_the_pose_and_its_covariance_along(seed):
    rng = np.random.default_rng(seed)
    x, y, C_x, C_y, _, _ = trials(rng, 3, 7)
    fit = maximum_likelihood(x, y, C_x, C_y)
    Q, s = random_motions(rng, 3)
    moved = maximum_likelihood(x, move(Q, s, y), C_x, Q[:, None] @ C_y @ np.swapaxes(Q, 1, 2)[:, None])
    assert_close(moved.R, Q @ fit.R, atol=1e-9)
    both = np.zeros((3, 6, 6))
    both[:, :3, :3] = both[:, 3:, 3:] = Q
    turned = both @ fit.covariance @ np.swapaxes(both, 1, 2)
    assert_close(moved.covariance, turned, atol=1e-6 * np.abs(turned).max())


@given(seeds)
def test_exchanging_the_clouds_inverts_the_motion(seed):
    x, y, C_x, C_y, _, _ = trials(np.random.default_rng(seed), 3, 7)
    there, back = maximum_likelihood(x, y, C_x, C_y), maximum_likelihood(y, x, C_y, C_x)
    assert_close(back.R, np.swapaxes(there.R, 1, 2), atol=1e-9)
    assert_close(back.t, -np.einsum("bji,bj->bi", there.R, there.t), atol=1e-9)


@given(seeds)
def test_results_are_independent_of_point_order_and_unit_of_length(seed):
    rng = np.random.default_rng(seed)
    x, y, C_x, C_y, _, _ = trials(rng, 3, 7)
    fit, order = maximum_likelihood(x, y, C_x, C_y), rng.permutation(7)
    shuffled = maximum_likelihood(1e3 * x[:, order], 1e3 * y[:, order], 1e6 * C_x[order], 1e6 * C_y[:, order])
    assert_close(shuffled.R, fit.R, atol=1e-10)
    assert_close(shuffled.t, 1e3 * fit.t, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("both", [False, True])
def test_covers_attains_the_bound_and_beats_the_isotropic_pose(both):
    from scipy.stats import binom, chi2

    count = 8000
    x, y, C_x, C_y, R, t = trials(np.random.default_rng(21), count, 8, both)
    fit = maximum_likelihood(x, y, C_x, C_y)
    assert fit.ok.all()
    squared = squared_pulls(pose_error(fit.R, fit.t, R, t), fit.covariance)
    low, high = binom.ppf([1e-4, 1 - 1e-4], count, 0.95)
    assert low <= np.sum(squared < chi2.ppf(0.95, 6)) <= high
    assert squared.mean() / 6 == pytest.approx(1.0, abs=4 * np.sqrt(2 / 6 / count))
    isotropic = umeyama(x, y)
    loss = np.sum(pose_error(isotropic.R, isotropic.t, R, t)[:, :3] ** 2) / np.sum(
        pose_error(fit.R, fit.t, R, t)[:, :3] ** 2
    )
    assert loss > 1.5


def test_missing_points_are_as_good_as_absent():
    x, y, C_x, C_y, _, _ = trials(np.random.default_rng(22), 3, 8)
    mask = np.ones((3, 8), bool)
    mask[:, [1, 5]] = False
    y[:, 1], C_y[:, 5] = np.nan, np.nan
    fit = maximum_likelihood(x, y, C_x, C_y, mask)
    keep = [0, 2, 3, 4, 6, 7]
    alone = maximum_likelihood(x[:, keep], y[:, keep], C_x[keep], C_y[:, keep])
    assert_close(fit.R, alone.R, atol=1e-12)
    assert_close(fit.rms, alone.rms, atol=1e-12)
    assert (fit.n_used == 6).all()


def test_degenerate_entries_keep_their_status_and_spoil_no_neighbour():
    x, y, C_x, C_y, _, _ = trials(np.random.default_rng(23), 3, 8)
    mask = np.ones((3, 8), bool)
    mask[1, 2:] = False
    fit = maximum_likelihood(x, y, C_x, C_y, mask)
    assert list(fit.status) == ["ok", "too-few-points", "ok"]
    assert np.isnan(fit.R[1]).all()


def test_converges_from_a_start_half_a_turn_away_or_says_that_it_did_not():
    x, y, C_x, C_y, R, t = trials(np.random.default_rng(24), 200, 8)
    good = maximum_likelihood(x, y, C_x, C_y)
    bad = umeyama(x, move(np.broadcast_to(np.diag([1.0, -1.0, -1.0]), R.shape), t, y))
    fit = maximum_likelihood(x, y, C_x, C_y, start=bad)
    same = fit.ok & (np.abs(fit.R - good.R).max(axis=(1, 2)) < 1e-6)
    assert same.mean() > 0.5
    assert set(fit.status) <= {FitStatus.OK, FitStatus.NOT_CONVERGED}


@pytest.mark.parametrize(
    ("cov_source", "cov_target", "message"),
    [
        (np.eye(3), np.zeros(3), r"cov_target: found shape \(3,\)"),
        (np.zeros((3, 3)), np.zeros((3, 3)), "noise on neither"),
        (np.eye(3), np.array([[1.0, 0.5, 0], [0, 1, 0], [0, 0, 1]]), "asymmetric"),
        (np.eye(3), np.diag([1.0, 1.0, -1.0]), "negative variance"),
    ],
)
def test_covariances_that_are_none_are_refused(cov_source, cov_target, message):
    x = body(np.random.default_rng(25), 6)
    with pytest.raises(ValueError, match=message):
        maximum_likelihood(x, x, cov_source, cov_target)
