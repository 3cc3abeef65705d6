"""Design parameters of flexures are identified if the flexures bend far, and undetermined otherwise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from tests.simulation.mechanisms.flexure_telescope import flexure_telescope
from tests.simulation.mechanisms.telescope import readings
from truing.calibration.calibration_input import CalibrationData, MeasuredPlatform, PosesWithCovariance
from truing.calibration.estimation_problem import Case
from truing.calibration.fits import maximum_likelihood
from truing.calibration.flexure_observability import DesignParameter, flexure_design_parameters
from truing.estimation.rotation import exp_so3
from truing.simulation.mechanisms.structures.beam_model import BeamModel
from truing.simulation.mechanisms.structures.structure import NO_CHANGE, Machine, poses_at

_POSES = 40
_P, _THETA = 2e-6, 1e-5  # m, rad


def _data(machine: Machine, truth: Machine, tolerance: dict[str, float], travel: float = 1.0) -> CalibrationData:
    rng = np.random.default_rng(8)
    rho0 = machine.legs.rho0
    rho = rho0 + travel * (readings(rng, _POSES) - rho0)
    found = poses_at(BeamModel(), truth, rho)
    assert found.converged.all()
    noise = np.diag([_P**2] * 3 + [_THETA**2] * 3)
    covariance = np.broadcast_to(noise, (_POSES, 6, 6))
    R = exp_so3(rng.normal(0.0, _THETA, (_POSES, 3))) @ found.R
    platform = PosesWithCovariance(found.p + rng.normal(0.0, _P, (_POSES, 3)), R, covariance)
    base = PosesWithCovariance(0.0 * platform.p, np.broadcast_to(np.eye(3), R.shape), 0.0 * covariance)
    roles = np.full(_POSES, "calibration", object)
    measured = MeasuredPlatform(tuple(range(_POSES)), roles, base, platform, rho, {})
    return CalibrationData(measured, machine, tolerance, 1e-7, {}, None, "")


def _of(data: CalibrationData, model: str, name: str) -> list[DesignParameter]:
    found = flexure_design_parameters(data, data.measured)
    return [one for one in found if (one.model, one.entry.name) == (model, name)]


_TOLERANCE = {"a": 1e-4, "b": 1e-4, "u": 2e-3, "l": 1e-4, "beta": 0.1, "flexure_length": 2e-4}


def test_short_flexures_over_a_small_range_are_not_identifiable() -> None:
    machine = replace(flexure_telescope(), beta=np.full(6, 0.25))
    data = _data(machine, machine, _TOLERANCE)
    for name in ("beta", "flexure_length"):
        found = _of(data, "beam", name)
        assert len(found) == 6
        assert not any(one.identifiable for one in found)
        assert max(one.sensitivity for one in found) < 0.3e-6  # section 7.1.3 of the report: all of it at most
        assert min(one.noise for one in found) > 1e-6
    assert {one.entry.leg for one in _of(data, "stiffness", "flexure_bending")} == {-1}


def test_one_tolerance_changes_the_closure_as_much_as_stated() -> None:
    machine = replace(flexure_telescope(), beta=np.full(6, 0.25))
    data = _data(machine, machine, _TOLERANCE)
    found, step = _of(data, "beam", "beta")[2], np.where(np.arange(6) == 2, 1e-3, 0.0)
    poses, rho = data.measured.platform, data.measured.rho
    model = BeamModel()
    one, other = (
        model.close(replace(machine, beta=machine.beta + sign * step), poses.p, poses.R, rho, NO_CHANGE).value[:, 2]
        for sign in (1.0, -1.0)
    )
    expected = 0.1 * np.sqrt(np.mean(((one - other) / 2e-3) ** 2))
    assert found.sensitivity == pytest.approx(expected, rel=1e-4)


def test_beta_of_long_flexures_that_bend_far_is_recovered() -> None:
    nominal = replace(flexure_telescope(), flexure_length=np.full(6, 0.2), beta=np.full(6, 0.25))
    beta = 0.25 + np.array([0.1, -0.08, 0.12, 0.05, -0.1, 0.06])
    tolerance = {"a": 0.0, "b": 0.0, "u": 0.0, "l": 1e-4, "beta": 0.1, "flexure_length": 0.0}
    data = _data(nominal, replace(nominal, beta=beta), tolerance, travel=20.0)
    known = _of(data, "beam", "beta")
    assert all(one.identifiable for one in known)
    case = Case(BeamModel(), "none", nominal)
    fit = maximum_likelihood(data, data.measured, case, np.ones(_POSES, bool))
    own = [i for i, entry in enumerate(fit.parameters.entries) if entry.name == "beta"]
    squares = ((fit.values - beta[np.arange(len(fit.values)) % 6])[own] / fit.sigma[own]) ** 2
    low, high = (float(chi2.ppf(q, 6)) for q in (1e-3, 1 - 1e-3))
    assert low < squares.sum() < high
    assert fit.identifiable[own].all()
    ratio = fit.sigma[own] / [one.sigma * one.tolerance for one in known]
    assert np.all((ratio > 0.5) & (ratio < 2.0))  # linearised at the nominal values, where the slope is another


def test_a_parameter_without_a_declared_tolerance_is_held_in_the_calibration() -> None:
    machine = replace(flexure_telescope(), beta=np.full(6, 0.25))
    data = _data(machine, machine, {"a": 1e-4, "b": 1e-4, "u": 2e-3, "l": 1e-4})
    fit = maximum_likelihood(data, data.measured, Case(BeamModel(), "none", machine), np.ones(_POSES, bool))
    assert "beta" not in {entry.name for entry in fit.parameters.entries}
    assert _of(data, "beam", "beta")[0].tolerance == 0.25
