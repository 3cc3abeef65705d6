"""Readings at new load steps, predicted by an extended model of a sensor."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index
from truing.estimation.interferometry.recorded_steps import CHANNELS, LOADS, READING_SI
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.covariates import column_alias, own_name
from truing.schemas.faults import CampaignFaults, Fault
from truing.simulation.bench.extended_model import ExtendedSensor, predict_readings
from truing.simulation.bench.known_readings import ReadingConditions
from truing.stages.common.point_arrays import number_column
from truing.stages.common.reading_arrays import LOAD_COLUMNS

_UNITS = (*(("um",) * 3), *(("arcsec",) * 3))
_TEXT = {"run": "the run's name", "channel": "what is read"}
_NUMBERS = {"step": "the load step", "time_s": "when it is taken"}


def predicted_readings(extended: ExtendedSensor, table: pa.Table, file: str) -> pa.Table:
    """Rows as in ``readings``, less a run's zero, for an interferometer table without its readings.

    Needs the columns run, step, time_s, channel, the loads (load_axis and load, or six columns) and those that the
    model's effects follow. Raises CampaignFaults where ``file`` lacks one of them or holds no number.
    """
    loads = _checked(extended, table, file)
    channel = np.array([CHANNELS.index(name) for name in table.column("channel").to_pylist()])
    keys = list(zip(table.column("run").to_pylist(), table.column("step").to_pylist(), strict=True))
    steps = {key: row for row, key in reversed(list(enumerate(keys)))}  # by a step's first row
    rows = np.array(sorted(steps.values(), key=lambda row: _order(table, keys, row)))
    index_of = {keys[row]: number for number, row in enumerate(rows)}
    readings = predict_readings(extended, _conditions(table, loads, rows))
    at = np.array([index_of[key] for key in keys])
    columns = {
        "run": table.column("run"),
        "step": table.column("step"),
        "time_s": table.column("time_s"),
        **{name: loads[:, n] for n, name in enumerate(LOAD_COLUMNS)},
        "channel": table.column("channel"),
        "reading": readings.value[at, channel] / READING_SI[channel],
        "unit": [_UNITS[k] for k in channel],
        "sigma": readings.sigma[at, channel] / READING_SI[channel],
    }
    identifier = "int64" if pa.types.is_integer(table.schema.field("run").type) else "string"
    schema = ARTIFACTS["readings"].arrow_schema(identifier)
    return pa.table({name: columns[name] for name in schema.names}).cast(schema)


def _order(table: pa.Table, keys: list[tuple[int | str, int]], row: int) -> tuple[str, float]:
    return str(keys[row][0]), float(table.column("time_s")[row].as_py())


def _conditions(table: pa.Table, loads: Array, rows: Index) -> ReadingConditions:
    known = {
        column_alias(field.name): number_column(table, field.name)[rows]
        for field in table.schema
        if str(field.type) in ("double", "int64") and field.name not in (*LOAD_COLUMNS, *_TEXT, *_NUMBERS, "load")
    }
    run = np.array(table.column("run").to_pylist())[rows]
    step, time = (number_column(table, name)[rows] for name in ("step", "time_s"))
    return ReadingConditions(run, step.astype(int), time, loads[rows], known, (float(time.min()), float(time.max())))


def _checked(extended: ExtendedSensor, table: pa.Table, file: str) -> Array:
    """The loads (N, 6) of the rows; raises CampaignFaults with everything that is missing or no number."""
    names, faults = table.schema.names, []
    six = any(name in names for name in LOAD_COLUMNS)
    needed = {**_TEXT, **_NUMBERS, **({} if six else {"load_axis": "the axis that is loaded", "load": "the load"})}
    for cause in [cause for cause in extended.causes if cause.is_persistent]:
        needed |= {own_name(name): f"which {cause.id} follows" for name in cause.needs(len(LOADS)) if name not in LOADS}
    needed = {name: what for name, what in needed.items() if name not in LOAD_COLUMNS}
    faults += [Fault(file, f"a column of that name, {what}", column=n) for n, what in needed.items() if n not in names]
    if faults:
        raise CampaignFaults(faults)
    text = {"channel": CHANNELS, **({} if six else {"load_axis": LOADS})}
    for name, allowed in text.items():
        values = table.column(name).to_pylist()
        wrong = [row for row, value in enumerate(values) if value not in allowed]
        faults += [Fault(file, f"one of {', '.join(allowed)}", _line(file, r), name, str(values[r])) for r in wrong]
    numbers = [name for name in names if name in (*LOAD_COLUMNS, *needed) and name not in ("run", *text)]
    for name in numbers:
        values = number_column(table, name)
        faults += [Fault(file, "a number", _line(file, int(row)), name, "") for row in np.flatnonzero(np.isnan(values))]
    if faults:
        raise CampaignFaults(faults)
    if six:
        zero = np.zeros(table.num_rows)
        return np.column_stack([number_column(table, name) if name in names else zero for name in LOAD_COLUMNS])
    axis = np.array([LOADS.index(name) for name in table.column("load_axis").to_pylist()])
    return np.asarray(np.eye(len(LOADS))[axis] * number_column(table, "load")[:, None])


def _line(file: str, row: int) -> int:
    return row + (2 if file.endswith(".csv") else 1)  # an editor counts the line of heads too
