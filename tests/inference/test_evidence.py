"""Evidence of parameters whose sign is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from tests.tolerance import assert_close
from truing.inference.evidence import log_possible


@pytest.mark.parametrize("value", [-4.0, -1.0, 0.0, 2.0])
def test_a_sign_that_nature_does_not_have_is_taken_from_the_prior_and_given_to_the_other_side(value: float) -> None:
    """One parameter, seen to one sigma at a value, plausible to a hundred: by sums over what it may be."""
    may_be = np.linspace(-500.0, 500.0, 2_000_001)
    told = norm.pdf(may_be, value) * norm.pdf(may_be, 0.0, 100.0)
    gained = np.log(2.0 * told[may_be >= 0.0].sum() / told.sum())
    assert_close(log_possible(np.array([value]), np.eye(1), (0,)), gained, atol=2e-2, what="gain of log evidence")
    assert log_possible(np.array([value]), np.eye(1), ()) == 0.0
