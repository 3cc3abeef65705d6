"""Evidence of parameters: by products of columns as by directions, and of parameters whose sign is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from tests.tolerance import assert_close
from truing.inference.evidence import log_evidence, log_evidence_of_products, log_possible


@pytest.mark.parametrize("value", [-4.0, -1.0, 0.0, 2.0])
def test_a_sign_that_nature_does_not_have_is_taken_from_the_prior_and_given_to_the_other_side(value: float) -> None:
    """One parameter, seen to one sigma at a value, plausible to a hundred: by sums over what it may be."""
    may_be = np.linspace(-500.0, 500.0, 2_000_001)
    told = norm.pdf(may_be, value) * norm.pdf(may_be, 0.0, 100.0)
    gained = np.log(2.0 * told[may_be >= 0.0].sum() / told.sum())
    assert_close(
        log_possible(np.array([value]), np.eye(1), (0,), 1e6, 1e6), gained, atol=2e-2, what="gain of log evidence"
    )
    assert log_possible(np.array([value]), np.eye(1), (), 1e6, 1e6) == 0.0


@pytest.mark.parametrize("noise", [0.8, 1.0, 1.3])
@pytest.mark.parametrize("size", [3.0, 12.0, 40.0])
def test_a_parameter_of_an_impossible_sign_has_no_evidence_whatever_its_size_and_the_noise(
    size: float, noise: float
) -> None:
    freedom, along, strengths = 300.0, np.array([-size]), np.array([20.0])
    left = noise**2 * freedom
    evidence = float(log_evidence(along, strengths, left + size**2, freedom))
    signs = log_possible(along / strengths, np.diag(1.0 / strengths**2), (0,), left, freedom)
    assert evidence + signs < 0.0
    assert size < 10.0 or evidence > 20.0  # without the sign it would be found


def test_evidence_of_products_is_that_along_the_directions_of_the_columns() -> None:
    rng = np.random.default_rng(7)
    columns, residual = rng.standard_normal((40, 6)), rng.standard_normal(40)
    left, strengths, _ = np.linalg.svd(columns, full_matrices=False)
    total = float(residual @ residual)
    expected = float(log_evidence(left.T @ residual, strengths, total, 40.0, 2.0))
    found = log_evidence_of_products(columns.T @ columns, columns.T @ residual, total, 40.0, 2.0)
    assert_close(found, expected, atol=1e-9, what="log evidence")
