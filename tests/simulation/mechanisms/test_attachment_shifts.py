"""Measured shifts of attachments: exact derivatives, and a platform with a common height error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.simulation.mechanisms.constrained import assert_derivatives_exact
from tests.simulation.mechanisms.telescope import K, readings, telescope
from tests.tolerance import assert_close
from truing.simulation.mechanisms.calibration_problem import AttachmentShifts, CalibrationProblem
from truing.simulation.mechanisms.parameters import full_set
from truing.simulation.mechanisms.structures.kinematic_model import KinematicModel
from truing.simulation.mechanisms.structures.structure import Machine, poses_at

POSES = 4


def _problem(deformation: str = "matrix") -> CalibrationProblem:
    """Exact poses and shifts of the deforming telescope, five of whose attachments carry targets."""
    machine = Machine(telescope(), K)
    rho = readings(np.random.default_rng(1), POSES)
    reached = poses_at(KinematicModel("6-pus"), machine, rho)
    leg = np.array([0, 1, 2, 4, 5])
    shifts = AttachmentShifts(leg, machine.delta_bz(rho)[:, leg], machine.legs.b[leg, 2])
    parameters = full_set(machine, deformation, rho0=True)
    return CalibrationProblem(KinematicModel("6-pus"), machine, parameters, reached.p, reached.R, rho, shifts=shifts)


@pytest.mark.parametrize("deformation", ["linear", "matrix"])
def test_derivatives_agree_with_a_complex_step(deformation: str) -> None:
    problem, rng = _problem(deformation), np.random.default_rng(2)
    values = problem.start + rng.normal(0.0, 1e-3, len(problem.start))
    deviation = rng.normal(0.0, 1e-3, (POSES, problem.deviations))
    assert problem.constrain(values, deviation).value.shape == (POSES, 11)
    assert_derivatives_exact(problem, values, deviation)


def test_exact_shifts_close() -> None:
    problem = _problem()
    found = problem.constrain(problem.start, np.zeros((POSES, problem.deviations)))
    assert_close(found.value, np.zeros((POSES, 11)), atol=1e-15, what="equations, m")


def test_a_height_that_the_survey_missed_shows_in_every_shift() -> None:
    problem = _problem()
    assert problem.shifts is not None
    surveyed = replace(problem, shifts=replace(problem.shifts, surveyed_bz=problem.shifts.surveyed_bz - 5e-6))
    found = surveyed.constrain(problem.start, np.zeros((POSES, problem.deviations)))
    assert_close(found.value[:, 6:], np.full((POSES, 5), -5e-6), atol=1e-15, what="equations of the shifts, m")
