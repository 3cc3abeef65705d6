"""Quality of axis rows: units, constant readings, copied rows, sides of approach."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import chain
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from scipy.special import chdtr, stdtr

from truing.arrays import Array
from truing.belonging.axis_rows import (
    AxisRowSlip,
    RowSlipKind,
    copied_stretch,
    other_order,
    sexagesimal,
    slip_of_rows,
    unit_of_deviations,
)
from truing.report.numbers import count_text, listed
from truing.simulation.axis.rows import ENCODERS, LOAD, MEASURED, MOTOR
from truing.stages.common.axis_columns import AxisColumns, columns_of, command_sigma, encoder_sigma
from truing.stages.common.point_arrays import number_column
from truing.stages.quality.axis_movement import UNIT_SLIPS, exchanged_columns, movements, unit_check
from truing.stages.quality.check import FAIL, PASS, WARN, CampaignLimits, Check, CheckResults, not_evaluated
from truing.stages.quality.time_and_temperature import temperature_columns, temperature_units

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

# Units in which an instrument may give deviations from the command, by their number in a unit of the column.
_DEVIATIONS = {"deg": {3600.0: "arc seconds"}, "mm": {1e3: "micrometres"}}
_WRONG = 2.0
# How many times its noise, and what the other does, the encoder of a wrong loop departs from the command.
_CLEARLY = 3.0
_SIGNS = (("", 1.0), (" with the opposite sign", -1.0))
_FEW = 0.1  # share of the rows
_FEWEST, _FEWEST_ROWS = 3, 8
_UNIFORM = float(np.sqrt(12.0))  # step over the standard deviation of what it rounds
_SAME = 0.9  # least share of equal rows of two columns that are one
_SURELY = 3.0  # standard deviations of a number that chance gives
_NEAR, _MOST_REPEATS = 3, 30  # steps of the resolution; rows of one command that are compared
# From here on, readings are so coarse that equal rows say nothing.
_COARSE = 0.5
# Pairs that show a scatter, the factor of a declared noise that is too large, and its level; digits of deviations.
_FEWEST_PAIRS, _TOO_LARGE, _UNLIKELY, _DIGITS = 8, 1.5, 1e-3, 12


def checks(tables: Mapping[str, pa.Table], settings: Campaign) -> CheckResults:
    """Return all checks of the rows of an axis."""
    table = tables["configurations"]
    columns = columns_of(settings, table)
    limits = CampaignLimits(settings.campaign.kind, settings.qa.limits)
    sigmas = {name: encoder_sigma(settings, name) or 0.0 for name in columns.encoders}
    results = _checks(table, columns, command_sigma(settings), sigmas, limits)
    warmth = _temperatures(table, columns, settings.mechanism.reference_temperature_c)
    return CheckResults(chain(results, warmth), f"{count_text(len(table), 'row')} of an axis")


def _checks(
    table: pa.Table, columns: AxisColumns, off: float, sigmas: Mapping[str, float], limits: CampaignLimits
) -> Iterator[Check]:
    rows = columns.rows(table, off)
    in_time = np.argsort(rows.order)
    command = rows.command[in_time]
    readings = {encoder: columns.si(table, column)[in_time] for encoder, column in columns.encoders.items()}
    moved = {encoder: movements(command, reading) for encoder, reading in readings.items()}
    exchanged = exchanged_columns(table, columns, in_time)
    units = {encoder: unit_check(encoder, columns, moved, exchanged) for encoder in columns.encoders}
    yield from units.values()
    for encoder, column in columns.encoders.items():
        raw = number_column(table, column)[in_time]
        poses, reading = np.array(rows.poses, object)[in_time], readings[encoder]
        sigma = sigmas[encoder] if encoder == MEASURED else 0.0
        yield (
            _same(encoder, columns, rows.command[in_time], readings)
            or _order(encoder, command, reading)
            or _in_another_order(encoder, columns, command, reading, poses)
            or _deviations(encoder, columns, command, reading, sigma)
            or _rows(encoder, columns, command, reading, poses)
        )
        yield _repeated_readings(encoder, command, raw, np.array(rows.poses, object)[in_time], off, limits)
    deviations = columns.deviations(table)
    for encoder, deviation in zip(columns.encoders, deviations.T, strict=True):
        if units[encoder].verdict == FAIL:  # neither its noise nor its unit is known
            yield not_evaluated("another unit", "axis-noise", encoder, "the encoder moves unlike the command")
            continue
        yield noise_of_rows(encoder, rows.command, rows.direction, deviation, float(np.hypot(off, sigmas[encoder])))
    if any(check.verdict == FAIL for check in units.values()):
        yield not_evaluated("another unit", "axis-encoders", "", "an encoder moves unlike the command")
    else:
        steps = {name: float(np.diff(np.unique(reading)).min(initial=np.inf)) for name, reading in readings.items()}
        declared = {
            name: float(np.hypot(np.hypot(off, sigma), steps[name] / _UNIFORM)) for name, sigma in sigmas.items()
        }
        yield encoders_in_place(columns, dict(zip(columns.encoders, deviations.T, strict=True)), declared)
    yield _repeated(table, columns, np.array(rows.poses, object), limits)
    yield _approach(rows.direction, limits)


def _temperatures(table: pa.Table, columns: AxisColumns, reference_c: float) -> Iterator[Check]:
    """Check that columns of temperatures are in degrees Celsius."""
    recorded = {name: number_column(table, name) for name in temperature_columns(table.column_names)}
    rows = [f"row {pose}" for pose in table.column("pose").to_pylist()]
    yield from temperature_units(recorded, reference_c, rows, np.argsort(columns.rows(table, 0.0).order))


def noise_of_rows(encoder: str, command: Array, direction: Array, deviations: Array, declared: float) -> Check:
    """Check that deviations (N,), rad or m, scatter as much as declared: between pairs of neighbouring commands from
    one side. Effects of the axis can only enlarge that scatter."""
    if not declared > 0.0:
        return not_evaluated("no declared noise", "axis-noise", encoder, "neither encoder nor command has a noise")
    known = np.isfinite(command) & np.isfinite(deviations) & (direction != 0.0)
    pairs = []
    for side in (-1.0, 1.0):
        rows = np.flatnonzero(known & (np.sign(direction) == side))
        rows = rows[np.argsort(command[rows], kind="stable")]
        pairs.append(deviations[rows[: len(rows) // 2 * 2]].reshape(-1, 2))
    both = np.concatenate(pairs)
    if len(both) < _FEWEST_PAIRS:
        return not_evaluated(
            "too few rows", "axis-noise", encoder, f"{count_text(len(both), 'pair')} of neighbouring rows"
        )
    if len(np.unique(np.round(both, _DIGITS))) < _COARSE * both.size:
        return not_evaluated("too coarse", "axis-noise", encoder, "most readings repeat to the last digit")
    squares = float(np.sum((both[:, 1] - both[:, 0]) ** 2)) / (2.0 * declared**2)
    ratio = float(np.sqrt(squares / len(both)))
    is_small = chdtr(len(both), squares * _TOO_LARGE**2) < _UNLIKELY
    text = f"Neighbouring readings of {encoder} scatter by {ratio:.2g} times the declared noise"
    text += (
        ": the declared noise is too large, so that small effects may be missed. Correct [noise]" if is_small else ""
    )
    return Check("axis-noise", encoder, ratio, 1.0 / _TOO_LARGE, "1", WARN if is_small else PASS, f"{text}.")


def encoders_in_place(
    columns: AxisColumns, deviations: Mapping[str, Array], noise: Mapping[str, float] = MappingProxyType({})
) -> Check:
    """Check that the outside instrument agrees with the load encoder, and that of the loop with the command.

    ``deviations`` (N,) of each encoder from the command, rad or m, and their declared ``noise``. Both comparisons are
    Pitman's test of correlated variances (Biometrika 31 (1939) 9). The columns are exchanged if the instrument agrees
    with the motor and the other encoder follows the command; or the load encoder errs in another loop.
    """
    unit = columns.reported_unit
    missing = [encoder_name for encoder_name in ENCODERS if encoder_name not in deviations]
    if len(missing) == 1 and columns.loop in deviations:
        return _loop_follows(columns, deviations, noise)
    if missing:
        return not_evaluated("one is missing", "axis-encoders", "", f"no readings of {listed(missing)}")
    known = np.isfinite(np.column_stack([deviations[encoder_name] for encoder_name in ENCODERS])).all(1)
    if known.sum() < _FEWEST_ROWS:
        return not_evaluated(
            "too few rows", "axis-encoders", "", f"{count_text(int(known.sum()), 'row')} with all encoders"
        )
    motor, load, measured = (deviations[encoder_name][known] for encoder_name in ENCODERS)
    loop, other = (MOTOR, LOAD) if columns.loop == MOTOR else (LOAD, MOTOR)
    of_loop, of_other = (motor, load) if columns.loop == MOTOR else (load, motor)
    named = {encoder_name: columns.encoders[encoder_name] for encoder_name in ENCODERS}
    apart = [f"{np.std(measured - encoder) / unit[1]:.3g}" for encoder in (load, motor)]
    text = f"{named[MEASURED]} departs from {named[LOAD]} by {apart[0]} {unit[0]} and from {named[MOTOR]} by {apart[1]}"
    ratio = float(np.std(measured - motor) / max(float(np.std(measured - load)), 1e-300))
    size = float(np.std(of_loop))
    is_far = size > _CLEARLY * noise.get(loop, 0.0)
    if max(_larger_variance(measured - load, measured - motor), _larger_variance(of_loop, of_other)) < _UNLIKELY:
        text += f", and {named[other]} follows the command. Did you mean: columns {named[MOTOR]} and {named[LOAD]} "
        text += f'exchanged? Or loop = "{other}", if the load encoder errs.'
        verdict = FAIL if is_far and size > _CLEARLY * float(np.std(of_other)) else WARN
        return Check("axis-encoders", "", ratio, 1.0, "1", verdict, text)
    if is_far and size > _CLEARLY * float(np.std(measured)) and _larger_variance(of_loop, measured) < _UNLIKELY:
        text = f"{named[loop]} departs from the command by {size / unit[1]:.3g} {unit[0]} and {named[MEASURED]} by "
        text += f"{np.std(measured) / unit[1]:.3g}, but the controller holds the encoder of the loop to the command. "
        text += f"Did you mean: columns {named[loop]} and {named[MEASURED]} exchanged?"
        return Check("axis-encoders", "", ratio, 1.0, "1", FAIL, text)
    return Check("axis-encoders", "", ratio, 1.0, "1", PASS, f"{text}.")


def _loop_follows(columns: AxisColumns, deviations: Mapping[str, Array], noise: Mapping[str, float]) -> Check:
    """Check that the encoder of the loop follows the command no worse than the other: the controller holds it there."""
    loop, (other, *_) = columns.loop, [name for name in ENCODERS if name in deviations and name != columns.loop]
    known = np.isfinite(deviations[loop]) & np.isfinite(deviations[other])
    if known.sum() < _FEWEST_ROWS:
        return not_evaluated(
            "too few rows", "axis-encoders", "", f"{count_text(int(known.sum()), 'row')} with both encoders"
        )
    of_loop, of_other = (deviations[encoder_name][known] for encoder_name in (loop, other))
    sizes = [float(np.std(difference)) for difference in (of_loop, of_other)]
    ratio = sizes[0] / max(sizes[1], 1e-300)
    is_astray = sizes[0] > _CLEARLY * noise.get(loop, 0.0) and _larger_variance(of_loop, of_other) < _UNLIKELY
    unit, named = columns.reported_unit, [columns.encoders[encoder_name] for encoder_name in (loop, other)]
    texts = [f"{size / unit[1]:.3g} {unit[0]}" for size in sizes]
    text = f"{named[0]} departs from the command by {texts[0]} and {named[1]} by {texts[1]}"
    if not is_astray:
        return Check("axis-encoders", "", ratio, 1.0, "1", PASS, f"{text}.")
    text += f', but the controller holds the encoder of the loop ("{loop}") to the command. Did you mean '
    text += f'loop = "{other}" in [mechanism], or ' if other != MEASURED else ""
    text += f"columns {named[0]} and {named[1]} exchanged?"
    return Check("axis-encoders", "", ratio, 1.0, "1", FAIL if ratio > _CLEARLY else WARN, text)


def _larger_variance(first: Array, second: Array) -> float:
    """Return the one-sided p-value of equal variances of correlated values (N,) if the first one's is larger."""
    total, difference = first + second, first - second
    total, difference = total - total.mean(), difference - difference.mean()
    scale = float(np.sqrt(np.sum(total**2) * np.sum(difference**2)))
    r = min(max(float(total @ difference) / scale, -1.0 + 1e-12), 1.0 - 1e-12) if scale > 0.0 else 0.0
    return float(stdtr(len(first) - 2, -r * np.sqrt((len(first) - 2) / (1.0 - r**2))))


