"""Columns are assigned to rows at the least total cost, even if several rows prefer the same column."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from truing.belonging.assignment import cheapest_columns


@given(st.integers(0, 2**31), st.integers(0, 12), st.booleans())
def test_each_column_is_used_once_and_the_sum_is_least(seed: int, size: int, nearly_ordered: bool) -> None:
    rng = np.random.default_rng(seed)
    cost = rng.random((size, size)) + (1.0 - np.eye(size)[rng.permutation(size)]) * nearly_ordered
    columns = cheapest_columns(cost)
    assert sorted(columns.tolist()) == list(range(size))
    least = cost[linear_sum_assignment(cost)].sum()
    assert cost[np.arange(size), columns].sum() == pytest.approx(least, rel=1e-12)
