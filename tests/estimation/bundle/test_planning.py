"""Photograph plans: stations face the targets, the information is that of the adjustment, choices beat random ones."""

from __future__ import annotations

import numpy as np
import pytest

from tests.tolerance import assert_close
from truing.estimation.bundle.adjustment import adjust
from truing.estimation.bundle.camera import Camera
from truing.estimation.bundle.network import Bars
from truing.estimation.bundle.photograph_plan import StationCandidates, exchanged, one_by_one, spread_points
from truing.estimation.bundle.planning import (
    CameraLimits,
    PlannedNetwork,
    PlannedObject,
    body_motion,
    filling_distance,
    largest_sigma,
    predict,
    shells,
    station_information,
    useful_stations,
    visible,
    weak_prior,
)

CAMERA = Camera("camera", 4000, 3000, 1600.0, None, ("c", "x0", "y0", "A1"))
INTERIOR = np.array([4000.0, 12.0, -7.0, -3e-9, 0, 0, 0, 0, 0, 0])
ANYTHING = CameraLimits(0.0, np.inf, np.radians(89.0), 0.0)


def layout(count=14, seed=3):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.2, 0.2, (count, 3)) * [1.0, 0.8, 0.4]
    return PlannedObject(points, np.full((count, 3), np.nan), np.full(count, np.nan))


def planned(own, sigma_m=1e-5):
    length = np.array([np.linalg.norm(own.points[1] - own.points[0])])
    bars = Bars(np.array([0]), np.array([0]), np.array([1]), np.zeros(1), length, np.array([sigma_m]))
    return PlannedNetwork(CAMERA, INTERIOR, 0.1, own, bars)


def around(own, directions=12, distance=1.2, rolls=(0.0, 90.0)):
    shell = np.array([distance * filling_distance(CAMERA, INTERIOR, own.radius)])
    return shells(own.middle, shell, directions, (0.1, 1.4), np.radians(rolls))


def nothing(*_):
    pass


def test_stations_look_at_the_middle_and_are_level_before_they_are_rolled():
    own = layout()
    stations = around(own)
    view = own.middle - stations.centre
    distance = np.linalg.norm(view, axis=1, keepdims=True)
    assert_close(stations.R[:, :, 2], view / distance, atol=1e-12)
    assert_close(np.linalg.det(stations.R), np.ones(stations.count), atol=1e-12)
    upright = stations.roll_rad == 0.0
    assert_close(stations.R[upright, 2, 0], np.zeros(upright.sum()), atol=1e-12)  # x is level
    assert np.all(stations.R[upright, 2, 1] < 0.0)  # and y points downwards
    elevation = np.arcsin(-stations.R[:, 2, 2])
    assert np.all((elevation > 0.1) & (elevation < 1.4))


def test_the_object_fills_the_format_from_the_filling_distance():
    own = layout(200, 4)
    for distance, whole in ((1.02, True), (0.5, False)):
        seen = visible(CAMERA, INTERIOR, around(own, distance=distance), own, ANYTHING)
        assert seen.all() == whole


@pytest.mark.parametrize(
    ("limits", "lost"),
    [
        (CameraLimits(0.0, np.inf, np.radians(60.0), 0.0), "incidence"),
        (CameraLimits(0.85, np.inf, np.radians(89.0), 0.0), "distance"),
        (CameraLimits(0.0, 0.85, np.radians(89.0), 0.0), "distance"),
        (CameraLimits(0.0, np.inf, np.radians(89.0), 20.0), "size"),
    ],
)
def test_a_target_is_seen_where_every_limit_is_kept(limits, lost):
    own = layout()
    normals = np.tile([0.0, 0.0, 1.0], (len(own.points), 1))
    own = PlannedObject(own.points, normals, np.full(len(own.points), 0.006))
    stations = around(own)
    seen = visible(CAMERA, INTERIOR, stations, own, limits)
    arm = stations.centre[:, None] - own.points
    distance = np.linalg.norm(arm, axis=-1)
    slant = arm[..., 2] / distance
    kept = {
        "incidence": slant >= np.cos(limits.incidence),
        "distance": (distance >= limits.nearest) & (distance <= limits.farthest),
        "size": 4000.0 * 0.006 * slant / distance >= limits.least_px,
    }[lost]
    everything = visible(CAMERA, INTERIOR, stations, own, ANYTHING)
    assert np.array_equal(seen, everything & kept)
    assert 0 < seen.sum() < everything.sum()


