"""A measured matrix against a simulated one: differences, joint tests and the common factor by their distributions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from tests.tolerance import assert_close
from truing.estimation.matrix_comparison import MatrixComparison, compare_matrices, joint_test, slopes_of_shifts

_DRAWS = 200
_ANGLES = np.radians([264, 276, 24, 36, 144, 156])
_RING = 0.135 * np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])
_K = 1e-3 * np.random.default_rng(4).normal(0.0, 10.0, (6, 6))


def _covariance(rng: np.random.Generator) -> np.ndarray:
    root = np.linalg.qr(rng.normal(size=(36, 36)))[0] * rng.uniform(0.3e-3, 1e-3, 36)
    return root @ root.T


def _compared(rng: np.random.Generator, truth: np.ndarray, simulated: np.ndarray, **more: object) -> MatrixComparison:
    cov = _covariance(rng)
    measured = truth + (np.linalg.cholesky(cov) @ rng.normal(size=36)).reshape(6, 6)
    sigma, determined = more.get("sigma", np.zeros((6, 6))), more.get("determined", np.ones(6, bool))
    return compare_matrices(measured, cov, simulated, sigma, determined, _RING)


def _near_one(squares: np.ndarray) -> None:
    low, high = (chi2.ppf(q, len(squares)) / len(squares) for q in (1e-4, 1 - 1e-4))
    assert low < np.mean(squares) < high


def test_differences_by_noise_of_both_have_their_distribution() -> None:
    rng, sigma = np.random.default_rng(1), np.full((6, 6), 0.5e-3)
    found = [_compared(rng, _K, _K + sigma * rng.normal(size=(6, 6)), sigma=sigma) for _ in range(_DRAWS)]
    assert {one.together.dof for one in found} == {36}
    assert kstest([one.together.p_value for one in found], "uniform").pvalue > 1e-3
    assert kstest([one.without_plane.p_value for one in found], "uniform").pvalue > 1e-3
    _near_one(np.concatenate([((one.difference / one.sigma) ** 2).ravel() for one in found[:20]]))


@pytest.mark.parametrize("factor", [0.08, 1.0, 12.0])
def test_a_common_factor_is_recovered_within_its_sigma(factor: float) -> None:
    rng = np.random.default_rng(2)
    found = [_compared(rng, factor * _K, _K) for _ in range(_DRAWS)]
    _near_one(np.array([(one.factor - factor) / one.factor_sigma for one in found]) ** 2)
    assert {one.scaled.dof for one in found} == {35}
    assert kstest([one.scaled.p_value for one in found], "uniform").pvalue > 1e-3


def test_another_frame_of_the_platform_shows_in_a_plane_alone() -> None:
    rng = np.random.default_rng(3)
    plane = np.column_stack([np.ones(6), _RING]) @ rng.normal(size=(3, 6)) * 1e-2
    found = [_compared(rng, _K + plane, _K) for _ in range(_DRAWS)]
    assert max(one.together.p_value for one in found) < 1e-6
    assert kstest([one.without_plane.p_value for one in found], "uniform").pvalue > 1e-3
    assert found[0].without_plane.dof == 18


def test_rows_that_were_not_determined_are_not_compared() -> None:
    determined = np.array([True, True, False, True, False, False])
    found = _compared(np.random.default_rng(5), _K, _K, determined=determined)
    assert np.isfinite(found.sigma).all(axis=1).tolist() == determined.tolist()
    assert found.together.dof == 18
    assert found.without_plane is None


def test_a_simulation_of_a_rigid_platform_has_no_factor() -> None:
    found = _compared(np.random.default_rng(6), _K, np.zeros((6, 6)))
    assert np.isnan(found.factor)
    assert found.together.p_value < 1e-12


def test_the_joint_test_counts_a_difference_known_twice_once() -> None:
    cov = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 4.0]])
    found = joint_test(np.array([2.0, 2.0, 4.0]), cov)
    assert found.dof == 2
    assert found.chi_square == pytest.approx(8.0)


def test_slopes_of_simulated_shifts_are_those_of_the_matrix() -> None:
    rng = np.random.default_rng(7)
    unit, sigma = slopes_of_shifts(1.3 * np.eye(6), 1.3 * _K.T, None)
    assert_close(unit, _K, atol=1e-15)
    assert not sigma.any()
    moved = rng.uniform(-1.3, 1.3, (30, 6))
    squares = []
    for noise in (np.full(30, 2e-3), None):
        for _ in range(30):
            found, sigma = slopes_of_shifts(moved, moved @ _K.T + 2e-3 * rng.normal(size=(30, 6)), noise)
            squares.append(((found - _K) / sigma) ** 2)
    declared, estimated = np.concatenate(squares[:30]), np.concatenate(squares[30:])
    _near_one(declared.ravel())
    assert 1.0 < estimated.mean() < 1.25  # Student's t of 24 degrees: 24 / 22
