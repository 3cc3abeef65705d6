"""Noise-free machines with exact declarations: response to an effect in the generator and in ``truing.simulation``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tests.blind.generator import effects as hidden
from tests.blind.generator.campaign import Campaign, draw_campaign
from tests.blind.generator.hexapod import draw_hexapod, hexapod_geometry, random_places
from tests.blind.generator.layout import (
    DataFaults,
    Layout,
    Noise,
    Surroundings,
    Targets,
    Tolerance,
    noiseless,
    telescope_geometry,
)
from tests.blind.generator.quaternions import rotate, with_axis
from tests.blind.generator.schedule import even_moves, published_moves
from tests.tolerance import assert_between
from truing.simulation import targets as kinds
from truing.simulation.cause import Cause
from truing.simulation.inputs import APPROACH, ORDER, approach, order_in_time
from truing.simulation.mechanisms.legs.closures import mechanism
from truing.simulation.mechanisms.model import MechanismModel, PriorKnowledge
from truing.simulation.mechanisms.recording import Conditions
from truing.simulation.targets import FREE_ANGLE_RAD, ShapeUnknowns

TENTH_OF_NOISE_M, ROUNDING_M = 0.5e-6, 5e-9
WARM = Surroundings(frame_turn_rad=0.0, frame_shift_mm=0.0, temperature_step_c=1.0)
EXACT = Layout(name="exact", noise=noiseless(Noise()), faults=DataFaults(0.0, 0.0), surroundings=WARM)


def telescope(effects: list[hidden.Effect]) -> Campaign:
    return draw_campaign(EXACT, published_moves(), effects, np.random.default_rng(21))


def other(effects: list[hidden.Effect]) -> Campaign:
    geometry = telescope_geometry(
        base_radius=240.0, platform_radius=150.0, platform_half_separation_deg=9.0, length=430
    )
    layout = replace(EXACT, geometry=geometry, surroundings=replace(WARM, shuffled=True))
    moves = even_moves(15, 3, np.random.default_rng(3), 4.0)
    return draw_campaign(layout, moves, effects, np.random.default_rng(22))


def as_drawn(effects: list[hidden.Effect]) -> Campaign:
    """Without tolerance, so that the platform is level where flexures are straight, and far from there."""
    layout = replace(EXACT, tolerance=Tolerance(0.0, 0.0, 0.0, 0.0))
    return draw_campaign(layout, even_moves(15, 3, np.random.default_rng(3), 6.0), effects, np.random.default_rng(24))


def hexapod(effects: list[hidden.Effect]) -> Campaign:
    layout = replace(EXACT, geometry=hexapod_geometry(), targets=Targets(per_leg=0))
    places = random_places(15, 3, np.random.default_rng(4))
    return draw_hexapod(layout, places, effects, np.random.default_rng(23))


MACHINES: tuple[Callable[[list[hidden.Effect]], Campaign], ...] = (telescope, other, hexapod)


def targets_of(campaign: Campaign) -> kinds.Targets:
    marks = campaign.marks
    legs = [int(body[3:]) if body.startswith("leg") else on for body, on in zip(marks.body, marks.on_leg, strict=True)]
    kind = [{"base": kinds.BASE, "platform": kinds.PLATFORM}.get(body, kinds.LEG) for body in marks.body]
    return kinds.Targets(np.array(kind), np.array(legs) - 1, tuple(marks.name), tuple(marks.body))


def model_of(campaign: Campaign, make: Callable[[float, float], Cause] | None) -> MechanismModel:
    """The machine as it was built and surveyed, all of it exactly known, with one cause or none."""
    built, schedule = campaign.truth.built, campaign.schedule
    kind = campaign.layout.geometry.mechanism
    u = built.u if kind == "6-pus" else None
    legs = mechanism(kind, built.a / 1e3, built.b / 1e3, u, built.length / 1e3, built.rho0 / 1e3)
    targets, count = targets_of(campaign), legs.count
    none = ShapeUnknowns(np.zeros((len(targets.body), 3, 0)), np.eye(3 * int(targets.at_attachment.sum())) * 1e-6)
    ridden = np.unique(targets.leg[targets.body == kinds.LEG])
    seats, nowhere = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    known = PriorKnowledge({}, campaign.surveyed / 1e3, none, 0.0, ridden, seats, nowhere)
    readings = campaign.readings / 1e3
    covariates = {
        "time_s": schedule.time_s,
        "temperature_c": schedule.temperature_c,
        ORDER: order_in_time(schedule.time_s, len(readings)),
        APPROACH: approach(readings, schedule.time_s, 5e-3 * campaign.layout.noise.declared_actuator_mm),
    }
    conditions = Conditions(readings, covariates, tuple(schedule.pose))
    model = MechanismModel(targets, conditions, legs, known)
    axes = np.stack([rotate(with_axis(model.nominal_direction), np.tile(axis, (count, 1))) for axis in np.eye(3)], -1)
    start, end = schedule.time_s.min(), schedule.time_s.max()
    model = replace(model, known=replace(known, seat_rotation=axes))
    return model.with_causes(() if make is None else (make(float(start), float(end - start)),))


def points_of(model: MechanismModel, values: NDArray, measured: NDArray) -> NDArray:
    """Points by the model; each leg is turned about its own axis as measured, because no closure fixes that angle."""
    shared = np.zeros(model.shared_size)
    if model.causes:
        sigma = np.concatenate([model.effect_sigma(cause) for cause in model.causes])
        shared[model.shared_size - len(sigma) :] = values / sigma
    local = np.zeros((len(measured), model.local_size))
    for _ in range(3):
        found = model.predict(shared, local)
        rolls, gap = found.by_local, measured - found.values
        square = np.sum(rolls**2, (1, 2))
        local = local + np.einsum("bkih,bki->bh", rolls, gap) / np.where(square > 0, square, 1.0)
    assert np.all(np.abs(local) * FREE_ANGLE_RAD < 0.01)
    return model.points(shared, local)


def assert_alike(
    campaign: Campaign, make: Callable[[float, float], Cause], values: NDArray, largest: float = 1e-2
) -> None:
    measured = campaign.record.points / 1e3
    gap = np.abs(points_of(model_of(campaign, make), values, measured) - measured)
    size = np.abs(points_of(model_of(campaign, None), np.zeros(0), measured) - measured)
    assert ROUNDING_M < TENTH_OF_NOISE_M
    assert_between(float(size.max()), 3 * TENTH_OF_NOISE_M, largest, what="effect, m")
    assert_between(float(gap.max()), 0.0, ROUNDING_M, what="difference, m")
