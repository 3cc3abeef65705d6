"""Leg-by-leg calibrations of many draws: recovery, noise, compiled against plain code, and number of minima."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.simulation.mechanisms.telescope import KAPPA, K, readings, telescope
from tests.tolerance import assert_between, assert_close
from truing.estimation.least_squares.solver import Method, SolverStatus
from truing.simulation.mechanisms import recalibration
from truing.simulation.mechanisms.parameters import LegParameter, ParameterSet, deformation_set, report_set
from truing.simulation.mechanisms.recalibration import (
    LegDraws,
    calibrate_leg,
    calibrate_leg_compiled,
    calibrate_leg_plain,
    leg_draws,
    leg_residuals,
    minima_from,
    nominal_values,
    recalibrate,
)
from truing.simulation.mechanisms.structures.kinematic_model import KinematicModel
from truing.simulation.mechanisms.structures.structure import Machine, poses_at

METHODS: tuple[Method, ...] = ("levenberg-marquardt", "trust-region")
POSES, NOISE_M = 40, 2e-6
LINEAR = KAPPA * np.eye(6)
Draws = tuple[NDArray, NDArray, NDArray]


def built(rng: np.random.Generator, deformation: NDArray, kind: str = "6-pus") -> Machine:
    """A machine that differs from the nominal one by its tolerances."""
    legs = telescope(kind)
    moved = {name: getattr(legs, name) for name in ("a", "b", "l")}
    moved = {name: array + 5e-4 * rng.normal(size=array.shape) for name, array in moved.items()}
    return Machine(legs.replace(**moved), deformation)


def campaign(rng: np.random.Generator, machine: Machine, draws: int, noise_m: float = NOISE_M) -> Draws:
    """Poses (D, N, 3), (D, N, 3, 3) and readings (1, N, L), noise on the positions alone."""
    rho = readings(rng, POSES)
    reached = poses_at(KinematicModel(machine.legs.closure.name), machine, rho)
    assert reached.converged.all()
    return reached.p + noise_m * rng.normal(size=(draws, POSES, 3)), reached.R[None], rho[None]


def nominal(deformation: NDArray, kind: str = "6-pus") -> Machine:
    return Machine(telescope(kind), deformation)


def with_u_y(parameters: ParameterSet) -> ParameterSet:
    return ParameterSet((*parameters.entries, *(LegParameter("u_y", leg, "1", 1.0) for leg in range(6))))


def starts_of(leg: LegDraws, count: int) -> NDArray:
    values = leg.parameters.values(leg.machine)[0]
    return np.broadcast_to(values, (count, values.shape[-1]))


@given(seed=st.integers(0, 1000))
def test_derivatives_are_exact_for_every_number_of_a_leg(seed: int) -> None:
    rng = np.random.default_rng(seed)
    names = ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "u_x", "u_y", "l", "kappa", "rho0")
    parameters = ParameterSet(tuple(LegParameter(name, leg, "", 1.0) for name in names for leg in range(6)))
    p, R, rho = campaign(rng, built(rng, K), 1)
    leg = leg_draws(nominal(K), parameters, int(rng.integers(6)), p, R, rho)
    x = starts_of(leg, 1) + 1e-3 * rng.normal(size=len(names))
    _, jacobian = leg_residuals(leg)(x, leg.p, leg.R, leg.rho)
    step = 1e-30
    shifted, _ = leg_residuals(leg)(x + 1j * step * np.eye(len(names)), leg.p, leg.R, leg.rho)
    assert_close(jacobian[0], shifted.imag.T / step, atol=1e-13)


@pytest.mark.parametrize(("kind", "deformation"), [("6-pus", "matrix"), ("6-pus", "none"), ("ups", "linear")])
def test_without_noise_the_machine_is_recovered_exactly(kind: str, deformation: str) -> None:
    rng = np.random.default_rng(5)
    K_true = {"matrix": K, "none": np.zeros((6, 6)), "linear": LINEAR}[deformation]
    truth = built(rng, K_true, kind)
    p, R, rho = campaign(rng, truth, 2, noise_m=0.0)
    parameters = report_set(nominal(K_true, kind), deformation)
    start = nominal_values(nominal(K_true, kind), parameters)
    found = recalibrate(nominal(K_true, kind), parameters, p, R, rho)
    assert found.ok.all()
    assert_close(found.values[0], found.values[1], atol=0.0)
    # a_z and b_z, which no pose shows apart from l, stay nominal: what they would do goes to the other parameters
    assert np.sqrt(found.cost / POSES).max() < 0.02 * 5e-4
    level = replace(truth, legs=truth.legs.replace(a=_level(truth.legs.a), b=_level(truth.legs.b)))
    p, R, rho = campaign(rng, level, 1, noise_m=0.0)
    found = recalibrate(nominal(K_true, kind), parameters, p, R, rho)
    assert_close(found.values[0], nominal_values(level, parameters), atol=1e-9)
    assert np.abs(found.values[0] - start).max() > 1e-4


def _level(points: NDArray) -> NDArray:
    return points * [1.0, 1.0, 0.0]


def test_the_scatter_of_many_draws_is_the_covariance() -> None:
    rng = np.random.default_rng(6)
    machine = replace(nominal(LINEAR), deformation=LINEAR)
    p, R, rho = campaign(rng, machine, 500)
    found = recalibrate(machine, report_set(machine, "linear"), p, R, rho)
    assert found.ok.all()
    off = found.values - nominal_values(machine, report_set(machine, "linear"))
    # noise of a position moves a leg's residual by its part along the leg, which has the same deviation
    whitened = np.einsum("dlp,dlpq,dlq->dl", off, np.linalg.inv(found.covariance), off) / NOISE_M**2
    assert_between(whitened.mean() / 6.0, 1.0 - 5.0 * np.sqrt(2.0 / (6 * 500)), 1.0 + 5.0 * np.sqrt(2.0 / (6 * 500)))
    assert_between((found.cost / NOISE_M**2).mean() / (POSES - 6), 0.98, 1.02)


@pytest.mark.parametrize("deformation", ["none", "linear", "matrix"])
def test_compiled_and_plain_reach_the_same_minimum(deformation: str) -> None:
    rng = np.random.default_rng(7)
    K_true = {"matrix": K, "none": np.zeros((6, 6)), "linear": LINEAR}[deformation]
    p, R, rho = campaign(rng, built(rng, K_true), 37)
    for i in range(6):
        leg = leg_draws(nominal(K_true), report_set(nominal(K_true), deformation), i, p, R, rho)
        start = starts_of(leg, 37)
        compiled, plain = calibrate_leg_compiled(leg, start), calibrate_leg_plain(leg, start, np.arange(37))
        assert compiled.ok.all()
        assert plain.ok.all()
        assert_close(compiled.cost, plain.cost, atol=1e-8 * plain.cost.max())
        spread = np.sqrt(np.diagonal(plain.covariance, axis1=1, axis2=2)) * NOISE_M
        assert_close(compiled.x / spread, plain.x / spread, atol=1e-3)
        alike = np.sqrt(np.diagonal(compiled.covariance, axis1=1, axis2=2)) * NOISE_M
        # where u_x is all but open the minimum is a long flat one, and curvature changes along it
        assert_close(alike / spread, np.ones_like(spread), atol=1e-6 if deformation != "none" else 1e-2)


def test_draws_that_compiled_code_cannot_prove_are_solved_by_qr() -> None:
    rng = np.random.default_rng(8)
    p, R, rho = campaign(rng, built(rng, LINEAR), 20)
    parameters = ParameterSet(
        tuple(LegParameter(name, i, "mm", 1e-3) for name in ("l", "b_x", "rho0") for i in range(6))
    )
    leg = leg_draws(nominal(np.zeros((6, 6))), parameters, 0, p, R, rho)  # without kappa nothing depends on rho0
    found = calibrate_leg_compiled(leg, starts_of(leg, 20))
    assert np.all(found.status == SolverStatus.RANK_DEFICIENT)
    assert np.all(found.rank == 2)
    assert np.isnan(found.covariance[:, 2]).all()


def test_many_draws_run_compiled_and_threads_do_not_matter() -> None:
    rng = np.random.default_rng(9)
    p, R, rho = campaign(rng, built(rng, LINEAR), 1100)
    leg = leg_draws(nominal(LINEAR), report_set(nominal(LINEAR), "linear"), 2, p, R, rho)
    start = starts_of(leg, 1100)
    one, two, chosen = (
        calibrate_leg_compiled(leg, start, 1),
        calibrate_leg_compiled(leg, start, 2),
        calibrate_leg(leg, start),
    )
    assert np.array_equal(one.x, two.x)
    assert np.array_equal(one.x, chosen.x)
    assert np.array_equal(one.covariance, two.covariance)


def test_results_are_independent_of_batch_size(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(10)
    p, R, rho = campaign(rng, built(rng, LINEAR), 9)
    found = recalibrate(nominal(LINEAR), report_set(nominal(LINEAR), "linear"), p, R, rho)
    monkeypatch.setattr(recalibration, "_DRAWS_AT_ONCE", 2)
    again = recalibrate(nominal(LINEAR), report_set(nominal(LINEAR), "linear"), p, R, rho)
    assert_close(again.values, found.values, atol=1e-13)


def plain_gauss_newton(leg: LegDraws, x: NDArray, steps: int = 200) -> NDArray:
    """Sums of squares (steps,) along undamped steps."""
    costs = []
    for _ in range(steps):
        residual, jacobian = leg_residuals(leg)(x, leg.p, leg.R, leg.rho)
        costs.append(np.sum(residual**2))
        size = np.linalg.norm(jacobian[0], axis=0)
        x = x - np.linalg.lstsq(jacobian[0] / size, residual[0])[0] / size
    return np.array(costs)


def test_with_u_y_plain_gauss_newton_cycles_and_the_damped_solver_converges() -> None:
    rng = np.random.default_rng(1)
    p, R, rho = campaign(rng, built(rng, K), 1)
    machine, parameters = nominal(np.zeros((6, 6))), with_u_y(report_set(nominal(K), "none"))
    cycling = 0
    for i in range(6):
        leg = leg_draws(machine, parameters, i, p, R, rho)
        fits = [calibrate_leg_plain(leg, starts_of(leg, 1), np.arange(1), method) for method in METHODS]
        assert all(fit.ok.all() for fit in fits)
        assert_close(fits[0].cost, fits[1].cost, atol=1e-6 * fits[1].cost[0])
        costs = plain_gauss_newton(leg, starts_of(leg, 1))
        cycling += abs(costs[-1] / costs[-3] - 1.0) < 1e-6 < abs(costs[-1] / costs[-2] - 1.0)
        assert costs[-1] > 0.999999 * fits[1].cost[0]
    assert cycling >= 2  # three here; which ones is a matter of rounding


@pytest.mark.parametrize("deformation", ["linear", "matrix"])
def test_both_methods_agree_from_starts_a_hundred_tolerances_away(deformation: str) -> None:
    rng = np.random.default_rng(11)
    p, R, rho = (array[0] for array in campaign(rng, built(rng, K), 1))
    machine = nominal({"linear": LINEAR, "matrix": K}[deformation])
    parameters = report_set(machine, deformation)
    start = nominal_values(machine, parameters) + 0.05 * rng.uniform(-1.0, 1.0, (20, 6, 6))
    damped, inside = (minima_from(machine, parameters, p, R, rho, start, method) for method in METHODS)
    for one, other in zip(damped, inside, strict=True):
        assert one.is_unique
        assert other.is_unique
        assert_close(one.cost, other.cost, atol=1e-9 * one.cost[0])


def test_an_actuator_direction_that_swallows_the_deformation_has_two_minima() -> None:
    """The leg sees u_x z_x + u_z z_z, a circle's arc: two directions give nearly the same (eq. 39 and 40)."""
    rng = np.random.default_rng(12)
    p, R, rho = (array[0] for array in campaign(rng, built(rng, K), 1))
    machine = nominal(np.zeros((6, 6)))
    parameters = report_set(machine, "none")
    u_x = [entry.name for entry in parameters.entries if entry.leg == 0].index("u_x")
    start = np.repeat(nominal_values(machine, parameters)[None], 40, 0)
    start[..., u_x] = np.linspace(-0.6, 0.6, 40)[:, None]
    found = minima_from(machine, parameters, p, R, rho, start)
    slope = np.array([0.216, -0.216, -0.042, 0.174, -0.174, 0.042])  # z_x / z_z at the reference
    for minima, ratio in zip(found, slope, strict=True):
        directions = minima.x[:2, u_x]
        assert len(minima.x) == 2
        # the two roots of u_x z_x / z_z + sqrt(1 - u_x^2) = constant lie symmetric about the slope
        assert_close(directions.mean(), ratio, atol=0.05)


def _one_pose(machine: Machine) -> Draws:
    rho = readings(np.random.default_rng(0), 8)
    reached = poses_at(KinematicModel("6-pus"), machine, rho)
    return reached.p[None], reached.R[None], rho[None]


def test_parameters_that_are_not_a_legs_own_are_refused() -> None:
    machine = nominal(K)
    with pytest.raises(ValueError, match="found K11, K12"):
        recalibrate(machine, deformation_set(machine, "matrix"), *_one_pose(machine))
    with pytest.raises(ValueError, match=r"found \[1, 0, 0, 0, 0, 0\] per leg"):
        recalibrate(machine, ParameterSet((LegParameter("l", 0, "mm", 1e-3),)), *_one_pose(machine))
    with pytest.raises(ValueError, match="largest component"):
        recalibrate(
            machine, ParameterSet(tuple(LegParameter("u_z", leg, "1", 1.0) for leg in range(6))), *_one_pose(machine)
        )
