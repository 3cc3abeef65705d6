"""Errors in variables on six legs: the maximum itself, its covariance, and campaigns with bad poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.estimation.implicit_models import POSE_SIGMA, READING_SIGMA, Campaign, campaign, linear, spoiled
from tests.tolerance import assert_between, assert_close
from truing.estimation.errors_in_variables.fit import ErrorsInVariablesFit, fit_errors_in_variables
from truing.estimation.least_squares.solver import least_squares
from truing.estimation.rotation import exp_so3
from truing.simulation.mechanisms.legs.kinematics import inverse


def _fit(found: Campaign, robust: bool = True, prior: bool = True) -> ErrorsInVariablesFit:
    known = found.prior if prior else None
    return fit_errors_in_variables(found.problem.constrain, found.covariance, found.problem.start, known, robust=robust)


def _explicit(found: Campaign, unknowns: NDArray) -> NDArray:
    """Poses, the readings they ask for, and the prior, all in sigmas; unknowns: values and each pose's deviation."""
    count, problem = len(found.truth), found.problem
    values, twist = unknowns[:count], unknowns[count:].reshape(-1, 6)
    legs = problem.machine(values).legs
    rho = inverse(legs, problem.p + twist[:, :3], exp_so3(twist[:, 3:]) @ problem.R)
    off = np.linalg.solve(np.linalg.cholesky(found.covariance[:, :6, :6]), twist[..., None])
    away = np.sqrt(np.diag(found.prior.information)) * (values - found.prior.mean)
    return np.concatenate([off.ravel(), (rho - problem.rho).ravel() / READING_SIGMA, away])


def test_elimination_reaches_the_maximum_over_values_and_poses_together() -> None:
    from scipy.optimize import least_squares

    found = campaign(np.random.default_rng(1), 7)
    fit = _fit(found, robust=False)
    sigma = np.concatenate([np.diag(found.prior.information) ** -0.5, np.tile(POSE_SIGMA, 7)])
    centre = np.concatenate([found.prior.mean, np.zeros(42)])
    expected = least_squares(lambda x: _explicit(found, centre + x * sigma), np.zeros(84), "3-point", xtol=1e-12)
    assert fit.ok
    assert_close(fit.cost, 2 * expected.cost, atol=1e-8 * fit.cost)
    assert_close((fit.values - found.prior.mean) / sigma[:42], expected.x[:42], atol=1e-4)
    assert_close(fit.deviations[:, :6] / POSE_SIGMA, expected.x[42:].reshape(-1, 6), atol=1e-4)


def test_readings_without_an_error_stay_and_equations_close() -> None:
    found = campaign(np.random.default_rng(2), 20, reading_sigma=0.0)
    fit = _fit(found)
    assert fit.ok
    assert_close(fit.deviations[:, 6:], np.zeros((20, 6)), atol=0)
    assert_close(found.problem.constrain(fit.values, fit.deviations).value, np.zeros((20, 6)), atol=1e-14)
    # a hundred-thousandth of the poses' noise does what none does, to second order
    almost = replace(found, covariance=found.covariance + 2e-11**2 * np.diag([0.0] * 6 + [1.0] * 6))
    assert_close(_fit(almost).cost, fit.cost, atol=1e-6 * fit.cost)


def test_a_direction_in_which_poses_are_exact_stays() -> None:
    found = campaign(np.random.default_rng(3), 20)
    C = found.covariance.copy()
    C[:, 2], C[:, :, 2] = 0.0, 0.0
    fit = _fit(replace(found, covariance=C), robust=False)
    assert fit.ok
    assert_close(fit.deviations[:, 2], np.zeros(20), atol=0)


def test_the_stated_covariance_is_that_of_the_errors_and_chi_squares_have_their_freedom() -> None:
    rng = np.random.default_rng(4)
    draws, distance, surprise, ratio = 60, [], [], []
    for _ in range(draws):
        found = campaign(rng, 12)
        fit = _fit(found, robust=False)
        error = fit.values - found.truth
        distance.append(error @ np.linalg.solve(fit.covariance, error))
        surprise.append(fit.leave_one_out.surprise.mean())
        ratio.append(fit.leave_one_out.chi_square / fit.leave_one_out.freedom)
        assert_close(fit.leave_one_out.freedom, 72 - np.trace(fit.information @ fit.covariance), atol=1e-6)
    assert_between(np.mean(distance), 42 - 4 * np.sqrt(84 / draws), 42 + 4 * np.sqrt(84 / draws))
    # poses of a campaign are not independent of each other: twelve count as six
    assert_between(np.mean(surprise), 6 - 4 * np.sqrt(12 / draws / 6), 6 + 4 * np.sqrt(12 / draws / 6))
    freedom = fit.leave_one_out.freedom
    assert_between(np.mean(ratio), 1 - 4 * np.sqrt(2 / freedom / draws), 1 + 4 * np.sqrt(2 / freedom / draws))


