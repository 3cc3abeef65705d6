"""The ordinary hexapod (ups): legs of variable length between two joints each, any number of them from 3 on.

The platform is put somewhere and readings follow: with fewer than six legs readings do not fix the platform, and more
than six cannot be chosen freely.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tests.blind.generator.campaign import STREAMS, Campaign, measured
from tests.blind.generator.closure import platform_pose
from tests.blind.generator.effects import Effect, Setting
from tests.blind.generator.layout import Geometry, Layout, Tolerance
from tests.blind.generator.machine import BodyPoses, Machine, Marks, at_reference, place_marks
from tests.blind.generator.quaternions import IDENTITY, Array, from_vector, rotate
from tests.blind.generator.schedule import plan

ROUNDS = 12  # each leaves of a reading's error what effects are of the reading, some hundredths


@dataclass(frozen=True)
class Place:
    """Commanded pose of the platform: position (3,) mm, rotation vector (3,) rad from the level reference pose, and
    role."""

    role: str
    position: Array
    turn: Array


def hexapod_geometry(
    legs: int = 6,
    *,
    base_radius: float = 220.0,
    platform_radius: float = 130.0,
    height: float = 320.0,
    rho0: float = 60.0,
) -> Geometry:
    """Joints in close pairs on two circles, those of the platform opposite to those of the base: evenly spaced ones
    would leave the platform a motion that no leg holds.
    """
    step, side = 2 * np.pi / legs, (-1.0) ** np.arange(legs)
    number = np.arange(legs)
    a = _on_circle(base_radius, step * (number + 0.3 * side))
    b = _on_circle(platform_radius, step * (number - 0.35 * side))
    reach = np.linalg.norm(b + np.array([0.0, 0.0, height]) - a, axis=1)
    return Geometry(a, b, np.zeros((0, 3)), reach - rho0, np.full(legs, rho0), flexure_length=None)


def _on_circle(radius: float, angle: Array) -> Array:
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros_like(angle)], axis=1)


def random_places(
    calibration: int, verification: int, rng: np.random.Generator, position_mm: float = 25.0, turn_deg: float = 6.0
) -> list[Place]:
    """Places drawn evenly from a box about the reference; held-out ones from a box of half its size."""
    reach = np.array([1.0] * calibration + [0.5] * verification)[:, None]
    shift = position_mm * reach * rng.uniform(-1.0, 1.0, (len(reach), 3))
    turn = np.deg2rad(turn_deg) * reach * rng.uniform(-1.0, 1.0, (len(reach), 3))
    roles = ["calibration"] * calibration + ["verification"] * verification
    return [Place(*place) for place in zip(roles, shift, turn, strict=True)]


def draw_hexapod(
    layout: Layout, places: Sequence[Place], effects: Sequence[Effect], rng: np.random.Generator
) -> Campaign:
    """Runs the chain once, as ``draw_campaign`` does: the first pose, 0, is the reference configuration, where as few
    readings as legs leave free are other than rho0.
    """
    stream = dict(zip(STREAMS, rng.spawn(len(STREAMS)), strict=True))
    built = build_hexapod(layout.geometry, layout.tolerance, stream["build"])
    marks = place_marks(layout, built, stream["marks"])
    body_poses = _body_poses(built, places)
    roles = ["reference", *(place.role for place in places)]
    asked = displacements(layout.geometry, body_poses)
    moves = [(n, role, row) for n, (role, row) in enumerate(zip(roles, asked, strict=True))]
    schedule = plan(moves, layout.surroundings, stream["plan"])
    actuator_mm = layout.noise.declared_actuator_mm or layout.noise.actuator_mm
    setting = Setting(schedule, marks, layout.targets.follow, actuator_mm)

    machine, indicated = _closed(built, marks, body_poses, effects, setting)
    return measured(layout, built, machine, body_poses, indicated, effects, setting, stream)


def build_hexapod(nominal: Geometry, tolerance: Tolerance, rng: np.random.Generator) -> Geometry:
    """The geometry that was really made: nominal plus a draw from the tolerance."""
    return replace(
        nominal,
        a=nominal.a + rng.normal(0.0, tolerance.a_mm, nominal.a.shape),
        b=nominal.b + rng.normal(0.0, tolerance.b_mm, nominal.b.shape),
        length=nominal.length + rng.normal(0.0, tolerance.length_mm, nominal.length.shape),
    )


def _body_poses(built: Geometry, places: Sequence[Place]) -> BodyPoses:
    """Base and platform, (N, 2) of each: at rest, then at the places."""
    rest, level = platform_pose(built.a[None], built.b[None], (built.length + built.rho0)[None], built.home_height)
    home = np.array([0.0, 0.0, built.home_height])
    position = np.concatenate([rest, [home + place.position for place in places]])
    turn = np.concatenate([level, [from_vector(place.turn) for place in places]])
    still = np.zeros_like(position)
    return BodyPoses(np.stack([still, position], 1), np.stack([np.tile(IDENTITY, (len(turn), 1)), turn], 1))


def displacements(geometry: Geometry, body_poses: BodyPoses) -> Array:
    """Displacements of the actuators from rho0 (N, L), mm, for given platform poses without effects."""
    return _spans(geometry.a, geometry.b, body_poses) - geometry.length - geometry.rho0


def _spans(a: Array, b: Array, body_poses: BodyPoses) -> Array:
    upper = rotate(body_poses.turn[:, 1, None], np.broadcast_to(b, (len(body_poses.turn), *b.shape[-2:])))
    return np.linalg.norm(upper + body_poses.position[:, 1, None] - a, axis=-1)


def _closed(
    built: Geometry, marks: Marks, body_poses: BodyPoses, effects: Sequence[Effect], setting: Setting
) -> tuple[Machine, Array]:
    """The machine under its effects, and the displacements (N, L) that its actuators indicate, where all loops are
    closed.
    """
    indicated = displacements(built, body_poses)
    for _ in range(ROUNDS):
        drho = indicated
        for effect in effects:
            drho = effect.drive(drho, setting)
        machine = at_reference(built, marks, drho)
        for effect in effects:
            effect.structure(machine, setting)
        open_by = _spans(machine.a, machine.b, body_poses) - machine.length - machine.rho0 - machine.drho
        indicated = indicated + open_by
    return machine, indicated
