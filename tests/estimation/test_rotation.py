"""Laws of the rotation group, near zero, near pi and in between."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from truing.estimation.rotation import (
    exp_so3,
    inverse_left_jacobian_so3,
    left_jacobian_so3,
    log_so3,
    skew,
)

directions = arrays(np.float64, (3,), elements=st.floats(-1, 1)).filter(lambda v: np.linalg.norm(v) > 0.1)
angles = st.one_of(
    st.floats(0, np.pi),
    st.floats(-16, 0).map(lambda k: 10.0**k),
    st.floats(-16, 0).map(lambda k: np.pi - 10.0**k),
)


def rotation_vector(direction: np.ndarray, angle: float) -> np.ndarray:
    return direction / np.linalg.norm(direction) * angle


@given(directions, angles)
def test_exp_is_a_rotation_about_its_vector(direction, angle):
    theta = rotation_vector(direction, angle)
    R = exp_so3(theta)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_allclose(R @ theta, theta, atol=1e-14)
    assert np.trace(R) == pytest.approx(1 + 2 * np.cos(angle), abs=1e-14)


@given(directions, angles)
def test_log_inverts_exp_up_to_the_sign_at_pi(direction, angle):
    theta = rotation_vector(direction, angle)
    back = log_so3(exp_so3(theta))
    assert np.linalg.norm(back) <= np.pi + 1e-14
    np.testing.assert_allclose(exp_so3(back), exp_so3(theta), atol=5e-15)
    if angle < np.pi - 1e-9:
        np.testing.assert_allclose(back, theta, atol=2e-15, rtol=1e-14)


def test_log_keeps_relative_precision_of_tiny_rotations():
    theta = np.array([3e-13, -4e-14, 1e-20])
    np.testing.assert_allclose(log_so3(exp_so3(theta)), theta, rtol=1e-3, atol=1e-16)


@pytest.mark.parametrize("axis", range(3))
def test_log_at_pi_returns_a_vector_of_length_pi(axis):
    R = -np.eye(3)
    R[axis, axis] = 1.0
    np.testing.assert_allclose(np.abs(log_so3(R)), np.pi * np.eye(3)[axis], atol=1e-15)


@given(directions, directions)
def test_skew_is_the_cross_product(v, w):
    np.testing.assert_allclose(skew(v) @ w, np.cross(v, w), atol=1e-15)


@given(directions, angles)
def test_left_jacobian_is_the_derivative_of_exp(direction, angle):
    theta = rotation_vector(direction, angle)
    J = left_jacobian_so3(theta)
    h = 1e-30
    for k, step in enumerate(np.eye(3)):
        derivative = exp_so3(theta + 1j * h * step).imag / h
        np.testing.assert_allclose(derivative, skew(J[:, k]) @ exp_so3(theta), atol=1e-14)


@given(directions, angles)
def test_left_jacobian_times_its_inverse_is_one(direction, angle):
    theta = rotation_vector(direction, angle)
    product = left_jacobian_so3(theta) @ inverse_left_jacobian_so3(theta)
    np.testing.assert_allclose(product, np.eye(3), atol=5e-14)


@given(directions, st.floats(0, np.pi - 1e-3))
def test_log_passes_a_complex_step(direction, angle):
    theta = rotation_vector(direction, angle)
    h = 1e-30
    for k, step in enumerate(np.eye(3)):
        moved = exp_so3(1j * h * step) @ exp_so3(theta)
        derivative = log_so3(moved).imag / h
        np.testing.assert_allclose(derivative, inverse_left_jacobian_so3(theta)[:, k], atol=1e-12, rtol=1e-12)


@pytest.mark.parametrize("shape", [(), (1,), (4,), (2, 3), (0,)])
def test_batch_shapes_agree_with_single_calls(shape):
    theta = np.random.default_rng(1).normal(size=(*shape, 3))
    R, J = exp_so3(theta), left_jacobian_so3(theta)
    assert R.shape == J.shape == (*shape, 3, 3)
    assert log_so3(R).shape == (*shape, 3)
    for index in np.ndindex(shape):
        np.testing.assert_array_equal(R[index], exp_so3(theta[index]))
        np.testing.assert_array_equal(log_so3(R)[index], log_so3(R[index]))
