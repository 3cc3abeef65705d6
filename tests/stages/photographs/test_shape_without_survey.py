"""A body without a survey gets the common shape of its poses, even if the scale is poorly known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.tolerance import assert_between, assert_close
from truing.estimation.rigid_poses.body_estimate import fit_body
from truing.estimation.rigid_poses.points import PointErrors, PosePoints, SurveyPoints
from truing.estimation.rigid_poses.umeyama import umeyama

POSES, TARGETS, NOISE, SCALE = 5, 12, 1e-6, 3e-4
NO_SURVEY = SurveyPoints((), np.empty((0, 3)), np.empty((0, 3, 3)), np.empty(0, np.int64))


def turns() -> np.ndarray:
    angle = np.radians(15.0) * np.arange(POSES)
    c, s, z = np.cos(angle), np.sin(angle), np.zeros(POSES)
    return np.stack([np.stack([c, -s, z], -1), np.stack([s, c, z], -1), np.stack([z, z, z + 1], -1)], -2)


def photographed(seed: int) -> tuple[np.ndarray, PosePoints, np.ndarray]:
    """A flat body's shape, its points with their covariances, and what an error of the scale does to each (B, T, 3):
    away from the middle of all that each pose shows, which is none of the body's."""
    rng = np.random.default_rng(seed)
    shape = rng.uniform(-0.2, 0.2, (TARGETS, 3)) * [1.0, 1.0, 0.02]
    true = shape @ np.swapaxes(turns(), 1, 2)
    along = SCALE * (true - rng.uniform(-0.1, 0.1, (POSES, 1, 3)))
    cov = NOISE**2 * np.eye(3) + along[..., None] * along[..., None, :]
    names = tuple(map(str, range(TARGETS)))
    points = true + NOISE * rng.normal(size=true.shape)
    return shape, PosePoints(tuple(range(POSES)), names, points, cov, np.ones((POSES, TARGETS), bool)), along


def off(shape: np.ndarray, points: PosePoints, own: np.ndarray | None) -> float:
    """Distance of the found from the true shape after a rigid fit, m."""
    found = fit_body(points, "plate", NO_SURVEY, None, None, own)
    assert not found.rejected.any()
    onto = umeyama(found.source, shape[None], np.ones((1, TARGETS)))
    return float(np.sqrt(np.mean((onto.apply(found.source) - shape) ** 2)))


def test_an_error_of_the_scale_leaves_the_shape_as_the_poses_have_it() -> None:
    """As well as the mean of all poses tells it; with the whole covariance of each point, it is not."""
    drawn = [photographed(seed) for seed in range(6)]
    errors = [(off(s, p, p.cov - a[..., None] * a[..., None, :]), off(s, p, None)) for s, p, a in drawn]
    own, whole = np.sqrt(np.mean(np.square(errors), axis=0))
    # Six of 36 numbers of the shape are no shape but where it lies.
    assert_between(own / (NOISE * np.sqrt(30 / 36 / POSES)), 0.85, 1.15, what="error over the noise of a mean")
    assert whole > 1.5 * own


def test_errors_common_to_all_poses_are_removed_from_each_covariance() -> None:
    _, points, along = photographed(1)
    whole = points.cov.reshape(-1, 3, 3)
    sigma = np.sqrt(np.diagonal(whole, axis1=1, axis2=2))
    none = np.empty(0, np.int64)
    errors = PointErrors(
        np.repeat(np.arange(POSES), TARGETS),
        sigma,
        whole / (sigma[:, :, None] * sigma[:, None, :]),
        *(none, none, np.empty((0, 3, 3)), np.zeros(POSES + 1, np.int64)),
        ("camera c", "bar S"),
        np.stack([2.0 * along.reshape(-1, 3), along.reshape(-1, 3)], -1),
    )
    # Two parameters of which the second takes back what the first does: 2 x - x.
    found = errors.of_each(np.array([[1.0, -1.0], [-1.0, 1.0]]))
    assert_close(found, np.broadcast_to(NOISE**2 * np.eye(3), found.shape), atol=1e-17, what="m^2")
    least = replace(errors, effect=10.0 * errors.effect).of_each(np.eye(2))
    assert (np.linalg.eigvalsh(least) > 0.0).all()
