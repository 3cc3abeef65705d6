"""Inputs of effects: columns of a campaign and what follows from them."""

from __future__ import annotations

import numpy as np
import pytest

from truing.simulation.inputs import numbers_rows


def test_a_column_that_counts_its_rows_says_no_more_than_their_order() -> None:
    assert numbers_rows("No", np.arange(5.0, 25.0))
    assert not numbers_rows("No", np.arange(5.0, 25.0)[::-1])
    assert not numbers_rows("No", np.array([1.0, 2.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]))
    assert not numbers_rows("No", np.array([3.0, 4.0]))


@pytest.mark.parametrize("name", ["temperature_c", "t_c", "payload_kg"])
def test_a_quantity_with_a_unit_may_grow_by_one_from_row_to_row(name: str) -> None:
    assert not numbers_rows(name, np.arange(5.0, 25.0))
