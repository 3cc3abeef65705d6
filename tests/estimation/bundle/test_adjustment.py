"""The adjustment reaches the least sum of squares from remote starts, whatever is eliminated; without noise, the
truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.estimation.bundle.drawn_networks import INTERIOR, LENGTH, disturbed, draw, noisy, uneven
from truing.estimation.bundle.adjustment import adjust
from truing.estimation.bundle.camera import PARAMETERS
from truing.estimation.bundle.determinable import UndeterminedNetworkError, determinable
from truing.estimation.bundle.network import KnownPoints, Rays


def distances(points):
    """Return all distances between points."""
    return np.linalg.norm(points[:, None] - points, axis=-1)


def test_without_noise_the_truth_is_found_from_ten_degrees_and_ten_percent():
    rng = np.random.default_rng(1)
    network, truth = draw(rng, images=8, points=20)
    found = adjust(network, disturbed(rng, truth, np.deg2rad(10), 0.1, 0.1))
    assert found.converged
    np.testing.assert_allclose(found.residuals_px, 0, atol=1e-8)
    np.testing.assert_allclose(found.state.interior[0, :3], INTERIOR[:3], rtol=1e-9)
    np.testing.assert_allclose(distances(found.state.points), distances(truth.points), rtol=0, atol=1e-11)


def test_the_sum_of_squares_is_least():
    rng = np.random.default_rng(2)
    network, truth = draw(rng, poses=2, repeat=2e-5)
    network = noisy(rng, uneven(rng, network))
    found = adjust(network, disturbed(rng, truth))
    for _ in range(40):
        around = disturbed(rng, found.state, 1e-7, 1e-7, 0)
        around = replace(around, interior=found.state.interior * (1 + 1e-7 * rng.normal(size=10)))
        assert adjust(network, around, max_iterations=0).chi2 > found.chi2


@pytest.mark.parametrize("repeat", [0.0, 1e-13, 1e-7, 2e-5, 1e-3])
def test_adjustments_that_eliminate_points_or_images_agree(repeat):
    """Ten images of twelve points leave the points, four of thirty the images; as many rays either way round."""
    rng = np.random.default_rng(3)
    network, truth = draw(rng, images=10, points=21, repeat=repeat)
    network = noisy(rng, network)
    start = disturbed(rng, truth)
    whole = adjust(network, start)  # 60 against 63: points are eliminated
    assert len(whole.covariance.image_numbers(0)) * 2 < len(whole.covariance.point_numbers(0))
    # One more image that sees every point with so little weight that it tells nothing turns it round.
    rays = network.rays
    doubled = Rays(
        np.concatenate([rays.image, np.full(21, 10)]),
        np.concatenate([rays.point, np.arange(21)]),
        np.concatenate([rays.xy_px, rays.xy_px[:21]]),
        np.concatenate([rays.cov_px2, np.tile(1e12 * np.eye(2), (21, 1, 1))]),
        np.concatenate([rays.kind, rays.kind[:21]]),
    )
    wider = replace(
        network,
        rays=doubled,
        image_camera=np.append(network.image_camera, 0),
        image_pose=np.append(network.image_pose, 0),
    )
    more = replace(
        start, R=np.concatenate([start.R, start.R[:1]]), centre=np.concatenate([start.centre, start.centre[:1]])
    )
    other = adjust(wider, more)
    assert whole.converged
    assert other.converged
    np.testing.assert_allclose(other.chi2, whole.chi2, rtol=1e-7)  # (rounding of the distance / 1e-13 m) squared
    sigma = np.sqrt(np.diagonal(whole.covariance.points(0))).reshape(-1, 3)
    assert np.abs((other.state.points - whole.state.points) / sigma).max() < 1e-4
    np.testing.assert_allclose(other.covariance.points(0), whole.covariance.points(0), rtol=0, atol=1e-15)
    np.testing.assert_allclose(other.covariance.images(0)[:10], whole.covariance.images(0), rtol=0, atol=1e-13)


def test_a_rigid_bar_has_its_length_and_a_soft_one_gives_way():
    rng = np.random.default_rng(4)
    network, truth = draw(rng, images=5, points=10)
    network = replace(noisy(rng, network), bars=replace(network.bars, length_m=np.array([LENGTH]), sigma_m=np.zeros(1)))
    found = adjust(network, replace(disturbed(rng, truth), bar_length_m=np.zeros(1)))  # nor does the start matter
    assert abs(np.linalg.norm(found.state.points[1] - found.state.points[0]) - LENGTH) < 1e-14
    assert found.state.bar_length_m == LENGTH
    # Two bars of the same length and weight on the same ends, one too long, meet in the middle.
    bars = replace(
        network.bars,
        bar=np.array([0, 1]),
        first=np.array([0, 0]),
        second=np.array([1, 1]),
        repeat_sigma_m=np.array([1e-4, 1e-4]),
        length_m=np.array([LENGTH, LENGTH + 1e-4]),
        sigma_m=np.zeros(2),
    )
    start = replace(disturbed(rng, truth), bar_length_m=bars.length_m)
    found = adjust(replace(network, bars=bars), start)
    assert abs(np.linalg.norm(found.state.points[1] - found.state.points[0]) - LENGTH - 5e-5) < 1e-12


def test_weights_are_variances_and_no_weight_is_no_ray():
    rng = np.random.default_rng(5)
    network, truth = draw(rng, images=5, points=12)
    network, start = noisy(rng, network), disturbed(rng, truth)
    weights = rng.uniform(0.2, 1, network.rays.count)
    weights[::7] = 0
    weighted = adjust(network, start, weights=weights)
    on = weights > 0
    varied = adjust(network, start, used=on, variance_factor=1 / np.where(on, weights, 1))
    np.testing.assert_allclose(weighted.state.points, varied.state.points, rtol=0, atol=1e-9)
    assert weighted.redundancy == varied.redundancy == adjust(network, start).redundancy - 2 * np.sum(~on)
    assert np.isfinite(weighted.residuals_px).all()
    assert np.array_equal(np.isnan(weighted.covariance.redundancy_numbers()[:, 0]), ~on)


def test_known_points_carry_the_network():
    rng = np.random.default_rng(6)
    network, truth = draw(rng, images=6, points=12, bars=False)
    sigma = 1e-6
    xyz = truth.points[[0, 3, 5, 8]] + sigma * rng.normal(size=(4, 3))
    known = KnownPoints(np.array([0, 3, 5, 8]), xyz, np.tile(sigma**2 * np.eye(3), (4, 1, 1)))
    found = adjust(replace(noisy(rng, network), known=known), disturbed(rng, truth), "known")
    assert found.defect.tolist() == [0]
    assert found.redundancy == 2 * 72 + 12 - 36 - 36 - 10
    errors = (found.state.points - truth.points).ravel()
    squared = errors @ np.linalg.solve(found.covariance.points(0), errors)
    assert 12 < squared < 75  # chi-square of 36, one in a thousand on either side
    fewer = replace(known, point=known.point[:1], xyz_m=known.xyz_m[:1], cov_m2=known.cov_m2[:1])
    one = adjust(replace(noisy(rng, network), known=fewer), disturbed(rng, truth), "known")
    assert one.defect.tolist() == [4]
    np.testing.assert_allclose(one.state.points[0], fewer.xyz_m[0], rtol=0, atol=1e-10)


def test_points_with_one_ray_and_images_with_few_rays_are_named():
    rng = np.random.default_rng(7)
    network, truth = draw(rng, images=5, points=12)
    rays = network.rays
    used = ~((rays.point == 3) & (rays.image > 0)) & ~((rays.image == 4) & (rays.point > 1))
    with pytest.raises(UndeterminedNetworkError, match=r"points 3 have one ray.*images 4 have fewer than 3 rays"):
        adjust(network, truth, used=used)
    able = determinable(network, used)
    assert np.flatnonzero(~able.points).tolist() == [3]
    assert np.flatnonzero(~able.images).tolist() == [4]
    found = adjust(network, truth, used=able.rays)
    assert found.converged
    assert found.covariance.point_numbers(0).tolist() == [p for p in range(12) if p != 3]
    assert found.covariance.image_numbers(0).tolist() == [0, 1, 2, 3]
    np.testing.assert_array_equal(found.state.R[4], truth.R[4])
    assert np.isnan(found.covariance.point_blocks()[3]).all()


def test_all_faults_of_a_network_are_named_at_once():
    rng = np.random.default_rng(11)
    network, truth = draw(rng, poses=2, images=4, points=8)
    cov, point = network.rays.cov_px2.copy(), network.rays.point.copy()
    cov[5] = [[1, 2], [2, 1]]
    cov[6] = 0
    point[9] = 12
    bars = replace(network.bars, second=network.bars.second[::-1])
    known = KnownPoints(np.array([3, 4]), truth.points[[3, 4]], np.stack([np.eye(3), np.diag([1.0, 1, 0])]))
    broken = replace(network, rays=replace(network.rays, cov_px2=cov, point=point), bars=bars, known=known)
    faults = (
        r"rays 9 join an image and a point of different poses; distances 0, 1 join points of different poses; "
        r"rays 5, 6 have a covariance that is not positive definite; known points 1 have a covariance"
    )
    with pytest.raises(UndeterminedNetworkError, match=faults):
        adjust(broken, truth, "known")


def test_points_behind_cameras_are_named():
    rng = np.random.default_rng(8)
    network, truth = draw(rng, images=4, points=8)
    turned = truth.R.copy()
    turned[2] = turned[2] @ np.diag([-1.0, 1, -1])
    with pytest.raises(UndeterminedNetworkError, match=r"8 points behind their cameras.*image 2, point 0"):
        adjust(network, replace(truth, R=turned))


def test_parameters_that_the_images_do_not_determine_are_named():
    """Vertical images of a plane, without roll, do not separate principal distance and height."""
    rng = np.random.default_rng(9)
    network, truth = draw(rng, images=4, points=10, bars=False, free=PARAMETERS[:1])
    flat = truth.points * [1, 1, 0]
    centre = np.array([[0.2, 0, 2], [-0.2, 0.1, 2], [0, 0.3, 2], [0.3, 0.3, 2]])
    state = replace(truth, points=flat, R=np.tile(np.diag([1.0, -1, -1]), (4, 1, 1)), centre=centre)
    found = adjust(network, state, max_iterations=0)
    with pytest.raises(UndeterminedNetworkError, match="camera 0 c"):
        _ = found.covariance


def test_a_network_with_a_hinge_converges_and_has_no_covariance():
    """Two halves that share two points turn about the line through them."""
    rng = np.random.default_rng(0)
    network, truth = draw(rng, images=8, points=20, bars=False, free=("c",))
    image, point = network.rays.image, network.rays.point
    used = ((image < 4) & (point < 11)) | ((image >= 4) & (point >= 9))
    found = adjust(noisy(rng, network), truth, used=used)
    assert found.converged
    assert 0.4 < found.variance_factor < 1.8
    with pytest.raises(UndeterminedNetworkError, match=r"free directions are left, seen at|network is disconnected"):
        _ = found.covariance


def test_without_iterations_no_point_moves():
    rng = np.random.default_rng(10)
    network, truth = draw(rng, images=4, points=8)
    found = adjust(network, truth, max_iterations=0)
    assert not found.converged
    assert found.iterations == 0
    np.testing.assert_allclose(found.state.points, truth.points, rtol=0, atol=1e-14)
