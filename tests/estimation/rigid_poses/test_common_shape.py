"""Estimate of a body's shape from its poses alone."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.estimation.scatter import body, move, random_motions, seeds
from tests.tolerance import assert_close
from truing.estimation.rigid_poses.procrustes import common_shape
from truing.estimation.rigid_poses.umeyama import umeyama

SIGMA = 5e-6


def measured(rng, poses, points):
    x = body(rng, points)
    return x, move(*random_motions(rng, poses), x) + SIGMA * rng.normal(size=(poses, points, 3))


def off_shape(shape, x, targets=slice(None)):
    """Largest distance of the shape from the truth after the best motion onto it."""
    onto = umeyama(shape[targets], x[targets])
    return np.linalg.norm(onto.apply(shape[targets]) - x[targets], axis=-1).max()


@given(seeds, st.integers(3, 12))
def test_a_common_shape_is_accurate_to_three_standard_deviations(seed, points):
    x, y = measured(np.random.default_rng(seed), 30, points)
    shape = common_shape(y, np.ones((30, points), bool), SIGMA)
    assert off_shape(shape, x) < 3 * SIGMA


def test_a_common_shape_grows_over_poses_that_share_three_targets():
    rng = np.random.default_rng(81)
    x, y = measured(rng, 9, 10)
    mask = np.ones((9, 10), bool)
    mask[:3, 6:], mask[3:, :3] = False, False
    y[~mask] = np.nan
    assert off_shape(common_shape(y, mask, SIGMA), x) < 12 * SIGMA


def test_targets_moved_by_metres_between_epochs_do_not_keep_poses_apart():
    rng = np.random.default_rng(82)
    x, y = measured(rng, 24, 30)
    late = x.copy()
    late[:12] += rng.normal(size=(12, 3))
    R, t = random_motions(rng, 24)
    y[16:] = (move(R, t, late) + SIGMA * rng.normal(size=y.shape))[16:]
    mask = rng.uniform(size=(24, 30)) < 0.7
    shape = common_shape(y, mask, SIGMA)
    assert off_shape(shape, x) < 6 * SIGMA  # every target where most poses saw it


def test_a_gross_error_in_the_first_pose_does_not_stay():
    x, y = measured(np.random.default_rng(83), 10, 6)
    y[:, 5] += np.where(np.arange(10)[:, None] == 0, 2e-3, 0.0)
    assert off_shape(common_shape(y, np.ones((10, 6), bool), SIGMA), x) < 12 * SIGMA


def test_a_body_that_flexes_more_than_its_noise_has_a_shape_all_the_same():
    rng = np.random.default_rng(84)
    x, y = measured(rng, 40, 5)
    y += 15 * SIGMA * rng.normal(size=y.shape)
    assert off_shape(common_shape(y, np.ones((40, 5), bool), SIGMA), x) < 45 * SIGMA


def test_a_target_never_seen_with_others_has_no_common_shape():
    rng = np.random.default_rng(85)
    _, y = measured(rng, 5, 8)
    mask = np.ones((5, 8), bool)
    mask[:, 7] = False
    shape = common_shape(y, mask, SIGMA)
    assert_close(np.isfinite(shape).all(axis=1), [True] * 7 + [False], atol=0.0)
    assert np.isnan(common_shape(y, mask & (np.arange(8) < 2), SIGMA)).all()
