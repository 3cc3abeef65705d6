"""Periods of a load that a campaign resolves: passed twice, with at least four levels."""

from __future__ import annotations

import numpy as np
import pytest

from tests.tolerance import assert_close
from truing.simulation.bench.causes.nonparametric import periods_of_levels

WEIGHTS = np.array([0.0, 0.5886, 1.42245, 2.01105, 2.79585, 3.924, 6.71985, 11.33055, 15.8922])


def test_even_levels_distinguish_periods_of_four_of_them_up_to_half_the_range() -> None:
    assert_close(periods_of_levels(np.linspace(-7.0, 7.0, 15)), [14.0 / n for n in (2.0, 2.5, 3.0, 3.5)], atol=1e-9)
    assert_close(periods_of_levels(np.arange(9.0)), [4.0], atol=1e-9)


@pytest.mark.parametrize("levels", [np.arange(8.0), WEIGHTS, -WEIGHTS[::-1]])
def test_few_levels_far_apart_distinguish_no_period(levels: np.ndarray) -> None:
    assert not len(periods_of_levels(levels))
