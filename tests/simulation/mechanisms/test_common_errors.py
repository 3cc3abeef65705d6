"""Errors common to all poses as parameters of a calibration: exact derivatives, and the bias that they remove."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.simulation.mechanisms.constrained import assert_batch_is_its_members, assert_derivatives_exact
from tests.simulation.mechanisms.telescope import K, readings, telescope
from tests.tolerance import assert_close
from truing.simulation.mechanisms.calibration_problem import AttachmentShifts, CalibrationProblem, CommonErrors
from truing.simulation.mechanisms.parameters import full_set
from truing.simulation.mechanisms.structures.kinematic_model import KinematicModel
from truing.simulation.mechanisms.structures.structure import Machine, poses_at

POSES, ERRORS = 3, 2


def _problem(rng: np.random.Generator) -> CalibrationProblem:
    """Exact poses and shifts of the deforming telescope, and two errors that move all of them."""
    machine = Machine(telescope(), K)
    rho = readings(rng, POSES)
    reached = poses_at(KinematicModel("6-pus"), machine, rho)
    leg = np.arange(6)
    shifts = AttachmentShifts(leg, machine.delta_bz(rho), machine.legs.b[leg, 2])
    common = CommonErrors(rng.normal(0.0, 1e-4, (POSES, 18, ERRORS)))
    parameters = full_set(machine, "matrix")
    return CalibrationProblem(
        KinematicModel("6-pus"), machine, parameters, reached.p, reached.R, rho, shifts=shifts, common=common
    )


def test_derivatives_agree_with_a_complex_step() -> None:
    rng = np.random.default_rng(1)
    problem = _problem(rng)
    assert [entry.label for entry in problem.entries[-ERRORS:]] == ["common1", "common2"]
    values = problem.start + rng.normal(0.0, 1e-3, len(problem.start))
    deviation = rng.normal(0.0, 1e-3, (POSES, problem.deviations))
    assert_derivatives_exact(problem, values, deviation)
    assert_batch_is_its_members(problem, np.stack([values, problem.start]), np.stack([deviation, 2.0 * deviation]))


def test_errors_are_what_the_truth_is_off_the_measurement_the_other_way() -> None:
    problem = _problem(np.random.default_rng(2))
    assert problem.common is not None
    errors = np.array([0.7, -1.3])
    off = problem.common.effects @ errors
    found = problem.constrain(np.concatenate([problem.start[:-ERRORS], errors]), off)
    assert_close(found.value, np.zeros((POSES, 12)), atol=1e-14, what="equations, m")
    alone = replace(problem, common=None)
    expected = alone.constrain(problem.start[:-ERRORS], 0.0 * off).by_values
    assert_close(found.by_values[..., :-ERRORS], expected, atol=1e-14, what="by the machine's numbers")
