"""Columns of an axis campaign for command and encoders, and their units in SI."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index, Mask
from truing.simulation.axis.rows import (
    COMMAND,
    ENCODERS,
    MEASURED,
    ROTARY,
    Axis,
    AxisRows,
)
from truing.stages.common.point_arrays import number_column

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import AxisMechanism
    from truing.schemas.sections import Overrule


APPROACH = "approach"  # column of the recorded direction of approach
NUMBERED = ("pose", "role", "time_s", "event", "repeat_of", APPROACH)
SI = {"deg": np.pi / 180.0, "mm": 1e-3}
REPORTED_UNITS = {"deg": ("arcsec", np.pi / 180.0 / 3600.0), "mm": ("um", 1e-6)}
"""Unit of reported errors by the unit of the axis, and its value in SI."""
_TURN = 2.0 * np.pi
_COUNTS = "_counts"
_DIGITS = 9  # of commands, rad or m
# Sizes of counters, and the part of their range within which all deviations lie if nothing but overflows is large.
_BITS, _WITHIN = range(16, 33), 0.02
_WITHIN_TURN = 0.1  # the same of a turn, where an encoder counts turns
# Smallest change of the command that counts as a movement, in standard deviations of the axis from its command.
_MOVED = 5.0


@dataclass(frozen=True)
class AxisColumns:
    """Columns of the command and of the encoders by name; ``per_unit``: counts per deg or mm;
    ``period``: of a periodic error, deg or mm.
    """

    kind: str
    unit: str
    loop: str
    command: str
    encoders: dict[str, str]
    per_unit: float | None
    period: float | None = None

    @classmethod
    def of(cls, section: AxisMechanism, names: list[str]) -> AxisColumns:
        """Return the columns named in campaign.toml, and that of the external instrument if the table has it."""
        named = dict(section.columns)
        command = named.pop(COMMAND)
        if (measured := f"{MEASURED}_{section.unit}") in names:
            named[MEASURED] = measured
        encoders = {name: named[name] for name in ENCODERS if named.get(name) in names}
        return cls(section.kind, section.unit, section.loop, command, encoders, section.counts_per_unit, section.period)

    def axis(self, command_sigma: float) -> Axis:
        """Return the axis with the encoders that were recorded; command_sigma as in `rows`."""
        period = None if self.period is None else self.period * SI[self.unit]
        return Axis(self.kind, tuple(self.encoders), self.loop, _MOVED * command_sigma, period=period)

    @property
    def reported_unit(self) -> tuple[str, float]:
        """Return the unit of reported errors, and its value in SI."""
        return REPORTED_UNITS[self.unit]

    def si(self, table: pa.Table, column: str) -> Array:
        """Return a column (N,) in rad or m, NaN if empty."""
        return number_column(table, column) / self._counts(column) * SI[self.unit]

    def recorded(self, column: str, values: Array) -> Array:
        """Return positions (N,), rad or m, in the unit of a column; inverse of `si`."""
        return np.asarray(values / SI[self.unit] * self._counts(column))

    def _counts(self, column: str) -> float:
        """Return the counts per deg or mm of a column; 1 if it holds no counts."""
        return self.per_unit if column.endswith(_COUNTS) and self.per_unit else 1.0

    def commands(self, table: pa.Table) -> Array:
        """Return the commands (N,), rad or m; those of a rotary axis within one turn go on over turns that an encoder
        counts: it agrees with the command but for whole turns, and with them the axis moves no farther."""
        command = self.si(table, self.command)
        known = np.isfinite(command)
        if self.kind != ROTARY or not known.any() or np.ptp(command[known]) >= _TURN:
            return command
        in_time = np.argsort(number_column(table, "time_s"), kind="stable")
        in_time = in_time[known[in_time]]
        for column in self.encoders.values():
            reading = self.si(table, column)
            both = known & np.isfinite(reading)
            if both[known].all() and np.ptp(reading[known]) > _TURN:
                off = reading - command
                away = off - np.median(off[known])
                turns = _TURN * np.round(away / _TURN)
                is_shorter = _travel((command + turns)[in_time]) <= _travel(command[in_time])
                if is_shorter and np.abs(away - turns)[known].max() < _WITHIN_TURN * _TURN:
                    return np.asarray(command + turns)
        return command

    def rows(self, table: pa.Table, command_sigma: float) -> AxisRows:
        """Return the rows of a table; command_sigma: standard deviation of the axis from its command, rad or m."""
        command, time_s = self.commands(table), number_column(table, "time_s")
        column_names = {self.command, *self.encoders.values(), *NUMBERED}
        other_columns = {
            field.name: number_column(table, field.name)
            for field in table.schema
            if field.name not in column_names and str(field.type) in ("double", "int64")
        }
        poses, least = table.column("pose").to_pylist(), self.axis(command_sigma).least_move
        recorded = number_column(table, APPROACH) if APPROACH in table.column_names else None
        return AxisRows.of(poses, time_s, command, least, _events_in_time(table, time_s), other_columns, recorded)

    def deviations(self, table: pa.Table) -> Array:
        """Return encoder readings minus command (N, K), rad or m, without whole turns and overflows; NaN if empty."""
        command, columns = self.si(table, self.command), self.encoders.values()
        deviation = np.column_stack([self.si(table, column) - command for column in columns])
        for deviation_of_column, column in zip(deviation.T, columns, strict=True):
            if column.endswith(_COUNTS):
                deviation_of_column -= _overflows(
                    deviation_of_column, number_column(table, column), SI[self.unit] / self._counts(column)
                )
        if self.kind != ROTARY:
            return deviation
        middle = np.array([_middle_in_turn(row[np.isfinite(row)]) for row in deviation.T])
        return np.asarray(deviation - _TURN * np.round((deviation - middle) / _TURN))


def _middle_in_turn(deviation: Array) -> float:
    """Return the median of deviations (N,), rad, up to whole turns: about their mean direction, as half of the readings
    may be a turn larger; 0 without any."""
    if not deviation.size:
        return 0.0
    direction = float(np.angle(np.mean(np.exp(1j * deviation))))
    near = deviation - _TURN * np.round((deviation - direction) / _TURN)
    middle = float(np.median(near))
    return middle + _TURN * float(np.round((np.median(deviation) - middle) / _TURN))


def excluded_rows(rules: tuple[Overrule, ...], rows: AxisRows) -> Mask:
    """Mask (N,) of rows named by a person; rules on bodies or targets match no row."""
    named = {str(rule.pose) for rule in rules if rule.pose is not None and rule.body is None and rule.target is None}
    return np.array([str(pose) in named for pose in rows.poses], bool)


def targets_of(command: Array) -> tuple[Array, Index]:
    """Return the commands (P,) that differ by more than rounding, and the number (N,) of that of each row."""
    target, number = np.unique(np.round(command, _DIGITS), return_inverse=True)
    return target, number.ravel().astype(np.int64)


def _travel(positions: Array) -> float:
    """Sum of the movements between successive positions (N,)."""
    return float(np.abs(np.diff(positions)).sum())


def _overflows(off: Array, counts: Array, count: float) -> Array:
    """Return the steps that overflows of a counter removed from deviations (N,); ``count`` is the size of one count.

    All counts lie within a range of 16 to 32 bits, and the deviations, apart from whole ranges, within a small part of
    it.
    """
    none, known = np.zeros(len(off)), np.isfinite(off)
    low, high = (counts[known].min(), counts[known].max()) if known.any() else (0.0, 0.0)
    for bits in _BITS:
        first = 0.0 if low >= 0.0 else -(2.0 ** (bits - 1))
        if first <= low and high < first + 2.0**bits:
            span = 2.0**bits * count
            away = np.where(known, off - np.median(off[known]), 0.0)
            ranges = span * np.round(away / span)
            return ranges if np.abs(away - ranges).max() < _WITHIN * span else none
    return none


def columns_of(settings: Campaign, table: pa.Table) -> AxisColumns:
    """Return the columns of a campaign's table by content."""
    return AxisColumns.of(cast("AxisMechanism", settings.mechanism), table.schema.names)