def _implicit(found: Campaign) -> NDArray:
    """Values (P,) by least squares of the equations at what was measured, all of one common noise, and the prior."""
    problem, sigma = found.problem, np.diag(found.prior.information) ** -0.5
    nowhere = np.zeros((len(problem.p), 12))
    A = problem.constrain(problem.start, nowhere).by_deviation
    noise = np.sqrt(np.einsum("bmi,bij,bmj->", A, found.covariance, A) / A[..., 0].size)

    def residuals(x: NDArray) -> tuple[NDArray, NDArray]:
        equations = problem.constrain(problem.start + sigma * x[0], nowhere)
        rows = (equations.by_values * sigma / noise).reshape(-1, len(sigma))
        value = np.concatenate([equations.value.ravel() / noise, x[0]])
        return value[None], np.concatenate([rows, np.eye(len(sigma))])[None]

    return problem.start + sigma * least_squares(residuals, np.zeros(len(sigma))).x[0]


@pytest.mark.slow
def test_equations_that_do_not_know_whose_error_it_is_lose_where_poses_are_not_equally_good() -> None:
    rng, draws = np.random.default_rng(10), 20
    errors = np.empty((2, draws))
    for k in range(draws):
        found = campaign(rng, 20, scatter=1.0)
        fit = _fit(found, robust=False)
        for row, values in enumerate((_implicit(found), fit.values)):
            error = values - found.truth
            errors[row, k] = error @ np.linalg.solve(fit.covariance, error)
    plain, own = errors.mean(1)
    assert_between(own, 42 - 4 * np.sqrt(84 / draws), 42 + 4 * np.sqrt(84 / draws))
    # noise that differs by e, one sigma, between poses: some errors are several times as large as they need be
    assert plain > 4 * own


@pytest.mark.parametrize(("share", "sigmas"), [(0.1, 20), (0.2, 20), (0.2, 1000)])
def test_bad_poses_are_left_out_and_the_rest_fits_as_if_they_had_never_been(share: float, sigmas: float) -> None:
    rng = np.random.default_rng(5)
    clean = campaign(rng, 30)
    bad = rng.permutation(30)[: round(share * 30)]
    good = ~np.isin(np.arange(30), bad)
    fit, expected = _fit(spoiled(clean, rng, bad, sigmas)), _fit(clean.only(good), robust=False)
    assert fit.ok
    assert_close(fit.weight, good, atol=0)
    assert np.all(fit.leave_one_out.p_value[bad] < 1e-4)
    sigma = np.sqrt(np.diag(expected.covariance))
    assert_close((fit.values - expected.values) / sigma, np.zeros(42), atol=1e-4)


@pytest.mark.parametrize("seed", [47, 48, 49])
def test_a_fifth_of_the_poses_in_the_same_wrong_place_are_no_majority(seed: int) -> None:
    rng = np.random.default_rng(seed)
    clean = campaign(rng, 40)
    bad = rng.permutation(40)[:8]
    p = clean.problem.p.copy()
    p[bad] += 2e-3 * rng.normal(size=3)
    fit = _fit(replace(clean, problem=replace(clean.problem, p=p)))
    assert fit.ok
    assert_close(fit.weight, ~np.isin(np.arange(40), bad), atol=0)


@pytest.mark.parametrize("noise", [0.2, 1.0, 5.0])
def test_clean_campaigns_lose_no_pose_whatever_the_noise(noise: float) -> None:
    rng, campaigns = np.random.default_rng(6), 150
    lost = 0
    for _ in range(campaigns):
        problem = linear(rng, poses=15, noise=noise)
        fit = fit_errors_in_variables(problem.constrain, problem.covariance, np.zeros(4))
        lost += np.any(fit.weight == 0)
    # at 1 % a campaign, 7 of 150 have a chance of 1 in 1000
    assert lost <= 6


@pytest.mark.slow
def test_the_minimum_at_the_end_of_a_bent_valley_is_found_from_either_side() -> None:
    # without tolerances u_y is hardly determined, and steps of Gauss and Newton cycle
    found = campaign(np.random.default_rng(7), 20)
    fit = _fit(found, robust=False, prior=False)
    other = fit_errors_in_variables(found.problem.constrain, found.covariance, found.truth, robust=False)
    assert fit.ok
    assert other.ok
    assert_close(fit.cost, other.cost, atol=1e-6 * fit.cost)


def test_a_wrong_derivative_does_not_pass_for_a_minimum() -> None:
    found = campaign(np.random.default_rng(8), 12)

    def wrong(values: NDArray, deviation: NDArray) -> object:
        equations = found.problem.constrain(values, deviation)
        return replace(equations, by_values=-equations.by_values)

    fit = fit_errors_in_variables(wrong, found.covariance, found.problem.start, found.prior, robust=False)
    assert not fit.ok
    assert fit.status.remedy
