"""Residuals in a fitted frame: the stated covariance is that of simulated errors."""

from __future__ import annotations

import numpy as np
import pytest

from truing.estimation.rigid_poses.body_frames import frame_covariance, residual_covariance
from truing.estimation.rotation import skew


@pytest.fixture(scope="module")
def simulated():
    rng = np.random.default_rng(1)
    points = 0.1 * rng.standard_normal((9, 3))
    used = np.ones((1, 9), bool)
    used[0, 6:] = False
    root = 1e-6 * rng.standard_normal((9, 3, 3))
    noise = np.einsum("tij,tkj->tik", root, root) + 1e-12 * np.eye(3)
    errors = np.einsum("tij,ntj->nti", np.linalg.cholesky(noise), rng.standard_normal((40_000, 9, 3)))
    lever = np.concatenate([np.broadcast_to(np.eye(3), (9, 3, 3)), -skew(points)], axis=2)
    weight = np.linalg.inv(noise) * used[0][:, None, None]
    normal = np.einsum("tia,tij,tjc->ac", lever, weight, lever)
    frame = np.einsum("ac,tic,tij,ntj->na", np.linalg.inv(normal), lever, weight, errors, optimize=True)
    residuals = errors - np.einsum("tia,na->nti", lever, frame)
    return points, noise[None], used, frame, residuals


def test_frame_covariance_is_the_scatter_of_fitted_frames(simulated):
    points, noise, used, frame, _ = simulated
    stated = frame_covariance(points, noise, used)[0]
    _same_covariance(frame, stated)


def test_residual_covariance_is_the_scatter_of_residuals(simulated):
    points, noise, used, _, residuals = simulated
    stated = residual_covariance(points, noise, used, np.ones_like(used))[0]
    _same_covariance(residuals.reshape(len(residuals), -1), stated)


def _same_covariance(draws, stated):
    """Each entry within six of its own standard deviations."""
    found = np.cov(draws.T)
    deviation = np.sqrt((stated**2 + np.outer(np.diag(stated), np.diag(stated))) / len(draws))
    assert (np.abs(found - stated) < 6.0 * deviation).all()


def test_residuals_of_fitted_frames_have_lost_the_rigid_part(simulated):
    points, noise, used, _, _ = simulated
    only = residual_covariance(points[:6], noise[:, :6], used[:, :6], used[:, :6])[0]
    assert np.linalg.matrix_rank(only, tol=1e-9 * np.abs(only).max()) == 3 * 6 - 6


def test_targets_not_seen_have_no_covariance(simulated):
    points, noise, used, _, _ = simulated
    is_observed = np.ones_like(used)
    is_observed[0, 8] = False
    cov = residual_covariance(points, np.where(is_observed[..., None, None], noise, 0.0), used, is_observed)[0]
    assert not cov[24:].any()
    assert not cov[:, 24:].any()
