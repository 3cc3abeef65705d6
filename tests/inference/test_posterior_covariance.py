"""Signs of parameters are tested by their whole uncertainty, also along directions that data do not show."""

from __future__ import annotations

import numpy as np

from truing.inference.evidence import log_possible
from truing.inference.scores import posterior_covariance

RNG = np.random.default_rng(3)
PARAMETERS = 4


def _design() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A Gram matrix (P, P), its strengths (P,) and its orthonormal directions (P, P)."""
    root = RNG.normal(size=(3 * PARAMETERS, PARAMETERS))
    values, vectors = np.linalg.eigh(root.T @ root)
    return root.T @ root, np.sqrt(values), vectors


def test_of_a_design_that_shows_all_parameters_it_is_the_inverse() -> None:
    gram, strengths, vectors = _design()
    np.testing.assert_allclose(posterior_covariance(vectors, strengths), np.linalg.inv(gram), rtol=1e-9)


def test_directions_that_data_do_not_show_keep_their_plausible_size() -> None:
    _, strengths, vectors = _design()
    covariance = posterior_covariance(vectors[:, :2], strengths[:2])
    np.testing.assert_allclose(vectors[:, 2:].T @ covariance @ vectors[:, 2:], np.eye(2), atol=1e-12)


def test_a_parameter_that_data_hardly_show_does_not_decide_by_its_sign() -> None:
    """A tilt of 10 sigmas, with a shift that acts almost as the tilt does: its tiny negative share means nothing."""
    direction = np.array([[1.0], [-1e-4]]) / np.hypot(1.0, 1e-4)
    strengths = np.array([1.2])
    values = direction[:, 0] * 8.0
    covariance = posterior_covariance(direction, strengths)
    assert abs(log_possible(values, covariance, (0, 1), 400.0, 400.0) - np.log(2.0)) < 0.01
