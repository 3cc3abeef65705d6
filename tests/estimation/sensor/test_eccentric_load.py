"""Lines of action and their common point: exact without noise, within their covariance with noise."""

from __future__ import annotations

import numpy as np
import pytest

from tests.tolerance import assert_between, assert_close
from truing.estimation.sensor.eccentric_load import line_of_action

COV = np.diag([2.0, 3.0, 2.5, 0.1, 0.2, 0.15]) ** 2


def _wrenches(rng: np.random.Generator, count: int, point: np.ndarray) -> np.ndarray:
    force = rng.normal(size=(count, 3)) * 500.0
    return np.concatenate([force, np.cross(np.broadcast_to(point, force.shape), force)], axis=1)


def test_the_line_is_that_of_the_force_and_nothing_else_explains_the_rest():
    rng = np.random.default_rng(0)
    point = np.array([0.02, -0.05, 0.01])
    wrench = _wrenches(rng, 20, point)
    found = line_of_action(wrench, np.broadcast_to(COV, (20, 6, 6)))
    way = wrench[:, :3] / np.linalg.norm(wrench[:, :3], axis=1)[:, None]
    assert_close(found.arm, point - (way @ point)[:, None] * way, atol=1e-12)
    assert_close(found.along, np.zeros(20), atol=1e-9)
    twisted = wrench + np.concatenate([0 * way, 3.0 * way], axis=1)
    assert_close(line_of_action(twisted, np.broadcast_to(COV, (20, 6, 6))).along, np.full(20, 3.0), atol=1e-9)


def test_fitted_arms_scatter_by_their_sigmas():
    rng = np.random.default_rng(1)
    wrench = np.repeat(_wrenches(rng, 1, np.array([0.02, -0.05, 0.01])), 4000, axis=0)
    noisy = wrench + rng.multivariate_normal(np.zeros(6), COV, 4000)
    true, found = (line_of_action(w, np.broadcast_to(COV, (4000, 6, 6))) for w in (wrench, noisy))
    scatter = np.cov((found.arm - true.arm).T)
    assert_close(scatter / np.trace(scatter), true.covariance[0] / np.trace(scatter), atol=0.05)
    assert_between(float(found.along.std() / true.along_sigma[0]), 0.95, 1.05, what="moment along the force")


def test_pure_moments_are_refused():
    wrench = np.zeros((2, 6))
    wrench[:, 2], wrench[:, 4] = [100.0, 200.0], [5.0, 10.0]
    cov = np.broadcast_to(COV, (2, 6, 6))
    with pytest.raises(ValueError, match="without a force"):
        line_of_action(wrench * (np.arange(6) > 2), cov)
