"""Budgets sum to the whole covariance, part by part as often as a Monte Carlo campaign repeats it."""

from __future__ import annotations

import numpy as np
import pytest

from truing.estimation.uncertainty_budget import (
    Budget,
    Source,
    beyond_declared,
    budget,
    coverage_factor,
    linear_estimate,
)

POINTS, READINGS, TOLERANCE = Source("points", "B"), Source("readings", "A", 12.0), Source("tolerance", "B")


def _problem(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, dict, dict]:
    """Equations (7, 4) in 9 sets of 3 values of very different size, seen through inputs of two groups, and a prior."""
    jacobian = rng.normal(size=(9, 4, 3)) * [1.0, 1e3, 1e-4]
    loadings = rng.normal(size=(9, 4, 6))
    noise = {}
    for source, own in ((POINTS, slice(0, 4)), (READINGS, slice(4, 6))):
        root = np.zeros((9, 6, 6))
        root[:, own, own] = rng.normal(size=(9, own.stop - own.start, own.stop - own.start))
        noise[source] = root @ np.swapaxes(root, 1, 2)
    return jacobian, loadings, noise, {TOLERANCE: np.diag([2.0, 3e6, 1e-7])}


def test_parts_sum_to_the_covariance_of_the_whole() -> None:
    jacobian, loadings, noise, prior = _problem(np.random.default_rng(1))
    parts = linear_estimate(jacobian, noise, prior, loadings)
    whole = loadings @ (noise[POINTS] + noise[READINGS]) @ np.swapaxes(loadings, 1, 2)
    precision = np.einsum("bmp,bmn,bnq->pq", jacobian, np.linalg.inv(whole), jacobian) + prior[TOLERANCE]
    scale = np.sqrt(np.diag(precision))
    covariance = np.linalg.inv(precision / np.outer(scale, scale)) / np.outer(scale, scale)
    assert sum(parts.values()) == pytest.approx(covariance, rel=1e-9)
    reported = budget(parts, np.array([[1.0, 1e-3, 0.0], [0.0, 0.0, 1.0]]))
    assert reported.shares.sum(0) == pytest.approx(1.0, abs=1e-12)
    rows = np.array([[1.0, 1e-3, 0.0], [0.0, 0.0, 1.0]])
    assert reported.standard == pytest.approx(np.sqrt(np.diag(rows @ covariance @ rows.T)), rel=1e-9)


@pytest.mark.parametrize("alone", [POINTS, READINGS, TOLERANCE])
def test_each_part_is_what_its_source_alone_makes_of_the_estimate(alone: Source) -> None:
    """Draws in which one source alone errs: estimates scatter by its part, within what so many draws leave open."""
    rng = np.random.default_rng(2)
    jacobian, loadings, noise, prior = _problem(rng)
    part = linear_estimate(jacobian, noise, prior, loadings)[alone]
    weight = np.linalg.inv(loadings @ sum(noise.values()) @ np.swapaxes(loadings, 1, 2))
    draws = 4000
    y, known = np.zeros((draws, 9, 4)), np.zeros((draws, 3))
    if alone is TOLERANCE:
        known = rng.normal(size=(draws, 3)) / np.sqrt(np.diag(prior[TOLERANCE]))
    else:
        root = np.linalg.cholesky(noise[alone] + 1e-14 * np.eye(6))
        y = np.einsum("bmn,bnk,dbk->dbm", loadings, root, rng.normal(size=(draws, 9, 6)), optimize=True)
    precision = np.einsum("bmp,bmn,bnq->pq", jacobian, weight, jacobian) + prior[TOLERANCE]
    right = np.einsum("bmp,bmn,dbn->dp", jacobian, weight, y, optimize=True) + known @ prior[TOLERANCE]
    scale = np.sqrt(np.diag(precision))
    found = np.linalg.solve(precision / np.outer(scale, scale), (right / scale).T).T / scale
    ratio = found.var(0) / np.diag(part)
    assert np.all(np.abs(ratio - 1.0) < 4.0 * np.sqrt(2.0 / draws))


def test_scatter_beyond_what_was_declared_is_of_its_own_kind() -> None:
    declared, found = np.diag([4.0, 9.0]), Source("scatter", "A", 10.0)
    parts = beyond_declared({POINTS: declared * 2.25, TOLERANCE: np.eye(2)}, POINTS, 1.5, found)
    assert parts[POINTS] == pytest.approx(declared)
    assert sum(parts.values()) == pytest.approx(declared * 2.25 + np.eye(2))
    assert not beyond_declared({POINTS: declared}, POINTS, 0.8, found)[found].any()


def test_effective_degrees_of_freedom_are_those_of_the_example_of_the_guide() -> None:
    """JCGM 100:2008, G.4.1: y = b x1 x2 x3 with n = 10, 5, 15 and 0.25, 0.57, 0.82 % gives nu_eff = 19."""
    sources = tuple(Source(name, "A", dof) for name, dof in (("x1", 9.0), ("x2", 4.0), ("x3", 14.0)))
    reported = Budget(sources, np.array([[0.25], [0.57], [0.82]]))
    assert reported.standard[0] == pytest.approx(1.03, abs=0.005)
    assert reported.dof[0] == pytest.approx(19.0, abs=0.05)
    assert coverage_factor(np.array([19.0]))[0] == pytest.approx(2.09, abs=0.005)  # Table G.2
    assert coverage_factor(np.array([1.0, 50.0, np.inf])) == pytest.approx([12.71, 2.01, 1.96], abs=0.005)


def test_a_source_without_any_part_is_not_listed() -> None:
    reported = budget({POINTS: np.eye(2), READINGS: np.zeros((2, 2))})
    assert reported.sources == (POINTS,)
    assert np.isinf(reported.dof).all()
    assert reported.with_source(READINGS, np.array([1.0, 0.0])).dof == pytest.approx([48.0, np.inf])
