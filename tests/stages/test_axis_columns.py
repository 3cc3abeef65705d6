"""Columns of an axis become commands and deviations in SI: counts, whole turns, overflows, directions of approach."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest

from tests.tolerance import assert_close
from truing.simulation.axis.rows import AxisRows, approaches
from truing.stages.common.approaches import _configurations
from truing.stages.common.axis_columns import AxisColumns


def test_approaches_without_times_are_no_recording_in_motion() -> None:
    up = [
        (40.0 * k, way, cycle)
        for cycle in (1, 2)
        for way, ks in (("forward", range(9)), ("backward", range(8, -1, -1)))
        for k in ks
    ]
    target, way, cycle = zip(*up, strict=True)
    positions = {"target_mm": target, "direction": way, "cycle": cycle, "position_mm": target}
    table = _configurations(pa.table(positions | {"run": ["X"] * len(up), "row_order": list(range(1, len(up) + 1))}))
    command = table.column("command_mm").to_numpy() / 1e3
    rows = AxisRows.of(table.column("pose").to_pylist(), table.column("time_s").to_numpy(), command, 1e-9)
    assert set(rows.direction[1::2][9:18]) == {-1.0}
    assert not rows.rate.any()


def test_counts_and_whole_turns_are_brought_to_one_unit() -> None:
    table = pa.table({"c_counts": [0.0, 3600.0, 7200.0], "motor_deg": [0.5, 360.5, 0.5]})
    columns = AxisColumns("rotary", "deg", "motor", "c_counts", {"motor": "motor_deg"}, 10.0)
    assert np.allclose(columns.si(table, "c_counts"), [0.0, 2.0 * np.pi, 4.0 * np.pi])
    assert np.allclose(columns.deviations(table)[:, 0], np.deg2rad(0.5))


@pytest.mark.parametrize("zero_deg", [0.0, 130.0])
def test_readings_between_0_and_a_turn_are_none_of_its_errors(zero_deg: float) -> None:
    """Half of the readings of a table that turns from -180 to 180 deg are a whole turn larger than its commands."""
    command = np.tile(np.linspace(-180.0, 180.0, 25), 2)
    table = pa.table({"c_deg": command, "measured_deg": (command + zero_deg + 0.01) % 360.0})
    columns = AxisColumns("rotary", "deg", "motor", "c_deg", {"measured": "measured_deg"}, None)
    deviation = np.rad2deg(columns.deviations(table)[:, 0])
    assert np.ptp(deviation) < 1e-9
    assert_close(deviation % 360.0, np.full(len(command), zero_deg + 0.01), atol=1e-9)


def test_overflows_of_a_counter_are_no_errors_but_other_jumps_are() -> None:
    command = np.arange(0.0, 80.0, 4.0)  # mm, 1000 counts each: 16 bits overflow at 65.5 mm
    off = np.random.default_rng(1).normal(0.0, 2.0, len(command))
    columns = AxisColumns("linear", "mm", "motor", "command_mm", {"load": "load_counts"}, 1000.0)

    def deviations_um(counts: np.ndarray) -> np.ndarray:
        table = pa.table({"command_mm": command, "load_counts": counts})
        return columns.deviations(table)[:, 0] * 1e6  # counts are um

    truth = np.round(1000.0 * command + off)
    assert_close(deviations_um(truth % 2**16), truth - 1000.0 * command, atol=1e-6)
    signed = (truth + 2**15) % 2**16 - 2**15
    assert_close(np.ptp(deviations_um(signed) - off), 0.0, atol=1.0)
    jump = np.where(command > 40.0, 30000.0, 0.0)
    assert_close(deviations_um(truth % 2**16 * 0.0 + truth + jump), truth + jump - 1000.0 * command, atol=1e-6)


def test_commands_within_a_turn_go_on_where_an_encoder_counts_turns() -> None:
    turned = np.array([340.0, 460.0, 580.0, 700.0, 820.0, 700.0])
    table = pa.table(
        {
            "pose": np.arange(6),
            "time_s": np.arange(6.0),
            "command_deg": turned % 360.0,
            "motor_deg": turned + 5.0,
            "load_deg": turned % 360.0 + 0.01,
        }
    )
    columns = AxisColumns("rotary", "deg", "motor", "command_deg", {"load": "load_deg", "motor": "motor_deg"}, None)
    rows = columns.rows(table, 0.0)
    assert_close(np.diff(rows.command), np.deg2rad(np.diff(turned)), atol=1e-12)
    assert rows.direction.tolist() == [1.0, 1.0, 1.0, 1.0, 1.0, -1.0]
    apart = columns.deviations(table) % (2.0 * np.pi)  # a constant zero is free, whole turns too
    assert_close(apart, np.deg2rad(np.tile([0.01, 5.0], (6, 1))), atol=1e-12)
    alone = AxisColumns("rotary", "deg", "motor", "command_deg", {"load": "load_deg"}, None)
    assert_close(alone.deviations(table), np.deg2rad(np.full((6, 1), 0.01)), atol=1e-12)


@pytest.mark.parametrize("slip", [lambda own: 60.0 * own, lambda own: own + 360.0 * (np.arange(len(own)) > 6)])
def test_commands_stay_where_a_slip_of_one_encoder_looks_like_turns(slip) -> None:  # type: ignore[no-untyped-def]
    command = np.array([-80.0, -60.0, -20.0, 20.0, 60.0, 80.0, 40.0, 10.0, -30.0, -70.0, 5.0, 75.0])
    recorded = {"command_deg": command, "motor_deg": command + 0.01, "measured_deg": slip(command)}
    table = pa.table({"pose": np.arange(12), "time_s": np.arange(12.0), **recorded})
    encoders = {"motor": "motor_deg", "measured": "measured_deg"}
    columns = AxisColumns("rotary", "deg", "motor", "command_deg", encoders, None)
    assert_close(columns.commands(table), np.deg2rad(command), atol=1e-12)


def test_direction_of_approach_is_that_of_the_last_movement_larger_than_the_least() -> None:
    command = np.array([0.0, 1.0, 0.95, 0.9, 0.0, np.nan, -1.0])
    found, _ = approaches(command, np.arange(7.0), 0.1)
    assert found.tolist() == [1.0, 1.0, 1.0, 1.0, -1.0, -1.0, -1.0]


def test_travel_since_the_turn_is_counted_from_where_the_axis_stood_when_it_turned() -> None:
    command = np.array([0.0, 1.0, 3.0, 2.95, 1.0, 0.0, 0.5])
    _, found = approaches(command, np.arange(7.0), 0.1)
    assert_close(found, np.array([0.0, 1.0, 3.0, 3.0, 2.0, 3.0, 0.5]), atol=1e-12)
