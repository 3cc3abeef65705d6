"""Legs with measured poses of their own: exact closure at their ends, in addition to the leg closure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.simulation.mechanisms.constrained import assert_batch_is_its_members, assert_derivatives_exact
from tests.simulation.mechanisms.telescope import K, readings, telescope
from tests.tolerance import assert_between, assert_close
from truing.estimation.rotation import exp_so3
from truing.simulation.mechanisms.calibration_problem import CalibrationProblem, PoseEquations
from truing.simulation.mechanisms.legs.kinematics import unit, upper_joints
from truing.simulation.mechanisms.legs.leg_bodies import LegBodies, LegPoses, seated
from truing.simulation.mechanisms.parameters import full_set, report_set
from truing.simulation.mechanisms.structures.kinematic_model import JacobianModel, KinematicModel
from truing.simulation.mechanisms.structures.structure import Machine, poses_at

RIDDEN = np.array([0, 2, 5])
MODEL = KinematicModel("6-pus")


def _aligned(w: NDArray, z: NDArray) -> NDArray:
    """Some rotation (B, K, 3, 3) from w to z: of the bases whose third axis is that."""
    bases = []
    for axis in (w, z):
        first = unit(np.cross(axis, np.broadcast_to([0.3, 0.9, -0.2], axis.shape)))
        bases.append(np.stack([first, np.cross(axis, first), axis], -1))
    return bases[1] @ np.swapaxes(bases[0], -1, -2)


def _exact(poses: int = 4, ridden: NDArray = RIDDEN) -> tuple[CalibrationProblem, NDArray]:
    """A machine seen exactly, its legs rolling freely in survey frames of any attitude, and the true values."""
    rng = np.random.default_rng(31)
    machine, rho = Machine(telescope(), K), readings(rng, poses)
    found = poses_at(MODEL, machine, rho)
    lower = machine.legs.closure.lower(machine.legs, rho)[:, ridden]
    z = unit(upper_joints(machine.legs, found.p, found.R, machine.delta_bz(rho))[:, ridden] - lower)
    c, w = rng.normal(0.0, 0.1, (len(ridden), 3)), unit(rng.normal(size=(len(ridden), 3)))
    R = exp_so3(rng.normal(0.0, 0.01, (poses, len(ridden), 1)) * z) @ _aligned(np.broadcast_to(w, z.shape), z)
    bodies = LegBodies(ridden, R, lower - (R @ c[..., None])[..., 0], c, w)
    everything = full_set(machine, "matrix", rho0=True)
    problem = CalibrationProblem(MODEL, machine, everything, found.p, found.R, rho, bodies)
    return problem, problem.start


def test_exact_poses_of_legs_close() -> None:
    problem, values = _exact()
    found = problem.constrain(values, np.zeros((4, problem.deviations)))
    assert found.value.shape == (4, 3 + 6 * 3)
    assert problem.deviations == 6 + 6 + 6 * 3
    assert_close(found.value, np.zeros_like(found.value), atol=1e-14, what="equations, m")


def test_derivatives_at_finite_deviations_agree_with_a_complex_step() -> None:
    problem, values = _exact()
    rng = np.random.default_rng(32)
    values = values + rng.normal(0.0, 1e-3, len(values))
    deviation = rng.normal(0.0, 1e-3, (4, problem.deviations))
    for body in [3, *range(15, problem.deviations, 6)]:
        deviation[:, body : body + 3] += rng.normal(0.0, 0.2, (4, 3))
    assert_derivatives_exact(problem, values, deviation, atol=(1e-12, 1e-11))


def test_a_batch_of_values_is_solved_as_single_values() -> None:
    problem, values = _exact()
    rng = np.random.default_rng(33)
    many = values + rng.normal(0.0, 1e-4, (3, len(values)))
    deviation = rng.normal(0.0, 1e-5, (3, 4, problem.deviations))
    assert_batch_is_its_members(problem, many, deviation)


def _information(found: PoseEquations, cov: NDArray, machine: int) -> NDArray:
    """Information on the machine's own parameters, those of the legs' seats eliminated."""
    spread = found.by_deviation @ cov @ np.swapaxes(found.by_deviation, -1, -2)
    full = np.einsum("bmp,bmq->pq", found.by_values, np.linalg.solve(spread, found.by_values))
    inner, across = full[machine:, machine:], full[:machine, machine:]
    return full[:machine, :machine] - across @ np.linalg.solve(inner, across.T)


def _informed(leg_sigma: float) -> tuple[NDArray, NDArray]:
    """Information with and without the legs' poses, of one sigma in m and (per 0.1 m) rad."""
    problem, _ = _exact(poses=60)
    problem = replace(problem, parameters=report_set(problem.nominal, "none"))
    found = problem.constrain(problem.start, np.zeros((60, problem.deviations)))
    sigma = np.concatenate(
        [np.full(3, 2e-6), np.full(3, 2e-5), np.full(6, 1e-6), np.tile([1] * 3 + [10] * 3, 3) * leg_sigma]
    )
    alone = replace(problem, leg_bodies=None)
    plain = alone.constrain(alone.start, np.zeros((60, 12)))
    size = len(problem.parameters)
    return _information(found, np.diag(sigma**2), size), _information(plain, np.diag(sigma[:12] ** 2), size)


