"""Variance components by kind of target are recovered within their uncertainty, and sigma0 is tested."""

from dataclasses import replace

import numpy as np
import pytest

from truing.estimation.bundle.data_snooping import adjust_robustly
from truing.estimation.bundle.variance_components import POOLED_GROUPS, global_test, initial_components

from .photographed import simulate


def with_kinds(made, sigmas, rng, share=(0.6, 0.4)):
    """The rays as kinds of targets, each with noise of its own next to the stated one."""
    rays = made.network.rays
    kind = rng.choice(len(sigmas), rays.count, p=share)
    noise = rng.normal(size=rays.xy_px.shape) * np.asarray(sigmas)[kind][:, None]
    return replace(made.network, rays=replace(rays, kind=kind, xy_px=rays.xy_px + noise))


def test_components_of_two_kinds_are_found_within_their_standard_deviations():
    deviations, stated = [], []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        made = simulate(seed=seed, images=8, points=30)
        extra = (0.0, np.sqrt(0.08))  # next to 0.1 px: variances one and nine times those stated
        found = adjust_robustly(with_kinds(made, extra, rng), made.truth)
        assert found.components.kind.tolist() == [0, 1]
        deviations.append((found.components.factor - [1, 9]) / found.components.sigma)
        stated.append(found.components.sigma / found.components.factor)
        assert not found.sigma0.passed
        assert found.components.redundancy.sum() == pytest.approx(found.adjustment.redundancy - 1, abs=1.5)
    deviations = np.array(deviations)
    assert np.abs(deviations).max() < 4
    assert 0.5 < np.sqrt(np.mean(deviations**2)) < 1.6
    assert np.max(stated) < 0.15


def test_small_groups_are_pooled_and_reported():
    made = simulate(seed=3, images=8, points=30)
    network = with_kinds(made, (0.0, 0.0, 0.0), np.random.default_rng(0), (0.97, 0.02, 0.01))
    each = np.full(network.rays.count, 1.5)
    components = initial_components(network, np.ones(network.rays.count, bool), each)
    assert len(components.factor) == 1
    assert components.kind.tolist() == [POOLED_GROUPS]
    network = with_kinds(made, (0.0, 0.0, 0.0), np.random.default_rng(0), (0.8, 0.1, 0.1))
    components = initial_components(network, np.ones(network.rays.count, bool), each)
    assert components.kind.tolist() == [0, 1, 2]


def test_sigma0_passes_where_the_stated_deviations_are_true_and_not_where_they_are_not():
    made = simulate(seed=4, images=8, points=30)
    true = adjust_robustly(made.network, made.truth).sigma0
    assert true.passed
    assert true.low < 1 < true.high
    rays = made.network.rays
    small = replace(made.network, rays=replace(rays, cov_px2=rays.cov_px2 / 1.3))
    large = replace(made.network, rays=replace(rays, cov_px2=rays.cov_px2 * 1.3))
    assert adjust_robustly(small, made.truth).sigma0.variance_factor > true.high
    assert adjust_robustly(large, made.truth).sigma0.variance_factor < true.low


def test_the_global_test_is_two_sided():
    # chi-square of 10 degrees of freedom: 2.5 % below 3.247, 2.5 % above 20.483
    test = global_test(20.483, 10)
    assert (test.low, test.high) == pytest.approx((0.3247, 2.0483), abs=1e-4)
    assert test.p_value == pytest.approx(0.05, abs=1e-4)
    assert not global_test(3.2, 10).passed


def test_a_factor_at_its_bound_says_so():
    made = simulate(seed=5, images=6, points=20)
    rays = made.network.rays
    absurd = replace(made.network, rays=replace(rays, cov_px2=rays.cov_px2 * 1e6))
    found = adjust_robustly(absurd, made.truth)
    assert found.components.bounded.all()
    assert found.components.factor == pytest.approx(1e-4)
    assert not adjust_robustly(made.network, made.truth).components.bounded.any()
