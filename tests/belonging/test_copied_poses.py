"""Copies of measured poses are distinguished from poses that are equal by chance."""

from __future__ import annotations

import numpy as np
import pytest

from truing.belonging.copied_poses import relate_copied_numbers, relate_copies
from truing.belonging.relation import RelationState

NAMES = tuple(map(str, range(30)))
SEEN = np.ones((30, 2), bool)


def wide(step: float) -> np.ndarray:
    """Points (30, 2, 3), m, over metres, so that the nearest numbers differ clearly more than the step of the file."""
    return step * np.round(np.random.default_rng(6).uniform(-2.0, 2.0, (30, 2, 3)) / step)


@pytest.mark.parametrize("step", [1e-8, 1e-7, 2.54e-8])
def test_copies_in_a_wide_workspace_are_found(step: float) -> None:
    points = wide(step)
    assert relate_copies(points, SEEN, 1e-5, NAMES).state is RelationState.OK
    points[17] = points[3]
    (slip,) = relate_copies(points, SEEN, 1e-5, NAMES).slips
    assert slip.subjects == ("3", "17")


def test_numbers_on_no_grid_are_finer_than_their_differences() -> None:
    points = np.random.default_rng(6).uniform(-2.0, 2.0, (30, 2, 3))
    points[17] = points[3]
    assert relate_copies(points, SEEN, 1e-5, NAMES).state is RelationState.FAILS


def test_equal_points_in_a_coarse_file_are_no_copies() -> None:
    points = 1e-3 * np.round(1e3 * np.random.default_rng(6).uniform(-0.01, 0.01, (30, 2, 3)))
    points[17] = points[3]
    tested = relate_copies(points, SEEN, 1e-3, NAMES)
    assert (tested.state, tested.reason) == (RelationState.NOT_TESTED, "coarse")


def test_equal_positions_of_other_orientations_are_no_copies() -> None:
    positions, turns = wide(1e-8)[:, 0], np.random.default_rng(2).normal(size=(30, 9))
    seen = np.ones((30, 3), bool)
    positions[17] = positions[3]
    assert relate_copied_numbers(positions, seen, 1e-5, NAMES, "poses", turns).state is RelationState.OK
    turns[17] = turns[3]
    assert relate_copied_numbers(positions, seen, 1e-5, NAMES, "poses", turns).state is RelationState.FAILS
