"""Tables of readings and signals as dense arrays in SI, one row per load step."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index
from truing.estimation.interferometry.recorded_steps import CHANNELS, READING_SI, RecordedSteps
from truing.schemas.covariates import column_alias
from truing.simulation.inputs import numbers_rows
from truing.stages.common.point_arrays import number_column, number_columns

LOAD_COLUMNS = ("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm")
MOVED_COLUMNS = ("dx_mm", "dy_mm", "dz_mm", "rx_rad", "ry_rad", "rz_rad")
MOVED_SI = np.array([1e-3] * 3 + [1.0] * 3)
_OWN = ("run", "step", "time_s", "role", *LOAD_COLUMNS)
_OF_TABLE = {"readings": (*_OWN, "channel", "reading", "unit", "sigma"), "signals": _OWN}
_SIGNAL = re.compile(r"v[1-8]_mv")


def load_steps(tables: Mapping[str, pa.Table]) -> RecordedSteps:
    """Load steps of the tables ``readings`` and ``signals``, either of which may be absent.

    Rows of both with equal run and step are one step. Steps are in order of time within the order of runs.
    """
    tables_of_kind = {name: tables[name] for name in _OF_TABLE if name in tables and tables[name].num_rows}
    if not tables_of_kind:
        raise ValueError("needs readings or signals")
    keys = list(dict.fromkeys(key for table in tables_of_kind.values() for key in _key_rows(table)))
    index_of = {key: row for row, key in enumerate(keys)}
    runs = tuple(dict.fromkeys(run for run, _ in keys))
    at = {name: np.array([index_of[key] for key in _key_rows(table)]) for name, table in tables_of_kind.items()}
    arrays = _common(tables_of_kind, at, len(keys))
    reading, sigma = _readings(tables_of_kind, at, len(keys))
    place_of = {run: number for number, run in enumerate(runs)}
    number = np.array([place_of[run] for run, _ in keys])
    order = np.lexsort((arrays["time_s"], number))
    columns = {name: values[order] for name, values in arrays.items()}
    return RecordedSteps(
        runs,
        number[order],
        np.array([step for _, step in keys])[order],
        columns.pop("time_s"),
        np.column_stack([columns.pop(name) for name in LOAD_COLUMNS]),
        reading[order],
        sigma[order],
        _signals(tables_of_kind, at, len(keys))[order],
        columns.pop("held_out").astype(bool),
        columns,
    )


def _key_rows(table: pa.Table) -> list[tuple[int | str, int]]:
    return list(zip(table.column("run").to_pylist(), table.column("step").to_pylist(), strict=True))


def _common(tables: Mapping[str, pa.Table], at: Mapping[str, Index], count: int) -> dict[str, Array]:
    """Values that every row of a step repeats, (B,) by column: time, loads, role, covariates."""
    arrays: dict[str, Array] = {"held_out": np.zeros(count)}
    for kind, table in tables.items():
        rows, covariates = at[kind], covariate_columns(kind, table)
        for name in ("time_s", *LOAD_COLUMNS):
            _complete(arrays, name, rows, number_column(table, name), count)
        for name, column in covariates.items():
            values = number_column(table, name)
            if kind == "signals" and numbers_rows(name, values):
                continue
            differing = _columns_differ(arrays.get(column), rows, values)
            _complete(arrays, f"{kind}.{column}" if differing else column, rows, values, count)
        if "role" in table.schema.names:
            arrays["held_out"][rows] = np.asarray(table.column("role").to_pylist(), object) == "verification"
    for name in LOAD_COLUMNS:
        arrays[name] = np.nan_to_num(arrays[name])
    return arrays


def covariate_columns(kind: str, table: pa.Table) -> dict[str, str]:
    """Return the covariates of the readings or signals: internal name by column of the table."""
    tables_of_kind = _OF_TABLE[kind]
    return {
        field.name: column_alias(field.name)
        for field in table.schema
        if field.name not in tables_of_kind and str(field.type) in ("double", "int64")
        if not (kind == "signals" and _SIGNAL.fullmatch(field.name))
    }


def _complete(arrays: dict[str, Array], name: str, rows: Index, values: Array, count: int) -> None:
    known = arrays.setdefault(name, np.full(count, np.nan))
    known[rows] = np.where(np.isfinite(values), values, known[rows])


def _columns_differ(known: Array | None, rows: Index, values: Array) -> bool:
    """True if two tables have a column of the same name with different values for the same steps."""
    if known is None:
        return False
    both = np.isfinite(known[rows]) & np.isfinite(values)
    return not np.array_equal(known[rows][both], values[both])


def _readings(tables: Mapping[str, pa.Table], at: Mapping[str, Index], count: int) -> tuple[Array, Array]:
    reading, sigma = np.full((2, count, len(CHANNELS)), np.nan)
    if (table := tables.get("readings")) is not None:
        channel = np.array([CHANNELS.index(name) for name in table.column("channel").to_pylist()])
        reading[at["readings"], channel] = number_column(table, "reading") * READING_SI[channel]
        sigma[at["readings"], channel] = number_column(table, "sigma") * READING_SI[channel]
    return reading, sigma


def _signals(tables: Mapping[str, pa.Table], at: Mapping[str, Index], count: int) -> Array:
    table = tables.get("signals")
    names = [] if table is None else sorted(filter(_SIGNAL.fullmatch, table.schema.names), key=lambda n: int(n[1:-3]))
    signal = np.full((count, len(names)), np.nan)
    if table is not None and names:
        signal[at["signals"]] = number_columns(table, names) * 1e-3
    return signal
