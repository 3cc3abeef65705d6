"""Gross errors among rays are found and located; without gross errors, the false-alarm rate is as stated."""

from dataclasses import replace

import numpy as np
import pytest

from truing.estimation.bundle import data_snooping, robust_start
from truing.estimation.bundle.adjustment import adjust
from truing.estimation.bundle.camera import PARAMETERS
from truing.estimation.bundle.data_snooping import (
    GROSS,
    NO_IMAGE,
    NO_POINT,
    ONE_OF_TWO,
    SECOND_TARGET,
    adjust_robustly,
)
from truing.estimation.bundle.network import Bars
from truing.estimation.bundle.ray_tests import critical_values, p_values, ray_tests
from truing.estimation.bundle.variance_components import initial_components

from .photographed import photograph, simulate
from .test_start_values import without


@pytest.mark.parametrize("sigma_px", [0.05, 0.5])
def test_gross_errors_are_found_with_their_size(sigma_px):
    made = simulate(seed=11, images=10, points=40, gross=0.04, sigma_px=sigma_px)
    found = adjust_robustly(made.network, made.truth)
    assert made.gross.sum() > 10
    assert not (found.used & made.gross).any()
    assert (~found.used & ~made.gross).sum() <= 4  # 0.4 expected
    listed = np.isin(found.rejected.ray, np.flatnonzero(made.gross))
    size = np.linalg.norm(found.adjustment.residuals_px[found.rejected.ray], axis=1)[listed]
    true = made.gross_px[found.rejected.ray[listed]]
    assert np.abs(size - true).max() < 6 * sigma_px
    assert set(np.array(found.rejected.reason)[listed]) == {GROSS}
    assert (found.tests.p_value[found.rejected.ray] < found.alpha).all()


def test_good_rays_are_rejected_at_the_stated_rate():
    alpha, rejected, tested = 0.02, 0, 0
    for seed in range(4):
        made = simulate(seed=seed, images=10, points=40)
        found = adjust_robustly(made.network, made.truth, alpha=alpha)
        rejected += len(found.rejected.ray)
        tested += found.tested
        assert found.family_level == pytest.approx(1 - (1 - alpha) ** found.tested)
        assert found.critical == pytest.approx(7.824, abs=1e-3)
    assert abs(rejected - alpha * (tested + rejected)) < 3.5 * np.sqrt(alpha * (tested + rejected))


@pytest.mark.parametrize("seed", [3, 11])
def test_steps_between_rounds_reject_the_same_rays_as_full_adjustments(seed, monkeypatch):
    made = simulate(seed=seed, images=10, points=40, gross=0.08, sigma_px=0.2)
    found = adjust_robustly(made.network, made.truth, alpha=0.01)
    for module in (data_snooping, robust_start):
        monkeypatch.setattr(module, "STEP_WITHIN", 0.0)
    full = adjust_robustly(made.network, made.truth, alpha=0.01)
    assert (found.used == full.used).all()
    assert found.rejected.reason == full.rejected.reason
    assert min(found.rounds, full.rounds) > 2
    np.testing.assert_allclose(found.adjustment.residuals_px, full.adjustment.residuals_px, rtol=0, atol=1e-6)


def test_data_snooping_ends_where_full_adjustments_run_out_of_steps(monkeypatch):
    made = simulate(seed=3, images=6, points=15)
    whole, full = adjust_robustly(made.network, made.truth), []

    def out_of_steps(*network, decrease_tolerance=0.0, **options):
        full.append(not decrease_tolerance)
        assert sum(full) < 10, "the last adjustment is repeated without end"
        return replace(adjust(*network, decrease_tolerance=decrease_tolerance, **options), converged=False)

    for module in (data_snooping, robust_start):
        monkeypatch.setattr(module, "adjust", out_of_steps)
    found = adjust_robustly(made.network, made.truth)
    assert not found.adjustment.converged
    assert np.array_equal(found.used, whole.used)
    assert found.rejected.reason == whole.rejected.reason


def test_critical_values_have_the_p_value_alpha():
    rng = np.random.default_rng(0)
    freedom, used = rng.integers(1, 3, 40), rng.random(40) < 0.5
    redundancy = 10 ** rng.uniform(0.5, 5, 40)
    critical = critical_values(0.003, freedom, redundancy, used)
    np.testing.assert_allclose(p_values(critical, freedom, redundancy, used), 0.003, rtol=1e-8)
    np.testing.assert_allclose(p_values(critical_values(0.003, freedom, None, used), freedom), 0.003, rtol=1e-8)


def shifted_ray_tests(made, cov, shift, used):
    """The tests of all rays, one of which is shifted (px), with a covariance of all (px^2)."""
    rays = made.network.rays
    xy = rays.xy_px.copy()
    xy[5] += shift
    stated = np.broadcast_to(cov, rays.cov_px2.shape).copy()
    network = replace(made.network, rays=replace(rays, xy_px=xy, cov_px2=stated))
    adjusted = adjust(network, made.truth, "free", used=used)
    return ray_tests(adjusted, initial_components(network, used, np.ones(rays.count)))


