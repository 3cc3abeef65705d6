"""Terms of a calibration: exact derivatives, unique names, and equations with errors in both variables."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.tolerance import assert_close
from truing.estimation.sensor.calibrate import TermEquations
from truing.estimation.sensor.calibration import Terms

STEP = 1e-30
options = st.builds(
    Terms,
    st.just(("a", "b", "c")),
    st.sampled_from([(), ("T",), ("T", "p")]),
    st.booleans(),
    st.booleans(),
    st.sampled_from(["linear", "squares", "products"]),
)


@given(options, st.integers(0, 2**32 - 1))
def test_derivatives_are_those_of_a_complex_step(terms, seed):
    rng = np.random.default_rng(seed)
    x, z = rng.normal(size=(4, 3)), rng.normal(size=(4, len(terms.covariates)))
    columns = [terms.at(x + 1j * STEP * one, z).imag / STEP for one in np.eye(3)]
    assert_close(terms.by_inputs(x, z), np.stack(columns, axis=-1), atol=1e-12)
    assert terms.at(x, z).shape[1] == len(terms.labels)


def test_every_term_has_a_name_of_its_own():
    terms = Terms(("v1", "v2"), ("dT",), drift=True, gain=True, powers="products")
    assert terms.labels == ("v1", "v2", "dT", "dT v1", "dT v2", "v1^2", "v1 v2", "v2^2")
    found = terms.at(np.array([[2.0, 3.0]]), np.array([[5.0]]))
    assert_close(found, [[2, 3, 5, 10, 15, 4, 6, 9]], atol=0.0)


@pytest.mark.parametrize("powers", ["linear", "products"])
def test_the_equations_of_both_errors_have_exact_derivatives(powers):
    rng = np.random.default_rng(0)
    terms = Terms(("a", "b"), ("T",), drift=True, powers=powers)
    x, y, z = rng.normal(size=(5, 2)), rng.normal(size=(5, 3)), rng.normal(size=(5, 1))
    equations = TermEquations(terms, y, x, z, np.ones((5, 1)))
    values, deviation = rng.normal(size=3 * (len(terms.labels) + 1)), 0.1 * rng.normal(size=(5, 5))
    found = equations.constrain(values, deviation)
    by_deviation = [equations.constrain(values, deviation + 1j * STEP * one).value.imag / STEP for one in np.eye(5)]
    by_values = [
        equations.constrain(values + 1j * STEP * one, deviation).value.imag / STEP for one in np.eye(len(values))
    ]
    assert_close(found.by_deviation, np.stack(by_deviation, -1), atol=1e-12)
    assert_close(found.by_values, np.stack(by_values, -1), atol=1e-12)
