"""The beam model: reference values, size of the flexures' shift, and limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.simulation.mechanisms.flexure_telescope import (
    FLEXURE_M,
    REFERENCE,
    TABLE_3,
    crooked,
    flexure_telescope,
    pose,
    vector,
)
from tests.tolerance import assert_between, assert_close
from truing.simulation.mechanisms.legs.kinematics import ReferencePose, forward, inverse, reference_pose
from truing.simulation.mechanisms.structures.beam_model import BeamModel, arc_distance, circle_distance, flexure_bending
from truing.simulation.mechanisms.structures.kinematic_model import KinematicModel
from truing.simulation.mechanisms.structures.structure import NO_CHANGE, Machine, readings_at

MODEL, ARC = BeamModel(), BeamModel("beam, exact arc", arc_distance)


def _shift_um(machine: Machine, model: BeamModel = MODEL) -> np.ndarray:
    """Change of the readings by the flexures at the poses of table 3, µm."""
    rho = machine.legs.rho0 + TABLE_3
    reached = forward(machine.legs, rho)
    asked = readings_at(model, machine, reached.p, reached.R)
    assert asked.converged.all()
    return (asked.rho - rho) * 1e6


def test_home_is_that_of_the_reference() -> None:
    found, expected = reference_pose(flexure_telescope().legs), REFERENCE["home"]
    assert_close(found.p[0] * 1e3, expected["p0"], atol=1e-9 * 500.0, what="p0, mm")
    assert_close(found.R[0], expected["R0"], atol=1e-9, what="R0")
    assert_close(found.z[0], expected["z0"], atol=1e-9, what="z0")


def test_readings_are_those_of_the_reference() -> None:
    inputs, outputs = vector("eq18")
    machine, (p, R) = flexure_telescope(), pose(inputs)
    asked = readings_at(MODEL, machine, p, R)
    found = flexure_bending(circle_distance, machine, reference_pose(machine.legs), p, R, asked.rho)
    assert asked.converged.all()
    assert_close(asked.rho[0] * 1e3, outputs["rho_mm"], atol=1e-9 * 10.0, what="rho, mm")
    assert_close(found.z[0], outputs["z"], atol=1e-9, what="z")
    assert_close(found.a.value[0] * 1e3, outputs["dlA_mm"], atol=1e-9 * 5.0, what="dl_A, mm")
    assert_close(found.b.value[0] * 1e3, outputs["dlB_mm"], atol=1e-9 * 5.0, what="dl_B, mm")
    shift = (asked.rho - inverse(machine.legs, p, R))[0] * 1e6
    assert_close(shift, outputs["rho_minus_6pus_um"], atol=1e-9 * 10e3, what="less the 6-pus, um")


def test_closing_is_that_of_the_reference() -> None:
    """Leg 1 with parameters off, its flexures straight along the nominal reference direction."""
    (inputs, _), (own, outputs) = vector("eq30"), vector("eq32")
    legs = flexure_telescope().legs
    given = {name: getattr(legs, name).copy() for name in ("a", "b", "u", "l")}
    for name, si in (("a", 1e-3), ("b", 1e-3), ("u", 1.0), ("l", 1e-3)):
        given[name][0] = np.array(inputs[name]) * si
    machine = replace(flexure_telescope(), legs=legs.replace(**given))
    reference = ReferencePose(np.zeros((1, 3)), np.eye(3)[None], np.tile(own["z0"], (1, 6, 1)))
    rho = np.full((1, 6), inputs["rho_mm"] * 1e-3)
    found = flexure_bending(circle_distance, machine, reference, *pose(inputs), rho).value[0, 0] * 1e3
    assert_close(found, outputs["f_mm"], atol=1e-9 * outputs["f_mm"], what="f, mm")


def test_over_table_3_flexures_move_readings_by_half_a_micrometre() -> None:
    assert_between(np.abs(_shift_um(flexure_telescope())).max(), 0.53, 0.54, what="um")


def test_the_shift_grows_with_the_flexures_and_the_square_of_the_bend() -> None:
    machine = flexure_telescope()
    plain = _shift_um(machine)
    longer = _shift_um(replace(machine, flexure_length=np.full(6, 2 * FLEXURE_M)))
    assert_close(longer, 2 * plain, atol=1e-3 * np.abs(plain).max(), what="twice as long, um")


def test_the_circle_replaces_the_arc_to_a_tenth_of_a_nanometre() -> None:
    """l_b (1/432 + 1/80) of the fourth power of at most 1.3 degrees, at both ends of a leg."""
    machine = flexure_telescope()
    apart = np.abs(_shift_um(machine) - _shift_um(machine, ARC)).max()
    bound = 2 * FLEXURE_M * 1e6 * (1 / 432 + 1 / 80) * np.deg2rad(1.3) ** 4
    assert_between(apart, 1e-6, bound, what="um")


@pytest.mark.parametrize("kind", ["6-pus", "ups"])
def test_without_length_flexures_are_spherical_joints(kind: str) -> None:
    machine = replace(crooked(np.random.default_rng(0), kind), flexure_length=np.zeros(6))
    rho = machine.legs.rho0 + TABLE_3[:5]
    reached = forward(machine.legs, rho)
    found, expected = (
        model.close(machine, reached.p, reached.R, rho, NO_CHANGE) for model in (MODEL, KinematicModel(kind))
    )
    for name in ("value", "by_twist", "by_rho"):
        assert_close(getattr(found, name), getattr(expected, name), atol=1e-14, what=name)
