"""Joint estimate of poses and shape: covariance of both, single use of the survey, and deforming targets."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from tests.estimation.scatter import body, move, pose_error, random_motions, seeds, squared_pulls
from tests.tolerance import assert_close
from truing.estimation.rigid_poses.likelihood import maximum_likelihood
from truing.estimation.rigid_poses.procrustes import generalised_procrustes
from truing.estimation.rigid_poses.rigid import FitStatus
from truing.estimation.rigid_poses.umeyama import umeyama

SIGMA = 5e-6


def isotropic(*shape):
    return np.broadcast_to(SIGMA**2 * np.eye(3), (*shape, 3, 3))


def measured(rng, poses, points, seen=0.8):
    """Shape, survey, points, mask and motions of one campaign."""
    x = body(rng, points)
    R, t = random_motions(rng, poses)
    y = move(R, t, x) + SIGMA * rng.normal(size=(poses, points, 3))
    mask = rng.uniform(size=(poses, points)) < seen
    mask[:, :4] = True
    return x, x + SIGMA * rng.normal(size=x.shape), np.where(mask[..., None], y, np.nan), mask, R, t


def test_a_survey_alone_in_one_pose_is_the_maximum_likelihood_pose():
    _, survey, y, mask, _, _ = measured(np.random.default_rng(71), 1, 8, seen=2.0)
    joint = generalised_procrustes(y, isotropic(1, 8), mask, survey, isotropic(8), deforming=False)
    single = maximum_likelihood(survey, y, isotropic(8), isotropic(1, 8))
    assert_close(joint.poses.R, single.R, atol=1e-9)
    assert_close(joint.poses.covariance, single.covariance, atol=1e-3 * np.abs(single.covariance).max())


def test_errors_with_a_survey_match_the_covariance():
    rng = np.random.default_rng(72)
    pose_pulls, shape_pulls, survey_error, shape_error = [], [], 0.0, 0.0
    for _ in range(60):
        x, survey, y, mask, R, t = measured(rng, 12, 7)
        fit = generalised_procrustes(y, isotropic(12, 7), mask, survey, isotropic(7), deforming=False)
        assert fit.status == FitStatus.OK
        # one pose of each campaign: the survey's share of the error is common to all of them
        error = pose_error(fit.poses.R[:1], fit.poses.t[:1], R[:1], t[:1])
        pose_pulls.append(squared_pulls(error, fit.poses.covariance[:1])[0])
        e = (fit.shape - x).ravel()
        shape_pulls.append(e @ np.linalg.solve(fit.shape_covariance, e))
        survey_error += np.sum((survey - x) ** 2)
        shape_error += np.sum(e**2)
    assert np.mean(pose_pulls) == pytest.approx(6.0, abs=4 * np.sqrt(12 / 60))
    assert np.mean(shape_pulls) == pytest.approx(21.0, abs=4 * np.sqrt(42 / 60))
    assert shape_error < 0.5 * survey_error


@pytest.mark.slow
def test_errors_without_a_survey_match_the_covariance():
    """The frame is free: estimate and truth are compared after the best motion between them."""
    rng = np.random.default_rng(73)
    shape_pulls, pose_pulls = [], []
    for _ in range(60):
        x, _, y, mask, R, t = measured(rng, 12, 7)
        fit = generalised_procrustes(y, isotropic(12, 7), mask, deforming=False)
        onto = umeyama(fit.shape, x)
        Q = np.kron(np.eye(7), onto.R)
        e = (onto.apply(fit.shape) - x).ravel()
        shape_pulls.append(e @ np.linalg.pinv(Q @ fit.shape_covariance @ Q.T, rcond=1e-8) @ e)
        back = onto.R.T
        R_true, t_true = R @ onto.R, np.einsum("bij,j->bi", R, onto.t) + t
        assert_close(back @ onto.R, np.eye(3), atol=1e-12)
        error = pose_error(fit.poses.R[:1], fit.poses.t[:1], R_true[:1], t_true[:1])
        pose_pulls.append(squared_pulls(error, fit.poses.covariance[:1])[0])
    assert np.mean(shape_pulls) == pytest.approx(15.0, abs=4 * np.sqrt(30 / 60))
    assert np.mean(pose_pulls) == pytest.approx(6.0, abs=4 * np.sqrt(12 / 60))


def test_the_survey_counts_once_for_any_number_of_poses():
    """More poses improve the shape, but not the survey's frame, whose covariance stays that of the survey."""
    rng = np.random.default_rng(74)
    x, survey, y, mask, _, _ = measured(rng, 400, 6, seen=2.0)
    fit = generalised_procrustes(y, isotropic(400, 6), mask, survey, isotropic(6), deforming=False)
    mean = np.tile(np.eye(3), 6) / 6
    assert_close(mean @ fit.shape_covariance @ mean.T, SIGMA**2 / 6 * np.eye(3), atol=1e-3 * SIGMA**2)
    distance = np.zeros(18)
    along = (x[1] - x[0]) / np.linalg.norm(x[1] - x[0])
    distance[:3], distance[3:6] = -along, along
    assert distance @ fit.shape_covariance @ distance < 0.02 * SIGMA**2