def _same(encoder: str, columns: AxisColumns, command: Array, readings: Mapping[str, Array]) -> Check | None:
    """Return the failed check of an encoder that equals another column in every digit; None if it differs from all.

    The encoder of the loop may stand at the command.
    """
    columns_to_compare = {columns.command: command} if encoder != columns.loop else {}
    columns_to_compare |= {columns.encoders[name]: readings[name] for name in readings if name != encoder}
    for name, other in columns_to_compare.items():
        both = np.isfinite(readings[encoder]) & np.isfinite(other)
        equal = np.isclose(readings[encoder][both], other[both], rtol=1e-12, atol=1e-15)
        if both.sum() >= _FEWEST_ROWS and equal.mean() >= _SAME and len(np.unique(other[both])) >= _FEWEST:
            text = (
                f"{columns.encoders[encoder]} equals {name} in every digit in {count_text(int(equal.sum()), 'row')}. "
            )
            text += "Did you mean another column, or is the reading coarser than the errors of the axis?"
            return Check("axis-rows", encoder, float(equal.sum()), 0.0, "1", FAIL, text)
    return None


def _order(encoder: str, command: Array, reading: Array) -> Check | None:
    """Return the failed check of readings that belong to the commands in another order of rows; None if they do not."""
    both = np.isfinite(command) & np.isfinite(reading)
    if not other_order(command[both], reading[both]):
        return None
    text = f"Readings of {encoder} belong to the commands, but in another order of rows. Was one column sorted?"
    return Check("axis-rows", encoder, float(both.sum()), 0.0, "1", FAIL, text)


