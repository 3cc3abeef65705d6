"""A recorded direction of approach has precedence over that of the rows before."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.tolerance import assert_close
from truing.simulation.axis.rows import AxisRows

UP_AND_DOWN = np.array([0.0, 1.0, 2.0, 2.0, 1.0, 0.0])
SIDES = np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0])


def _rows(command: NDArray, recorded: NDArray | None = None, least: float = 0.0) -> AxisRows:
    return AxisRows.of(range(len(command)), np.arange(len(command)), command, least, recorded=recorded)


def test_a_command_repeated_at_a_reversal_was_approached_from_beyond() -> None:
    assert _rows(UP_AND_DOWN).direction[3] == 1.0
    rows = _rows(UP_AND_DOWN, SIDES)
    assert rows.direction.tolist() == SIDES.tolist()
    assert_close(rows.since_turn[3:], [0.5, 1.5, 2.5], atol=1e-12)  # it had gone half a step beyond


def test_the_first_row_has_travelled_where_its_direction_is_recorded() -> None:
    assert _rows(UP_AND_DOWN).travelled[0] == 0.0
    assert _rows(UP_AND_DOWN, SIDES).travelled[0] > 0.0


def test_directions_that_the_rows_show_change_nothing() -> None:
    rng = np.random.default_rng(5)
    command = rng.normal(size=40)
    known, reported = _rows(command), _rows(command, np.where(np.arange(40) < 1, np.nan, _rows(command).direction))
    for name in ("direction", "since_turn", "travelled", "order", "stops", "rate"):
        assert_close(getattr(reported, name), getattr(known, name), atol=1e-12)


def test_rows_sorted_by_command_keep_their_recorded_sides() -> None:
    sides = np.tile([1.0, -1.0], 5)
    assert _rows(np.repeat(np.arange(5.0), 2), sides).direction.tolist() == sides.tolist()


@pytest.mark.parametrize("unknown", [np.nan, 0.0])
def test_rows_without_a_recorded_direction_go_on_from_the_rows_before(unknown: float) -> None:
    recorded = np.array([unknown, unknown, unknown, -1.0, unknown, unknown])
    assert _rows(np.array([0.0, 1.0, 2.0, 2.0, 2.0, 3.0]), recorded).direction.tolist() == [1, 1, 1, -1, -1, 1]


def test_a_scatter_of_the_command_is_no_movement_next_to_a_recorded_direction() -> None:
    command = UP_AND_DOWN + 1e-4 * np.array([0, 1, -1, 1, -1, 1])
    assert _rows(command, SIDES, least=1e-3).direction.tolist() == SIDES.tolist()
