"""Poses of rigid legs: elastic legs whose stiffness follows the motion fit them, those of the reference do not."""

from __future__ import annotations

import numpy as np

from tests.simulation.mechanisms.flexure_telescope import TABLE_3, flexure_telescope
from tests.tolerance import assert_between
from truing.calibration.calibration_input import CalibrationData, MeasuredPlatform, PosesWithCovariance
from truing.calibration.estimation_problem import Case, problem_with_all_parameters
from truing.calibration.fits import fit_problem
from truing.estimation.rotation import exp_so3
from truing.simulation.mechanisms.legs.kinematics import forward
from truing.simulation.mechanisms.structures.stiffness_model import StiffnessModel

_P, _THETA = 3e-6, 1e-5
_TOLERANCE = {"a": 5e-4, "b": 5e-4, "u": 2e-3, "l": 5e-4}


def _misfit(share: float) -> float:
    rng, machine = np.random.default_rng(3), flexure_telescope()
    legs = machine.legs.replace(a=machine.legs.a + rng.normal(0.0, 5e-4, (6, 3)))  # the truth is off the nominal
    rho = machine.legs.rho0 + TABLE_3
    found, poses = forward(legs, rho), len(rho)
    covariance = np.broadcast_to(np.diag([_P**2] * 3 + [_THETA**2] * 3), (poses, 6, 6))
    R = exp_so3(rng.normal(0.0, _THETA, (poses, 3))) @ found.R
    platform = PosesWithCovariance(found.p + rng.normal(0.0, _P, (poses, 3)), R, covariance)
    base = PosesWithCovariance(0.0 * platform.p, np.broadcast_to(np.eye(3), R.shape), 0.0 * covariance)
    roles = np.full(poses, "calibration", object)
    measured = MeasuredPlatform(tuple(range(poses)), roles, base, platform, rho, {})
    data = CalibrationData(measured, machine, _TOLERANCE, 1e-6, {}, None, "")
    asked = problem_with_all_parameters(data, measured, Case(StiffnessModel("", share), "none", machine))
    return fit_problem(asked, robust=False).noise_ratio


def test_only_the_stiffness_along_the_motion_leaves_noise() -> None:
    assert_between(_misfit(0.5), 0.75, 1.25, what="along the motion")  # about 200 degrees of freedom
    for share in (0.0, 1.0):
        assert _misfit(share) > 2.0