def _deviations(encoder: str, columns: AxisColumns, command: Array, reading: Array, sigma: float) -> Check | None:
    """Return the failed check of deviations from the command that were read in another unit; None if they were not."""
    both = np.isfinite(command) & np.isfinite(reading)
    units = _DEVIATIONS[columns.unit]
    unit = unit_of_deviations(command[both], (reading - command)[both], sigma, units)
    if not unit:
        return None
    factor = next(size for size, name in units.items() if name == unit)
    text = f"Readings of {encoder} scatter from row to row by about {factor:g} times the declared noise. "
    text += f"Did you mean: deviations from the command in {unit}? Correct their unit, or the noise of {encoder}."
    return Check("axis-rows", encoder, factor, 1.0, "1", FAIL, text)


def _rows(encoder: str, columns: AxisColumns, command: Array, reading: Array, poses: NDArray[np.object_]) -> Check:
    """Check that every reading belongs to the command of its own row."""
    both = np.isfinite(command) & np.isfinite(reading)
    ratio, count = movements(command, reading)
    if not np.isfinite(ratio):
        return not_evaluated("too few movements", "axis-rows", encoder, f"the command moves {count} times")
    if not 1.0 / _WRONG <= ratio <= _WRONG:
        return not_evaluated("another unit", "axis-rows", encoder, "the encoder moves unlike the command")
    if columns.unit == "deg" and (written := _minutes(encoder, command[both], reading[both])) is not None:
        return written
    slip = slip_of_rows(command[both], reading[both], ratio, _units(columns))
    if slip is None and (copied := copied_stretch(command[both], reading[both])) is not None:
        return _copied(encoder, poses[both], *copied)
    if slip is None:
        return Check("axis-rows", encoder, 0.0, 0.0, "1", PASS, "Every reading belongs to the command of its row.")
    return _misplaced(encoder, slip, poses[both])


