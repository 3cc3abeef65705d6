"""Elimination ray by ray gives the adjustment, covariance and statistics of the dense equations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.estimation.bundle.drawn_networks import disturbed, draw, noisy, uneven
from truing.estimation.bundle import row_blocks
from truing.estimation.bundle.adjustment import adjust
from truing.estimation.bundle.determinable import determinable
from truing.estimation.bundle.network import Bars, KnownPoints
from truing.estimation.bundle.ray_statistics import ray_statistics

RTOL = 1e-9


@pytest.fixture
def by_ray(monkeypatch):
    """Return a function that adjusts with every pose eliminated ray by ray."""

    def adjusted(*given, **named):
        with monkeypatch.context() as patched:
            patched.setattr(row_blocks, "MOST_DENSE_POINTS", 0)
            found = adjust(*given, **named)
            _ = found.covariance
            return found

    return adjusted


def _thinned(rng, network, share):
    """Return the network without some of its rays, and the mask of the rays that can be adjusted."""
    kept = np.flatnonzero(rng.uniform(size=network.rays.count) < share)
    rays = network.rays
    fewer = replace(rays, image=rays.image[kept], point=rays.point[kept], xy_px=rays.xy_px[kept])
    fewer = replace(fewer, cov_px2=rays.cov_px2[kept], kind=rays.kind[kept])
    network = replace(network, rays=fewer)
    return network, determinable(network).rays


def _same(ours, reference, name):
    """Assert equality within rounding; redundancy numbers are shares of one."""
    share = name.startswith(("redundancy", "prior"))
    size = 1.0 if share else np.nanmax(np.abs(reference), initial=0.0)
    np.testing.assert_allclose(ours, reference, rtol=RTOL, atol=RTOL * size, err_msg=name)


def _all_of(found, pose):
    """Return all parts of the covariance of a pose in an adjustment, by name."""
    covariance = found.covariance
    points = len(covariance.point_numbers(pose))
    rows = np.random.default_rng(7).normal(size=(4, 3 * points))
    some = np.array([points - 1, 0, 3])
    return {
        "points": covariance.points(pose),
        "some points": covariance.joint(pose, some),
        "combinations": covariance.combined(pose, rows),
        "each point": covariance.point_blocks(),
        "images": covariance.images(pose),
        "images, common": covariance.images_common(pose),
        "points, common": covariance.sensitivities(pose) @ covariance.common,
        "common": covariance.common,
        "rays": covariance.computed_px2(),
        "redundancy": covariance.redundancy_numbers(),
        "distances": np.array(covariance.distance_variances()),
        "prior": np.concatenate([part.ravel() for part in covariance.prior_redundancy_numbers()]),
    }


CASES = {
    "free": {"bars": False},
    "a rigid bar": {"bars": True},
    "a soft bar": {"bars": True, "repeat": 3e-6},
    "two cameras": {"bars": True, "cameras": 2, "free": ("c", "x0", "y0", "A1")},
    "calibrated": {"bars": False, "free": ()},
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("datum", ["free", "minimal", "known"])
def test_ray_by_ray_is_the_same_as_dense(by_ray, case, datum):
    rng = np.random.default_rng(3)
    network, truth = draw(rng, 2, 8, 40, **CASES[case])
    if datum == "known":
        known = np.array([2, 3, 5, 45, 46])
        cov = np.tile(1e-10 * np.diag([1.0, 2.0, 3.0]), (5, 1, 1))
        network = replace(network, known=KnownPoints(known, truth.points[known], cov))
    network, used = _thinned(rng, noisy(rng, uneven(rng, network)), 0.6)
    weights = rng.uniform(0.5, 1.0, network.rays.count)
    start = disturbed(rng, truth)
    dense = adjust(network, start, datum, used=used, weights=weights)
    ours = by_ray(network, start, datum, used=used, weights=weights)
    assert ours.layout.rows.by_point[0] is not None
    assert dense.layout.rows.by_point[0] is None
    assert (ours.iterations, ours.redundancy, ours.converged) == (dense.iterations, dense.redundancy, True)
    assert ours.chi2 == pytest.approx(dense.chi2, rel=1e-10)
    sigma = np.sqrt(np.nanmax(np.diagonal(dense.covariance.points(0))))
    np.testing.assert_allclose(ours.state.points, dense.state.points, rtol=0, atol=1e-6 * sigma)
    for pose in (0, 1):
        reference = _all_of(dense, pose)
        for name, value in _all_of(ours, pose).items():
            _same(value, reference[name], f"{name} of pose {pose}")
    _same(ours.covariance.between(0, 1), dense.covariance.between(0, 1), "between poses")


@settings(max_examples=8)
@given(seed=st.integers(0, 10_000), share=st.floats(0.35, 1.0), images=st.integers(5, 14))
def test_sparse_and_dense_networks_have_the_same_adjustment(seed, share, images):
    """Points that few and that many images see take different paths."""
    rng = np.random.default_rng(seed)
    network, truth = draw(rng, 1, images, 60, bars=True, free=("c", "A1"))
    network, used = _thinned(rng, noisy(rng, network), share)
    dense = adjust(network, truth, used=used)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(row_blocks, "MOST_DENSE_POINTS", 0)
        ours = adjust(network, truth, used=used)
        reference = _all_of(dense, 0)
        for name, value in _all_of(ours, 0).items():
            _same(value, reference[name], name)


def test_a_point_measured_twice_in_an_image_counts_twice(by_ray):
    rng = np.random.default_rng(5)
    network, truth = draw(rng, 1, 6, 40, bars=False, free=("c",))
    rays, again = network.rays, rng.choice(network.rays.count, 50)
    every = np.concatenate([np.arange(rays.count), again])
    more = replace(rays, image=rays.image[every], point=rays.point[every], xy_px=rays.xy_px[every])
    network = noisy(rng, replace(network, rays=replace(more, cov_px2=rays.cov_px2[every], kind=rays.kind[every])))
    dense, ours = adjust(network, truth), by_ray(network, truth)
    _same(ours.covariance.points(0), dense.covariance.points(0), "points")
    _same(ours.covariance.computed_px2(), dense.covariance.computed_px2(), "rays")


def test_ends_of_several_bars_stay_joint(by_ray):
    rng = np.random.default_rng(9)
    network, truth = draw(rng, 1, 8, 40, bars=False, free=("c",))
    first, second = np.array([0, 4, 39, 7]), np.array([12, 13, 2, 39])
    lengths = np.linalg.norm(truth.points[first] - truth.points[second], axis=1)
    spread, sigma = np.array([0.0, 1e-5, 3e-5, 0.0]), np.array([1e-5, 1e-5, 0.0, 2e-5])
    network = replace(network, bars=Bars(np.arange(4), first, second, spread, lengths, sigma))
    network, used = _thinned(rng, noisy(rng, network), 0.7)
    start = replace(truth, bar_length_m=lengths)
    dense, ours = (run(network, start, used=used) for run in (adjust, by_ray))
    reference = _all_of(dense, 0)
    for name, value in _all_of(ours, 0).items():
        _same(value, reference[name], name)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("known", [False, True])
def test_the_information_of_the_rays_is_the_same(monkeypatch, case, known):
    rng = np.random.default_rng(11)
    network, truth = draw(rng, 2, 8, 40, **CASES[case])
    if known:
        cov = np.tile(1e-10 * np.diag([1.0, 2.0, 3.0]), (4, 1, 1))
        network = replace(network, known=KnownPoints(np.arange(2, 6), truth.points[2:6] + 1e-6, cov))
    network, used = _thinned(rng, noisy(rng, uneven(rng, network)), 0.7)
    dense = adjust(network, truth, "known" if known else "free", used=used)
    reference = ray_statistics(dense.observed, dense.state)
    monkeypatch.setattr(row_blocks, "MOST_DENSE_POINTS", 0)
    ours = adjust(network, dense.state, "known" if known else "free", used=used)
    found = ray_statistics(ours.observed, dense.state)
    # A single bar gives the scale and tells nothing of its own strain: below one sigma per relevant size is rounding.
    least = np.array([number.scale for number in reference.numbers]) ** -2.0
    unit = np.maximum(np.einsum("stt->st", reference.information), least) ** -0.5
    both = unit[:, None] * unit[:, :, None]
    _same(found.information * both, reference.information * both, "information")
    np.testing.assert_allclose(found.score * unit, reference.score * unit, rtol=0, atol=1e-6)
    _same(found.by_point, reference.by_point, "points")


def test_free_directions_are_named_alike(by_ray):
    from truing.estimation.bundle.determinable import UndeterminedNetworkError

    rng = np.random.default_rng(2)
    network, truth = draw(rng, 1, 8, 60, bars=False, free=())
    apart = (network.rays.image < 4) == (network.rays.point < 30)  # two halves without a common point
    messages = []
    for run in (lambda *a, **k: adjust(*a, **k).covariance, by_ray):
        with pytest.raises(UndeterminedNetworkError) as raised:
            run(network, truth, used=apart)
        messages.append(raised.value)
    assert messages[0].images or messages[0].points
    assert messages[1].images or messages[1].points
