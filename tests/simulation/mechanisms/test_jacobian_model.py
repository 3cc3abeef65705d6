"""The linear model: reference values, what linearity costs, and exact derivatives through the reference pose."""

from __future__ import annotations

import numpy as np
import pytest

from tests.simulation.mechanisms.telescope import KAPPA, REFERENCE, K, readings, telescope, vector
from tests.tolerance import assert_between, assert_close
from truing.estimation.rotation import exp_so3, log_so3
from truing.simulation.mechanisms.calibration_problem import CalibrationProblem
from truing.simulation.mechanisms.legs.closures import Legs
from truing.simulation.mechanisms.legs.kinematics import forward
from truing.simulation.mechanisms.parameters import full_set, report_set
from truing.simulation.mechanisms.structures.catalogue import departure
from truing.simulation.mechanisms.structures.kinematic_model import JacobianModel
from truing.simulation.mechanisms.structures.structure import NO_CHANGE, Machine, poses_at, readings_at

MODEL = JacobianModel()


def _rigid(legs: Legs | None = None) -> Machine:
    return Machine(legs or telescope(), np.zeros((6, 6)))


def _turned_legs(rng: np.random.Generator) -> tuple[Legs, np.ndarray]:
    """The telescope seen from another base frame, with its platform frame turned by yet another rotation."""
    base, platform = exp_so3(rng.normal(0.0, 0.5, (2, 3)))
    legs = telescope()
    return legs.replace(a=legs.a @ base.T, u=legs.u @ base.T, b=legs.b @ platform), base


def test_readings_are_those_of_the_reference() -> None:
    inputs, outputs = vector("eq9")
    p, R = np.array(inputs["p_mm"])[None] * 1e-3, exp_so3(np.array(inputs["rotvec_rad"]))[None]
    found = readings_at(MODEL, _rigid(), p, R)
    assert found.converged.all()
    assert_close(found.rho[0] * 1e3, outputs["rho_mm"], atol=1e-9 * 10.0, what="rho, mm")


def test_closing_is_that_of_the_reference() -> None:
    inputs, outputs = vector("eq31")
    rho = telescope().rho0[None] + np.array(inputs["drho_mm"]) * 1e-3
    p, R = np.array(inputs["p_mm"])[None] * 1e-3, np.array(inputs["R"])[None]
    found = MODEL.close(_rigid(), p, R, rho, NO_CHANGE).value[0] * 1e3
    assert_close(found, outputs["f_mm"], atol=1e-9 * 1.3, what="f, mm")


def test_linearity_costs_what_the_reference_says_over_the_report_s_configurations() -> None:
    rho = telescope().rho0 + 1.3e-3 * np.array(REFERENCE["configurations"])
    error_um = departure(JacobianModel(), _rigid(), rho) * 1e6
    assert_between(np.sqrt(np.mean(error_um**2)), 29.55, 29.65, what="rms, um")
    assert_between(np.abs(error_um).max(), 83.5, 84.5, what="maximum, um")


def test_what_linearity_costs_grows_with_the_square_of_the_reach() -> None:
    moves = readings(np.random.default_rng(0), 20) - telescope().rho0
    near, far = (departure(JacobianModel(), _rigid(), telescope().rho0 + reach * moves) for reach in (1e-3, 2e-3))
    assert_between(np.sqrt(np.sum(far**2) / np.sum(near**2)), 3.999, 4.001, what="ratio")


def test_a_linear_deformation_scales_the_readings_of_actuators_along_z() -> None:
    rho = readings(np.random.default_rng(1), 5)
    reached = forward(telescope(), rho)
    rigid = MODEL.close(_rigid(), reached.p, reached.R, rho, NO_CHANGE)
    bent = MODEL.close(Machine(telescope(), KAPPA * np.eye(6)), reached.p, reached.R, rho, NO_CHANGE)
    assert_close(bent.value, rigid.value - KAPPA * (rho - telescope().rho0), atol=1e-15, what="f, m")


