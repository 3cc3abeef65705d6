"""Wrench of each row of signals, by the calibration of a run."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Mask
from truing.estimation.interferometry.recorded_steps import LOADS
from truing.estimation.sensor.calibrated_sensor import CalibratedSensor
from truing.estimation.sensor.calibration import UnreachedSignalsError
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import CampaignFaults, Fault
from truing.stages.common.reading_arrays import LOAD_COLUMNS

UNLOADED = "unloaded"  # 1 in rows of signals without load
_KEPT = ("run", "step", "time_s")


def is_of_signals(table: pa.Table) -> bool:
    """True if a table holds signals of a sensor and no channel of an interferometer."""
    return "v1_mv" in table.schema.names and "channel" not in table.schema.names


def wrenches_of_signals(sensor: CalibratedSensor, table: pa.Table, file: str) -> pa.Table:
    """Rows of ``wrenches`` for a table of signals, in mV, with the covariates that the calibration follows.

    A sensor whose zero changes from run to run needs rows marked 1 in a column ``unloaded``, in every run of a column
    ``run``. Raises CampaignFaults where ``file`` lacks a column or holds no number.
    """
    columns = _checked(sensor, table, file)
    signals = np.column_stack([columns[name] for name in _signal_columns(sensor)])
    covariates = np.column_stack(
        [*(columns[f"{name}_c"] for name in sensor.covariate_names), np.empty((len(signals), 0))]
    )
    value, covariance = np.empty((len(signals), len(LOADS))), np.empty((len(signals), len(LOADS), len(LOADS)))
    within = np.zeros(len(signals), bool)
    for rows, unloaded in _runs(sensor, table, columns, file):
        try:
            wrenches = sensor.wrench(signals[rows], covariates[rows], signals[unloaded])
        except UnreachedSignalsError as error:
            raise CampaignFaults([Fault(file, f"signals of loads that the calibration determines ({error})")]) from None
        value[rows], covariance[rows], within[rows] = wrenches.value, wrenches.covariance, wrenches.is_within
    return _table(table, value, covariance, within)


def _signal_columns(sensor: CalibratedSensor) -> list[str]:
    return [f"{name}_mv" for name in sensor.signal_names]


def _checked(sensor: CalibratedSensor, table: pa.Table, file: str) -> dict[str, Array]:
    """The columns that are needed; raises CampaignFaults with all that is missing or no number."""
    needed = dict.fromkeys(_signal_columns(sensor), "a signal of the sensor in mV")
    needed |= {f"{name}_c": "which the calibration follows" for name in sensor.covariate_names}
    needed |= {UNLOADED: "1 where no load acts, else 0: zeros changed from run to run"} if sensor.is_tared else {}
    faults = [
        Fault(file, f"a column of that name, {what}", column=name)
        for name, what in needed.items()
        if name not in table.schema.names
    ]
    if faults:
        raise CampaignFaults(faults)
    columns = {name: _numbers(table.column(name)) for name in needed}
    first = 2 if file.endswith(".csv") else 1  # an editor counts the line of heads too
    for name, values in columns.items():
        column = table.column(name)
        faults += [
            Fault(file, "a number", row=int(row) + first, column=name, value=str(column[int(row)].as_py()))
            for row in np.flatnonzero(~np.isfinite(values))
        ]
    if faults:
        raise CampaignFaults(faults)
    return columns


def _numbers(column: pa.ChunkedArray) -> Array:
    """A column as float64, NaN where a value is no number."""
    if pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
        return np.array([_number(value) for value in column.to_pylist()])
    return np.asarray(column.to_numpy(zero_copy_only=False), dtype=float)


def _number(value: str | None) -> float:
    try:
        return float(value or "nan")
    except ValueError:
        return float("nan")


def _runs(sensor: CalibratedSensor, table: pa.Table, columns: dict[str, Array], file: str) -> list[tuple[Mask, Mask]]:
    """The rows of each run, and those of them without load."""
    every = np.ones(table.num_rows, bool)
    if not sensor.is_tared:
        return [(every, every)]
    runs = np.array(table.column("run").to_pylist()) if "run" in table.schema.names else np.zeros(table.num_rows, int)
    runs_of_signals = [(runs == run, (runs == run) & (columns[UNLOADED] != 0.0)) for run in np.unique(runs)]
    faults = [
        Fault(file, f"1 in one row at least of run {runs[rows][0]}", column=UNLOADED)
        for rows, unloaded in runs_of_signals
        if not unloaded.any()
    ]
    if faults:
        raise CampaignFaults(faults)
    return runs_of_signals


def _table(table: pa.Table, value: Array, covariance: Array, within: Mask) -> pa.Table:
    sigma = np.sqrt(np.einsum("nii->ni", covariance))
    columns: dict[str, object] = {name: table.column(name) for name in _KEPT if name in table.schema.names}
    columns["row_order"] = np.arange(1, table.num_rows + 1)
    for k, name in enumerate(LOAD_COLUMNS):
        columns |= {name: value[:, k], f"sigma_{name}": sigma[:, k]}
    columns |= {f"cov_{LOADS[i]}_{LOADS[j]}": covariance[:, i, j] for i, j in combinations(range(len(LOADS)), 2)}
    columns["is_within"] = within
    is_named = "run" in columns and not pa.types.is_integer(table.schema.field("run").type)
    identifier = "string" if is_named else "int64"
    schema = ARTIFACTS["wrenches"].arrow_schema(identifier, tuple(name for name in _KEPT if name in columns))
    return pa.table({name: columns[name] for name in schema.names}).cast(schema)
