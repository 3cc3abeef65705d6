"""Least-squares solver, single and in batches: minima, covariances, and status of failed fits."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.tolerance import assert_close
from truing.estimation.least_squares.solver import (
    EPS,
    Method,
    SolverStatus,
    TrustRegion,
    distinct_minima,
    join_solutions,
    least_squares,
    linearise,
)

METHODS: tuple[Method, ...] = ("levenberg-marquardt", "trust-region")
Residuals = Callable[..., tuple[NDArray, NDArray]]


def linear(A: NDArray, y: NDArray) -> Residuals:
    def residuals(x: NDArray) -> tuple[NDArray, NDArray]:
        return x @ A.T - y, np.broadcast_to(A, (len(x), *A.shape))

    return residuals


def decay(x: NDArray, t: NDArray, y: NDArray) -> tuple[NDArray, NDArray]:
    """x0 exp(-x1 t) - y, every problem with data of its own."""
    fall = np.exp(-x[:, 1:] * t)
    return x[:, :1] * fall - y, np.stack([fall, -x[:, :1] * t * fall], -1)


def decays(rng: np.random.Generator, count: int, noise: float = 1e-3) -> tuple[NDArray, NDArray, NDArray]:
    """True parameters (B, 2), times and observations (B, 20)."""
    truth = rng.uniform(0.5, 2.0, (count, 2))
    t = np.sort(rng.uniform(0.0, 3.0, (count, 20)), 1)
    return truth, t, decay(truth, t, 0.0)[0] + noise * rng.normal(size=t.shape)


def rosenbrock(x: NDArray) -> tuple[NDArray, NDArray]:
    first, second = x.T
    jacobian = np.zeros((len(x), 2, 2))
    jacobian[:, 0, 0], jacobian[:, 0, 1], jacobian[:, 1, 0] = -20.0 * first, 10.0, -1.0
    return np.stack([10.0 * (second - first**2), 1.0 - first], -1), jacobian


@pytest.mark.parametrize("method", METHODS)
@given(seed=st.integers(0, 1000))
def test_a_linear_problem_ends_at_its_closed_form(method: Method, seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, y, unit = rng.normal(size=(12, 4)), rng.normal(size=12), 10.0 ** rng.uniform(-3, 3, 4)
    fit = least_squares(linear(A / unit, y), np.zeros(4), method=method)
    expected, cost, *_ = np.linalg.lstsq(A, y)
    assert fit.ok.all()
    assert_close(fit.x[0] / unit, expected, atol=1e-13 * np.linalg.cond(A))
    assert_close(fit.cost, cost, atol=1e-12 * cost[0])
    inverse = np.linalg.inv(A.T @ A)
    assert_close(fit.covariance[0] / np.outer(unit, unit), inverse, atol=1e-13 * np.linalg.cond(A) ** 2 * inverse.max())


@pytest.mark.parametrize("method", METHODS)
def test_digits_survive_where_normal_equations_lose_them(method: Method) -> None:
    small = 1e-9  # its square is rounding: A^T A is singular in double precision
    A = np.array([[1.0, 1.0], [small, 0.0], [0.0, small]])
    fit = least_squares(linear(A, A @ [1.0, 2.0]), [0.3, 0.1], method=method)
    assert fit.status[0] == SolverStatus.CONVERGED
    assert_close(fit.x[0], [1.0, 2.0], atol=10.0 * EPS / small)


@pytest.mark.parametrize("method", METHODS)
@settings(max_examples=8)
@given(seed=st.integers(0, 1000))
def test_a_batch_gives_the_results_of_single_problems(method: Method, seed: int) -> None:
    truth, t, y = decays(np.random.default_rng(seed), 6)
    start = np.full((6, 2), 1.0)
    together = least_squares(decay, start, t, y, method=method)
    alone = join_solutions([least_squares(decay, start[i], t[[i]], y[[i]], method=method) for i in range(6)])
    assert together.ok.all()
    assert np.all(together.iterations == alone.iterations)
    assert_close(together.x, alone.x, atol=1e-13)
    error = together.x - truth
    chi_square = np.einsum("bi,bij,bj->b", error, np.linalg.inv(together.covariance), error) / 1e-6
    assert np.all(chi_square < 25.0)  # five standard deviations of the noise


@pytest.mark.parametrize("method", METHODS)
@given(shift=st.floats(-6, 6), seed=st.integers(0, 100))
def test_results_are_independent_of_the_unit_of_a_parameter(method: Method, shift: float, seed: int) -> None:
    _, t, y = decays(np.random.default_rng(seed), 1)
    unit = np.array([10.0**shift, 10.0**-shift])

    def rescaled(x: NDArray, t: NDArray, y: NDArray) -> tuple[NDArray, NDArray]:
        residual, jacobian = decay(x * unit, t, y)
        return residual, jacobian * unit

    fit, other = (
        least_squares(decay, [1.0, 1.0], t, y, method=method),
        least_squares(rescaled, 1.0 / unit, t, y, method=method),
    )
    assert_close(other.x * unit, fit.x, atol=1e-9)
    assert other.status[0] == fit.status[0]


@pytest.mark.parametrize("method", METHODS)
def test_a_curved_valley_is_followed_to_its_end(method: Method) -> None:
    starts = np.random.default_rng(3).uniform(-3.0, 3.0, (50, 2))
    fit = least_squares(rosenbrock, starts, method=method)
    assert fit.ok.all()
    assert_close(fit.x, np.ones((50, 2)), atol=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_parameters_that_cannot_be_distinguished_are_named_and_the_others_have_numbers(method: Method) -> None:
    A = np.random.default_rng(1).normal(size=(9, 2))[:, [0, 0, 1]]
    fit = least_squares(linear(A, A @ [1.0, 2.0, 3.0]), [0.5, 0.0, 0.0], method=method)
    assert fit.status[0] == SolverStatus.RANK_DEFICIENT
    assert fit.rank[0] == 2
    assert_close(fit.x[0, :2].sum(), 3.0, atol=1e-12)
    assert_close(fit.x[0, 2], 3.0, atol=1e-12)
    assert np.isnan(fit.covariance[0, :2]).all()
    expected = np.linalg.inv(A[:, 1:].T @ A[:, 1:])[1, 1]
    assert_close(fit.covariance[0, 2, 2], expected, atol=1e-12 * expected)


@pytest.mark.parametrize("method", METHODS)
def test_fewer_observations_than_parameters_are_deficient_not_an_error(method: Method) -> None:
    fit = least_squares(linear(np.ones((1, 2)), np.ones(1)), [0.0, 0.0], method=method)
    assert fit.status[0] == SolverStatus.RANK_DEFICIENT
    assert fit.rank[0] == 1


@pytest.mark.parametrize("method", METHODS)
def test_steps_out_of_where_the_model_has_values_are_taken_back(method: Method) -> None:
    def logarithm(x: NDArray) -> tuple[NDArray, NDArray]:
        return np.log(x) - np.log([1e-3, 1e-3]), np.stack([1.0 / x, 1.0 / x], 1)

    fit = least_squares(logarithm, [[1.0], [-1.0]], method=method)
    assert list(fit.status) == [SolverStatus.CONVERGED, SolverStatus.NOT_FINITE]
    assert_close(fit.x[0], [1e-3], atol=1e-15)


@pytest.mark.parametrize("method", METHODS)
def test_derivatives_of_the_wrong_sign_stall(method: Method) -> None:
    _, t, y = decays(np.random.default_rng(4), 1)

    def uphill(x: NDArray, t: NDArray, y: NDArray) -> tuple[NDArray, NDArray]:
        residual, jacobian = decay(x, t, y)
        return residual, -jacobian

    assert least_squares(uphill, [1.0, 1.0], t, y, method=method).status[0] == SolverStatus.STALLED


def distances(x: NDArray, length: NDArray) -> tuple[NDArray, NDArray]:
    """Distances of points near 3 m away to a point x next to the origin, less those measured."""
    g = POINTS + x[:, None]
    distance = np.linalg.norm(g, axis=-1)
    return distance - length, g / distance[..., None]


POINTS = np.random.default_rng(0).normal([1.0, 2.0, 3.0], 1.0, (40, 3))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("reach", [0.0, 1e-8, 1e-4])
@pytest.mark.parametrize("noise", [0.0, 1e-9, 1e-6])
def test_small_differences_of_large_numbers_end_at_their_rounding(method: Method, reach: float, noise: float) -> None:
    rng = np.random.default_rng(1)
    truth = reach * rng.normal(size=(50, 3))
    length = np.linalg.norm(POINTS + truth[:, None], axis=-1)
    fit = least_squares(distances, np.zeros((50, 3)), length + noise * rng.normal(size=length.shape), method=method)
    assert fit.ok.all()
    rounding = 10.0 * EPS * np.linalg.norm(POINTS)
    allowed = 6.0 * np.sqrt(np.diagonal(fit.covariance, axis1=1, axis2=2)) * (noise + rounding)
    assert np.all(np.abs(fit.x - truth) <= allowed)


@pytest.mark.parametrize("method", METHODS)
def test_an_iteration_limit_is_reported(method: Method) -> None:
    fit = least_squares(rosenbrock, [[-1.2, 1.0], [1.0, 1.0]], method=method, max_iterations=2)
    assert list(fit.status) == [SolverStatus.ITERATION_LIMIT, SolverStatus.CONVERGED]


def test_every_status_has_a_remedy() -> None:
    assert all(status.remedy.endswith(".") for status in SolverStatus)


def test_wrong_shapes_and_unknown_methods_are_refused() -> None:
    with pytest.raises(ValueError, match="expected one of levenberg-marquardt, trust-region"):
        least_squares(rosenbrock, [1.0, 1.0], method="newton")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"jacobian \(1, 2, 2\) for 1 problems of 3 parameters"):
        least_squares(rosenbrock_of_two, [1.0, 1.0, 1.0])


def rosenbrock_of_two(x: NDArray) -> tuple[NDArray, NDArray]:
    return rosenbrock(x[:, :2])


@given(seed=st.integers(0, 1000))
def test_a_damped_step_promises_what_a_linear_problem_gives(seed: int) -> None:
    rng = np.random.default_rng(seed)
    J, r, damping = rng.normal(size=(3, 10, 4)), rng.normal(size=(3, 10)), 10.0 ** rng.uniform(-3, 1, 3)
    problem = linearise(r, J)
    step, length, promised = problem.step(damping)
    assert_close(length, np.linalg.norm(step * problem.scale, axis=1), atol=1e-12)
    after = np.sum((r + np.einsum("bnp,bp->bn", J, step)) ** 2, 1)
    assert_close(promised, np.sum(r**2, 1) - after, atol=1e-12)


@given(seed=st.integers(0, 1000), radius=st.floats(1e-6, 10.0))
def test_a_step_that_would_leave_the_radius_ends_on_it(seed: int, radius: float) -> None:
    rng = np.random.default_rng(seed)
    problem = linearise(rng.normal(size=(5, 10)), rng.normal(size=(5, 10, 4)) @ _nearly_dependent())
    damping = TrustRegion().damping(problem, np.tile([radius, 0.0], (5, 1)))
    free, length = problem.step(np.zeros(5))[1], problem.step(damping)[1]
    assert np.all(np.where(free > 1.1 * radius, np.abs(length / radius - 1.0) < 0.1, damping == 0.0))


def _nearly_dependent() -> NDArray:
    return np.array([[1.0, 1.0, 0, 0], [0, 1e-3, 0, 0], [0, 0, 1.0, 1.0], [0, 0, 0, 1e-6]])


def test_minima_of_many_starts_are_distinguished() -> None:
    def two_wells(x: NDArray) -> tuple[NDArray, NDArray]:
        return np.concatenate([x**2 - 1.0, 0.1 * (x - 1.0)], 1), np.stack([2.0 * x, np.full_like(x, 0.1)], 1)

    starts = np.linspace(-3.0, 3.0, 40)[:, None]
    minima = distinct_minima(least_squares(two_wells, starts))
    assert len(minima.x) == 2
    assert_close(minima.x[0], [1.0], atol=1e-7)
    assert minima.x[1, 0] < -0.9
    assert minima.cost[0] < 1e-14 < minima.cost[1]
    assert minima.reached.sum() + minima.failed == 40
    assert not minima.is_unique
    assert distinct_minima(least_squares(two_wells, starts[starts[:, 0] > 0.5])).is_unique
