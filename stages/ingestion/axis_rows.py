"""The raw rows of an axis: read, named, checked against campaign.toml."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa

from truing.formats.faultlog import FaultLog
from truing.formats.gather import Gathered, gather
from truing.formats.shapes import Shape
from truing.formats.source import CampaignFiles
from truing.report.numbers import count
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import Fault
from truing.schemas.near_names import meant
from truing.simulation.axis.rows import MEASURED
from truing.stages.common.axis_columns import AxisColumns, encoder_sigma
from truing.stages.common.gathered import once
from truing.stages.declaration import Outcome
from truing.stages.ingestion.tables import as_artifact, check_any_fitted

ROWS = Shape("configurations", ("pose",), ("role", "time_s", "temperature_c", "repeat_of", "event"), covariates=True)
_OTHER = {"deg": "mm", "mm": "deg"}


def ingest(settings: Any, source: CampaignFiles, log: FaultLog) -> Outcome:
    """Return the rows of an axis as `configurations`; raises CampaignFaults with everything that is wrong at once."""
    found = gather(source, ROWS, log, "pose")
    if found is None:
        if not source.entries("configurations"):
            log.add(Fault("configurations.csv", "this file, or [files.configurations] in campaign.toml"))
        log.throw()
        raise AssertionError("a table that cannot be read is a fault")
    once(found, log, ("pose",))
    columns = AxisColumns.of(settings.mechanism, found.table.column_names)
    _check_columns(found, columns, settings, log)
    table = _completed(found.table)
    check_any_fitted([table], found.first_file, "row", log)
    log.throw()
    left_out = dict(found.left_out)
    rows = [
        {"stage": "ingest", "subject": file, "reason": why, "rows": n, "by": "[files] of campaign.toml"}
        for (file, why), n in left_out.items()
    ]
    return Outcome(
        {
            "configurations": as_artifact("configurations", table),
            "exclusions": pa.Table.from_pylist(rows, schema=ARTIFACTS["exclusions"].arrow_schema()),
        },
        read=f"{count(len(table), 'row')} of a {columns.kind} axis",
        left_out="; ".join(f"{n:,} rows: {why}" for (_, why), n in left_out.items()) or "nothing",
        figure=f"command {columns.command}; recorded by {', '.join(columns.encoders.values())}",
    )


def _check_columns(found: Gathered, columns: AxisColumns, settings: Any, log: FaultLog) -> None:
    """Note columns that are named and missing, commands that are no number, encoders without noise or readings."""
    names, file = found.table.column_names, found.first_file
    for what, column in settings.mechanism.columns.items():
        if column not in names:
            hint = meant(column, names) or f"; there are {', '.join(names)}"
            log.add(Fault(file, f"this column, which [mechanism] {what} names{hint}", column=column))
    if columns.command in names:
        found.fault(
            log, np.isnan(_numbers(found, columns.command)), columns.command, "a number: the command of the row"
        )
    other = f"{MEASURED}_{_OTHER[columns.unit]}"
    if other in names and MEASURED not in columns.encoders:
        log.add(Fault(file, f"{MEASURED}_{columns.unit}: the axis is {columns.kind} ([mechanism] kind)", column=other))
    elif not columns.encoders and all(name in names for name in settings.mechanism.columns.values()):
        expected = f"what recorded the axis: {MEASURED}_{columns.unit}, or [mechanism] motor or load with their columns"
        log.add(Fault(file, expected, column=f"{MEASURED}_{columns.unit}"))
    for encoder, column in columns.encoders.items():
        if not np.isfinite(_numbers(found, column)).any():
            log.add(Fault(file, "a number in some rows: the column is empty", column=column))
        if encoder_sigma(settings, encoder) is None:
            log.lacks(f"noise.{encoder}_{columns.unit}", f"a standard deviation of {column}", file)
    if "time_s" in names:
        times = _numbers(found, "time_s")
        _, first = np.unique(times, return_index=True)
        again = ~np.isnan(times)
        again[first] = False
        found.fault(log, again, "time_s", "a time of its own for every row")
        found.fault(log, np.isnan(times), "time_s", "a number: times order the rows")


def _numbers(found: Gathered, name: str) -> Any:
    return np.asarray(found.table.column(name).to_numpy(zero_copy_only=False), dtype=float)


def _completed(table: pa.Table) -> pa.Table:
    """The role calibration, and the order of the rows as times, where the campaign gives neither."""
    if "role" not in table.column_names:
        table = table.append_column("role", pa.array(["calibration"] * len(table), pa.string()))
    if "time_s" not in table.column_names:
        table = table.append_column("time_s", pa.array(np.arange(len(table), dtype=float)))
    return table