def test_targets_that_deform_lose_weight_and_do_not_bend_the_poses():
    rng = np.random.default_rng(75)
    _, survey, y, mask, R, t = measured(rng, 80, 8, seen=2.0)
    own = np.zeros((80, 8, 3))
    own[:, 2] = 80e-6 * rng.normal(size=(80, 3))
    own[:, 5, 2] = 60e-6 * rng.normal(size=80)
    y = y + np.einsum("bij,bnj->bni", R, own)
    given = (y, isotropic(80, 8), mask, survey, isotropic(8))
    fit, stiff = generalised_procrustes(*given), generalised_procrustes(*given, deforming=False)
    assert fit.deformation[2] == pytest.approx(80e-6, rel=0.2)
    assert fit.deformation[5] == pytest.approx(60e-6 / np.sqrt(3), rel=0.2)
    assert np.delete(fit.deformation, [2, 5]).max() < 0.5 * SIGMA
    keep = [0, 1, 3, 4, 6, 7]
    known = umeyama(survey[keep], y[:, keep])
    spread = [np.mean(pose_error(f.R, f.t, R, t)[:, :3] ** 2) for f in (fit.poses, stiff.poses, known)]
    assert spread[0] < 0.2 * spread[1]
    assert spread[0] < 1.3 * spread[2]


@given(seeds)
def test_moving_the_measurements_moves_the_poses_and_leaves_the_shape(seed):
    rng = np.random.default_rng(seed)
    _, survey, y, mask, _, _ = measured(rng, 6, 7)
    Q, s = random_motions(rng, 6)
    given = (isotropic(6, 7), mask, survey, isotropic(7))
    fit = generalised_procrustes(np.nan_to_num(y), *given, deforming=False)
    moved = generalised_procrustes(move(Q, s, np.nan_to_num(y)), *given, deforming=False)
    assert_close(moved.shape, fit.shape, atol=1e-10)
    assert_close(moved.poses.R, Q @ fit.poses.R, atol=1e-9)


@given(seeds)
def test_results_are_independent_of_the_unit_of_length(seed):
    _, survey, y, mask, _, _ = measured(np.random.default_rng(seed), 6, 7)
    fit = generalised_procrustes(y, isotropic(6, 7), mask, survey, isotropic(7))
    in_mm = generalised_procrustes(1e3 * y, 1e6 * isotropic(6, 7), mask, 1e3 * survey, 1e6 * isotropic(7))
    assert_close(in_mm.shape, 1e3 * fit.shape, atol=1e-8)
    assert_close(in_mm.deformation, 1e3 * fit.deformation, atol=1e-5)


def test_undetermined_targets_and_poses_are_left_out_with_a_status():
    rng = np.random.default_rng(77)
    _, survey, y, mask, _, _ = measured(rng, 6, 8, seen=2.0)
    survey[7] = np.nan
    mask[:, 7] = False
    mask[2, 2:] = False
    fit = generalised_procrustes(y, isotropic(6, 8), mask, survey, isotropic(8))
    assert np.isnan(fit.shape[7]).all()
    assert np.isfinite(fit.shape[:7]).all()
    assert list(fit.poses.status) == ["ok", "ok", "too-few-points", "ok", "ok", "ok"]
    apart = np.ones((6, 8), bool)
    apart[:4, 5:], apart[4:, :4] = False, False
    split = generalised_procrustes(y, isotropic(6, 8), apart)
    assert list(split.poses.status) == ["ok"] * 4 + ["too-few-points"] * 2
    for seen in (mask & (np.arange(8) < 2), mask & False):
        assert generalised_procrustes(y, isotropic(6, 8), seen).status == FitStatus.TOO_FEW_POINTS


def test_shapes_that_do_not_match_are_refused():
    with pytest.raises(ValueError, match="expected"):
        generalised_procrustes(np.zeros((2, 5, 3)), isotropic(2, 4), np.ones((2, 5), bool))
