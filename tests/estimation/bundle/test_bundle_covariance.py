"""The covariance agrees with the unreduced equations and with repeated draws, and the redundancy adds up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.estimation.bundle.dense_reference import dense_covariance, inner_constraints, unknowns
from tests.estimation.bundle.drawn_networks import disturbed, draw, noisy, uneven
from truing.estimation.bundle.adjustment import adjust
from truing.estimation.bundle.network import Bars, KnownPoints


@pytest.mark.parametrize(
    ("images", "points", "bars", "repeat"),
    [
        (4, 12, True, 0.0),
        (4, 12, True, 1e-5),
        (7, 8, True, 0.0),
        (7, 8, True, 3e-6),
        (4, 12, False, 0.0),
        (7, 8, False, 0.0),
    ],
)
def test_every_part_is_that_of_the_unreduced_equations(images, points, bars, repeat):
    rng = np.random.default_rng(1)
    network, truth = draw(rng, 2, images, points, cameras=2, free=("c", "x0", "y0", "A1"), bars=bars, repeat=repeat)
    network = uneven(rng, network)
    network, weights = noisy(rng, network), rng.uniform(0.5, 1, network.rays.count)
    first = adjust(network, disturbed(rng, truth), weights=weights)
    found = adjust(network, first.state, weights=weights)  # linearised where it ends, as the reference is
    unit = 1 / np.sqrt(np.diagonal(found.covariance.points(0)))
    change = first.covariance.points(0) - found.covariance.points(0)
    assert np.abs(np.outer(unit, unit) * change).max() < 1e-4  # nothing next to what the last step is: 1 % of sigma
    dense = dense_covariance(found, inner_constraints(found, scale=not bars))
    at, common, _ = unknowns(found)
    covariance = found.covariance
    split, width = at + 3 * points, 6 * images
    parts = {
        "points": (covariance.points(0), dense[at:split, at:split]),
        "between poses": (covariance.between(0, 1), dense[at:split, split:common]),
        "points, common": (covariance.sensitivities(1) @ covariance.common, dense[split:common, common:]),
        "common": (covariance.common, dense[common:, common:]),
        "image": (covariance.images(1)[2], dense[width + 12 : width + 18, width + 12 : width + 18]),
        "image, common": (covariance.images_common(0)[1], dense[6:12, common:]),
        "point": (covariance.point_blocks()[points + 1], dense[split + 3 : split + 6, split + 3 : split + 6]),
    }
    sigma = np.sqrt(np.diagonal(dense))
    assert sigma[at:common].max() < 1e-3
    for name, (ours, reference) in parts.items():
        np.testing.assert_allclose(ours, reference, rtol=1e-6, atol=1e-7 * np.abs(reference).max(), err_msg=name)


def test_a_pose_of_which_every_point_is_the_end_of_a_distance_has_its_covariance():
    rng = np.random.default_rng(4)
    network, truth = draw(rng, 1, 4, 12, free=("c",))
    first, second = np.arange(0, 12, 2), np.arange(1, 12, 2)
    length = np.linalg.norm(truth.points[second] - truth.points[first], axis=-1)
    bars = Bars(np.arange(6), first, second, np.zeros(6), length, np.full(6, 1e-5))
    network, truth = replace(network, bars=bars), replace(truth, bar_length_m=length)
    first = adjust(noisy(rng, network), disturbed(rng, truth))
    found = adjust(first.network, first.state)
    dense = dense_covariance(found, inner_constraints(found, scale=False))
    at, common, _ = unknowns(found)
    parts = (
        (found.covariance.points(0), dense[at:common, at:common]),
        (found.covariance.common, dense[common:, common:]),
    )
    for ours, reference in parts:
        np.testing.assert_allclose(ours, reference, rtol=1e-6, atol=1e-7 * np.abs(reference).max())


def test_without_a_common_unknown_images_have_their_covariance_all_the_same():
    rng = np.random.default_rng(2)
    network, truth = draw(rng, 2, 4, 8, free=(), bars=False)
    first = adjust(noisy(rng, network), disturbed(rng, truth))
    found = adjust(first.network, first.state)
    dense = dense_covariance(found, inner_constraints(found, scale=True))
    np.testing.assert_allclose(found.covariance.images(0)[2], dense[12:18, 12:18], rtol=1e-6, atol=1e-7 * dense.max())
    assert found.covariance.images_common(0).shape == (4, 6, 0)


@settings(max_examples=12, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    images=st.sampled_from([5, 9]),
    repeat=st.sampled_from([None, 0.0, 1e-9, 1e-5, 1e-4]),
    known=st.integers(0, 4),
)
def test_redundancy_numbers_add_up_to_the_redundancy(seed, images, repeat, known):
    rng = np.random.default_rng(seed)
    network, truth = draw(rng, 2, images, 14, free=("c", "A1"), bars=repeat is not None, repeat=repeat or 0.0)
    chosen = rng.permutation(14)[:known]
    xyz = truth.points[chosen] + 1e-5 * rng.normal(size=(known, 3))
    network = replace(network, known=KnownPoints(chosen, xyz, np.tile(1e-10 * np.eye(3), (known, 1, 1))))
    used = rng.random(network.rays.count) < 0.9
    weights = rng.uniform(0.1, 1, network.rays.count)
    found = adjust(noisy(rng, uneven(rng, network)), disturbed(rng, truth), "known", used=used, weights=weights)
    numbers = [found.covariance.redundancy_numbers(), *found.covariance.prior_redundancy_numbers()]
    ray_factors = numbers[0][np.isfinite(numbers[0][:, 0])].sum(-1)  # the two of a ray, which are correlated
    assert np.all((ray_factors > -1e-7) & (ray_factors < 2 + 1e-7))
    np.testing.assert_allclose(sum(np.nansum(part) for part in numbers), found.redundancy, rtol=1e-6)


def test_repeated_measurement_scatters_as_the_covariance_says():
    """Sixty draws of a small network: standardised errors, sums of squares and covariance, bounds on both sides."""
    rng = np.random.default_rng(2)
    network, truth = draw(rng, images=6, points=8, free=("c", "x0", "y0"), repeat=1e-5)
    bars = replace(network.bars, sigma_m=np.array([5e-5]))
    network = replace(uneven(rng, network), bars=bars)
    draws, errors, factors = 60, [], []
    for _ in range(draws):
        once = noisy(rng, network)
        once = replace(once, bars=replace(once.bars, length_m=once.bars.length_m))
        true_distance = np.linalg.norm(truth.points[1] - truth.points[0])
        shifted = replace(once, bars=replace(once.bars, length_m=once.bars.length_m + 1e-5 * rng.normal(size=1)))
        assert abs(true_distance - 0.8) < 1e-12
        found = adjust(shifted, truth)
        errors.append(
            np.append((found.state.points - truth.points).ravel(), (found.state.interior - truth.interior)[0, :3])
        )
        factors.append(found.variance_factor)
    errors, cov = np.array(errors), found.covariance
    root = np.sqrt(draws)
    pulls = errors / np.sqrt(np.append(np.diagonal(cov.points(0)), np.diagonal(cov.common)[:3]))
    assert abs(pulls.mean(0)).max() < 4 / root
    np.testing.assert_allclose((pulls**2).mean(), 1, atol=0.15)
    assert np.abs(np.std(pulls, axis=0) - 1).max() < 4 / np.sqrt(2 * draws)
    squared = np.einsum("ni,ij,nj->n", errors[:, :24], np.linalg.pinv(cov.points(0), rcond=1e-9), errors[:, :24])
    freedom = 24 - 6
    assert abs(squared.mean() - freedom) < 4 * np.sqrt(2 * freedom / draws)
    assert abs(np.mean(factors) - 1) < 4 * np.sqrt(2 / found.redundancy / draws)
