"""Hexapods of the generator obey the physics, and agree with the independent ``truing.simulation``."""

from __future__ import annotations

import csv
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.blind.generator.campaign import Campaign
from tests.blind.generator.closure import platform_pose
from tests.blind.generator.effects import ActuatorGain, Effect, LegDrift, LinearDeformation, MatrixDeformation
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.hexapod import draw_hexapod, hexapod_geometry, random_places
from tests.blind.generator.layout import DataFaults, Layout, Noise, Surroundings, Targets, noiseless
from tests.blind.generator.quaternions import Array, fit_motion, from_vector, rotate, to_vector
from tests.tolerance import assert_close
from truing.estimation.rotation import exp_so3
from truing.schemas.campaign import read_campaign
from truing.simulation.mechanisms.legs.closures import mechanism
from truing.simulation.mechanisms.legs.kinematics import forward, inverse

ROUNDING_MM = 1e-9
LEGS = (3, 5, 6, 8)


def layout(legs: int) -> Layout:
    return Layout(
        name=f"exact-{legs}",
        geometry=hexapod_geometry(legs),
        targets=Targets(on_attachments=tuple(range(1, legs + 1)), per_leg=0),
        noise=noiseless(Noise()),
        faults=DataFaults(0.0, 0.0),
        surroundings=Surroundings(frame_turn_rad=0.0, frame_shift_mm=0.0),
        decimals=12,
    )


def draw(legs: int, *effects: Effect, seed: int = 3) -> Campaign:
    rng = np.random.default_rng(seed)
    return draw_hexapod(layout(legs), random_places(12, 4, rng), effects, rng)


def bending(legs: int) -> tuple[Effect, ...]:
    return (MatrixDeformation(np.random.default_rng(legs).normal(0.0, 0.004, (legs, legs))),)


def poses(campaign: Campaign) -> tuple[Array, Array]:
    return campaign.truth.position, from_vector(campaign.truth.rotation_vector)


def upper_joints(campaign: Campaign) -> Array:
    """Attachments (N, L, 3) in the base frame as the points show them."""
    on = {leg: k for k, leg in enumerate(campaign.marks.on_leg) if leg}
    return campaign.record.points[:, [on[leg] for leg in sorted(on)]]


@pytest.mark.parametrize("legs", LEGS)
@pytest.mark.parametrize("bent", [False, True], ids=["rigid", "bent"])
def test_a_reading_and_a_length_span_the_joints_of_every_leg(legs: int, bent: bool) -> None:
    campaign = draw(legs, *(bending(legs) if bent else ()))
    spans = np.linalg.norm(upper_joints(campaign) - campaign.truth.built.a, axis=-1)
    assert_close(campaign.truth.built.length + campaign.readings, spans, atol=ROUNDING_MM, what="length, mm")


@pytest.mark.parametrize("legs", [6, 8])
def test_the_closure_leads_back_from_readings_to_poses(legs: int) -> None:
    campaign = draw(legs, *bending(legs))
    built, (position, turn) = campaign.truth.built, poses(campaign)
    upper = built.b + campaign.truth.delta_bz[..., None] * [0.0, 0.0, 1.0]
    lower = np.broadcast_to(built.a, upper.shape)
    p, q = platform_pose(lower, upper, built.length + campaign.readings, built.home_height)
    assert_close(p, position, atol=ROUNDING_MM, what="position, mm")
    assert_close(to_vector(q), to_vector(turn), atol=1e-11, what="rotation vector")


@pytest.mark.parametrize("legs", [3, 5, 6])
def test_the_reference_is_where_no_actuator_has_moved(legs: int) -> None:
    campaign = draw(legs)
    assert campaign.schedule.role[0] == "reference"
    assert_close(campaign.readings[0], campaign.layout.geometry.rho0, atol=ROUNDING_MM, what="readings, mm")


