"""Statistics of rays on parameters that poses share: exact without noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.blind.generator.schedule import random_moves
from tests.photographs.as_network import interior_of, network_of
from tests.photographs.hidden import AirGradient, CameraEffect, UnstableCamera, Window
from tests.photographs.rays import BARS, Photographed, Shooting, draw_rays
from tests.photographs.stations import Round
from tests.tolerance import assert_close
from truing.estimation.bundle.adjustment import Adjustment, adjust
from truing.estimation.bundle.camera import PARAMETERS
from truing.estimation.bundle.network import Network, project
from truing.estimation.bundle.ray_statistics import RayStatistics, ray_channels, ray_statistics

MOVES = random_moves(4, 0, np.random.default_rng(3))
SIGMA_PX = 0.02


def photographed(*effects: CameraEffect, noisy: bool = False) -> Photographed:
    shooting = Shooting(
        stations=Round(count=6),
        missing_share=0.0,
        gross_share=0.0,
        sigma_px=SIGMA_PX if noisy else 1e-12,
        stated_sigma_px=SIGMA_PX,
        bars=tuple(replace(bar, sigma_mm=0.005 if noisy else 0.0) for bar in BARS),
    )
    return draw_rays(shooting, MOVES, [], effects, np.random.default_rng(5))


def adjusted(made: Photographed) -> Adjustment:
    network, start = network_of(made)
    return adjust(network, start)


def statistics_of(found: Adjustment) -> tuple[RayStatistics, list[str]]:
    statistics = ray_statistics(found.observed, found.state)
    return statistics, [f"{number.kind} {number.name}" for number in statistics.numbers]


def test_scores_follow_a_change_in_one_pose() -> None:
    made = photographed(UnstableCamera("c", jump_px=0.002, from_pose=MOVES[2][0]))
    found = adjusted(made)
    statistics, names = statistics_of(found)
    off = np.zeros((len(MOVES), len(names)))
    lens = made.shooting.lenses[0]
    places = [names.index(f"camera {name}") for name in PARAMETERS]
    for pose, longer in enumerate((0.0, 0.0, 0.002, 0.002)):
        own = replace(lens, focal_px=lens.focal_px + longer)
        off[pose, places] = np.array(interior_of(own)) - found.state.interior[0]
    true = np.array([bar.length_mm for bar in made.shooting.bars]) * 1e-3
    strains = [place for place, name in enumerate(names) if name == "bar strain"]
    off[:, strains] = true / found.state.bar_length_m - 1
    expected = np.einsum("pst,pt->ps", statistics.information, off)
    sigma = np.sqrt(np.diagonal(statistics.information, axis1=1, axis2=2))
    assert np.abs(expected / sigma).max() > 5e-3
    assert_close(statistics.score / sigma, expected / sigma, atol=2e-6)


def test_scores_sum_to_nothing_for_what_was_estimated() -> None:
    statistics, names = statistics_of(adjusted(photographed(noisy=True)))
    total, sigma = statistics.score.sum(0), np.sqrt(np.diagonal(statistics.information.sum(0)))
    free = [names.index(f"camera {name}") for name in ("c", "x0", "y0", "A1", "A2", "B1", "B2", "C1", "C2")]
    assert_close(total[free] / sigma[free], np.zeros(len(free)), atol=1e-4)


def test_channels_have_unit_noise_and_the_reported_effects() -> None:
    statistics, _ = statistics_of(adjusted(photographed(noisy=True)))
    channels = ray_channels(statistics.information, statistics.score)
    again = np.swapaxes(channels.root, 1, 2) @ channels.root
    scale = np.sqrt(np.diagonal(statistics.information, axis1=1, axis2=2))
    assert_close(again / scale[:, None] / scale[..., None], statistics.information / scale[:, None] / scale[..., None],
                 atol=1e-7)  # fmt: skip
    score = np.einsum("pkt,pk->pt", channels.root, channels.value)
    assert_close(score / scale, statistics.score / scale, atol=1e-5)
    # One strain of two bars is what the scale of the pose takes up.
    assert channels.determined.sum(1).tolist() == [len(statistics.numbers) - 1] * len(MOVES)
    assert 0.7 < np.std(channels.value[channels.determined]) < 1.3


def test_an_even_gradient_of_the_air_leaves_nothing_in_any_image() -> None:
    plain, bent = (adjusted(photographed(*effects)) for effects in ((), (AirGradient(per_m=2e-5),)))
    moved = bent.state.points - plain.state.points
    assert np.abs(moved).max() > 5e-7  # 20 K per metre of height bend shapes by some um
    assert bent.chi2 / bent.redundancy < 1e-4


def test_a_pane_before_the_camera_is_as_thick_as_it_is() -> None:
    statistics, names = statistics_of(adjusted(photographed(Window(thickness_mm=1.0))))
    information, score = statistics.information.sum(0), statistics.score.sum(0)
    pane = names.index("window thickness")
    own = [pane, *(place for place, name in enumerate(names) if name.startswith("camera") and name[-2:] != "A3")]
    found = np.linalg.solve(information[np.ix_(own, own)], score[own])
    assert found[0] == pytest.approx(1e-3, rel=5e-3)


def test_points_follow_a_number_as_an_adjustment_with_another_one_moves_them() -> None:
    made = photographed()
    network, start = network_of(made)
    held = replace(network, cameras=tuple(replace(camera, free=()) for camera in network.cameras))
    plain, longer = (_adjusted_with(held, start.interior, made, dc) for dc in (0.0, 0.01))
    statistics, names = statistics_of(plain)
    expected = statistics.by_point[..., names.index("camera c")] * 0.01
    assert np.abs(expected).max() > 1e-8
    assert_close(longer.state.points - plain.state.points, expected, atol=2e-3 * np.abs(expected).max())


def _adjusted_with(network: Network, interior: np.ndarray, made: Photographed, dc: float) -> Adjustment:
    start = network_of(made)[1]
    changed = interior.copy()
    changed[:, 0] += dc
    return adjust(network, replace(start, interior=changed))


def test_rays_bent_by_a_layer_of_air_give_its_curvature() -> None:
    # Where points seem to be is integrated along the chord, by a rule of its own.
    network, start = network_of(photographed())
    rays, curvature = network.rays, 3e-6
    centre, point = start.centre[rays.image], start.points[rays.point]
    away = centre - point
    length = np.linalg.norm(away, axis=1, keepdims=True)
    s, weight = np.polynomial.legendre.leggauss(8)
    moved = np.zeros_like(point)
    for part, share in zip((s + 1) / 2, weight / 2, strict=True):
        height = (point + part * away)[:, 2:] - start.points[:, 2].mean()
        moved[:, 2:] -= share * curvature * height * part * length**2
    seeming = replace(start, points=point + moved)
    xy = project(network, seeming, rays.image, np.arange(rays.count))
    bent = replace(network, rays=replace(rays, xy_px=xy))
    statistics, names = statistics_of(adjust(bent, start))
    information, score = statistics.information.sum(0), statistics.score.sum(0)
    own = [
        names.index("air zz"),
        *(n for n, name in enumerate(names) if name.startswith("camera") and name[-2:] != "A3"),
    ]
    found = np.linalg.solve(information[np.ix_(own, own)], score[own])
    assert found[0] == pytest.approx(curvature, rel=5e-3)


def test_neither_information_nor_scores_know_the_datum() -> None:
    network, start = network_of(photographed(noisy=True))
    free, least = (
        ray_statistics(a.observed, a.state) for a in (adjust(network, start), adjust(network, start, "minimal"))
    )
    sigma = np.sqrt(np.diagonal(free.information, axis1=1, axis2=2))
    names = [number.kind for number in free.numbers]
    camera = [place for place, kind in enumerate(names) if kind != "air"]  # whose axes turn with the points
    assert_close((free.score / sigma)[:, camera], (least.score / sigma)[:, camera], atol=1e-4)
