"""Poses and readings by Newton's method on any structure, and their status without a solution."""

from __future__ import annotations

import numpy as np
import pytest

from tests.simulation.mechanisms.telescope import K, readings, telescope
from tests.tolerance import assert_close
from truing.simulation.mechanisms.legs.kinematics import forward, inverse
from truing.simulation.mechanisms.structures.kinematic_model import JacobianModel, KinematicModel
from truing.simulation.mechanisms.structures.structure import Machine, Structure, poses_at, readings_at

MODELS = (KinematicModel("6-pus"), JacobianModel())


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_a_member_that_cannot_close_leaves_the_others_alone(model: Structure) -> None:
    machine, rho = Machine(telescope(), K), readings(np.random.default_rng(1), 3)
    alone = poses_at(model, machine, rho)
    rho[1] += [0.4, -0.4, 0.4, -0.4, 0.4, -0.4]
    found = poses_at(model, machine, rho)
    assert found.converged.tolist() == [True, False, True]
    assert np.isfinite(found.p).all()
    assert_close(found.p[[0, 2]], alone.p[[0, 2]], atol=1e-15, what="p, m")


def test_a_place_out_of_reach_has_no_reading_and_leaves_the_others_alone() -> None:
    machine = Machine(telescope(), K)
    p, R = np.array([[0.0, 0.0, 0.497], [0.4, 0.0, 0.497], [1e-3, 0.0, 0.497]]), np.broadcast_to(np.eye(3), (3, 3, 3))
    found = readings_at(KinematicModel("6-pus"), machine, p, R)
    assert found.converged.tolist() == [True, False, True]
    assert np.isfinite(found.rho).all()
    shifted = inverse(machine.legs, p[[0, 2]], R[[0, 2]], machine.delta_bz(found.rho[[0, 2]]))
    assert_close(found.rho[[0, 2]], shifted, atol=1e-15, what="readings, m")


def test_poses_of_the_kinematic_model_are_those_of_legs_with_shifted_attachments() -> None:
    machine, rho = Machine(telescope(), K), readings(np.random.default_rng(2), 5)
    found, shifted = poses_at(MODELS[0], machine, rho), forward(machine.legs, rho, machine.delta_bz(rho))
    assert_close(found.p, shifted.p, atol=1e-15, what="p, m")
    assert_close(found.R, shifted.R, atol=1e-14, what="R")
