"""The generator of rays: lenses invert exactly, and hidden effects obey the physics."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.blind.generator.folder import truth_path
from tests.blind.generator.quaternions import Array, from_vector, rotate, unit
from tests.blind.generator.schedule import Schedule, at_rest, random_moves
from tests.photographs.hidden import AirGradient, AirProfile, CameraEffect, UnstableCamera, WarmBar, Window
from tests.photographs.lens import Lens, View
from tests.photographs.ray_folder import write_rays
from tests.photographs.rays import Photographed, Shooting, draw_rays
from tests.photographs.stations import from_matrix
from tests.tolerance import assert_close

MOVES = [at_rest(), *random_moves(5, 1, np.random.default_rng(3))]


def photograph(*effects: object, **settings: object) -> Photographed:
    shooting = Shooting(missing_share=0.0, gross_share=0.0, sigma_px=0.0, **settings)  # type: ignore[arg-type]
    return draw_rays(shooting, MOVES, [], effects, np.random.default_rng(5))  # type: ignore[arg-type]


def test_a_lens_is_undone() -> None:
    lens, rng = Lens(), np.random.default_rng(1)
    pixel = rng.uniform(0, lens.width_px, 500) + 1j * rng.uniform(0, lens.height_px, 500)
    there_and_back = lens.image_of(lens.direction_of(pixel))
    assert_close(np.stack([there_and_back.real, there_and_back.imag]), np.stack([pixel.real, pixel.imag]), atol=1e-8)


def test_axes_become_the_quaternion_that_turns_alike() -> None:
    rng = np.random.default_rng(2)
    turn = from_vector(np.pi * unit(rng.normal(size=(200, 3))) * rng.uniform(0, 1, (200, 1)))
    axes = np.stack([rotate(turn, np.tile(axis, (200, 1))) for axis in np.eye(3)], axis=-1)
    v = rng.normal(size=(200, 3))
    assert_close(rotate(from_matrix(axes), v), rotate(turn, v), atol=1e-12)


def test_every_target_is_seen_by_enough_cameras() -> None:
    made = photograph()
    rays = np.zeros(made.points.shape[:2])
    np.add.at(rays, (made.pose, made.point), 1)
    assert rays.min() >= 4


@pytest.mark.parametrize(
    ("effect", "slope"),
    [(AirGradient(per_m=1e-3), lambda z: 1e-6 + 0 * z), (AirProfile(curvature_per_m2=1e-3), lambda z: 1e-9 * z)],
)
def test_a_ray_through_uneven_air_meets_its_point(effect: CameraEffect, slope: Callable[[float], float]) -> None:
    # Integrated step by step along the ray equation, d(n t)/ds = grad n, from the camera to where it comes out.
    view = View(np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, 400.0]))
    seen = np.array([900.0, 300.0, 500.0])
    towards = unit(effect.bend(seen, view))
    place, length, steps = view.centre, float(np.linalg.norm(seen)), 4000
    bends = 0.0
    for _ in range(steps):
        place = place + towards * length / steps
        up = np.array([0.0, 0.0, slope(place[2])])
        across = up - towards * (up @ towards)
        towards = unit(towards + across * length / steps)
        bends += float(np.linalg.norm(across)) * length / steps
    off = view.centre + seen - place
    along = unit(seen)
    missed = np.linalg.norm(off - along * (off @ along))
    # To first order in the index; the bow itself is half the bend times the way.
    assert missed < 0.02 * bends * length / 2


def test_a_window_shifts_a_slanted_ray_as_snells_law_says() -> None:
    view, angle, thickness, index = View(np.array([1.0, 0, 0, 0]), np.zeros(3)), 0.5, 12.0, 1.5
    # Traced from the camera: through air, the plate, and air again.
    inside = np.arcsin(np.sin(angle) / index)
    depth = 700.0
    sideways = (depth - thickness) * np.tan(angle) + thickness * np.tan(inside)
    seems: Array = Window(thickness, index).bend(np.array([sideways, 0.0, depth]), view)
    assert_close(seems[0] / seems[2], np.tan(angle), atol=1e-12)


def test_a_warm_bar_is_longer_and_reported_as_it_was(tmp_path: Path) -> None:
    made = photograph(WarmBar(1e-3))
    ends = made.points[:, -4:].reshape(-1, 2, 2, 3)
    length = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=-1)
    true = np.array([bar.length_mm for bar in made.shooting.bars])
    assert_close(length / true - 1, np.repeat(1e-3 * made.campaign.schedule.heat[:, None], 2, axis=1), atol=1e-12)
    reported = (write_rays(made, tmp_path / "warm", 5) / "scale_bars.csv").read_text(encoding="utf-8").splitlines()
    assert reported[0] == "bar,first,second,length_mm,sigma_mm"
    assert abs(float(reported[1].split(",")[3]) - true[0]) < 5 * 0.005


def test_an_unstable_camera_follows_its_declared_input() -> None:
    schedule: Schedule = photograph().campaign.schedule
    effect = UnstableCamera("x0", per_hour_px=2.0, per_k_px=0.5, jump_px=0.3, from_pose=4)
    jumped = np.array([pose >= 4 for pose in schedule.pose])
    expected = 2.0 * schedule.time_s / 3600 + 0.5 * schedule.heat + 0.3 * jumped
    assert_close(effect.change_px(schedule), expected, atol=1e-12)
    assert effect.lens(Lens(), 3, schedule).principal_px.real == Lens().principal_px.real + expected[3]


def test_the_folder_holds_every_ray_and_the_truth_what_was_hidden(tmp_path: Path) -> None:
    made = draw_rays(Shooting(gross_share=0.01), MOVES, [], [UnstableCamera(per_k_px=0.4)], np.random.default_rng(7))
    folder = write_rays(made, tmp_path / "rays", seed=7)
    rows = (folder / "image_points.csv").read_text(encoding="utf-8").splitlines()
    assert len(rows) == 1 + len(made.pixel)
    truth = json.loads(truth_path(folder).read_text(encoding="utf-8"))
    assert truth["effects"] == [
        {"cause": "camera-instability", "subject": "", "parameters": {"c_per_k": {"value": 0.4, "unit": "px/K"}}}
    ]
    assert len(truth["gross_errors"]) == made.gross.sum() > 0
