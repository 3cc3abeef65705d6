"""From tables of readings and signals to dense arrays in SI, one row per load step: what every stage begins with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stages.point_arrays import number_column

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]

LOADS = ("fx", "fy", "fz", "mx", "my", "mz")
CHANNELS = ("dx", "dy", "dz", "rx", "ry", "rz")
LOAD_COLUMNS = ("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm")
SURROUNDINGS = ("air_temperature_c", "air_pressure_hpa", "relative_humidity_pct", "material_temperature_c")
ARCSECOND = np.pi / 180.0 / 3600.0
# What one unit of a channel's readings is in SI.
READING_SI = np.array([1e-6] * 3 + [ARCSECOND] * 3)
_NOT_COVARIATES = {"run", "step", "role", "channel", "reading", "unit", "sigma", *LOAD_COLUMNS}


@dataclass(frozen=True)
class RecordedSteps:
    """The load steps of a campaign in the order taken: B steps of R runs.

    ``reading`` (B, 6) in m and rad, NaN where a channel was not read; ``sigma`` (B, 6) one standard deviation, NaN
    where none is declared; ``load`` (B, 6) in N and N m; ``signal`` (B, S) in V, NaN where there is none. ``run`` (B,)
    counts in ``runs``. ``covariates`` (B,) are surroundings and further columns, in the units of their names.
    """

    runs: tuple[int | str, ...]
    run: NDArray[np.int64]
    step: NDArray[np.int64]
    time_s: Array
    load: Array
    reading: Array
    sigma: Array
    signal: Array
    held_out: NDArray[np.bool_]
    covariates: Mapping[str, Array]

    @property
    def signals(self) -> tuple[str, ...]:
        """The names of the signal channels: v1, v2, .."""
        return tuple(f"v{number + 1}" for number in range(self.signal.shape[1]))

    def chosen(self, rows: NDArray[np.bool_]) -> RecordedSteps:
        """Some of the steps; runs keep their numbers."""
        own = ("run", "step", "time_s", "load", "reading", "sigma", "signal", "held_out")
        covariates = {name: values[rows] for name, values in self.covariates.items()}
        return replace(self, **{name: getattr(self, name)[rows] for name in own}, covariates=covariates)


def load_steps(tables: Mapping[str, pa.Table]) -> RecordedSteps:
    """The load steps of the tables ``readings`` and ``signals``, either of which may be absent.

    A step of both is one: they share run and step. Steps are in the order of time within the order of runs.
    """
    found = [tables[name] for name in ("readings", "signals") if name in tables and tables[name].num_rows]
    if not found:
        raise ValueError("needs readings or signals")
    keys = _keys(found)
    place = {key: row for row, key in enumerate(keys)}
    runs = tuple(dict.fromkeys(run for run, _ in keys))
    at = [np.array([place[key] for key in _key_rows(table)]) for table in found]
    arrays = _common(found, at, len(keys))
    reading, sigma = _readings(found, at, len(keys))
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
        _signals(found, at, len(keys))[order],
        columns.pop("held_out").astype(bool),
        columns,
    )


def _keys(tables: Sequence[pa.Table]) -> list[tuple[int | str, int]]:
    return list(dict.fromkeys(key for table in tables for key in _key_rows(table)))


def _key_rows(table: pa.Table) -> list[tuple[int | str, int]]:
    return list(zip(table.column("run").to_pylist(), table.column("step").to_pylist(), strict=True))


def _common(tables: Sequence[pa.Table], at: Sequence[NDArray[np.int64]], count: int) -> dict[str, Array]:
    """What every row of a step repeats, (B,) by column: time, loads, whether it is held out, surroundings."""
    found: dict[str, Array] = {"held_out": np.zeros(count)}
    for table, rows in zip(tables, at, strict=True):
        for name in table.schema.names:
            if name in LOAD_COLUMNS or (name not in _NOT_COVARIATES and _is_number(table, name)):
                known = found.setdefault(name, np.full(count, np.nan))
                values = number_column(table, name)
                known[rows] = np.where(np.isfinite(values), values, known[rows])
        if "role" in table.schema.names:
            found["held_out"][rows] = np.asarray(table.column("role").to_pylist(), object) == "verification"
    for name in LOAD_COLUMNS:
        found[name] = np.nan_to_num(found[name])
    return found


def _is_number(table: pa.Table, name: str) -> bool:
    return str(table.schema.field(name).type) in ("double", "int64") and not _is_signal(name)


def _is_signal(name: str) -> bool:
    return name.startswith("v") and name.endswith("_mv")


def _readings(tables: Sequence[pa.Table], at: Sequence[NDArray[np.int64]], count: int) -> tuple[Array, Array]:
    reading, sigma = np.full((2, count, len(CHANNELS)), np.nan)
    for table, rows in zip(tables, at, strict=True):
        if "channel" in table.schema.names:
            channel = np.array([CHANNELS.index(name) for name in table.column("channel").to_pylist()])
            reading[rows, channel] = number_column(table, "reading") * READING_SI[channel]
            sigma[rows, channel] = number_column(table, "sigma") * READING_SI[channel]
    return reading, sigma


def _signals(tables: Sequence[pa.Table], at: Sequence[NDArray[np.int64]], count: int) -> Array:
    for table, rows in zip(tables, at, strict=True):
        names = sorted((name for name in table.schema.names if _is_signal(name)), key=lambda n: int(n[1:-3]))
        if names:
            signal = np.full((count, len(names)), np.nan)
            signal[rows] = np.column_stack([number_column(table, name) for name in names]) * 1e-3
            return signal
    return np.empty((count, 0))