def _units(columns: AxisColumns) -> dict[str, float]:
    """Factors by which numbers in other units, or with the opposite sign, are right, by the words for them."""
    units = {f"{words}{sign}": factor / at for at, words in UNIT_SLIPS[columns.unit].items() for sign, factor in _SIGNS}
    return units | {f"{columns.unit}{sign}": factor for sign, factor in _SIGNS if factor < 0.0}


def _in_another_order(
    encoder: str, columns: AxisColumns, command: Array, reading: Array, poses: NDArray[np.object_]
) -> Check | None:
    """Return the failed check of readings that are shifted, or reversed from one turn to the next; None if they are
    not. Such rows scatter, too."""
    both = np.isfinite(command) & np.isfinite(reading)
    ratio, _ = movements(command, reading)
    if not (np.isfinite(ratio) and 1.0 / _WRONG <= ratio <= _WRONG):
        return None
    slip = slip_of_rows(command[both], reading[both], ratio, _units(columns))
    if slip is None or slip.kind not in (RowSlipKind.SHIFTED, RowSlipKind.REVERSED):
        return None
    return _misplaced(encoder, slip, poses[both])


def _misplaced(encoder: str, slip: AxisRowSlip, poses: NDArray[np.object_]) -> Check:
    """Return the check of readings (N,) of which some rows do not belong to their commands."""
    affected = f"{count_text(len(slip.rows), 'row')}: {listed([str(pose) for pose in poses[slip.rows]])}"
    whose = "their rows" if len(slip.rows) == len(poses) else affected
    text = f"Readings of {encoder} do not belong to the commands of {whose}."
    meant = {
        RowSlipKind.EXCHANGED: " Did you mean: readings of these rows exchanged?",
        RowSlipKind.SHIFTED: f" Did you mean: readings of these rows shifted by {slip.name} rows?",
        RowSlipKind.REVERSED: " Did you mean: the way back written in the order of the way there?",
        RowSlipKind.UNIT: f" Did you mean: these rows in {slip.name}?",
        RowSlipKind.COPIED: " They are equal in every digit to those of other rows.",
        RowSlipKind.STRAY: "",
    }[slip.kind]
    verdict = WARN if slip.kind is RowSlipKind.STRAY and len(slip.rows) <= _FEW * len(poses) else FAIL
    return Check("axis-rows", encoder, float(len(slip.rows)), 0.0, "1", verdict, f"{text}{meant}")


