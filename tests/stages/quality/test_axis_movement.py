"""Units, signs and exchanged columns of an axis are recognised by the movements of encoders and command."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pyarrow as pa
import pytest

from truing.stages.common.axis_columns import AxisColumns
from truing.stages.quality.axis_movement import exchanged_columns, movements, unit_check

ROWS = 48
COLUMNS = AxisColumns(
    "linear",
    "mm",
    "motor",
    "command_mm",
    {"motor": "motor_counts", "load": "load_mm", "measured": "measured_mm"},
    4000.0,
)
Table = dict[str, np.ndarray]


def _recorded() -> Table:
    rng, targets = np.random.default_rng(3), np.array([12.0, 55.0, 101.0, 204.0, 297.0, 391.0])
    command = np.concatenate([targets, targets[::-1]] * 4)
    noise = 1e-3 * rng.normal(size=(3, ROWS))
    return {
        "command_mm": command,
        "motor_counts": np.round(4000.0 * (command + noise[0])),
        "load_mm": np.round(command + noise[1], 5),
        "measured_mm": np.round(command + noise[2] + 7.0, 5),
    }


def _checks(recorded: Table) -> dict[str, tuple[str, str]]:
    table, columns = pa.table(recorded), COLUMNS
    command = columns.si(table, columns.command)
    moved = {name: movements(command, columns.si(table, column)) for name, column in columns.encoders.items()}
    exchanged = exchanged_columns(table, columns, np.arange(ROWS))
    rows = [unit_check(name, columns, moved, exchanged) for name in columns.encoders]
    return {row.subject: (row.verdict, row.message) for row in rows}


def _times(factor: float, *names: str) -> Callable[[Table], Table]:
    return lambda own: own | {name: factor * own[name] for name in names}


def _exchanged(first: str, second: str) -> Callable[[Table], Table]:
    return lambda own: own | {first: own[second], second: own[first]}


def test_right_columns_pass() -> None:
    assert {verdict for verdict, _ in _checks(_recorded()).values()} == {"pass"}


@pytest.mark.parametrize(
    ("slip", "failed", "said"),
    [
        (_times(1e-3, "measured_mm"), {"measured"}, "did you mean measured_mm in metres?"),
        (_times(-1.0, "load_mm"), {"load"}, "did you mean load_mm in mm with the opposite sign?"),
        (_times(1e-3, "command_mm"), {"motor", "load", "measured"}, "did you mean command_mm in metres?"),
        (_times(-1.0, "command_mm"), {"motor", "load", "measured"}, "mean command_mm in mm with the opposite sign?"),
        (_times(1e-3, "command_mm", "load_mm", "measured_mm"), {"motor"}, "command_mm, load_mm, measured_mm in metres"),
    ],
)
def test_the_column_in_another_unit_is_named(slip: Callable[[Table], Table], failed: set[str], said: str) -> None:
    found = _checks(slip(_recorded()))
    assert {name for name, (verdict, _) in found.items() if verdict == "fail"} == failed
    assert all(said in found[name][1] for name in failed)


@pytest.mark.parametrize(
    ("first", "second"),
    [("motor_counts", "load_mm"), ("command_mm", "motor_counts"), ("motor_counts", "measured_mm")],
)
def test_columns_exchanged_with_counts_are_named(first: str, second: str) -> None:
    found = _checks(_exchanged(first, second)(_recorded()))
    failed = {message for verdict, message in found.values() if verdict == "fail"}
    assert failed
    assert all(f"did you mean columns {first} and {second} exchanged?" in message for message in failed)


@pytest.mark.parametrize("other", ["load_mm", "measured_mm"])
def test_commands_are_known_by_their_exact_values(other: str) -> None:
    table = pa.table(_exchanged("command_mm", other)(_recorded()))
    assert exchanged_columns(table, COLUMNS, np.arange(ROWS)) == ("command_mm", other)
    assert exchanged_columns(pa.table(_recorded()), COLUMNS, np.arange(ROWS)) == ()


def test_a_slip_of_half_the_rows_is_none_of_all() -> None:
    own = _recorded()
    own["measured_mm"] = np.where(np.arange(ROWS) < 25, own["measured_mm"], -own["measured_mm"])
    assert _checks(own)["measured"][0] == "pass"  # the check of rows names them


def test_a_reading_that_does_not_follow_at_all_is_named_without_a_unit() -> None:
    verdict, said = _checks(_times(0.0, "measured_mm")(_recorded()))["measured"]
    assert verdict == "fail"
    assert "mean" not in said
