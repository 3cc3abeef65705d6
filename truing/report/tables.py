"""Access to tables by artifact name, load steps of a bench, and text of cells, loads and channels."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Protocol

import numpy as np
import pandas as pd

from truing.report.numbers import capitalised
from truing.schemas.columns import COLUMNS

WHY_NOT = "why_not"  # attribute of a table: reason why its stage was not evaluated; empty where it was
Tables = Mapping[str, pd.DataFrame]

LOADS = {"fx": "fx_n", "fy": "fy_n", "fz": "fz_n", "mx": "mx_nm", "my": "my_nm", "mz": "mz_nm"}
LOAD_UNITS = {axis: "N" if axis.startswith("f") else "N·m" for axis in LOADS}
CHANNELS = ("dx", "dy", "dz", "rx", "ry", "rz")
STEP_KEYS = ["run", "step"]
XYZ, SHIFT = ["x_mm", "y_mm", "z_mm"], ["dx_mm", "dy_mm", "dz_mm"]
SIGMA = ["sigma_x_mm", "sigma_y_mm", "sigma_z_mm"]
SEVERAL = "several"
_ON_LOADS_AND_MACHINES = ("displacement", "deformation", "tolerances", "neglected", "calibration", "requirements")

_ARCSECOND = 4.84813681109536e-06  # rad


class Row(Protocol):
    """Row of a table as `itertuples` yields it: one attribute per column; `truing.schemas.columns` declares types."""

    def __getattr__(self, column: str) -> Any:
        """Value of a column."""


def table_or_none(tables: Tables, name: str) -> pd.DataFrame | None:
    """Return a table, or None where the run has none or an empty one."""
    table = tables.get(name)
    return table if table is not None and len(table) else None


def each_row(tables: Tables, name: str) -> Iterator[Row]:
    """Return the rows of a table as named tuples; nothing where the run has none."""
    return iter(()) if (table := table_or_none(tables, name)) is None else table.itertuples()


def reason(tables: Tables, name: str) -> str:
    """Return the reason why the stage of a table was not evaluated; empty where it gave none."""
    why = str(tables[name].attrs.get(WHY_NOT, "")) if name in tables else ""
    return f"{capitalised(why)}{'' if why[-1] == '?' else '.'}" if why else ""


def cell(value: object) -> str:
    """Return a cell's text; empty for missing values."""
    return "" if value is None or value != value else str(value)


def is_bench(tables: Tables) -> bool:
    """Return True if the campaign applied loads."""
    return any(name in tables for name in ("readings", "signals", "reading_errors"))


def is_single_axis(tables: Tables) -> bool:
    """Return True for the rows of an axis; positions of a table have no commands."""
    return "positioning" in tables and "configurations" in tables


def has_positions_alone(tables: Tables) -> bool:
    """Return True for a campaign of positions of an axis that holds no load, signal, command or pose."""
    recorded = ("readings", "signals", "configurations", "observations")
    return table_or_none(tables, "positions") is not None and all(table_or_none(tables, n) is None for n in recorded)


def untested_sections(tables: Tables) -> tuple[str, ...]:
    """Return the sections on loads and machines, where a campaign of positions of an axis can show nothing of them."""
    return _ON_LOADS_AND_MACHINES if has_positions_alone(tables) else ()


def load_steps(tables: Tables) -> pd.DataFrame:
    """Return run, step, time_s, loads by axis (fx .. mz) and role, a row per load step of the readings and
    the signals."""
    known = [table for name in ("readings", "signals") if (table := table_or_none(tables, name)) is not None]
    columns = [*STEP_KEYS, "time_s", *LOADS.values()]
    if not known:
        return pd.DataFrame(columns=[*STEP_KEYS, "time_s", *LOADS, "role"])
    parts = [table[[*columns, *(["role"] if "role" in table else [])]] for table in known]
    all_steps = pd.concat(parts, ignore_index=True).drop_duplicates(STEP_KEYS)
    all_steps = all_steps.rename(columns={column: axis for axis, column in LOADS.items()})
    if "role" not in all_steps:
        all_steps = all_steps.assign(role=None)
    return all_steps.fillna(dict.fromkeys(LOADS, 0.0)).reset_index(drop=True)


def axes_of(steps: pd.DataFrame) -> list[str]:
    """Return the axes along which any load was applied."""
    return [axis for axis in LOADS if np.any(steps[axis].to_numpy() != 0.0)]


def loaded_by_run(steps: pd.DataFrame) -> pd.Series:
    """Return the loaded axis of each row's run, ``several`` or ``none``."""
    loaded = axes_loaded_by_run(steps)
    number = loaded.sum(axis=1)
    return loaded.idxmax(axis=1).mask(number > 1, SEVERAL).mask(number == 0, "none")


def axes_loaded_by_run(steps: pd.DataFrame) -> pd.DataFrame:
    """Return True for each row and axis if the row's run loads the axis."""
    return steps[list(LOADS)].ne(0.0).groupby(steps["run"]).transform("any")


def in_channel_order(names: Iterable[object]) -> list[str]:
    """Return names in the order displacements, rotations, signals by number."""
    known = list(dict.fromkeys(map(str, names)))
    return [*(c for c in CHANNELS if c in known), *sorted(set(known) - set(CHANNELS), key=lambda n: (len(n), n))]


def is_unloading(steps: pd.DataFrame, axis: str) -> pd.Series:
    """Return True for steps with a smaller load along an axis than the step before in the run."""
    size = steps[axis].abs()
    return size < size.groupby(steps["run"], sort=False).shift().fillna(0.0)


def signal_names(tables: Tables) -> list[str]:
    """Return the signal channels: ``v1``, ``v2``."""
    signals = table_or_none(tables, "signals")
    columns = [] if signals is None else [str(c) for c in signals.columns]
    return in_channel_order(c.removesuffix("_mv") for c in columns if COLUMNS["signal"].matches(c))


def moved_unit(channel: str) -> str:
    """Return the unit in which a channel is read."""
    return "µm" if channel.startswith("d") else "arcsec"


def kilo(load: str) -> str:
    """Return the name of a thousand units of a load."""
    return f"k{LOAD_UNITS[load]}"


def per_kilo(channel: str, load: str) -> tuple[float, str]:
    """Return factor and unit that print an entry of the compliance with few digits."""
    factor = 1e9 if channel.startswith("d") else 1e3 / _ARCSECOND
    return factor, f"{moved_unit(channel)}/{kilo(load) if load.startswith('f') else '(kN·m)'}"