def _copied(encoder: str, poses: NDArray[np.object_], first: int, again: int, count: int) -> Check:
    """Return the failed check of a stretch of rows that returns in every digit."""
    text = f"Readings of {encoder} in rows {poses[again]} to {poses[again + count - 1]} equal those in rows "
    text += (
        f"{poses[first]} to {poses[first + count - 1]} in every digit. Were rows, or a file, copied? Remove the copy."
    )
    return Check("axis-rows", encoder, float(count), 0.0, "1", FAIL, text)


def _minutes(encoder: str, command: Array, reading: Array) -> Check | None:
    """Check for angles, rad, that were written with minutes in place of decimals; None where there are none such."""
    of_command, notation = sexagesimal(np.degrees(command), np.degrees(reading))
    if not notation:
        return None
    whose = "Commands" if of_command else f"Readings of {encoder}"
    text = f"{whose} have no decimals from .60 to .99. Did you mean: {notation}? Write decimal degrees."
    return Check("axis-rows", encoder, float(len(reading)), 0.0, "1", FAIL, text)


def _repeated_readings(
    encoder: str, command: Array, raw: Array, poses: NDArray[np.object_], off: float, limits: CampaignLimits
) -> Check:
    """Check for rows whose reading equals the previous one exactly, although the command moved."""
    steps = np.abs(np.diff(command))
    known = np.isfinite(raw[1:]) & np.isfinite(raw[:-1])
    least = max(10.0 * off, 1e-3 * float(np.ptp(command[np.isfinite(command)])))
    moved = known & (steps > least)
    if moved.sum() < _FEWEST:
        return not_evaluated(
            "too few movements", "axis-standing-rows", encoder, f"the command moves {int(moved.sum())} times"
        )
    current = moved & (np.diff(raw) == 0.0)
    share = float(current.sum() / moved.sum())
    named = listed([str(pose) for pose in poses[1:][current]])
    text = f"{int(current.sum())} of {int(moved.sum())} moves of the command do not change the reading"
    text += f": rows {named}. Check whether the axis was disabled, or cells were filled down." if named else "."
    return limits.of("axis-standing-rows").row(encoder, share, "1", text)


