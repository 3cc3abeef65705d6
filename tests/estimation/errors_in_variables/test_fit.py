"""Errors in variables: published and independent results, laws of the estimate, and its covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from numpy.typing import NDArray

from tests.estimation.implicit_models import Circle, Equations, Line, linear
from tests.estimation.scatter import seeds
from tests.tolerance import assert_between, assert_close
from truing.estimation.errors_in_variables.fit import ErrorsInVariablesFit, Prior, fit_errors_in_variables
from truing.estimation.least_squares.solver import SolverStatus

SETTLED = 1e-5  # sigmas of the values by which a fit may stop short

# Pearson (1901) with the weights of York (1966)
PEARSON_X = np.array([0.0, 0.9, 1.8, 2.6, 3.3, 4.4, 5.2, 6.1, 6.5, 7.4])
PEARSON_Y = np.array([5.9, 5.4, 4.4, 4.6, 3.5, 3.7, 2.8, 2.8, 2.4, 1.5])
WEIGHTS = np.array([[1000, 1], [1000, 1.8], [500, 4], [800, 8], [200, 20], [80, 20], [60, 70], [20, 70], [1.8, 100]])
YORK = np.vstack([WEIGHTS, [1, 500]])


@pytest.mark.parametrize("start", [[0.0, 0.0], [5.0, -0.5], [20.0, 3.0]])
def test_york_line_through_the_points_of_pearson(start: list[float]) -> None:
    line = Line(np.stack([PEARSON_X, PEARSON_Y], 1))
    fit = fit_errors_in_variables(line.constrain, np.eye(2) / YORK[:, None], start)
    assert fit.ok
    # York et al., Am. J. Phys. 72 (2004) 367
    assert_close(fit.values, [5.47991022, -0.480533407], atol=SETTLED * np.sqrt(fit.covariance[0, 0]))
    assert_close(fit.cost / 8, 1.4833, atol=5e-5)
    assert_close(line.constrain(fit.values, fit.deviations).value, np.zeros((10, 1)), atol=1e-12)


def test_a_circle_is_the_one_of_least_orthogonal_distances() -> None:
    from scipy.optimize import least_squares

    rng = np.random.default_rng(2)
    angle = rng.uniform(0.0, 2.0, 25)
    points = np.stack([np.cos(angle), np.sin(angle)], 1) + 0.03 * rng.normal(size=(25, 2))
    expected = least_squares(lambda v: np.hypot(*(points - v[:2]).T) - v[2], [0.0, 0.0, 1.0], xtol=1e-15, gtol=1e-15)
    fit = fit_errors_in_variables(Circle(points).constrain, np.tile(9e-4 * np.eye(2), (25, 1, 1)), [0.3, -0.3, 2.0])
    assert fit.ok
    assert_close(fit.values, expected.x, atol=2 * SETTLED * np.sqrt(np.diag(fit.covariance).max()))
    assert_close(fit.cost, 2 * expected.cost / 9e-4, atol=1e-7)


@given(seeds)
def test_a_linear_model_gives_weighted_least_squares(seed: int) -> None:
    problem = linear(np.random.default_rng(seed))
    fit = fit_errors_in_variables(problem.constrain, problem.covariance, np.zeros(4), problem.prior, robust=False)
    H, right = problem.normal()
    sigma = np.sqrt(np.diag(np.linalg.inv(H)))
    assert_close((fit.values - np.linalg.solve(H, right)) / sigma, np.zeros(4), atol=SETTLED)
    assert_close(fit.covariance / np.outer(sigma, sigma), np.linalg.inv(H) / np.outer(sigma, sigma), atol=1e-9)
    assert_close(fit.information, H - problem.prior.information, atol=1e-9 * np.abs(H).max())


@given(seeds)
def test_the_misfit_of_a_pose_is_the_decrease_of_the_cost_without_it(seed: int) -> None:
    problem = linear(np.random.default_rng(seed))
    whole = fit_errors_in_variables(problem.constrain, problem.covariance, np.zeros(4), problem.prior, robust=False)
    part = problem.only(np.arange(9) != 4)
    rest = fit_errors_in_variables(part.constrain, part.covariance, np.zeros(4), part.prior, robust=False)
    assert_close(whole.leave_one_out.surprise[4], whole.cost - rest.cost, atol=1e-8 * (1 + whole.cost))
    # by the prior, that chi-square has as many degrees of freedom as the pose has equations
    assert_close(whole.leave_one_out.tested, np.full(9, 3), atol=0)


@given(seeds)
def test_results_are_independent_of_the_scale_of_equations_and_values(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0.0, 6.28, 12)
    circle = Circle(np.stack([np.cos(angle), np.sin(angle)], 1) + 0.01 * rng.normal(size=(12, 2)))
    C = np.tile(1e-4 * np.eye(2), (12, 1, 1))
    mix, factor = 10.0 ** rng.uniform(-6, 6, (12, 1)), 10.0 ** rng.uniform(-4, 4, 3)

    def rescaled(values: NDArray, deviation: NDArray) -> Equations:
        found = circle.constrain(values / factor, deviation)
        rows = mix[:, None] * found.by_values / factor
        return Equations(mix * found.value, mix[:, None] * found.by_deviation, rows)

    prior = Prior(np.array([0.1, 0.0, 1.0]), np.diag([4.0, 0.0, 100.0]))
    other = Prior(prior.mean * factor, prior.information / np.outer(factor, factor))
    start = np.array([0.1, -0.1, 1.2])
    plain = fit_errors_in_variables(circle.constrain, C, start, prior)
    fit = fit_errors_in_variables(rescaled, C, start * factor, other)
    assert (plain.ok, plain.weight.tolist()) == (fit.ok, fit.weight.tolist())
    assert_close((fit.values / factor - plain.values) / np.sqrt(np.diag(plain.covariance)), np.zeros(3), atol=1e-4)
    assert_close(fit.cost, plain.cost, atol=1e-6)
    back = fit.covariance / np.outer(factor, factor)
    assert_close(back, plain.covariance, atol=1e-4 * np.abs(plain.covariance).max())


def test_the_slope_is_not_attenuated_as_that_of_the_equations_alone() -> None:
    rng = np.random.default_rng(5)
    campaigns, sigma, slope = 60, 0.2, 2.0
    x = np.linspace(-1.0, 1.0, 40)
    found, plain = np.empty((2, campaigns))
    for k in range(campaigns):
        points = np.stack([x, slope * x], 1) + sigma * rng.normal(size=(40, 2))
        fit = fit_errors_in_variables(Line(points).constrain, np.tile(sigma**2 * np.eye(2), (40, 1, 1)), [0.0, 1.0])
        found[k], plain[k] = fit.values[1], np.polyfit(*points.T, 1)[0]
    spread = plain.std(ddof=1) / np.sqrt(campaigns)
    assert_between(plain.mean(), *(slope / (1 + sigma**2 / np.var(x)) + 4 * spread * np.array([-1, 1])))
    # a bias of second order in the noise is left: some tenths of one fit's own sigma
    spread = found.std(ddof=1)
    assert_between(found.mean(), slope - 0.4 * spread - 4 * spread / np.sqrt(campaigns), slope + 0.9 * spread)
    assert slope - plain.mean() > 10 * abs(found.mean() - slope)


def _line(rng: np.random.Generator, noise: float = 1.0) -> ErrorsInVariablesFit:
    """A fit of 20 points, drawn with this many times the declared noise."""
    points = np.stack([np.linspace(0, 1, 20), np.linspace(1, 3, 20)], 1) + noise * 0.01 * rng.normal(size=(20, 2))
    return fit_errors_in_variables(Line(points).constrain, np.tile(1e-4 * np.eye(2), (20, 1, 1)), [0.0, 1.0])


@pytest.mark.slow
def test_covariance_and_noise_ratio_are_those_of_many_fits() -> None:
    rng = np.random.default_rng(6)
    fits = [_line(rng, noise=1.5) for _ in range(400)]
    error = np.array([np.linalg.solve(np.linalg.cholesky(f.covariance_at(1.5)), f.values - [1, 2]) for f in fits])
    # the covariance of 400 standard normal pairs: each entry within 4.5 of its standard deviations
    assert_close(error.T @ error / 400, np.eye(2), atol=4.5 * np.sqrt(2 / 400))
    ratio = np.array([f.noise_ratio for f in fits])
    stated = np.mean([f.noise_ratio / np.sqrt(2 * f.leave_one_out.freedom) for f in fits])
    # the mean of a chi distribution of 18 degrees of freedom is 1.4 % below its root mean square
    assert_between(ratio.mean() / 1.5, 0.986 - 4 * 0.167 / 20, 0.986 + 4 * 0.167 / 20)
    assert_between(ratio.std() / stated, 1 - 4 / np.sqrt(800), 1 + 4 / np.sqrt(800))


def test_parameters_not_determined_by_data_or_prior_are_reported_without_covariance() -> None:
    rng = np.random.default_rng(7)
    problem = linear(rng)
    problem = replace(problem, design=problem.design[..., [0, 1, 2, 2]])
    fit = fit_errors_in_variables(problem.constrain, problem.covariance, np.zeros(4))
    assert fit.status == SolverStatus.RANK_DEFICIENT
    assert np.isnan(fit.covariance[2:]).all()
    held = Prior(np.zeros(4), np.diag([0.0, 0.0, 0.0, 1e9]))
    enough = fit_errors_in_variables(problem.constrain, problem.covariance, np.zeros(4), held)
    assert enough.ok
    assert_close(fit.covariance[:2, :2], enough.covariance[:2, :2], atol=1e-7)
    assert_close(fit.cost, enough.cost, atol=1e-5)


def test_a_start_without_a_value_is_reported() -> None:
    def root(values: NDArray, deviation: NDArray) -> Equations:
        value = np.sqrt(values[0]) * np.ones((3, 1)) - 1.0 - deviation
        return Equations(value, -np.ones((3, 1, 1)), np.full((3, 1, 1), 0.5 / np.sqrt(values[0])))

    noise = np.ones((3, 1, 1))
    assert fit_errors_in_variables(root, noise, [-1.0]).status == SolverStatus.NOT_FINITE
    # the first full step from here goes where there is no value
    fit = fit_errors_in_variables(root, noise, [30.0])
    assert fit.ok
    assert_close(fit.values, [1.0], atol=SETTLED * 2)


def test_derivatives_are_not_differenced() -> None:
    problem = linear(np.random.default_rng(8))
    asked: list[NDArray] = []

    def counted(values: NDArray, deviation: NDArray) -> Equations:
        asked.append(values)
        return problem.constrain(values, deviation)

    fit_errors_in_variables(counted, problem.covariance, np.zeros(4), problem.prior)
    assert len(asked) <= 4
    assert len(np.unique(asked, axis=0)) <= 3


def test_bad_input_raises() -> None:
    problem = linear(np.random.default_rng(9))
    C = problem.covariance
    with pytest.raises(ValueError, match="shape"):
        fit_errors_in_variables(problem.constrain, C[0], np.zeros(4))
    with pytest.raises(ValueError, match="asymmetric"):
        fit_errors_in_variables(problem.constrain, C + np.triu(np.ones((3, 3)), 1), np.zeros(4))
    with pytest.raises(ValueError, match="without any error"):
        fit_errors_in_variables(problem.constrain, np.where(np.arange(9)[:, None, None] == 3, 0.0, C), np.zeros(4))
    with pytest.raises(ValueError, match="prior"):
        fit_errors_in_variables(problem.constrain, C, np.zeros(4), Prior(np.zeros(3), np.eye(3)))
