"""A robot on four cables over pulleys: a laboratory's own closure, drives found from the log, unidentifiable
parameters."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest

from tests.real import cable_facts
from tests.real.cable_robot import CABLES, CableProblem, Run, geometry
from tests.real.pulley_cable import PulleyCable
from tests.tolerance import assert_between, assert_close
from truing.schemas import installed
from truing.simulation.change import Change
from truing.simulation.mechanisms.legs.closures import Legs, mechanism
from truing.simulation.mechanisms.legs.kinematics import closure_rows, solve_rows
from truing.simulation.mechanisms.structures.kinematic_model import KinematicModel
from truing.simulation.mechanisms.structures.structure import Machine, readings_at

STEP = 1e-20  # of a complex derivative
HALF_STEP = 1e-5  # of a central difference

_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")


def cables(radius=0.03):
    """Four cables from the corners of a frame to those of a platform."""
    corners = np.array([[1, -1], [1, 1], [-1, 1], [-1, -1.0]])
    frame = np.concatenate([1.1 * corners, np.full((4, 1), 1.8)], 1)
    platform = np.concatenate([0.08 * corners, np.full((4, 1), 0.26)], 1)
    axes = np.array([[1.0, 0, 0], [1, 0, 0], [-1, 0, 0], [-1, 0, 0]])
    return Legs(frame, platform, axes, np.full(4, 0.5), np.zeros(4), PulleyCable(radius))


def a_run(poses=6):
    rng = np.random.default_rng(4)
    planned = np.concatenate([rng.uniform(-0.3, 0.3, (poses, 2)), rng.uniform(0.7, 1.1, (poses, 1))], 1)
    angles = rng.normal(0.0, 0.1, (poses, 3))
    down, beside = np.tile([0.0, 0, -1], (4, 1)), np.array([[0.0, 1, 0], [0, 1, 0], [0, -1, 0], [0, -1, 0]])
    frames = np.stack([down, beside, cables().u], 1)
    lengths, swivel = rng.uniform(0.8, 1.6, (2, poses, 4))
    poses_ = np.concatenate([planned, angles], 1)
    return Run(cables(), frames, lengths, lengths, swivel, angles, poses_, poses_, poses_[0], 0.0, np.ones(4))


def test_a_cable_is_rim_and_tangent_and_length_is_stationary_where_it_leaves():
    legs, upper = cables(), np.array([0.1, 0.2, 1.1]) + cables().b
    cable = legs.closure.wrap(legs, upper)
    towards = upper - legs.a
    across = towards - np.sum(towards * legs.u, -1, keepdims=True) * legs.u
    outward = across / np.linalg.norm(across, axis=-1, keepdims=True)
    normal = np.cross(cable.direction, np.cross(legs.u, outward))  # in the pulley's plane, across the cable
    leaves = legs.a + 0.03 * (outward + normal)
    tangent = upper - leaves
    assert_close(np.sum(tangent * normal, -1), np.zeros(4), atol=1e-15)
    assert_close(tangent / np.linalg.norm(tangent, axis=-1, keepdims=True), cable.direction, atol=1e-15)
    turned = np.arctan2(np.linalg.norm(np.cross(-outward, normal), axis=-1), np.sum(-outward * normal, -1))
    assert_close(cable.length, 0.03 * turned + np.linalg.norm(tangent, axis=-1), atol=1e-14)


def test_without_radius_it_is_a_straight_leg():
    legs = cables(radius=0.0)
    upper = np.array([0.1, 0.2, 1.1]) + legs.b
    apart = np.linalg.norm(upper - legs.a, axis=-1)
    assert_close(legs.closure.wrap(legs, upper).length, apart, atol=1e-15)
    assert_close(legs.closure.close(legs, upper, apart - 0.5)[0], np.zeros(4), atol=1e-15)


def test_derivatives_of_the_closing_are_exact():
    legs, upper, rho = cables(), np.array([0.1, 0.2, 1.1]) + cables().b, np.full(4, 0.8)
    for axis in range(3):
        moved = upper + 1j * STEP * np.eye(3)[axis]
        slope = legs.closure.close(legs, moved, rho)[0].imag / STEP
        assert_close(legs.closure.close(legs, upper, rho)[1][:, axis], slope, atol=1e-14)
        for field in ("a", "u"):
            direction = np.eye(3)[axis] - (legs.u * legs.u[:, [axis]] if field == "u" else 0.0)  # axes stay units
            direction = np.broadcast_to(direction, (4, 3))
            changed = legs.replace(**{field: getattr(legs, field) + 1j * STEP * direction})
            slope = legs.closure.close(changed, upper, rho)[0].imag / STEP
            own = legs.closure.close_change(legs, upper, rho, Change({field: direction[..., None]}, 1))[:, 0]
            assert_close(own, slope, atol=1e-14, what=field)


def test_four_legs_give_readings_from_poses_and_no_poses_from_readings():
    machine = Machine(cables(), np.zeros((4, 4)))
    p, R = np.array([[0.1, 0.2, 0.9], [-0.2, 0.0, 1.0]]), np.broadcast_to(np.eye(3), (2, 3, 3))
    found = readings_at(KinematicModel("pulley-cable"), machine, p, R)
    assert found.converged.all()
    upper = p[:, None] + machine.legs.b
    assert_close(found.rho, machine.legs.closure.wrap(machine.legs, upper).length - 0.5, atol=1e-14)
    turn = closure_rows(machine.legs, R, machine.legs.closure.wrap(machine.legs, upper).direction)
    with pytest.raises(ValueError, match="4 legs"):
        solve_rows(turn, np.zeros((2, 4, 1)))


def test_an_installed_package_brings_the_closure(monkeypatch):
    point = SimpleNamespace(load=lambda: PulleyCable)
    monkeypatch.setattr(installed, "entry_points", lambda group: [point] if group == "truing.closures" else [])
    legs = cables()
    found = mechanism("pulley-cable", legs.a, legs.b, legs.u, legs.l, legs.rho0)
    assert isinstance(found.closure, PulleyCable)


def test_derivatives_of_the_calibration_are_exact():
    problem, rng = CableProblem(a_run(), a_run().raw, geometry()), np.random.default_rng(5)
    values = problem.nominal + 0.02 * rng.normal(size=len(problem.labels))
    deviation = 0.05 * rng.normal(size=(6, 14))
    found = problem.constrain(values, deviation)

    def differences(of, count):
        steps = HALF_STEP * np.eye(count)
        return np.stack([(of(step) - of(-step)) / (2 * HALF_STEP) for step in steps], -1)

    by_values = differences(lambda step: problem.constrain(values + step, deviation).value, len(values))
    by_deviation = differences(lambda step: problem.constrain(values, deviation + step).value, 14)
    # the third derivative is of order one over the square of the shortest distance, 0.5 m; and rounding over the step
    truncation = HALF_STEP**2 * 10 / 0.5**2 + 1e-15 / HALF_STEP
    assert_close(found.by_values, by_values, atol=truncation)
    assert_close(found.by_deviation, by_deviation, atol=truncation)


@pytest.fixture(scope="module")
def found(real_data):
    if not (real_data / cable_facts.FOLDER).is_dir():
        pytest.skip(f"no {cable_facts.FOLDER} among the real measurements")
    return cable_facts.facts(real_data)


@pytest.mark.parametrize("poses", [8, 27])
def test_the_loop_closes_with_the_authors_poses_and_pulleys(found, poses):
    closure = found[f"closure{poses}"]
    quoted = {8: 15.6, 27: 12.7}[poses]  # with the data, for a model of their page's own
    assert closure["point_mm"] == pytest.approx(quoted, rel=0.1)
    assert closure["pulley_mm"] < 0.2 * quoted
    assert closure["uncorrected_mm"] > 4 * closure["pulley_mm"]
    assert closure["authors_mm"] == pytest.approx({8: 10.5, 27: 7.3}[poses], abs=0.05)
    assert closure["authors_again_mm"] == pytest.approx(closure["authors_mm"], rel=1e-9)


@pytest.mark.parametrize("poses", [8, 27])
def test_the_wrong_ratio_of_every_drive_is_found_from_the_log(found, poses):
    drives = found[f"drives{poses}"]
    assert drives["status"] == "converged"
    off = (drives["ratio"] - drives["authors"]) / drives["sigma"]
    assert np.all(np.abs(off) < 3.0)
    assert np.all((1.0 - drives["ratio"]) / drives["sigma"] > 5.0)
    assert np.all(drives["sigma"] < 0.0035)


def test_more_poses_reduce_the_sigmas(found):
    assert np.all(found["drives27"]["sigma"] < found["drives8"]["sigma"])
    assert found["known27"]["rank"] > found["known8"]["rank"]


def test_the_noise_is_a_seventh_of_the_declared_one(found):
    for poses in (8, 27):
        assert_between(found[f"drives{poses}"]["noise_ratio"], 0.12, 0.18)


def test_unmeasured_quantities_are_named(found):
    texts = [text for text, _ in found["known27"]["hopeless"]]
    assert "a_x1 : a_x2 : a_x3 : a_x4 = 1 : 1 : 1 : 1" in texts  # the frame shifted, and the platform with it
    assert "b_z1 : b_z2 : b_z3 : b_z4 = 1 : 1 : 1 : 1" in texts
    turned = [text for text, sigma in found["known27"]["hopeless"] if not np.isfinite(sigma)]
    assert len(turned) == 1  # the platform's joints about its own axis, against the yaw's zero
    assert turned[0].startswith("yaw : b_x1")
    assert set(found["known27"]["chosen"][: 3 * CABLES + 1]) == {
        *(f"{name}{k + 1}" for name in ("ratio", "swivel", "l") for k in range(CABLES)),
        "yaw",
    }


def test_zeros_of_one_run_halve_what_is_left_of_the_other_and_joints_add_nothing(found):
    for poses in (8, 27):
        heldout = found[f"heldout{poses}"]
        assert heldout["drives"] < 0.6 * heldout["corrected"]
        assert heldout["joints"] > 0.98 * heldout["drives"]


def test_the_page_agrees_with_the_data(found):
    shown, made = cable_facts.PAGE.read_text(encoding="utf-8"), cable_facts.render(found)
    assert _NUMBER.sub("#", shown) == _NUMBER.sub("#", made), (
        "run `python -m tests.real.cable_facts`, look at what changed"
    )
    for old, new in zip(_NUMBER.findall(shown), _NUMBER.findall(made), strict=True):
        last = 10.0 ** -len(old.partition(".")[2])  # processors round differently: one unit of the last digit shown
        assert float(new) == pytest.approx(float(old), abs=1.01 * last)
