"""Groupings of epochs for leaving out blocks: by kind, by number and by size."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from truing.inference.blocks import BlockKind, days, group_numbers, possible_blocks, regions


def test_kinds_come_in_their_order_whatever_the_order_given() -> None:
    numbers = np.repeat(np.arange(4), 5)
    found = possible_blocks({BlockKind.REGION: numbers, BlockKind.DAY: numbers, BlockKind.RUN: numbers}, 20)
    assert [one.kind for one in found] == [BlockKind.RUN, BlockKind.DAY, BlockKind.REGION]
    assert all(one.count == 4 for one in found)


@pytest.mark.parametrize(
    ("sizes", "possible"),
    [((5, 5), False), ((4, 4, 4), True), ((3, 4, 4), False), ((20, 4, 4), False), ((4, 4, 4, *[1] * 7), False)],
)
def test_blocks_are_three_and_large_enough_and_none_is_most_of_all(sizes: tuple[int, ...], possible: bool) -> None:
    numbers = np.repeat(np.arange(len(sizes)), sizes)
    assert bool(possible_blocks({BlockKind.DAY: numbers}, len(numbers))) is possible


def test_small_groups_and_epochs_of_none_are_never_left_out() -> None:
    numbers = np.array([7] * 5 + [3] * 5 + [9] * 5 + [4] * 2 + [-1] * 2)
    (found,) = possible_blocks({BlockKind.RUN: numbers}, len(numbers))
    assert found.count == 3
    assert (found.numbers[-4:] == -1).all()
    assert len(np.unique(found.numbers[:15])) == 3


def test_many_runs_are_left_out_in_twelve_blocks() -> None:
    numbers = np.repeat(np.arange(50), 4)
    (found,) = possible_blocks({BlockKind.RUN: numbers}, 200)
    assert found.count == 12
    for run in range(50):
        assert len(np.unique(found.numbers[numbers == run])) == 1


@given(st.integers(0, 1000))
def test_regions_are_quarters_and_do_not_depend_on_units(seed: int) -> None:
    inputs = np.random.default_rng(seed).uniform(-1, 1, (80, 3)) * [1.0, 0.7, 0.2]
    own = regions(inputs)
    assert np.bincount(own).tolist() == [20, 20, 20, 20]
    scaled = regions(inputs * [1e-3, 1e3, 7.0] + 5.0)
    assert len(np.unique(np.stack([own, scaled]), axis=1).T) == 4


def test_observations_at_one_place_share_a_region() -> None:
    places = np.random.default_rng(1).normal(size=(9, 2))
    own = regions(np.repeat(places, 4, axis=0)).reshape(9, 4)
    assert (own == own[:, :1]).all()


def test_a_day_ends_where_nothing_was_measured_for_a_quarter_of_one() -> None:
    time = np.array([90_000.0, 0.0, np.nan, 3600.0, 90_500.0])
    assert days(time).tolist() == [1, 0, -1, 0, 1]
    assert (days(np.full(3, np.nan)) == -1).all()


def test_equal_rows_have_one_number_and_unknown_ones_none() -> None:
    found = group_numbers(np.array([[1.0, 2.0], [1.0, 2.0], [np.nan, 2.0], [1.0, 3.0]]))
    assert found[0] == found[1] != found[3]
    assert found[2] == -1