def test_any_frames_give_the_same_closing() -> None:
    legs, base = _turned_legs(np.random.default_rng(2))
    rho = readings(np.random.default_rng(3), 4)
    straight = MODEL.close(_rigid(), *_at(telescope(), rho), rho, NO_CHANGE).value
    p, R = _at(telescope(), rho)
    reference = _at(legs, legs.rho0[None])[1]
    assert np.abs(log_so3(reference[0])).max() > 0.1, "the reference pose is turned"
    level = _at(telescope(), telescope().rho0[None])[1]
    turned = MODEL.close(
        _rigid(legs), p @ base.T, base @ R @ level.swapaxes(1, 2) @ base.T @ reference, rho, NO_CHANGE
    ).value
    assert_close(turned, straight, atol=1e-14, what="f, m")


def _at(legs: Legs, rho: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    reached = forward(legs, rho)
    assert reached.converged.all()
    return reached.p, reached.R


@pytest.mark.parametrize("kind", ["6-pus", "ups"])
def test_derivatives_agree_with_a_complex_step_through_the_forward_kinematics(kind: str) -> None:
    machine, step = Machine(telescope(kind), K), 1e-30
    rho = readings(np.random.default_rng(4), 3)
    p, R = _at(machine.legs, rho)
    everything = full_set(machine, "matrix", rho0=True)
    start = everything.values(machine) + np.random.default_rng(5).normal(0.0, 1e-4, len(everything))
    moved = everything.machine(machine, start)
    closing = MODEL.close(moved, p, R, rho, everything.change(moved))
    for j, label in enumerate(everything.labels):
        there = everything.machine(machine, start + 1j * step * np.eye(len(start))[j])
        expected = MODEL.close(there, p, R, rho, NO_CHANGE).value.imag / step
        assert_close(closing.by_parameter[..., j], expected, atol=1e-11, what=label)
    for j in range(6):
        nudge = 1j * step * np.eye(6)[j]
        shifted = MODEL.close(moved, p + nudge[:3], exp_so3(nudge[3:]) @ R, rho, NO_CHANGE).value.imag / step
        assert_close(closing.by_twist[..., j], shifted, atol=1e-12, what=f"twist {j}")
        driven = MODEL.close(moved, p, R, rho + nudge, NO_CHANGE).value.imag / step
        assert_close(closing.by_rho[..., j], driven, atol=1e-12, what=f"reading {j}")


def test_poses_and_readings_undo_each_other() -> None:
    machine = Machine(telescope(), K)
    rho = readings(np.random.default_rng(6), 5)
    reached = poses_at(MODEL, machine, rho)
    found = readings_at(MODEL, machine, reached.p, reached.R)
    assert reached.converged.all()
    assert_close(found.rho, rho, atol=1e-14, what="readings, m")


def test_fewer_than_six_legs_have_no_home() -> None:
    legs = telescope("ups")
    three = legs.replace(**{name: getattr(legs, name)[:3] for name in ("a", "b", "u", "l", "rho0")})
    assert MODEL.fits(_rigid())
    assert not MODEL.fits(Machine(three, np.zeros((3, 3))))


def test_a_machine_without_a_home_has_no_closing_and_leaves_the_others_alone() -> None:
    """A solver's trial may leave the sphere of directions, or tear the legs apart: NaN, without error or warning."""
    rng = np.random.default_rng(7)
    machine, rho = _rigid(), readings(rng, 3)
    problem = CalibrationProblem(MODEL, machine, report_set(machine, "none"), *_at(machine.legs, rho), rho)
    values = np.stack([problem.start] * 3)
    values[0, problem.parameters.labels.index("u_x2")] = 1.2
    values[1, [problem.parameters.labels.index(f"l{leg}") for leg in (1, 3, 5)]] = 0.05
    found = problem.constrain(values, np.zeros((3, 3, 12)))
    assert not np.isfinite(found.value[0]).all()
    assert not np.isfinite(found.value[1]).all()
    alone = problem.constrain(problem.start, np.zeros((3, 12)))
    assert_close(found.value[2], alone.value, atol=1e-15, what="f, m")
    assert_close(found.by_values[2], alone.by_values, atol=1e-13, what="derivatives")
