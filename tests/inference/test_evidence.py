"""Evidence of parameters of a plausible size, of a known range, and of a known sign; also by products."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from tests.tolerance import assert_close
from truing.inference.evidence import SIZES, log_evidence, log_evidence_of_products, log_possible, sizes_of


@pytest.mark.parametrize("value", [-4.0, -1.0, 0.0, 2.0])
def test_a_sign_that_nature_does_not_have_is_taken_from_the_prior_and_given_to_the_other_side(value: float) -> None:
    """One parameter, seen to one sigma at a value, plausible to a hundred: by sums over what it may be."""
    may_be = np.linspace(-500.0, 500.0, 2_000_001)
    reported = norm.pdf(may_be, value) * norm.pdf(may_be, 0.0, 100.0)
    gained = np.log(2.0 * reported[may_be >= 0.0].sum() / reported.sum())
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
    expected = float(log_evidence(left.T @ residual, strengths, total, 40.0, (3.0, 0.5)))
    found = log_evidence_of_products(columns.T @ columns, columns.T @ residual, total, 40.0, (3.0, 0.5))
    assert_close(found, expected, atol=1e-9, what="log evidence")


@pytest.mark.parametrize("size", [5.0, 15.0, 30.0])
def test_a_wider_plausible_scale_is_no_proof_of_a_cause(size: float) -> None:
    """Two causes with the same effect on the data; it is ``size`` plausible scales of one, and a tenth of that of the
    other: the data cannot distinguish them, and the odds are below those at which rivals are indistinguishable."""
    freedom, along = 2000.0, np.array([25.0])
    narrow, wide = (log_evidence(along, along / own, freedom, freedom) for own in (size, size / 10.0))
    assert abs(float(wide - narrow)) < np.log(20.0)


def test_one_parameter_is_preferred_to_three_that_explain_the_same_however_large_it_is() -> None:
    along, size = np.array([25.0, 0.0, 0.0]), 28.0
    one = log_evidence(along[:1], along[:1] / size, 2000.0, 2000.0)
    three = log_evidence(along, np.full(3, along[0] / size), 2000.0, 2000.0)
    assert one > three


def test_a_property_of_a_material_far_from_all_known_ones_costs_evidence() -> None:
    freedom, along, known = 2000.0, np.array([25.0]), sizes_of(SIZES, 1.0, is_known=True)
    common, odd = (float(log_evidence(along, along / size, freedom, freedom, known)) for size in (1.0, 12.0))
    assert common - odd > np.log(20.0)
    assert float(log_evidence(along, along, freedom, freedom, known)) >= float(
        log_evidence(along, along, freedom, freedom)
    )