def test_both_coordinates_of_a_ray_are_tested_together_in_the_network_or_out_of_it():
    made = simulate(seed=1, images=8, points=20)
    cov = np.array([[0.04, 0.034], [0.034, 0.04]])  # an ellipse along x = y, 0.27 px long and 0.08 px wide
    every = np.ones(made.network.rays.count, bool)
    inside = shifted_ray_tests(made, cov, [0.6, -0.6], every)
    outside = shifted_ray_tests(made, cov, [0.6, -0.6], every & (np.arange(len(every)) != 5))
    assert inside.T[5] == pytest.approx(outside.T[5], rel=2e-3)
    assert inside.w[5] == pytest.approx(outside.w[5], rel=2e-3)
    assert inside.redundancy[5] == pytest.approx(outside.redundancy[5], rel=2e-3)
    assert inside.p_value[5] < 1e-6
    assert shifted_ray_tests(made, cov, [0.6, 0.6], every).p_value[5] > 1e-3


def test_rejected_rays_that_fit_in_the_end_are_used_again():
    made = simulate(seed=12, images=8, points=30, gross=0.02)
    agrees = np.ones(made.network.rays.count, bool)
    agrees[::7] = False
    found = adjust_robustly(made.network, made.truth, inliers=agrees)
    assert (found.used | made.gross).sum() >= len(agrees) - 3
    assert found.returned > 20


def test_undetectable_effects_are_named():
    made = simulate(seed=13, images=7, points=25, missed=0.0)
    rays = made.network.rays
    thin = (rays.image == 6) & (np.cumsum(rays.image == 6) > 3)  # three rays left: six equations, six unknowns
    few = (rays.point == 9) & (rays.image > 1)  # two rays left
    xy = rays.xy_px.copy()
    xy[(rays.point == 9) & (rays.image == 1)] += [40.0, 40.0]
    network = replace(made.network, rays=without(replace(rays, xy_px=xy), thin | few))
    found = adjust_robustly(network, made.truth)
    assert np.array_equal(found.untested, np.flatnonzero(network.rays.image == 6))
    two = np.isin(found.rejected.ray, np.flatnonzero(network.rays.point == 9))
    assert two.sum() == 2
    assert set(np.array(found.rejected.reason)[two]) == {ONE_OF_TWO}


def test_a_second_target_of_the_same_name_is_reported():
    made = simulate(seed=14, images=9, points=30, missed=0.0)
    rays, other = made.network.rays, made.truth.points[4] + [0.2, 0.1, 0.1]
    xy = rays.xy_px.copy()
    wrong = np.flatnonzero((rays.point == 4) & (rays.image < 4))
    for ray in wrong:
        i = rays.image[ray]
        xy[ray] = photograph(
            made.truth.interior[0], made.network.cameras[0], made.truth.R[i], made.truth.centre[i], other
        )[0]
    found = adjust_robustly(replace(made.network, rays=replace(rays, xy_px=xy)), made.truth)
    reason = dict(zip(found.rejected.ray.tolist(), found.rejected.reason, strict=True))
    assert [reason.get(ray) for ray in wrong.tolist()] == [SECOND_TARGET] * len(wrong)


def test_parameters_not_determined_by_the_images_are_held_and_reported():
    corners = np.array([[-0.1, -0.1, 0], [0.1, -0.1, 0], [0.1, 0.1, 0], [-0.1, 0.1, 0]])
    made = simulate(seed=4, images=4, points=4, body=corners, missed=0.0)
    found = adjust_robustly(made.network, made.truth)
    held = [name for _, name in found.fixed_elements]
    free = [name for camera, name in found.adjustment.covariance.names if camera == "camera0"]
    assert "A3" in held  # 32 coordinates do not tell ten elements next to 36 other unknowns less six of the datum
    assert sorted([*held, *free]) == sorted(PARAMETERS)
    places = [PARAMETERS.index(name) for name in held]
    assert np.array_equal(found.adjustment.state.interior[0, places], made.truth.interior[0, places])


def test_images_and_points_without_a_start_are_left_out_with_their_reason():
    made = simulate(seed=15, images=8, points=25)
    R, centre, points = made.truth.R.copy(), made.truth.centre.copy(), made.truth.points.copy()
    centre[2], R[2], points[7] = np.nan, np.nan, np.nan
    found = adjust_robustly(made.network, replace(made.truth, R=R, centre=centre, points=points))
    rays = made.network.rays
    reason = np.full(rays.count, "", dtype=object)
    reason[found.rejected.ray] = found.rejected.reason
    assert (reason[rays.image == 2] == NO_IMAGE).all()
    assert (reason[(rays.point == 7) & (rays.image != 2)] == NO_POINT).all()
    assert np.isfinite(found.adjustment.state.points[np.arange(25) != 7]).all()


def test_bars_that_contradict_each_other_cost_no_ray():
    """One of two is longer by a hundred of its standard deviations: rays are good, and their noise is what it is."""
    made = simulate(seed=2, images=8, points=20)
    first, second = np.array([0, 2]), np.array([1, 3])
    length = np.linalg.norm(made.truth.points[first] - made.truth.points[second], axis=1)
    bars = Bars(np.arange(2), first, second, np.zeros(2), length * [1.0, 1.01], 1e-4 * length)
    network = replace(made.network, bars=bars)
    start = replace(made.truth, bar_length_m=length)
    found = adjust_robustly(network, start)
    assert (~found.used).sum() <= 4  # 0.3 expected; with bars that hold, those of their ends
    off = found.adjustment.state.bar_length_m / bars.length_m - 1
    assert off[0] > 3e-4 > -3e-4 > off[1]
    alone = adjust_robustly(made.network, made.truth)
    np.testing.assert_allclose(found.components.factor, alone.components.factor, rtol=0.02)
