"""Test of axis rows: exchanged rows and another unit are distinguished from shifted zeros and from errors of the
axis."""

from __future__ import annotations

import numpy as np
import pytest

from truing.belonging.axis_rows import (
    AxisRowSlip,
    RowSlipKind,
    copied_stretch,
    other_order,
    sexagesimal,
    slip_of_rows,
    unit_of_deviations,
)

UNITS = {"radians": 180.0 / np.pi, "deg with the opposite sign": -1.0}
COUNT = 50
COMMAND = np.random.default_rng(7).permutation(np.linspace(-100.0, 100.0, COUNT))
LATE = np.arange(COUNT) >= 29


def readings() -> np.ndarray:
    """An encoder with a zero of 2.9 deg, a scale error of 1 part in 1000, and noise."""
    return 1.001 * COMMAND + 2.9 + 1e-3 * np.random.default_rng(8).normal(size=COUNT)


def slip_of(reading: np.ndarray) -> AxisRowSlip | None:
    return slip_of_rows(COMMAND, reading, 1.0, UNITS)


def test_an_axis_with_small_errors_has_no_slip() -> None:
    assert slip_of(readings()) is None


@pytest.mark.parametrize("shift", [0.5, 7.0, -90.0])
def test_a_shifted_zero_is_no_slip(shift: float) -> None:
    assert slip_of(readings() + shift * LATE) is None


def test_exchanged_rows_are_named() -> None:
    own = readings()
    own[[8, 17]] = own[[17, 8]]
    slip = slip_of(own)
    assert slip is not None
    assert (slip.kind, slip.rows.tolist()) == (RowSlipKind.EXCHANGED, [8, 17])


@pytest.mark.parametrize(("factor", "name"), [(np.pi / 180.0, "radians"), (-1.0, "deg with the opposite sign")])
def test_a_part_in_another_unit_is_named(factor: float, name: str) -> None:
    slip = slip_of(np.where(LATE, factor * readings(), readings()))
    assert slip is not None
    assert (slip.kind, slip.name) == (RowSlipKind.UNIT, name)
    assert LATE[slip.rows].all()


def test_a_lost_row_shifts_later_ones() -> None:
    own = readings()
    own[25:-1] = own[26:].copy()
    slip = slip_of(own)
    assert slip is not None
    assert (slip.kind, slip.name) == (RowSlipKind.SHIFTED, "-1")


@pytest.mark.parametrize("late", [1, 2, -1])
def test_a_column_that_is_shifted_as_a_whole_is_named(late: int) -> None:
    sweep = np.linspace(-100.0, 100.0, 11)
    command = np.concatenate([sweep, sweep[::-1]] * 3)
    noise = 1e-3 * np.random.default_rng(8).normal(size=len(command))
    slip = slip_of_rows(command, np.roll(command, late) + noise, 1.0, UNITS)
    assert slip is not None
    assert (slip.kind, slip.name, len(slip.rows)) == (RowSlipKind.SHIFTED, str(late), len(command))


def test_lost_motion_as_large_as_a_step_is_no_shift() -> None:
    sweep = np.linspace(-100.0, 100.0, 11)
    command = np.concatenate([sweep, sweep[::-1]] * 3)
    behind = np.repeat([-10.0, 10.0] * 3, len(sweep))  # a full gap of one step
    assert slip_of_rows(command, command + behind, 1.0, UNITS) is None


def test_copied_rows_are_distinguished_from_a_misread_digit() -> None:
    own = readings()
    own[20:26] = own[10:16]
    assert slip_of(own).kind is RowSlipKind.COPIED  # type: ignore[union-attr]
    own = readings()
    own[4] += 30.0
    slip = slip_of(own)
    assert slip is not None
    assert (slip.kind, slip.rows.tolist()) == (RowSlipKind.STRAY, [4])


def test_no_slip_is_named_where_most_rows_disagree() -> None:
    assert slip_of(np.random.default_rng(9).permutation(readings())) is None


@pytest.mark.parametrize(("factor", "unit"), [(1.0, ""), (3600.0, "arc seconds"), (60.0, ""), (1e-3, "")])
def test_deviations_in_another_unit_scatter_by_its_ratio(factor: float, unit: str) -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 37)
    noise = 8e-5 * np.random.default_rng(3).normal(size=74)
    deviation = 2e-3 * np.sin(np.concatenate([turn, turn[::-1]])) + 1e-3 * (np.arange(74) > 40) + noise
    command = np.concatenate([turn, turn[::-1]])
    assert unit_of_deviations(command, factor * deviation, 8e-5, {3600.0: "arc seconds"}) == unit