def test_poorly_measured_legs_determine_as_much_as_their_closing() -> None:
    carried, plain = _informed(3e-3)
    scale = 1.0 / np.sqrt(np.diag(plain))
    excess = scale[:, None] * (carried - plain) * scale
    assert_close(excess, np.zeros_like(excess), atol=1e-4, what="information, relative")


def test_well_measured_legs_determine_more() -> None:
    carried, plain = _informed(3e-6)
    scale = 1.0 / np.sqrt(np.diag(plain))
    gain = np.linalg.eigvalsh(scale[:, None] * (carried - plain) * scale)
    assert gain.min() > -1e-9 * gain.max()
    sigmas = [np.sqrt(np.diag(np.linalg.inv(information))) for information in (carried, plain)]
    assert_between(np.min(sigmas[0] / sigmas[1]), 0.0, 0.5, what="best gain in sigma")


def test_seats_are_found_where_they_are() -> None:
    problem, _ = _exact()
    bodies = problem.leg_bodies
    assert bodies is not None
    rigid = Machine(problem.nominal.legs, np.zeros((6, 6)))
    is_observed = np.ones((4, 3), bool)
    found = seated(rigid.legs, problem.p, problem.R, problem.rho, LegPoses(RIDDEN, bodies.R, bodies.t, is_observed))
    assert_close(found.c, bodies.c, atol=1e-15, what="c, m")
    assert_close(found.w, bodies.w, atol=2e-4, what="w: the platform's deformation over the leg's length")


def test_a_pose_without_a_leg_is_filled_with_one_that_fits() -> None:
    problem, _ = _exact()
    bodies = problem.leg_bodies
    assert bodies is not None
    is_observed = np.array([[False, True, True], [True, True, False], [True, True, True], [False, True, True]])
    hidden = np.where(is_observed[..., None], bodies.t, np.nan)
    turned = np.where(is_observed[..., None, None], bodies.R, np.nan)
    found = seated(
        problem.nominal.legs, problem.p, problem.R, problem.rho, LegPoses(RIDDEN, turned, hidden, is_observed)
    )
    there = replace(problem, leg_bodies=found)
    value = there.constrain(there.start, np.zeros((4, there.deviations))).value
    assert_close(value, np.zeros_like(value), atol=2e-4, what="equations, m, at the scale of the deformation")


def test_numbers_of_a_leg_are_reported_by_name() -> None:
    problem, _ = _exact()
    own = [entry for entry in problem.entries if entry.name[0] in "cw"]
    assert len(own) == 15
    assert [entry.label for entry in own[:3]] == ["c_x1", "c_y1", "c_z1"]
    assert own[5].leg == 2


def test_legs_that_are_no_bodies_of_a_leg_model_are_refused() -> None:
    problem, _ = _exact()
    with pytest.raises(ValueError, match="found 6-pus in the model jacobian"):
        replace(problem, structure=JacobianModel())
    with pytest.raises(ValueError, match="found ups in the model ups"):
        replace(problem, structure=KinematicModel("ups"), nominal=Machine(telescope("ups"), K))
