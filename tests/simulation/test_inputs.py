"""Inputs of effects: columns of a campaign and what follows from them."""

from __future__ import annotations

import numpy as np

from truing.simulation.inputs import numbers_rows


def test_a_column_that_counts_its_rows_says_no_more_than_their_order() -> None:
    assert numbers_rows(np.arange(5.0, 25.0))
    assert not numbers_rows(np.arange(5.0, 25.0)[::-1])
    assert not numbers_rows(np.array([1.0, 2.0, 2.0, 3.0]))
    assert not numbers_rows(np.array([3.0]))
