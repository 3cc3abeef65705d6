"""Poses of a body block by block equal those of all poses at once; also if few poses determine the shape."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import partial

import numpy as np
import pytest

from tests.estimation.scatter import body, move, random_motions
from tests.tolerance import assert_between, assert_close
from truing.estimation.rigid_poses import body_estimate
from truing.estimation.rigid_poses.body_estimate import estimate_body, fit_body, shape_rows
from truing.estimation.rigid_poses.points import CompactPoints, PosePoints, SurveyPoints
from truing.estimation.rigid_poses.rigid import RigidFit, join_fits

SIGMA, TARGETS, POSES = 5e-6, 8, 40
NO_SURVEY = SurveyPoints((), np.empty((0, 3)), np.empty((0, 3, 3)), np.empty(0, np.int64))
NAMES = tuple(map(str, range(TARGETS)))


def measured(seed: int, poses: int = POSES) -> tuple[CompactPoints, SurveyPoints]:
    """A body with gross errors, unseen targets, and noise of its own in each coordinate of each point."""
    rng = np.random.default_rng(seed)
    shape, sigma = body(rng, TARGETS), SIGMA * rng.uniform(0.5, 2.0, (poses, TARGETS, 3))
    points = move(*random_motions(rng, poses), shape) + sigma * rng.normal(size=(poses, TARGETS, 3))
    points[rng.random((poses, TARGETS)) < 0.02] += 3e-3
    is_observed = rng.random((poses, TARGETS)) < 0.95
    survey = shape + SIGMA * rng.normal(size=shape.shape)
    cov = np.broadcast_to(SIGMA**2 * np.eye(3), (TARGETS, 3, 3))
    points = np.where(is_observed[..., None], points, 0.0)
    compact = CompactPoints(tuple(range(poses)), NAMES, points, sigma, None, is_observed)
    return compact, SurveyPoints(NAMES, survey, cov, np.zeros(TARGETS, np.int64))


def with_matrices(compact: CompactPoints) -> PosePoints:
    sigma, is_observed = np.broadcast_to(compact.sigma, compact.points.shape), compact.is_observed
    correlation = np.broadcast_to(np.eye(3), (*is_observed.shape, 3, 3)).copy()
    if compact.correlation is not None:
        for k, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
            correlation[..., i, j] = correlation[..., j, i] = compact.correlation[..., k]
    cov = correlation * sigma[..., :, None] * sigma[..., None, :] * is_observed[..., None, None]
    return PosePoints(compact.poses, compact.targets, compact.points, cov, is_observed)


@pytest.mark.parametrize("common", [True, False])
@pytest.mark.parametrize("correlated", [True, False])
def test_compact_points_have_the_covariances_of_their_sigmas_and_correlations(common: bool, correlated: bool) -> None:
    points, _ = measured(1)
    rng = np.random.default_rng(2)
    points = replace(
        points,
        sigma=points.sigma[:1, :1] if common else points.sigma,
        correlation=rng.uniform(-0.5, 0.5, points.points.shape) if correlated else None,
    )
    whole = with_matrices(points)
    for rows in (slice(None), slice(3, 9), np.array([5, 1, 30])):
        block = points.block(rows)
        assert block.poses == tuple(np.arange(POSES)[rows].tolist())
        assert_close(block.cov, whole.cov[rows], atol=1e-14 * SIGMA**2)
        assert_close(points.variance[rows], np.trace(whole.cov[rows], axis1=-2, axis2=-1), atol=1e-14 * SIGMA**2)
        assert np.array_equal(block.is_observed, whole.is_observed[rows])


@pytest.mark.parametrize("surveyed", [True, False])
def test_blocks_of_poses_are_those_of_all_poses_at_once(surveyed: bool) -> None:
    points, survey = measured(3)
    survey = survey if surveyed else NO_SURVEY
    whole = fit_body(with_matrices(points), "plate", survey)
    estimate = estimate_body(points, "plate", survey)
    blocks = [estimate.poses(slice(first, first + 7)) for first in range(0, POSES, 7)]
    assert list(whole.fits) == (["umeyama", "haralick", "maximum_likelihood"] if surveyed else ["procrustes"])
    for method, fit in whole.fits.items():
        _same_fit(join_fits([block.fits[method] for block in blocks]), fit)
        left = np.concatenate([block.rejections[method] for block in blocks])
        assert np.array_equal(left, whole.rejections[method])
    for name in ("used", "rejected", "reason"):
        found = np.concatenate([getattr(block, name) for block in blocks])
        assert np.array_equal(found, getattr(whole, name)), name
    assert_close(
        np.nan_to_num(np.concatenate([block.residual for block in blocks])), np.nan_to_num(whole.residual), atol=1e-15
    )
    assert whole.rejected.any()
    assert np.array_equal(estimate.rejected, whole.rejected)
    pose, target = np.argwhere(whole.rejected)[0]
    assert estimate.reason(pose, target) == whole.reason[pose, target]


def _same_fit(found: RigidFit, expected: RigidFit) -> None:
    assert np.array_equal(found.status, expected.status)
    for field in fields(RigidFit):
        a, b = getattr(found, field.name), getattr(expected, field.name)
        if a.dtype.kind == "f":
            scale = float(np.nanmax(np.abs(b)))
            assert_close(np.nan_to_num(a), np.nan_to_num(b), atol=1e-12 * scale + 1e-30, what=field.name)


def test_without_all_methods_the_default_poses_stay() -> None:
    points, survey = measured(4)
    estimate = estimate_body(points, "plate", survey)
    every, default = estimate.poses(slice(5, 20)), estimate.poses(slice(5, 20), every=False)
    assert list(default.fits) == [every.default]
    assert np.array_equal(default.fit.R, every.fit.R)
    assert np.array_equal(default.reason, every.reason)


def test_the_shape_is_taken_from_poses_that_show_every_target_often() -> None:
    is_observed = np.ones((10_000, 5), bool)
    assert shape_rows(is_observed, 50_000) == slice(None)
    is_observed[:, 4] = False
    is_observed[7001:7301, 4] = True
    rows = shape_rows(is_observed, 1000)
    assert 200 <= len(rows) <= 200 + 200
    assert len(np.unique(rows)) == len(rows)
    assert is_observed[rows, 4].sum() >= 200
    assert np.diff(rows[rows < 7001]).max() <= 51


@pytest.mark.parametrize("flexing", [False, True])
def test_poses_on_the_shape_of_some_are_those_of_all_within_the_noise_of_the_shape(
    flexing: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Twelve poses determine a place to sigma over root 12; the common motion of all poses is within their
    covariance."""
    rng = np.random.default_rng(6)
    poses, some = 120, 12
    shape = body(rng, TARGETS)
    points = move(*random_motions(rng, poses), shape)
    if flexing:
        points[:, 2] += 4 * SIGMA * rng.normal(size=(poses, 3))
    points += SIGMA * rng.normal(size=points.shape)
    compact = CompactPoints(
        tuple(range(poses)), NAMES, points, np.full((1, 1, 3), SIGMA), None, np.ones((poses, TARGETS), bool)
    )
    joint = fit_body(with_matrices(compact), "plate", NO_SURVEY)
    monkeypatch.setattr(body_estimate, "shape_rows", partial(shape_rows, max_points=some * TARGETS))
    monkeypatch.setattr(body_estimate, "_SEEN_OFTEN", 1)
    estimate = estimate_body(compact, "plate", NO_SURVEY)
    found = estimate.poses(slice(None))
    assert estimate.common.shape_poses == some
    assert found.fit.ok.all()
    # The two shapes lie in frames of their own: compare the residuals, which have none. 18 of 24 numbers are shape.
    apart = np.sqrt(np.mean(np.delete(found.residual - joint.residual, 2, axis=1) ** 2))
    expected = SIGMA * np.sqrt((1 / some - 1 / poses) * 18 / 24)
    assert_between(apart / expected, 0.6, 1.5, what="residuals apart, over what the noise of the shape explains")
    # The covariance of a pose grows by what the shape's noise adds, and is never below that of the joint estimate.
    ratio = np.trace(found.fit.covariance, axis1=1, axis2=2) / np.trace(joint.fit.covariance, axis1=1, axis2=2)
    assert_between(float(np.median(ratio)), 0.9, 1.5, what="variance over that of the joint estimate")
