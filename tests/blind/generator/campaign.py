"""One campaign from layout, moves, effects and seed: what was recorded, and the truth behind it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tests.blind.generator.effects import Effect, Setting
from tests.blind.generator.instrument import (
    Record,
    back_to_body,
    declared_sigma,
    read_actuators,
    record_points,
    settle,
    survey,
)
from tests.blind.generator.layout import LEGS, Geometry, Layout
from tests.blind.generator.machine import (
    BodyPoses,
    Machine,
    Marks,
    at_reference,
    build,
    exact_points,
    framed_pose,
    place_marks,
    stand,
)
from tests.blind.generator.named_effect import as_record
from tests.blind.generator.quaternions import Array, rotate, to_vector
from tests.blind.generator.schedule import Schedule, plan

Move = tuple[int, str, Array]
STREAMS = ("build", "marks", "plan", "settle", "readings", "survey", "points")
SHARED = ("marks", "plan")


@dataclass(frozen=True)
class Truth:
    """The truth: geometry as built, true displacements (N, L), platform poses as the contract defines them, shifts of
    the attachments along the platform's z (N, L); mm, and rotation vectors in rad."""

    built: Geometry
    drho: Array
    position: Array
    rotation_vector: Array
    delta_bz: Array
    effects: tuple[Effect, ...]


@dataclass(frozen=True)
class Campaign:
    """Everything that is written down, and the truth, which is not."""

    layout: Layout
    schedule: Schedule
    marks: Marks
    surveyed: Array
    readings: Array
    record: Record
    truth: Truth


def streams(rng: np.random.Generator, kept: np.random.Generator | None) -> dict[str, np.random.Generator]:
    """A stream per step; of ``kept``, where given, those of what campaigns of one layout share: the targets' places,
    times and temperatures.
    """
    own = dict(zip(STREAMS, rng.spawn(len(STREAMS)), strict=True))
    if kept is not None:
        shared = dict(zip(STREAMS, kept.spawn(len(STREAMS)), strict=True))
        own |= {name: shared[name] for name in SHARED}
    return own


def draw_campaign(
    layout: Layout,
    moves: Sequence[Move],
    effects: Sequence[Effect],
    rng: np.random.Generator,
    kept: np.random.Generator | None = None,
) -> Campaign:
    """Runs the chain once: schedule, drive, structure, instrument. Each step draws from a stream of its own,
    so that an effect or another noise leaves all other draws as they are.
    """
    stream = streams(rng, kept)
    built = build(layout.geometry, layout.tolerance, stream["build"])
    marks = place_marks(layout, built, stream["marks"])
    schedule = plan(moves, layout.surroundings, stream["plan"])
    setting = Setting(
        schedule, marks, layout.targets.follow, layout.noise.declared_actuator_mm or layout.noise.actuator_mm
    )
    indicated = settle(schedule, layout.surroundings, stream["settle"])

    machine = _structured(built, marks, _driven(indicated, effects, setting), effects, setting)
    body_poses = stand(machine, at_reference(built, marks, np.zeros((1, LEGS))))
    return measured(layout, built, machine, body_poses, indicated, effects, setting, stream)


def measured(
    layout: Layout,
    built: Machine,
    machine: Machine,
    body_poses: BodyPoses,
    indicated: Array,
    effects: Sequence[Effect],
    setting: Setting,
    stream: Mapping[str, np.random.Generator],
) -> Campaign:
    """Return the records of the instruments for a machine in its true poses, and the truth."""
    exact = exact_points(machine, body_poses, setting.marks)
    recorded, scatter = exact, np.ones(exact.shape[:2])
    for effect in effects:
        recorded = effect.instrument(recorded, body_poses, setting)
        scatter = effect.scatter(scatter, setting)
    return Campaign(
        layout=layout,
        schedule=setting.schedule,
        marks=setting.marks,
        surveyed=survey(setting.marks, layout, stream["survey"]),
        readings=read_actuators(indicated, layout, stream["readings"]),
        record=record_points(recorded, scatter, setting.marks, layout, stream["points"]),
        truth=truth_of(built, machine, body_poses, exact, setting.marks, tuple(effects)),
    )


def _driven(indicated: Array, effects: Sequence[Effect], setting: Setting) -> Array:
    drho = indicated
    for effect in effects:
        drho = effect.drive(drho, setting)
    return drho


def _structured(built: Geometry, marks: Marks, drho: Array, effects: Sequence[Effect], setting: Setting) -> Machine:
    machine = at_reference(built, marks, drho)
    for effect in effects:
        effect.structure(machine, setting)
    return machine


def truth_of(
    built: Geometry,
    machine: Machine,
    body_poses: BodyPoses,
    exact: Array,
    marks: Marks,
    effects: tuple[Effect, ...],
) -> Truth:
    """Return the truth; the platform's pose is that of its framing targets, if there are enough of them."""
    position, turn = body_poses.position[:, 1], body_poses.turn[:, 1]
    upper = rotate(turn[:, None], machine.b) + position[:, None]
    if len(marks.framing("platform")) >= 3:
        position, turn = framed_pose(exact, marks)
    upper = back_to_body(turn[:, None], position[:, None], upper)
    return Truth(
        built=built,
        drho=machine.drho,
        position=position,
        rotation_vector=to_vector(turn),
        delta_bz=upper[..., 2] - built.b[:, 2],
        effects=effects,
    )


def truth_record(campaign: Campaign, seed: int) -> dict[str, object]:
    """The truth as plain values, for the file next to the campaign folder."""
    truth, schedule, marks = campaign.truth, campaign.schedule, campaign.marks
    rows, columns = np.nonzero(campaign.record.gross & campaign.record.is_observed)
    return {
        "seed": seed,
        "effects": [as_record(effect) for effect in truth.effects],
        "noise": {
            "point_mm": campaign.layout.noise.point_mm,
            "declared_point_mm": declared_sigma(campaign.layout.noise)[0],
        },
        "geometry": {
            "a_mm": truth.built.a.tolist(),
            "b_mm": truth.built.b.tolist(),
            "u": truth.built.u.tolist(),
            "length_mm": truth.built.length.tolist(),
            "rho0_mm": truth.built.rho0.tolist(),
        },
        "poses": [
            {
                "pose": pose,
                "delta_rho_mm": truth.drho[n].tolist(),
                "p_mm": truth.position[n].tolist(),
                "rotation_vector_rad": truth.rotation_vector[n].tolist(),
                "delta_bz_um": (1000 * truth.delta_bz[n]).tolist(),
            }
            for n, pose in enumerate(schedule.pose)
        ],
        "gross_errors": [[schedule.pose[n], marks.body[k], marks.name[k]] for n, k in zip(rows, columns, strict=True)],
    }
