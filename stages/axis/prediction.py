"""Prediction of encoder readings by an extended model of an axis."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import CampaignFaults, Fault
from truing.simulation.axis.extended_model import predict_axis, read_axis
from truing.simulation.axis.rows import ROTARY, AxisRows
from truing.stages.common.axis_columns import APPROACH, SI
from truing.stages.common.point_arrays import number_column

if TYPE_CHECKING:
    import pyarrow as pa


def predicted(model: str, table: pa.Table, file: str) -> pa.Table:
    """Return rows of axis_prediction, one per pose and encoder, for a table of commands in the order of time.

    Needs the columns pose and command_deg (a linear axis: command_mm), and those that an effect of the model follows;
    rows count as taken in their order unless there is a column time_s. Raises CampaignFaults where ``file`` lacks a
    column or holds no number in it.
    """
    import pyarrow as pa

    extended = read_axis(model)
    unit = "deg" if extended.axis.kind == ROTARY else "mm"
    needed = {name: f"which {e.cause.id} follows" for e in extended.effects for name in e.cause.needs(0)}
    _check(table, file, unit, needed)
    command = number_column(table, f"command_{unit}") * SI[unit]
    time_s = number_column(table, "time_s") if "time_s" in table.schema.names else np.arange(len(command), dtype=float)
    poses = table.column("pose").to_pylist()
    values_by_column = {name: number_column(table, name) for name in needed}
    recorded = number_column(table, APPROACH) if APPROACH in table.schema.names else None
    rows = AxisRows.of(poses, time_s, command, extended.axis.least_move, others=values_by_column, recorded=recorded)
    value, sigma = predict_axis(extended, rows)
    predictions = [
        {
            "pose": poses[b],
            "encoder": name,
            "command": float(command[b] / SI[unit]),
            "command_unit": unit,
            "approach": int(rows.direction[b]),
            "value": float(value[b, k] / SI[unit]),
            "sigma": float(sigma[b, k] / SI[unit]),
        }
        for b in range(len(poses))
        for k, name in enumerate(extended.axis.encoders)
    ]
    identifier = "int64" if pa.types.is_integer(table.schema.field("pose").type) else "string"
    return pa.Table.from_pylist(predictions, schema=ARTIFACTS["axis_prediction"].arrow_schema(identifier))


def _check(table: pa.Table, file: str, unit: str, followed: dict[str, str]) -> None:
    needed = {"pose": "the row's name", f"command_{unit}": "where the axis is sent", **followed}
    names = table.schema.names
    if missing := {name: what for name, what in needed.items() if name not in names}:
        raise CampaignFaults(
            Fault(file, f"a column of that name, {what}", column=name) for name, what in missing.items()
        )
    first = 2 if file.endswith(".csv") else 1  # an editor counts the header line too
    faults = []
    for name in (f"command_{unit}", "time_s", *followed):
        if name in names:
            values = number_column(table, name) if str(table.schema.field(name).type) in ("double", "int64") else None
            wrong = range(len(table)) if values is None else np.flatnonzero(~np.isfinite(values))
            faults += [
                Fault(file, "a number", row=int(row) + first, column=name, value=str(table.column(name)[int(row)]))
                for row in wrong
            ]
    if faults:
        raise CampaignFaults(faults)