@pytest.mark.parametrize("legs", LEGS)
def test_attachments_shift_as_the_displacements_say(legs: int) -> None:
    kappa = np.linspace(0.001, 0.004, legs)
    campaign = draw(legs, LinearDeformation(kappa))
    assert_close(campaign.truth.delta_bz, kappa * campaign.truth.drho, atol=ROUNDING_MM, what="shift, mm")
    framing, points = campaign.marks.framing("platform"), campaign.record.points
    survey = np.broadcast_to(campaign.marks.place[framing], points[:, framing].shape)
    turn, shift = fit_motion(points[:, framing], survey)
    seen = rotate(turn[:, None], upper_joints(campaign)) + shift[:, None] - campaign.truth.built.b
    assert_close(seen[..., 2], campaign.truth.delta_bz, atol=ROUNDING_MM, what="seen shift, mm")


@pytest.mark.parametrize("legs", LEGS)
def test_an_actuator_gain_changes_readings_and_no_points(legs: int) -> None:
    plain, gained = draw(legs), draw(legs, ActuatorGain(0.01 * np.ones(legs)))
    rho0 = plain.layout.geometry.rho0
    assert_close(gained.record.points, plain.record.points, atol=0.0, what="points, mm")
    assert_close(1.01 * (gained.readings - rho0), plain.readings - rho0, atol=ROUNDING_MM, what="displacement, mm")


def test_a_leg_that_drifts_is_read_shorter() -> None:
    drift = np.array([0.0, 0.1, 0.0])
    plain, drifted = draw(3), draw(3, LegDrift(drift))
    assert_close(drifted.readings[0], plain.readings[0], atol=ROUNDING_MM, what="first reading, mm")
    assert_close(drifted.readings[-1], plain.readings[-1] - drift, atol=ROUNDING_MM, what="last reading, mm")


@pytest.mark.parametrize("legs", [6, 8])
def test_both_simulations_put_the_platform_in_the_same_place(legs: int) -> None:
    campaign = draw(legs, *bending(legs))
    built, truth = campaign.truth.built, campaign.truth
    machine = mechanism("ups", built.a / 1e3, built.b / 1e3, None, built.length / 1e3, built.rho0 / 1e3)
    found = forward(machine, campaign.readings / 1e3, truth.delta_bz / 1e3)
    assert found.converged.all()
    assert_close(found.p, truth.position / 1e3, atol=1e-10, what="position, m")
    assert_close(found.R, exp_so3(truth.rotation_vector), atol=1e-10, what="rotation")


@pytest.mark.parametrize("legs", LEGS)
def test_both_simulations_find_the_readings_of_a_pose(legs: int) -> None:
    campaign = draw(legs, *bending(legs))
    built, truth = campaign.truth.built, campaign.truth
    machine = mechanism("ups", built.a / 1e3, built.b / 1e3, None, built.length / 1e3, built.rho0 / 1e3)
    found = inverse(machine, truth.position / 1e3, exp_so3(truth.rotation_vector), truth.delta_bz / 1e3)
    assert_close(found, campaign.readings / 1e3, atol=1e-10, what="readings, m")


@pytest.mark.parametrize("legs", LEGS)
def test_the_folder_is_one_of_the_campaign_format(tmp_path: Path, legs: int) -> None:
    folder = write_campaign(draw(legs), tmp_path / "hexapod", 3)
    document = tomllib.loads((folder / "campaign.toml").read_text(encoding="utf-8"))
    assert document["mechanism"]["type"] == "ups"
    assert len(document["mechanism"]["legs"]) == legs
    assert not any("u" in leg for leg in (*document["mechanism"]["legs"], document["mechanism"]["tolerance"]))
    read_campaign(document)
    with (folder / "configurations.csv").open(encoding="utf-8", newline="") as file:
        columns = csv.DictReader(file).fieldnames
    assert columns == ["pose", "role", "time_s", *(f"rho{i + 1}_mm" for i in range(legs)), "temperature_c"]


def test_noise_leaves_machine_and_places_as_they_are() -> None:
    rng, again = np.random.default_rng(3), np.random.default_rng(3)
    noisy = replace(layout(6), noise=Noise(), faults=DataFaults())
    plain, other = (draw_hexapod(one, random_places(5, 2, r), [], r) for one, r in ((layout(6), rng), (noisy, again)))
    assert_close(other.truth.position, plain.truth.position, atol=0.0, what="position, mm")
    assert_close(other.truth.built.a, plain.truth.built.a, atol=0.0, what="a, mm")
    assert np.abs(other.record.points - plain.record.points).max() > 0.0
