"""Input of axis rows: read, named and checked against campaign.toml."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa

from truing.formats.faultlog import FaultLog
from truing.formats.raw_tables import RawTable
from truing.formats.row_collection import CollectedRows, collect_rows
from truing.formats.source import CampaignFiles
from truing.report.numbers import count_text
from truing.schemas.faults import Fault
from truing.schemas.near_names import did_you_mean
from truing.simulation.axis.rows import MEASURED
from truing.stages.common.axis_columns import AxisColumns, encoder_sigma, planned_readings
from truing.stages.common.table_arrays import check_unique_keys, numbers
from truing.stages.declaration import Outcome
from truing.stages.ingestion.axis_places import angles, displacements, read_places
from truing.stages.ingestion.joined_readings import with_joined_readings
from truing.stages.ingestion.tables import (
    as_artifact,
    check_any_fitted,
    check_times,
    exclusions,
    left_out_words,
    with_role_and_time,
)

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import AxisMechanism

ROWS = RawTable(
    "configurations",
    ("pose",),
    ("role", "time_s", "temperature_c", "repeat_of", "event", "approach"),
    covariates=True,
    may_be_empty=("approach",),
)
DEVIATION = "deviation"
_OTHER = {"deg": "mm", "mm": "deg"}


def ingest(settings: Campaign, source: CampaignFiles, log: FaultLog, *, may_be_planned: bool = False) -> Outcome:
    """Return the rows of an axis as `configurations`; raises CampaignFaults with all faults at once.

    ``may_be_planned``: rows without any reading are a plan; every encoder with a declared noise then reads its command.
    """
    rows = collect_rows(source, ROWS, log, "pose")
    if rows is None:
        if not source.entries("configurations"):
            log.add(Fault("configurations.csv", "this file, or [files.configurations] in campaign.toml"))
        log.raise_faults()
        raise AssertionError("a table that cannot be read is a fault")
    check_unique_keys(rows, log, "pose")
    axis = cast("AxisMechanism", settings.mechanism)
    rows, joined = with_joined_readings(rows, source, log)
    rows = _with_deviations(rows, axis.columns["command"], log)
    rows = _with_places(rows, source, settings, log)
    if may_be_planned and axis.columns["command"] in rows.table.column_names:
        rows = replace(rows, table=planned_readings(rows.table, settings))
        if not AxisColumns.of(axis, rows.table.column_names).encoders:
            log.add_missing(
                f"noise.{MEASURED}_{axis.unit}", "the standard deviation of the instrument", rows.first_file
            )
            log.raise_faults()
    columns = AxisColumns.of(axis, rows.table.column_names)
    _check_columns(rows, columns, settings, log)
    table = with_role_and_time(rows.table)
    check_any_fitted([table], rows.first_file, "row", log)
    log.raise_faults()
    return Outcome(
        {"configurations": as_artifact("configurations", table), "exclusions": exclusions(rows.left_out)},
        read=f"{count_text(len(table), 'row')} of a {columns.kind} axis{joined and f'; {joined}'}",
        left_out=left_out_words(rows.left_out),
        figure=f"command {columns.command}; recorded by {', '.join(columns.encoders.values())}",
    )


def _with_deviations(collected: CollectedRows, command: str, log: FaultLog) -> CollectedRows:
    """Return rows with the places by an instrument that gives deviations from the command: command + deviation."""
    for unit in _OTHER:
        deviation_column, made = f"{DEVIATION}_{unit}", f"{MEASURED}_{unit}"
        if deviation_column not in collected.table.column_names:
            continue
        if (
            made in collected.table.column_names
            or command not in collected.table.column_names
            or not command.endswith(unit)
        ):
            expected = f"deviations from a command in {unit}, without a column {made} next to them"
            log.add(Fault(collected.first_file, expected, column=deviation_column))
            continue
        measured = pa.array(numbers(collected, command) + numbers(collected, deviation_column))
        collected = replace(
            collected, table=collected.table.drop_columns([deviation_column]).append_column(made, measured)
        )
    return collected


def _with_places(collected: CollectedRows, source: CampaignFiles, settings: Campaign, log: FaultLog) -> CollectedRows:
    """Return rows with the places by points or poses of the moved body, in a column of the outside instrument."""
    axis = cast("AxisMechanism", settings.mechanism)
    made, command = f"{MEASURED}_{axis.unit}", axis.columns["command"]
    poses = [str(pose) for pose in collected.table.column("pose").to_pylist()]
    points = read_places(source, poses, settings, log)
    if points is None or command not in collected.table.column_names:
        return collected
    if made in collected.table.column_names:
        log.add(Fault(collected.first_file, f"either {made}, or points and poses of what the axis moves", column=made))
        return collected
    commanded = numbers(collected, command)
    if command.endswith("_counts"):
        commanded = commanded / (axis.counts_per_unit or 1.0)
    measured = displacements(points, commanded) if axis.kind == "linear" else angles(points, commanded)
    if measured is None:
        expected = "two or more targets of the body, or one target around at least 270 deg, to determine angles"
        log.add(Fault("points.csv", expected, column="target"))
        return collected
    return replace(collected, table=collected.table.append_column(made, pa.array(measured, from_pandas=True)))


def _check_columns(collected: CollectedRows, columns: AxisColumns, settings: Campaign, log: FaultLog) -> None:
    """Report missing columns, commands without a number, and encoders without noise or readings."""
    names, file = collected.table.column_names, collected.first_file
    named = cast("AxisMechanism", settings.mechanism).columns
    for quantity, column in named.items():
        if column not in names:
            hint = did_you_mean(column, names) or f"; there are {', '.join(names)}"
            log.add(Fault(file, f"this column, which [mechanism] {quantity} names{hint}", column=column))
    if columns.command in names:
        collected.fault(
            log, np.isnan(numbers(collected, columns.command)), columns.command, "a number: the command of the row"
        )
    column_in_other_unit = f"{MEASURED}_{_OTHER[columns.unit]}"
    if column_in_other_unit in names and MEASURED not in columns.encoders:
        log.add(
            Fault(
                file,
                f"{MEASURED}_{columns.unit}: the axis is {columns.kind} ([mechanism] kind)",
                column=column_in_other_unit,
            )
        )
    elif not columns.encoders and all(name in names for name in named.values()):
        expected = f"what recorded the axis: {MEASURED}_{columns.unit}, or [mechanism] motor or load with their columns"
        log.add(Fault(file, expected, column=f"{MEASURED}_{columns.unit}"))
    for encoder, column in columns.encoders.items():
        if not np.isfinite(numbers(collected, column)).any():
            log.add(Fault(file, "a number in some rows: the column is empty", column=column))
        if encoder_sigma(settings, encoder) is None:
            log.add_missing(f"noise.{encoder}_{columns.unit}", f"a standard deviation of {column}", file)
    check_times(collected, log, names_matter=False)
    if "time_s" in names:
        collected.fault(log, np.isnan(numbers(collected, "time_s")), "time_s", "a number: times order the rows")
