"""Start values from named points alone: all images are oriented, with or without prior knowledge."""

from dataclasses import replace

import numpy as np
import pytest

from truing.estimation.bundle.adjustment import adjust
from truing.estimation.bundle.network import Bars, Markers, Rays
from truing.estimation.bundle.orientation import _resect_all_points
from truing.estimation.bundle.start_values import find_start

from .photographed import guess, off_by, shape_error, simulate


def without(rays, gone):
    """The rays that are not gone (N,)."""
    return Rays(*(getattr(rays, name)[~gone] for name in ("image", "point", "xy_px", "cov_px2", "kind")))


@pytest.mark.parametrize("planar", [False, True], ids=["spatial", "flat"])
def test_a_network_orients_itself_from_nothing(planar):
    made = simulate(seed=3, images=8, points=30, planar=planar, gross=0.05)
    start = find_start(made.network, guess(made.network.cameras, known=False))
    assert start.image_oriented.all()
    assert start.point_placed.all()
    assert start.scale == ("scale bars",)
    assert not start.ray_agrees[made.gross_px * made.gross > 50].any()
    assert start.ray_agrees[~made.gross].mean() > 0.97
    assert shape_error(start.state.points, made.truth.points) < 2e-3
    assert abs(start.state.interior[0, 0] / made.truth.interior[0, 0] - 1) < 0.02


@pytest.mark.parametrize("factor", [0.9, 1.1, 2.0])
def test_a_wrong_principal_distance_is_mended(factor):
    made = simulate(seed=5, images=7, points=25, gross=0.02)
    start = find_start(made.network, guess(made.network.cameras, factor))
    assert start.image_oriented.all()
    assert abs(start.state.interior[0, 0] / made.truth.interior[0, 0] - 1) < 0.03


def test_a_long_lens_that_nothing_is_known_of_is_found():
    far = np.array([14000.0, 20.0, -10.0, 0, 0, 0, 0, 0, 0, 0])
    made = simulate(seed=1, images=7, points=20, distance=10.0, interior=far)
    start = find_start(made.network, guess(made.network.cameras, known=False))
    assert start.image_oriented.all()
    assert abs(start.state.interior[0, 0] / far[0] - 1) < 0.05


def test_the_adjustment_converges_from_ten_degrees_and_ten_per_cent():
    made = simulate(seed=7, images=8, points=30)
    best = adjust(made.network, made.truth, "free")
    for seed in range(3):
        far = adjust(made.network, off_by(made, np.random.default_rng(seed)), "free")
        assert far.converged
        assert far.chi2 == pytest.approx(best.chi2, rel=1e-9)


def test_poses_are_oriented_each_for_itself_with_cameras_in_common():
    made = simulate(seed=2, poses=2, images=6, points=25, cameras=2, gross=0.03)
    start = find_start(made.network, guess(made.network.cameras, 1.1))
    assert start.image_oriented.all()
    for pose in range(2):
        own = made.network.point_pose == pose
        assert shape_error(start.state.points[own], made.truth.points[own]) < 3e-3
    for bar in range(2):
        first, second = made.network.bars.first[bar], made.network.bars.second[bar]
        length = np.linalg.norm(start.state.points[first] - start.state.points[second])
        assert length == pytest.approx(made.network.bars.length_m[bar], rel=1e-6)


def test_known_points_give_frame_and_scale_even_with_one_of_them_wrong():
    made = simulate(seed=4, images=5, points=20, known=8, bars=False)
    xyz = made.network.known.xyz_m.copy()
    xyz[3] += [0.2, -0.1, 0.15]
    network = replace(made.network, known=replace(made.network.known, xyz_m=xyz))
    start = find_start(network, guess(network.cameras))
    assert start.frame == start.scale == ("known points",)
    assert start.image_oriented.all()
    assert np.abs(start.state.points - made.truth.points)[start.point_placed].max() < 5e-3


def test_one_image_is_oriented_by_known_points():
    made = simulate(seed=4, images=2, points=15, known=9, bars=False)
    network = replace(made.network, rays=without(made.network.rays, made.network.rays.image == 1))
    start = find_start(network, made.truth.interior)
    assert start.image_oriented.tolist() == [True, False]
    assert start.state.centre[0] == pytest.approx(made.truth.centre[0], abs=2e-3)
    assert start.point_placed.sum() == 9


def test_a_marker_of_known_size_begins_where_images_share_too_little_else():
    corners = np.array([[-0.1, -0.1, 0], [0.1, -0.1, 0], [0.1, 0.1, 0], [-0.1, 0.1, 0]])
    body = np.concatenate([corners, [[0.4, 0.3, 0.2]]])
    made = simulate(seed=1, images=4, points=5, body=body, bars=False, missed=0.0)
    marker = Markers(np.array([[0, 1, 2, 3]]), np.array([0.2]))
    start = find_start(made.network, made.truth.interior, marker)
    assert start.image_oriented.all()
    assert start.scale == ("markers",)
    edge = np.linalg.norm(start.state.points[0] - start.state.points[1])
    assert edge == pytest.approx(0.2, rel=2e-3)
    reach = np.linalg.norm(start.state.points[4] - start.state.points[0])
    assert reach == pytest.approx(np.linalg.norm(body[4] - body[0]), rel=5e-3)


def test_images_that_cannot_be_oriented_are_left_out():
    made = simulate(seed=6, images=7, points=25, bars=False, missed=0.0)
    rays = made.network.rays
    few = (rays.image == 6) & (rays.point > 2)
    lone = (rays.point == 10) & (rays.image != 0)
    scrambled = rays.xy_px.copy()
    other = rays.image == 5
    scrambled[other] = np.random.default_rng(0).permutation(scrambled[other])  # all names wrong
    network = replace(made.network, rays=without(replace(rays, xy_px=scrambled), few | lone))
    start = find_start(network, guess(network.cameras))
    assert start.image_oriented.tolist() == [True] * 5 + [False] * 2
    assert np.isnan(start.state.centre[5:]).all()
    assert not start.point_placed[10]
    assert start.point_placed.sum() == 24
    assert start.scale == ("none",)


def test_a_pose_without_common_points_is_left_out_and_the_others_are_not():
    made = simulate(seed=8, poses=2, images=5, points=20)
    rays = made.network.rays
    second = made.network.image_pose[rays.image] == 1
    apart = second & (rays.point % 5 != rays.image % 5)
    network = replace(made.network, rays=without(rays, apart), bars=Bars.none())
    start = find_start(network, guess(network.cameras))
    assert start.image_oriented[:5].all()
    assert not start.image_oriented[5:].any()
    assert start.frame == ("none", "not oriented")


def test_points_that_all_lie_in_one_direction_orient_nothing():
    rng = np.random.default_rng(2)
    assert _resect_all_points(rng.normal(size=(6, 3)), 1e-9 * rng.normal(size=(6, 2))) == []