def command_sigma(settings: Campaign) -> float:
    """Return the standard deviation of the axis from its command, rad or m."""
    unit = cast("AxisMechanism", settings.mechanism).unit
    return float(getattr(settings.noise, f"command_{unit}") * SI[unit])


def encoder_sigma(settings: Campaign, encoder: str) -> float | None:
    """Return the standard deviation of an encoder's reading, rad or m; None if not declared."""
    unit = cast("AxisMechanism", settings.mechanism).unit
    sigma = getattr(settings.noise, f"{encoder}_{unit}")
    return None if sigma is None else float(sigma * SI[unit])


def planned_readings(table: pa.Table, settings: Campaign) -> pa.Table:
    """Return rows without any reading with the commands in place of readings; others unchanged.

    Every named encoder will be read, and the outside instrument if it has a noise.
    """
    axis = cast("AxisMechanism", settings.mechanism)
    measured, command = f"{MEASURED}_{axis.unit}", axis.columns[COMMAND]
    has_instrument = encoder_sigma(settings, MEASURED) is not None
    wanted = [column for name, column in axis.columns.items() if name != COMMAND] + [measured] * has_instrument
    present = [column for column in dict.fromkeys([*wanted, measured]) if column in table.column_names]
    if command not in table.column_names or any(np.isfinite(number_column(table, name)).any() for name in present):
        return table
    columns = AxisColumns.of(axis, table.column_names)
    position = columns.si(table, command)
    table = table.drop_columns(present)
    for column in dict.fromkeys([*wanted, *present]):
        table = table.append_column(column, pa.array(columns.recorded(column, position)))
    return table


def _events_in_time(table: pa.Table, time_s: Array) -> tuple[tuple[str, float], ...]:
    """Return the events, and the time of the first row after each.

    An event is a change to another text that is not empty.
    """
    if "event" not in table.schema.names:
        return ()
    named = table.column("event").to_pylist()
    events, before = [], ""
    for row in np.argsort(time_s, kind="stable"):
        now = (named[row] or "").strip()
        if now and now != before:
            events.append((now, float(time_s[row])))
        before = now
    return tuple(events)
