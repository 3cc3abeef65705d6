"""The closest line: exact, equivariant, with a correct covariance, and with no rotation about itself."""

from __future__ import annotations

import numpy as np
from hypothesis import given

from tests.estimation.scatter import move, random_motions, seeds
from tests.tolerance import assert_close
from truing.estimation.rigid_poses.line_fit import fit_line

SIGMA = 5e-6


def rod(rng, points):
    """Points (points, 3) on a cylinder 50 mm long and 1 mm in radius about z, in m."""
    angle = rng.uniform(0, 2 * np.pi, points)
    height = np.linspace(0.0, 0.05, points)
    return np.stack([1e-3 * np.cos(angle), 1e-3 * np.sin(angle), height], axis=1)


@given(seeds)
def test_passes_through_points_on_a_line(seed):
    rng = np.random.default_rng(seed)
    axis = random_motions(rng, 1)[0][0, :, 0]
    start = rng.uniform(-1, 1, 3)
    y = start + np.outer(rng.uniform(-0.1, 0.1, 6), axis)
    fit = fit_line(y, -axis, sigma=SIGMA)
    assert_close(fit.direction[0], -axis, atol=1e-9)
    assert_close(np.cross(fit.position[0] - start, axis), np.zeros(3), atol=1e-12)
    assert_close(fit.rms, np.zeros(1), atol=1e-9)


@given(seeds)
def test_the_fitted_line_moves_with_its_points(seed):
    rng = np.random.default_rng(seed)
    y = rod(rng, 9)
    R, t = random_motions(rng, 1)
    fit, moved = fit_line(y, [0, 0, 1.0], sigma=SIGMA), fit_line(move(R, t, y), R[:, :, 2], sigma=SIGMA)
    assert_close(moved.direction[0], R[0] @ fit.direction[0], atol=1e-10)
    assert_close(moved.position[0], R[0] @ fit.position[0] + t[0], atol=1e-12)
    turned = R[0] @ fit.covariance[0, 3:, 3:] @ R[0].T
    assert_close(moved.covariance[0, 3:, 3:], turned, atol=1e-9 * np.abs(turned).max())


def test_the_stated_covariance_is_that_of_the_errors_and_has_no_part_about_the_line():
    rng = np.random.default_rng(31)
    trials = 20_000
    shape = rod(rng, 8)
    true = fit_line(shape, [0, 0, 1.0], sigma=SIGMA)
    fit = fit_line(shape + SIGMA * rng.normal(size=(trials, 8, 3)), [0, 0, 1.0], sigma=SIGMA)
    error = np.concatenate([fit.position - true.position, np.cross(true.direction, fit.direction)], axis=1)
    stated = true.covariance[0]
    assert_close(true.direction[0] @ stated[3:, 3:] @ true.direction[0], 0.0, atol=1e-20)
    scale = np.sqrt(np.diag(stated))
    found = error.T @ error / trials
    assert_close(found / np.outer(scale, scale), stated / np.outer(scale, scale), atol=6 / np.sqrt(trials))


def test_sets_without_a_direction_have_a_status():
    ball = np.vstack([np.eye(3), -np.eye(3)])
    weight = np.ones((4, 6))
    weight[1, 1:] = 0.0
    y = np.stack([ball, ball, np.ones((6, 3)), np.outer(np.arange(6.0), [1, 0, 0])])
    fit = fit_line(y, [1.0, 0, 0], weight, sigma=SIGMA)
    assert list(fit.status) == ["ambiguous", "too-few-points", "coincident", "ok"]
    assert np.isnan(fit.direction[:3]).all()