def _in_minutes(angles: np.ndarray, with_seconds: bool) -> np.ndarray:
    """Angles as a person copies them from a display: degrees, then minutes (and seconds) as decimals."""
    written = []
    for angle in angles:
        seconds = round(abs(angle) * 3600.0, 1)
        degrees, minutes, seconds = int(seconds // 3600), int(seconds % 3600 // 60), seconds % 60
        decimals = minutes / 100.0 + (seconds / 1e4 if with_seconds else seconds / 6e3)
        written.append(np.sign(angle) * (degrees + decimals))
    return np.array(written)


@pytest.mark.parametrize("with_seconds", [False, True])
@pytest.mark.parametrize("of_command", [False, True])
def test_angles_with_minutes_as_decimals_are_named(with_seconds: bool, of_command: bool) -> None:
    command = COMMAND + np.random.default_rng(3).uniform(-1.0, 1.0, COUNT)
    reading = command + 1e-3 * np.random.default_rng(4).normal(size=COUNT)
    written = _in_minutes(command if of_command else reading, with_seconds)
    columns = (written, reading) if of_command else (command, written)
    found, name = sexagesimal(*columns)
    assert (found, "MMSS" in name, bool(name)) == (of_command, with_seconds, True)


def test_small_errors_are_no_minutes() -> None:
    rng = np.random.default_rng(5)
    command = np.round(rng.uniform(-100.0, 100.0, COUNT)) + rng.uniform(0.0, 0.5, COUNT)
    assert sexagesimal(command, command + 0.01 * np.sin(command)) == (False, "")


SWEEPS = np.concatenate([np.linspace(-80.0, 80.0, 9), np.linspace(75.0, -85.0, 9)] * 4)
FINE = {3600.0: "arc seconds"}


@pytest.mark.parametrize("of", [np.abs, np.negative, np.radians, lambda command: 5.0 * np.round(command / 5.0)])
def test_effects_of_the_command_are_no_scatter_in_another_unit(of) -> None:  # type: ignore[no-untyped-def]
    command = np.tile([-83.0, -61.0, -40.0, -17.0, 3.0, 24.0, 45.0, 66.0, 88.0, 52.0], 8)
    noise = 1e-3 * np.random.default_rng(2).normal(size=len(command))
    for declared in (3e-4, 6e-4, 1e-3, 3e-3):
        assert unit_of_deviations(command, of(command) + noise - command, declared, FINE) == ""


def test_readings_in_another_order_are_distinguished_from_a_shift_and_from_effects() -> None:
    noise = 1e-3 * np.random.default_rng(3).normal(size=len(SWEEPS))
    reading = SWEEPS + 3.0 + noise
    assert other_order(SWEEPS, np.sort(reading))
    assert other_order(SWEEPS, np.random.default_rng(4).permutation(reading))
    for right in (reading, np.roll(reading, 1), reading + 5.0 * np.sign(np.diff(SWEEPS, prepend=-99.0)), -reading):
        assert not other_order(SWEEPS, right)


@pytest.mark.parametrize("step", [1e-6, 1e-4])
def test_a_copied_stretch_is_found_with_its_rows(step: float) -> None:
    noise = 1e-3 * np.random.default_rng(5).normal(size=len(SWEEPS))
    reading = step * np.round((SWEEPS + noise) / step)
    assert copied_stretch(SWEEPS, reading) is None
    reading[36:54] = reading[:18]
    assert copied_stretch(SWEEPS, reading) == (0, 36, 18)


def test_a_file_that_is_given_twice_is_a_copied_stretch_without_repeats_too() -> None:
    assert copied_stretch(np.tile(COMMAND, 2), np.tile(readings(), 2)) == (0, COUNT, COUNT)


@pytest.mark.parametrize("share", [1.0, 0.5, 0.1])
def test_coarse_readings_that_repeat_are_no_copies(share: float) -> None:
    rng = np.random.default_rng(6)
    for _ in range(40):
        off = np.where(rng.random(len(SWEEPS)) < np.sqrt(share), 0.0, rng.integers(-50, 50, len(SWEEPS)))
        assert copied_stretch(SWEEPS, SWEEPS + 1e-3 * off) is None


def test_values_that_each_command_returns_are_no_copies() -> None:
    rng = np.random.default_rng(7)
    reading = SWEEPS + 1e-3 * rng.normal(size=len(SWEEPS))
    assert (
        copied_stretch(SWEEPS, 0.02 * np.round((SWEEPS + 0.004 * np.sign(np.diff(SWEEPS, prepend=-99.0))) / 0.02))
        is None
    )
    assert copied_stretch(reading, SWEEPS) is None  # exchanged columns: the commands return
    edge = np.where(np.arange(len(SWEEPS)) % 9 == 4, 0.02 * np.sign(rng.normal(size=len(SWEEPS))), 0.0)
    assert copied_stretch(SWEEPS, SWEEPS + edge) is None
