"""The datum changes no residual, no distance, and no variance of a distance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.estimation.bundle.drawn_networks import disturbed, draw, noisy
from truing.estimation.bundle.adjustment import adjust
from truing.estimation.bundle.network import KnownPoints


def variances_of_distances(adjustment, pose=0):
    """Return the variance of the distance of every pair of points of a pose."""
    numbers = adjustment.covariance.point_numbers(pose)
    points, cov = adjustment.state.points[numbers], adjustment.covariance.points(pose)
    found = []
    for i, j in zip(*np.triu_indices(len(points), 1), strict=True):
        a = np.zeros(len(cov))
        along = (points[j] - points[i]) / np.linalg.norm(points[j] - points[i])
        a[3 * i : 3 * i + 3], a[3 * j : 3 * j + 3] = -along, along
        found.append([np.linalg.norm(points[j] - points[i]), a @ cov @ a])
    return np.array(found).T


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 10**6), bars=st.booleans())
def test_free_and_minimal_agree_in_all_that_can_be_measured(seed, bars):
    rng = np.random.default_rng(seed)
    network, truth = draw(rng, images=6, points=9, bars=bars, free=("c", "A1"))
    network, start = noisy(rng, network), disturbed(rng, truth)
    free, minimal = adjust(network, start, "free"), adjust(network, start, "minimal")
    assert free.defect == minimal.defect == (6 if bars else 7)
    np.testing.assert_allclose(free.residuals_px, minimal.residuals_px, rtol=0, atol=1e-8)
    of_free, of_minimal = variances_of_distances(free), variances_of_distances(minimal)
    # Where nothing gives scale, distances and their variances are those of the scale that was chosen.
    scale = 1.0 if bars else of_free[0, 0] / of_minimal[0, 0]
    np.testing.assert_allclose(of_free[0], scale * of_minimal[0], rtol=1e-10)
    if bars:
        np.testing.assert_allclose(of_free[1], of_minimal[1], rtol=1e-6)
    unit = 1 / np.sqrt(np.diagonal(free.covariance.common))
    of_common = [np.outer(unit, unit) * one.covariance.common for one in (free, minimal)]
    np.testing.assert_allclose(*of_common, rtol=0, atol=1e-6)
    np.testing.assert_allclose(free.covariance.computed_px2(), minimal.covariance.computed_px2(), rtol=0, atol=1e-9)
    assert np.trace(free.covariance.points(0)) <= np.trace(minimal.covariance.points(0))


def test_the_datum_is_where_it_was_asked_for():
    rng = np.random.default_rng(2)
    network, truth = draw(rng, images=6, points=9, bars=False)
    network, start = noisy(rng, network), disturbed(rng, truth)
    free = adjust(network, start, "free").state.points - start.points
    np.testing.assert_allclose(free.sum(0), 0, atol=1e-12)
    np.testing.assert_allclose(np.cross(start.points - start.points.mean(0), free).sum(0), 0, atol=1e-12)
    minimal = adjust(network, start, "minimal")
    held = np.abs(minimal.state.points - start.points) < 1e-14
    assert held.sum() == 7
    sigma = np.sqrt(np.diagonal(minimal.covariance.points(0)).reshape(-1, 3))
    assert sigma[held].max() == 0
    assert sigma[~held].min() > 1e-6


@pytest.mark.parametrize("bars", [False, True])
def test_exactly_enough_known_coordinates_strain_nothing(bars):
    """Three points with one certain coordinate each more than the last hold the datum, and no more."""
    rng = np.random.default_rng(3)
    network, truth = draw(rng, images=6, points=9, bars=bars, free=("c",))
    network, start = noisy(rng, network), disturbed(rng, truth)
    loose, sure = 1e4, 1e-4
    sigma = np.array([[sure, sure, sure], [sure, sure, loose if bars else sure], [loose, loose, sure]])
    sigma[1, 0] = loose if bars else sure
    a, b, c = truth.points[[2, 4, 6]]
    third = np.array([0.0, 0.0, 1.0])
    turn = frame_through(a, b, c)
    cov = np.array([turn @ np.diag(s**2) @ turn.T for s in sigma[[0, 1, 2]]])
    if bars:
        cov[1] = turn @ np.diag([loose**2, sure**2, sure**2]) @ turn.T
    known = KnownPoints(np.array([2, 4, 6]), np.stack([a, b, c]), cov)
    with_known = adjust(replace(network, known=known), start, "known")
    free = adjust(network, start, "free")
    assert third @ turn.T @ turn @ third == pytest.approx(1)
    assert with_known.defect.tolist() == [0]
    np.testing.assert_allclose(with_known.residuals_px, free.residuals_px, rtol=0, atol=2e-6)


def frame_through(a, b, c):
    """Return axes (3, 3): along from a to b, in the plane of the three, across it."""
    x = (b - a) / np.linalg.norm(b - a)
    z = np.cross(x, c - a)
    z /= np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z], 1)
