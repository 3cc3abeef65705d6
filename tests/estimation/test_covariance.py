"""Covariance of errors that bodies share through their common parent."""

from __future__ import annotations

import numpy as np

from tests.tolerance import assert_close
from truing.estimation.covariance import invert, relative, shared_parent_covariance
from truing.estimation.rotation import exp_so3, log_so3


def _pose(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    root = rng.normal(size=(6, 6)) * 1e-6
    return exp_so3(rng.normal(size=3)), rng.normal(size=3), root @ root.T


def test_shared_covariance_is_the_whole_covariance_of_exact_bodies() -> None:
    rng = np.random.default_rng(3)
    parent, bodies = _pose(rng), [_pose(rng) for _ in range(2)]
    seen = [relative(*parent, R, p, np.zeros((6, 6))) for R, p, _ in bodies]
    found = shared_parent_covariance(*parent, np.stack([p for _, p, _ in seen]))
    for k, (_, _, covariance) in enumerate(seen):
        assert_close(
            found[6 * k : 6 * k + 6, 6 * k : 6 * k + 6], covariance, atol=1e-24, what=f"body {k}, m^2 and rad^2"
        )


def test_covariance_of_two_bodies_is_that_of_draws_of_their_parent() -> None:
    rng, draws = np.random.default_rng(4), 40_000
    R, p, covariance = _pose(rng)
    bodies = [_pose(rng)[:2] for _ in range(2)]
    error = rng.normal(size=(draws, 6)) @ np.linalg.cholesky(covariance).T
    R_off, p_off = exp_so3(error[:, 3:]) @ R, p + error[:, :3]
    back, origin, _ = invert(R, p, covariance)
    rows = []
    for R_b, p_b in bodies:
        there = (np.swapaxes(R_off, -1, -2) @ (p_b - p_off)[..., None])[..., 0]
        turned = log_so3(np.swapaxes(R_off, -1, -2) @ R_b @ (back @ R_b).T)
        rows += [there - (back @ p_b + origin), turned]
    sampled = np.cov(np.concatenate(rows, -1).T)
    found = shared_parent_covariance(R, p, covariance, np.stack([back @ p_b + origin for _, p_b in bodies]))
    scale = np.sqrt(np.diag(found))
    # a sampled correlation is off by 1 / sqrt(draws); five times that of the largest of 78 is rare to 1e-4
    assert_close(
        sampled / np.outer(scale, scale), found / np.outer(scale, scale), atol=5 / np.sqrt(draws), what="covariance"
    )