def test_the_sum_of_informations_is_that_of_the_adjustment():
    own = layout(8)
    plan, stations = planned(own), around(own, 5, rolls=(0.0,))
    seen = visible(CAMERA, INTERIOR, stations, own, ANYTHING)
    total = station_information(plan, stations, seen).sum(axis=0) + weak_prior(plan)
    covariance = np.linalg.inv(total)
    found = predict(plan, stations, seen)
    # both covariances of distances, which no datum touches; the prior is too weak to be seen in six digits
    points = own.points
    for one, other in ((2, 5), (0, 7), (3, 4)):
        direction = (points[other] - points[one]) / np.linalg.norm(points[other] - points[one])
        row = np.zeros(3 * len(points))
        row[3 * other : 3 * other + 3], row[3 * one : 3 * one + 3] = direction, -direction
        ours = row @ covariance[: len(row), : len(row)] @ row
        assert_close([ours], [row @ found.together @ row], atol=1e-4 * ours)


def test_chosen_stations_beat_others_and_exchange_makes_nothing_worse():
    own = layout()
    plan, stations = planned(own), around(own)
    seen = visible(CAMERA, INTERIOR, stations, own, ANYTHING)
    candidates = StationCandidates(
        station_information(plan, stations, seen), weak_prior(plan), own.points, has_scale=True
    )
    chosen = one_by_one(candidates, 6, nothing)
    better = exchanged(candidates, chosen, nothing)
    assert len(set(better.tolist())) == 6

    def mean(which):
        found = predict(plan, stations.subset(which), seen[which])
        return np.sqrt(np.mean(found.sigma**2))

    rng = np.random.default_rng(1)
    others = [mean(np.sort(rng.choice(stations.count, 6, replace=False))) for _ in range(12)]
    assert mean(better) <= mean(chosen) * 1.001
    assert mean(better) < min(others)


def test_predicted_sigmas_are_the_scatter_of_adjustments_of_noisy_rays():
    own = layout(10)
    plan, stations = planned(own), around(own, 6, rolls=(0.0, 90.0))
    seen = visible(CAMERA, INTERIOR, stations, own, ANYTHING)
    found = predict(plan, stations, seen)
    network, state = plan.with_stations(stations, seen)
    rng = np.random.default_rng(5)
    scatter = []
    for _ in range(30):
        noisy = network.rays.xy_px + rng.normal(0.0, plan.sigma_px, network.rays.xy_px.shape)
        rays = type(network.rays)(
            network.rays.image, network.rays.point, noisy, network.rays.cov_px2, network.rays.kind
        )
        points = adjust(type(network)(**{**vars(network), "rays": rays}), state).state.points
        scatter.append(_aligned(points, own.points) - own.points)
    ratio = np.mean(np.square(scatter)) / np.mean(np.diagonal(found.with_known_scale, axis1=1, axis2=2))
    assert 0.8 < ratio < 1.2  # of some 30 x 23 independent deviations: one standard deviation of it is 0.05


def _aligned(points, reference):
    """Points moved, without a change of scale, to where they lie nearest to others."""
    ours, theirs = points - points.mean(0), reference - reference.mean(0)
    left, _, right = np.linalg.svd(theirs.T @ ours)
    return ours @ (left @ right).T + reference.mean(0)


def test_a_known_camera_and_a_known_scale_leave_less():
    own = layout()
    plan, stations = planned(own, sigma_m=1e-3), around(own, 6)
    found = predict(plan, stations, visible(CAMERA, INTERIOR, stations, own, ANYTHING))
    camera, scale = largest_sigma(found.with_known_camera), largest_sigma(found.with_known_scale)
    assert np.all(camera < found.sigma)
    assert np.all(scale < 0.5 * found.sigma)  # the bar is what limits this network


def test_bodies_seen_from_each_other_do_not_depend_on_the_datum():
    own = layout(12)
    plan, stations = planned(own), around(own, 8)
    found = predict(plan, stations, visible(CAMERA, INTERIOR, stations, own, ANYTHING))
    one, other = np.arange(5), np.arange(5, 12)
    about = own.points[one].mean(axis=0)
    relative = body_motion(found.together, own.points, one, other, about)
    arm = own.points - own.points.mean(axis=0)
    moves = np.concatenate(
        [np.tile(np.eye(3), (12, 1)), -np.cross(arm[:, None], np.eye(3)).transpose(0, 2, 1).reshape(-1, 3)], 1
    )
    shaken = found.together + moves @ np.diag([1e-8] * 3 + [1e-6] * 3) @ moves.T
    assert_close(body_motion(shaken, own.points, one, other, about), relative, atol=1e-15)
    assert body_motion(shaken, own.points, one, None, about)[0, 0] > 0.9e-8


def test_points_for_the_search_are_spread():
    points = np.concatenate([np.zeros((50, 3)), np.eye(3), -np.eye(3)])
    assert set(range(50, 56)) <= set(spread_points(points, 7).tolist())
    assert len(spread_points(points, 100)) == 56


def test_too_few_stations_are_no_network():
    own = layout()
    plan, stations = planned(own), around(own)
    seen = visible(CAMERA, INTERIOR, stations, own, ANYTHING)
    assert predict(plan, stations.subset(np.array([0])), seen[:1]) is None
    assert len(useful_stations(np.eye(5, dtype=bool))) == 0
