"""Do the encoders of an axis move as far as its command: units, signs, counts, exchanged columns."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from types import MappingProxyType

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index
from truing.report.numbers import listed
from truing.stages.common.axis_columns import SI, AxisColumns
from truing.stages.common.point_arrays import number_column
from truing.stages.quality.check import FAIL, PASS, WARN, Check, not_evaluated

# What a column may have been written in instead, as the ratio of its movement to the command's.
UNIT_SLIPS: Mapping[str, Mapping[float, str]] = MappingProxyType(
    {
        "deg": {
            np.pi / 180.0: "radians",
            60.0: "arc minutes",
            3600.0: "arc seconds",
            1e3: "millidegrees",
            1.0 / 360.0: "turns",
            10.0 / 9.0: "gon",
        },
        "mm": {1e-3: "metres", 0.1: "centimetres", 1e3: "micrometres", 1.0 / 25.4: "inches"},
    }
)
FEWEST_MOVES = 3
_OF_SLIP = 0.01  # how near a ratio lies to that of a slip, or to that of another encoder
_ODD, _WRONG = 0.1, 2.0
_DEVIATING = 1e-2  # largest share of the movement that readings of deviations show
_PART = 0.3  # least share of the movements that make the others a slip of some rows
_LEAST_MOVE = 1e-3  # of the travel
# Exact values of commands: least share of different ones in the exchanged column, largest share in the other, their
# distance over the scatter about them, and how many decimals fewer they have.
_DIFFERENT, _REPEATED, _APART, _ROUNDER, _MOST_DECIMALS = 0.9, 0.5, 100.0, 2, 12


def movements(command: Array, reading: Array) -> tuple[float, int]:
    """Median ratio of the movements of reading (N,) and command (N,) between successive rows, and their number.

    Where a good part of the movements agrees, the ratio is that of this part: the others are a slip of some rows.
    """
    both = np.isfinite(command) & np.isfinite(reading)
    moves, movements_read = np.diff(command[both]), np.diff(reading[both])
    moved = np.abs(moves) > _LEAST_MOVE * np.ptp(command[both]) if both.any() else np.zeros(0, bool)
    if moved.sum() < FEWEST_MOVES:
        return np.nan, int(moved.sum())
    ratios = movements_read[moved] / moves[moved]
    agree = np.abs(ratios - 1.0) < _ODD
    return float(np.median(ratios[agree] if agree.mean() >= _PART else ratios)), int(moved.sum())


def unit_check(
    encoder: str, columns: AxisColumns, moved: Mapping[str, tuple[float, int]], exchanged: tuple[str, ...]
) -> Check:
    """Check that an encoder moves as far as the command.

    ``moved``: `movements` by encoder; ``exchanged``: two columns that belong in each other's place.
    """
    ratio, count = moved[encoder]
    if not np.isfinite(ratio):
        return not_evaluated("too few movements", "axis-units", encoder, f"the command moves {count} times")
    text = f"{columns.encoders[encoder]} moves {ratio:.6g} times as far as {columns.command}"
    is_odd = not _is_alike(ratio, columns.unit)
    column, slipped = columns.encoders[encoder], f"did you mean columns {' and '.join(exchanged)} exchanged?"
    if exchanged and is_odd:
        return _row(encoder, ratio, FAIL, f"{text}: {slipped}")
    if column in exchanged:
        why = f"{column} returns exact values, as commands do, and {columns.command} does not"
        return _row(encoder, ratio, FAIL, f"{why}: {slipped}")
    if is_odd and (meant := _meant(encoder, ratio, columns, moved)):
        return _row(encoder, ratio, FAIL, f"{text}: did you mean {meant}? Correct the unit or the sign.")
    if 0.0 < abs(ratio) < _DEVIATING and columns.loop != encoder:
        cure = f"did you mean deviations from {columns.command}? Those of an outside instrument belong in a column "
        cure += f"deviation_{columns.unit}; add the command to those of an encoder. Otherwise correct its unit."
        return _row(encoder, ratio, FAIL, f"{text}: {cure}")
    if not 1.0 / _WRONG <= ratio <= _WRONG:
        cure = f"Correct its unit, counts_per_{columns.unit} or the column that [mechanism] names."
        return _row(encoder, ratio, FAIL, f"{text}, which no axis does. {cure}")
    if is_odd:
        return _row(encoder, ratio, WARN, f"{text}: is its unit or counts_per_{columns.unit} right?")
    return _row(encoder, ratio, PASS, f"{text}.")


def exchanged_columns(table: pa.Table, columns: AxisColumns, in_time: Index) -> tuple[str, ...]:
    """Names of the two columns that are in each other's place; empty where the encoders agree, or no exchange helps.

    An exchange shows in the movements, if counts are among them. Commands are known by values that return exactly.
    """
    of = {columns.command: columns.command, **columns.encoders}
    raw = {column: number_column(table, column)[in_time] for column in of.values()}

    def moves_alike(named: Mapping[str, Array]) -> bool:
        si = {name: values / columns.recorded(name, np.array(SI[columns.unit])) for name, values in named.items()}
        ratios = np.array([movements(si[columns.command], si[name])[0] for name in columns.encoders.values()])
        return all(_is_alike(ratio, columns.unit) for ratio in ratios.tolist())

    are_alike = moves_alike(raw)
    for first, second in combinations(raw, 2):
        raw_exchanged = raw | {first: raw[second], second: raw[first]}
        is_command = first == columns.command and _hold_commands(raw[second], raw[first])
        if (is_command or not are_alike) and moves_alike(raw_exchanged):
            return first, second
    return ()


def _is_alike(ratio: float, unit: str) -> bool:
    """True if an encoder moves about as far as the command; not where the ratio is that of units as near as degrees
    and gon."""
    return abs(ratio - 1.0) < _ODD and not _unit_of(abs(ratio), unit) and not _unit_of(1.0 / abs(ratio), unit)


def _hold_commands(exact: Array, scattered: Array) -> bool:
    """True if values (N,) return exactly and are round, while those in the other column scatter about each of them."""
    known = np.isfinite(exact) & np.isfinite(scattered)
    exact, scattered = exact[known], scattered[known]
    values, group = np.unique(exact, return_inverse=True)
    if len(values) < FEWEST_MOVES or len(values) > _REPEATED * len(exact):
        return False
    if len(np.unique(scattered)) < _DIFFERENT * len(scattered) or _decimals(exact) + _ROUNDER > _decimals(scattered):
        return False
    off = scattered - exact
    within = max(float(np.ptp(off[group == number])) for number in range(len(values)))
    return bool(np.diff(values).min() > _APART * within)


def _decimals(values: Array) -> int:
    """Decimals with which all values (N,) are written."""
    scale = max(float(np.abs(values).max()), 1.0)
    digits = range(_MOST_DECIMALS)
    return next(
        (decimals for decimals in digits if np.abs(values - values.round(decimals)).max() < 1e-12 * scale),
        _MOST_DECIMALS,
    )


def _meant(encoder: str, ratio: float, columns: AxisColumns, moved: Mapping[str, tuple[float, int]]) -> str:
    """Slips of unit or sign that make the movements agree: of the encoder, or of the command and all that moves with
    it; empty where there is none."""
    ratios = {name: ratio_of_encoder for name, (ratio_of_encoder, _) in moved.items() if np.isfinite(ratio_of_encoder)}
    columns_that_agree = [
        columns.encoders[name]
        for name, ratio_of_encoder in ratios.items()
        if abs(ratio_of_encoder - ratio) > _OF_SLIP * abs(ratio)
    ]
    sign = " with the opposite sign" if ratio < 0.0 else ""
    own_unit, unit_of_others = _unit_of(abs(ratio), columns.unit), _unit_of(1.0 / max(abs(ratio), 1e-300), columns.unit)
    if sign and abs(abs(ratio) - 1.0) < _ODD:
        own_unit = unit_of_others = columns.unit
    of_command = f"{listed([columns.command, *columns_that_agree])} in {unit_of_others}{sign}" if unit_of_others else ""
    if len(ratios) > 1 and not columns_that_agree and of_command:  # what all encoders have in common is the command's
        return of_command
    is_other = not own_unit or (columns.encoders[encoder].endswith("_counts") and not sign)
    meant = [f"{columns.encoders[encoder]} in {own_unit}{sign}"] if own_unit else []
    return " or ".join([*meant, of_command] if of_command and is_other else meant)


def _unit_of(ratio: float, unit: str) -> str:
    """Name of the unit that makes this ratio of movements; empty where none does."""
    return next((words for at, words in UNIT_SLIPS[unit].items() if abs(ratio / at - 1.0) < _OF_SLIP), "")


def _row(encoder: str, ratio: float, verdict: str, text: str) -> Check:
    return Check("axis-units", encoder, ratio, 1.0, "1", verdict, text)
