"""The equations of a calibration: exact derivatives at finite deviations, and values in batches."""

from __future__ import annotations

import numpy as np
import pytest

from tests.simulation.mechanisms.constrained import assert_batch_is_its_members, assert_derivatives_exact
from tests.simulation.mechanisms.telescope import K, readings, telescope
from tests.tolerance import assert_close
from truing.estimation.rotation import exp_so3, log_so3
from truing.simulation.mechanisms.calibration_problem import CalibrationProblem
from truing.simulation.mechanisms.parameters import ParameterSet, full_set, report_set
from truing.simulation.mechanisms.structures.kinematic_model import JacobianModel, KinematicModel
from truing.simulation.mechanisms.structures.structure import Machine, Structure, poses_at

STRUCTURES: dict[str, Structure] = {
    "6-pus": KinematicModel("6-pus"),
    "ups": KinematicModel("ups"),
    "jacobian": JacobianModel(),
}


def _problem(name: str, parameters: ParameterSet | None = None, poses: int = 3) -> CalibrationProblem:
    """Exact poses of the nominal machine, identified by a model."""
    machine = Machine(telescope("ups" if name == "ups" else "6-pus"), K)
    rho = readings(np.random.default_rng(5), poses)
    truth = KinematicModel(machine.legs.closure.name)
    reached = poses_at(truth, machine, rho)
    everything = parameters or full_set(machine, "matrix", rho0=True)
    return CalibrationProblem(STRUCTURES[name], machine, everything, reached.p, reached.R, rho)


def _apart(problem: CalibrationProblem, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Values and deviations far beyond any tolerance, where the left Jacobian is no identity."""
    values = problem.start + rng.normal(0.0, 1e-3, len(problem.start))
    deviation = rng.normal(0.0, 1e-3, (len(problem.p), problem.deviations))
    deviation[:, 3:6] += rng.normal(0.0, 0.2, (len(problem.p), 3))
    return values, deviation


@pytest.mark.parametrize("name", STRUCTURES)
def test_derivatives_at_finite_deviations_agree_with_a_complex_step(name: str) -> None:
    problem = _problem(name)
    assert_derivatives_exact(problem, *_apart(problem, np.random.default_rng(6)))


@pytest.mark.parametrize("name", ["6-pus", "ups"])
def test_exact_poses_of_the_nominal_machine_close(name: str) -> None:
    problem = _problem(name)
    found = problem.constrain(problem.start, np.zeros((3, problem.deviations)))
    assert_close(found.value, np.zeros((3, 6)), atol=1e-15, what="equations, m")


@pytest.mark.parametrize("name", STRUCTURES)
def test_a_deviation_is_a_place_off_the_measured_one(name: str) -> None:
    problem = _problem(name)
    values, deviation = _apart(problem, np.random.default_rng(7))
    there = CalibrationProblem(
        problem.structure,
        problem.nominal,
        problem.parameters,
        problem.p + deviation[:, :3],
        exp_so3(deviation[:, 3:6]) @ problem.R,
        problem.rho + deviation[:, 6:],
    )
    expected = there.constrain(values, np.zeros_like(deviation)).value
    assert_close(problem.constrain(values, deviation).value, expected, atol=1e-15, what="equations, m")
    assert_close(log_so3(there.R @ np.swapaxes(problem.R, 1, 2)), deviation[:, 3:6], atol=1e-14, what="theta")


@pytest.mark.parametrize("name", STRUCTURES)
def test_a_batch_of_values_is_solved_as_single_values(name: str) -> None:
    problem, rng = _problem(name), np.random.default_rng(8)
    values = problem.start + rng.normal(0.0, 1e-4, (4, len(problem.start)))
    deviation = rng.normal(0.0, 1e-5, (4, 3, problem.deviations))
    assert_batch_is_its_members(problem, values, deviation)


def test_moving_the_reference_moves_all_readings_of_its_leg() -> None:
    problem = _problem("6-pus")
    moved = problem.start.copy()
    reference = problem.parameters.labels.index("rho04")
    moved[reference] += 1e-4
    rho = problem.readings(problem.machine(moved))
    assert_close(rho - problem.rho, np.broadcast_to(1e-4 * np.eye(6)[3], rho.shape), atol=1e-15, what="readings")
    assert_close(problem.machine(moved).delta_bz(rho), problem.nominal.delta_bz(problem.rho), atol=1e-16, what="shift")


def test_the_report_identifies_a_leg_from_its_own_closure_alone() -> None:
    machine = Machine(telescope(), np.zeros((6, 6)))
    problem = _problem("6-pus", report_set(machine, "none"))
    found = problem.constrain(problem.start, np.zeros((3, problem.deviations))).by_values
    for j, entry in enumerate(problem.parameters.entries):
        assert np.all(np.abs(np.delete(found[..., j], entry.leg, -1)) == 0.0), entry.label


def _bent_in_its_plane(name: str, poses: int = 3) -> CalibrationProblem:
    """Exact poses of a machine whose attachments shift along all axes, all its coefficients open."""
    rng = np.random.default_rng(12)
    machine = Machine(telescope(name), K, in_plane=rng.normal(0.0, 0.02, (6, 2, 6)))
    rho = readings(rng, poses)
    reached = poses_at(STRUCTURES[name], machine, rho)
    assert reached.converged.all()
    parameters = full_set(machine, "in-plane", rho0=True)
    return CalibrationProblem(STRUCTURES[name], machine, parameters, reached.p, reached.R, rho)


@pytest.mark.parametrize("name", ["6-pus", "ups"])
def test_derivatives_with_shifts_in_the_plane_agree_with_a_complex_step(name: str) -> None:
    problem = _bent_in_its_plane(name)
    assert_derivatives_exact(problem, *_apart(problem, np.random.default_rng(13)))


def test_shifts_in_the_plane_are_those_of_the_moved_attachments() -> None:
    problem = _bent_in_its_plane("6-pus", poses=1)
    machine, moved = problem.nominal, problem.rho[0] - problem.nominal.legs.rho0
    assert machine.in_plane is not None
    shift = np.concatenate([machine.in_plane @ moved, (K @ moved)[:, None]], -1)
    rigid = Machine(machine.legs.replace(b=machine.legs.b + shift), np.zeros((6, 6)))
    found = poses_at(STRUCTURES["6-pus"], rigid, problem.rho)
    assert_close(found.p, problem.p, atol=1e-12)
    assert_close(found.R, problem.R, atol=1e-12)


def test_values_of_shifts_in_the_plane_are_where_their_names_say() -> None:
    problem = _bent_in_its_plane("6-pus")
    assert problem.nominal.in_plane is not None
    values = dict(zip(problem.parameters.labels, problem.start, strict=True))
    assert values["Kx23"] == problem.nominal.in_plane[1, 0, 2]
    assert values["Ky61"] == problem.nominal.in_plane[5, 1, 0]
    assert values["K61"] == K[5, 0]
