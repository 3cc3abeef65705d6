"""Loads on the platform at each pose: the stiffness model includes them; calibrations without them misfit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.simulation.mechanisms.flexure_telescope import flexure_telescope
from tests.simulation.mechanisms.telescope import readings
from tests.tolerance import assert_close
from truing.calibration.accuracy import machine_errors
from truing.calibration.calibration_input import CalibrationData, MeasuredPlatform, PosesWithCovariance, under_load
from truing.calibration.estimation_problem import Case, problem_with_all_parameters
from truing.calibration.fits import fit_problem
from truing.estimation.rotation import exp_so3
from truing.simulation.mechanisms.structures.stiffness_model import StiffnessModel, compliance
from truing.simulation.mechanisms.structures.structure import poses_at
from truing.simulation.mechanisms.weight import GRAVITY, Weight, weight_wrench

_POSES, _P, _THETA = 40, 1e-6, 5e-6
_MODEL = StiffnessModel()
_LOAD = np.random.default_rng(2).normal(size=(_POSES, 6)) * [1500.0, 1500.0, 3000.0, 100.0, 100.0, 50.0]


def _data(load: np.ndarray | None) -> CalibrationData:
    """Poses of a machine under these loads, measured with noise; ``load`` is what the calibration knows of them."""
    rng, machine = np.random.default_rng(3), flexure_telescope()
    rho = readings(rng, _POSES)
    found = poses_at(_MODEL, replace(machine, load=_LOAD), rho)
    assert found.converged.all()
    covariance = np.broadcast_to(np.diag([_P**2] * 3 + [_THETA**2] * 3), (_POSES, 6, 6))
    R = exp_so3(rng.normal(0.0, _THETA, (_POSES, 3))) @ found.R
    platform = PosesWithCovariance(found.p + rng.normal(0.0, _P, (_POSES, 3)), R, covariance)
    base = PosesWithCovariance(0.0 * platform.p, np.broadcast_to(np.eye(3), R.shape), 0.0 * covariance)
    roles = np.full(_POSES, "calibration", object)
    measured = MeasuredPlatform(tuple(range(_POSES)), roles, base, platform, rho, {}, load=load)
    tolerance = {"a": 1e-4, "b": 1e-4, "u": 1e-3, "l": 1e-4}
    return CalibrationData(measured, machine, tolerance, 1e-7, {}, None, "")


def test_each_pose_has_the_equilibrium_of_its_own_load() -> None:
    machine, rho = flexure_telescope(), readings(np.random.default_rng(5), 4)
    together = poses_at(_MODEL, replace(machine, load=_LOAD[:4]), rho)
    for n in range(4):
        alone = poses_at(_MODEL, replace(machine, load=_LOAD[n]), rho[n : n + 1])
        assert_close(together.p[n], alone.p[0], atol=1e-13)
        assert_close(together.R[n], alone.R[0], atol=1e-13)


def test_a_small_load_moves_the_platform_by_its_compliance() -> None:
    machine, rho = flexure_telescope(), readings(np.random.default_rng(6), 3)
    free, load = poses_at(_MODEL, machine, rho), 1e-3 * _LOAD[:3]
    held = poses_at(_MODEL, replace(machine, load=load), rho)
    expected = np.einsum("bij,bj->bi", compliance(machine, free.p, free.R, rho), load)[:, :3]
    assert_close(held.p - free.p, expected, atol=1e-3 * np.abs(expected).max())


@pytest.mark.slow
def test_known_loads_leave_noise_and_unknown_ones_do_not() -> None:
    case = Case(_MODEL, "none", flexure_telescope())
    ratio = {}
    for name, load in (("known", _LOAD), ("unknown", None)):
        data = _data(load)
        ratio[name] = fit_problem(problem_with_all_parameters(data, data.measured, case), robust=False).noise_ratio
    assert 0.75 < ratio["known"] < 1.25  # about 200 degrees of freedom: within five standard deviations
    assert ratio["unknown"] > 3.0


def test_poses_chosen_keep_their_own_loads() -> None:
    measured = _data(_LOAD).measured
    rows = np.arange(_POSES) % 3 == 0
    assert_close(under_load(flexure_telescope(), measured.subset(rows)).load, _LOAD[rows], atol=0.0)
    errors = machine_errors(_MODEL, flexure_telescope(), measured, 0.0)
    assert np.sqrt(np.mean(errors.error[:, :3] ** 2)) < 1.5 * _P


def test_a_weight_pulls_down_at_its_centre() -> None:
    R = exp_so3(np.array([[0.0, 0.0, np.pi / 2]]))
    found = weight_wrench(Weight((0.0, 0.0, 1.0), None, (0.1, 0.0, 0.3)), R, np.array([2.0]))
    assert_close(found, 2.0 * GRAVITY * np.array([[0.0, 0.0, -1.0, -0.1, 0.0, 0.0]]), atol=1e-12)