def _repeated(table: pa.Table, columns: AxisColumns, poses: NDArray[np.object_], limits: CampaignLimits) -> Check:
    """Check for rows equal to an earlier row in command and all encoders, beyond those that the resolution repeats by
    chance."""
    raw = np.column_stack([number_column(table, name) for name in (columns.command, *columns.encoders.values())])
    is_complete = np.isfinite(raw).all(1)
    beside = [number_column(table, name) for name in temperature_columns(table.column_names)]  # equal in copies, too
    recorded = np.nan_to_num(np.column_stack([raw, *beside])[is_complete])
    _, first, inverse = np.unique(recorded, axis=0, return_index=True, return_inverse=True)
    again = np.flatnonzero(is_complete)[first[np.ravel(inverse)] != np.arange(int(is_complete.sum()))]
    # Readings relative to the command of rows sent elsewhere that are equal as well: as many repeat by chance.
    away = np.round(raw[is_complete][:, 1:] - raw[is_complete][:, :1], 9)
    share = 1.0 - len(np.unique(away, axis=0)) / max(len(away), 1)
    expected = max(share * len(again), _equal_by_chance(raw[is_complete][:, 0], away))
    beyond = max(len(again) - expected - _SURELY * np.sqrt(expected), 0.0) if share < _COARSE else 0.0
    named = listed([str(pose) for pose in poses[again]])
    text = f"{len(again)} rows are equal to an earlier one in every digit of all encoders"
    if again.size:
        text += (
            f": rows {named}. Remove copies; if the encoders have no finer resolution, declare their step in [noise]."
        )
    else:
        text += "."
    return limits.of("axis-repeated-rows").row("", float(np.floor(beyond)), "1", text)


def _equal_by_chance(command: Array, away: Array) -> float:
    """Return the expected number of pairs of rows of one command that the encoders' resolution makes equal: a share of
    the pairs that lie within some steps of it."""
    steps = [np.diff(np.unique(reading)) for reading in away.T]
    if not all(step.size for step in steps):
        return 0.0
    resolution, order = np.array([float(step.min()) for step in steps]), np.argsort(command, kind="stable")
    near = 0
    for lag in range(1, min(_MOST_REPEATS, len(order))):
        is_pair = command[order][lag:] == command[order][:-lag]
        changes = np.abs(away[order][lag:] - away[order][:-lag])[is_pair] / resolution
        near += int(np.sum((changes < _NEAR + 0.5).all(1) & (changes > 0.5).any(1)))
    return near / ((2 * _NEAR + 1) ** away.shape[1] - 1)


def _approach(direction: Array, limits: CampaignLimits) -> Check:
    share = float(min(np.mean(direction > 0.0), np.mean(direction < 0.0)))
    text = f"{100.0 * share:.0f} % of the rows were approached from the less frequent side"
    text += "" if share else ": lost motion cannot be detected. Measure the same commands from the other side too"
    return limits.of("axis-approach").row("", share, "1", f"{text}.")
