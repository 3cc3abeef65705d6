"""Slips of the hand, made in the tables of a good loading campaign as a person or an export makes them.

Written from the campaign format alone: it shares no code with what has to find them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

WAVELENGTH_UM = 0.632990577
ARCSEC_PER_RAD = 180.0 * 3600.0 / np.pi
LINEAR = ("dx", "dy", "dz")


@dataclass(frozen=True)
class Made:
    """The slip made, as the right answer: relation, kind, quantities that may be named, subjects that must all be
    named, and the correction."""

    relation: str
    kind: str
    quantities: tuple[str, ...] = ()
    subjects: tuple[str, ...] = ()
    factor: float = 1.0
    shift: int = 0


class Tables:
    """The tables of a campaign folder, to be spoiled and written back; readings in long form."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.toml = (folder / "campaign.toml").read_text(encoding="utf-8")
        self.wide = (folder / "displacement.csv").exists()
        self.readings_name = "displacement.csv" if self.wide else "interferometer.csv"
        self.readings = pd.read_csv(folder / self.readings_name)
        signals = folder / "signals.csv"
        self.signals = pd.read_csv(signals) if signals.exists() else None
        for table in self.tables:
            if "load" in table:
                table["load"] = table["load"].astype(float)

    @property
    def tables(self) -> list[pd.DataFrame]:
        return [table for table in (self.readings, self.signals) if table is not None]

    @property
    def voltages(self) -> list[str]:
        return [] if self.signals is None else [name for name in self.signals if name.endswith("_mv")]

    @property
    def axes(self) -> list[str]:
        return sorted(self.readings["load_axis"].unique()) if "load_axis" in self.readings else []

    @property
    def runs(self) -> list[int]:
        return sorted(self.readings["run"].unique().tolist())

    def axis_of(self, run: int) -> str:
        return str(self.readings.loc[self.readings["run"] == run, "load_axis"].iloc[0])

    def without_range(self) -> None:
        """Leave [loading] out: the range of the loads is unknown."""
        if "[loading]" in self.toml:
            before, after = self.toml.split("[loading]", 1)
            self.toml = before + after[after.index("\n[") + 1 :] if "\n[" in after else before

    def write(self) -> None:
        self.readings.to_csv(self.folder / self.readings_name, index=False)
        if self.signals is not None:
            self.signals.to_csv(self.folder / "signals.csv", index=False)
        (self.folder / "campaign.toml").write_text(self.toml, encoding="utf-8")


Spoil = Callable[[Tables, np.random.Generator], Made | None]
FORCES = {"kN": 1e-3, "mN": 1e3, "kgf": 1.0 / 9.80665, "lbf": 1.0 / 4.4482216152605, "N for kgf": 9.80665}
TORQUES = {"N mm": 1e3, "kN m": 1e-3, "kgf m": 1.0 / 9.80665, "lbf in": 1.0 / 0.1129848290276}
READINGS = {"mm": ("linear", 1e-3), "nm": ("linear", 1e3), "m": ("linear", 1e-6), "inch": ("linear", 1.0 / 25400.0)}
ANGLES = {"rad": 1.0 / ARCSEC_PER_RAD, "deg": 1.0 / 3600.0, "mrad": 1e3 / ARCSEC_PER_RAD}
_R, _S, _C = "loads-against-readings", "signals-against-loads", "copied-runs"


def _scale_loads(tables: Tables, factor: float, chosen: Callable[[pd.DataFrame], pd.Series]) -> None:
    tables.without_range()
    for table in tables.tables:
        rows = chosen(table)
        table.loc[rows, "load"] = table.loc[rows, "load"] * factor


def all_loads(unit: str) -> Spoil:
    def spoil(tables: Tables, rng: np.random.Generator) -> Made | None:
        if not tables.axes:
            return None
        _scale_loads(tables, FORCES[unit], lambda table: table["load"].notna())
        return Made(_R, "unit", ("load",), (), 1.0 / FORCES[unit])

    return spoil


def torques(unit: str) -> Spoil:
    def spoil(tables: Tables, rng: np.random.Generator) -> Made | None:
        if not any(axis[0] == "m" for axis in tables.axes):
            return None
        _scale_loads(tables, TORQUES[unit], lambda table: table["load_axis"].str.startswith("m"))
        return Made(_R, "unit", ("torque",), (), 1.0 / TORQUES[unit])

    return spoil


def forces(unit: str) -> Spoil:
    def spoil(tables: Tables, rng: np.random.Generator) -> Made | None:
        if not any(axis[0] == "f" for axis in tables.axes):
            return None
        _scale_loads(tables, FORCES[unit], lambda table: table["load_axis"].str.startswith("f"))
        return Made(_R, "unit", ("force",), (), 1.0 / FORCES[unit])

    return spoil


def loads_of_axis(unit: str) -> Spoil:
    def spoil(tables: Tables, rng: np.random.Generator) -> Made | None:
        if not tables.axes:
            return None
        axis = str(rng.choice(tables.axes))
        _scale_loads(tables, FORCES[unit], lambda table: table["load_axis"] == axis)
        return Made(_R, "unit", ("force", "torque", "load"), (axis,), 1.0 / FORCES[unit])

    return spoil


def loads_of_run(factor: float) -> Spoil:
    def spoil(tables: Tables, rng: np.random.Generator) -> Made | None:
        if not tables.axes:
            return None
        run = int(rng.choice(tables.runs))
        _scale_loads(tables, factor, lambda table: table["run"] == run)
        kind, size = ("sign", 1.0) if factor < 0 else ("unit", 1.0 / factor)
        return Made(_R, kind, ("load", "force", "torque"), (f"run {run}",), size)

    return spoil


def _is_linear(tables: Tables) -> pd.Series:
    return tables.readings["channel"].isin(LINEAR)


def readings(linear: bool, factor: float, *, kind: str = "unit", one_run: bool = False) -> Spoil:
    def spoil(tables: Tables, rng: np.random.Generator) -> Made | None:
        quantity, subjects = ("displacement" if linear else "rotation"), ()
        if tables.wide:
            names = [name for name in tables.readings if name[:2] in (LINEAR if linear else ("rx", "ry", "rz"))]
            tables.readings[names] *= factor
            return Made(_R, kind, (quantity,), (), 1.0 / factor)
        rows = _is_linear(tables) == linear
        if one_run:
            run = int(rng.choice(tables.readings.loc[rows, "run"].unique()))
            rows, subjects = rows & (tables.readings["run"] == run), (f"run {run}",)
        tables.readings.loc[rows, "reading"] *= factor
        return Made(_R, kind, (quantity,), subjects, 1.0 / factor)

    return spoil


def channel_turned(tables: Tables, rng: np.random.Generator) -> Made | None:
    if tables.wide:
        return None
    channel = str(rng.choice(tables.readings["channel"].unique()))
    tables.readings.loc[tables.readings["channel"] == channel, "reading"] *= -1.0
    return Made(_R, "sign", ("displacement", "rotation"), (channel,))


def channels_exchanged(tables: Tables, rng: np.random.Generator) -> Made | None:
    if tables.wide:
        return None
    names = sorted(tables.readings["channel"].unique())
    if len(names) < 2:
        return None
    one, other = rng.choice(names, 2, replace=False).tolist()
    tables.readings["channel"] = tables.readings["channel"].replace({one: other, other: one})
    return Made(_R, "columns-exchanged", ("columns",), (one, other))


def axes_exchanged(tables: Tables, rng: np.random.Generator) -> Made | None:
    pairs = [pair for pair in (("fx", "fy"), ("fy", "fz"), ("mx", "my"), ("my", "mz")) if set(pair) <= set(tables.axes)]
    if not pairs:
        return None
    one, other = pairs[int(rng.integers(len(pairs)))]
    for table in tables.tables:
        table["load_axis"] = table["load_axis"].replace({one: other, other: one})
    return Made(_R, "columns-exchanged", ("load axes",), (one, other))


def labels_of_two_runs(tables: Tables, rng: np.random.Generator) -> Made | None:
    if len(tables.axes) < 2:
        return None
    tables.without_range()
    one = int(rng.choice(tables.runs))
    others = [run for run in tables.runs if tables.axis_of(run)[0] == tables.axis_of(one)[0] != tables.axis_of(run)]
    others = [run for run in others if tables.axis_of(run) != tables.axis_of(one)] or [
        run for run in tables.runs if tables.axis_of(run) != tables.axis_of(one)
    ]
    other = int(rng.choice(others))
    a, b = tables.axis_of(one), tables.axis_of(other)
    for table in tables.tables:
        first, second = table["run"] == one, table["run"] == other
        table.loc[first, "load_axis"], table.loc[second, "load_axis"] = b, a
    return Made(_R, "parts-exchanged", ("load axes",), (f"run {one}", f"run {other}"))


def readings_shifted(tables: Tables, rng: np.random.Generator) -> Made | None:
    shift = int(rng.choice([-1, 1]))
    if tables.wide:
        names = [name for name in tables.readings if name[:2] in (*LINEAR, "rx", "ry", "rz")]
        tables.readings[names] = tables.readings[names].shift(shift).bfill().ffill()
    else:
        parts = tables.readings.groupby(["run", "channel"])["reading"]
        tables.readings["reading"] = parts.transform(lambda own: own.shift(shift).bfill().ffill())
    return Made(_R, "rows-shifted", ("readings",), (), shift=shift)


def reading_frozen(tables: Tables, rng: np.random.Generator) -> Made | None:
    if tables.wide or not tables.axes:
        return None
    table = tables.readings
    run = int(rng.choice(tables.runs))
    own = "d" + tables.axis_of(run)[1] if tables.axis_of(run)[0] == "f" else "r" + tables.axis_of(run)[1]
    rows = table.index[(table["run"] == run) & (table["channel"] == own)]
    if len(rows) < 10:
        return None
    start = int(rng.integers(0, len(rows) // 2))
    table.loc[rows[start:], "reading"] = table.loc[rows[start], "reading"]
    return Made(_R, "frozen", ("displacement", "rotation"), (own, f"run {run}"))


def run_of_readings_copied(tables: Tables, rng: np.random.Generator) -> Made | None:
    table = tables.readings
    if tables.wide or len(tables.runs) < 2:
        return None
    one, other = rng.choice(tables.runs, 2, replace=False).tolist()
    source, target = table[table["run"] == one], table.index[table["run"] == other]
    if len(source) != len(target):
        return None
    table.loc[target, "reading"] = source["reading"].to_numpy()
    return Made(_C, "copied", ("readings",), (f"run {one}", f"run {other}"))


def _signals(spoil: Callable[[Tables, pd.DataFrame, np.random.Generator], Made | None]) -> Spoil:
    def made(tables: Tables, rng: np.random.Generator) -> Made | None:
        return None if tables.signals is None or not tables.axes else spoil(tables, tables.signals, rng)

    return made


def signals_of_run(factor: float) -> Spoil:
    def spoil(tables: Tables, table: pd.DataFrame, rng: np.random.Generator) -> Made | None:
        run = int(rng.choice(tables.runs))
        table.loc[table["run"] == run, tables.voltages] *= factor
        kind, size = ("sign", 1.0) if factor < 0 else ("unit", 1.0 / factor)
        return Made(_S, kind, ("signal",), (f"run {run}",), size)

    return _signals(spoil)


def signal_of_run(factor: float) -> Spoil:
    def spoil(tables: Tables, table: pd.DataFrame, rng: np.random.Generator) -> Made | None:
        run, name = int(rng.choice(tables.runs)), str(rng.choice(tables.voltages))
        table.loc[table["run"] == run, name] *= factor
        kind, size = ("sign", 1.0) if factor < 0 else ("unit", 1.0 / factor)
        return Made(_S, kind, ("signal",), (f"run {run}", name[:-3]), size)

    return _signals(spoil)


def _declared(tables: Tables) -> None:
    """The gain of the signals as the laboratory states it, where it states none: that of sensors drawn about 1/980."""
    if "sensitivity_mv_per_n" not in tables.toml:
        tables.toml += "\n[signals]\nsensitivity_mv_per_n = 0.00102\nsensitivity_tolerance = 0.3\n"


@_signals
def all_signals_in_volts(tables: Tables, table: pd.DataFrame, rng: np.random.Generator) -> Made | None:
    _declared(tables)
    table[tables.voltages] *= 1e-3
    return Made(_S, "unit", ("signal",), (), 1e3)


@_signals
def cell_backwards(tables: Tables, table: pd.DataFrame, rng: np.random.Generator) -> Made | None:
    _declared(tables)
    name = str(rng.choice(tables.voltages))
    table[name] *= -1.0
    return Made(_S, "sign", ("signal",), (name[:-3],))


@_signals
def signals_exchanged(tables: Tables, table: pd.DataFrame, rng: np.random.Generator) -> Made | None:
    one, other = rng.choice(tables.voltages, 2, replace=False).tolist()
    table[[one, other]] = table[[other, one]].to_numpy()
    return Made(_S, "columns-exchanged", ("columns",), (one[:-3], other[:-3]))


@_signals
def signals_exchanged_under_one_axis(tables: Tables, table: pd.DataFrame, rng: np.random.Generator) -> Made | None:
    axis = str(rng.choice(tables.axes))
    one, other = rng.choice(tables.voltages, 2, replace=False).tolist()
    rows = table["load_axis"] == axis
    table.loc[rows, [one, other]] = table.loc[rows, [other, one]].to_numpy()
    return Made(_S, "columns-exchanged", ("columns",), (one[:-3], other[:-3], f"all runs of {axis}"))


@_signals
def signals_exchanged_from_a_run_on(tables: Tables, table: pd.DataFrame, rng: np.random.Generator) -> Made | None:
    start = int(rng.choice(tables.runs[1:] or tables.runs))
    one, other = rng.choice(tables.voltages, 2, replace=False).tolist()
    table.loc[table["run"] >= start, [one, other]] = table.loc[table["run"] >= start, [other, one]].to_numpy()
    return Made(_S, "columns-exchanged", ("columns",), (one[:-3], other[:-3], f"from run {start} on"))


@_signals
def signal_frozen(tables: Tables, table: pd.DataFrame, rng: np.random.Generator) -> Made | None:
    run, name = int(rng.choice(tables.runs)), str(rng.choice(tables.voltages))
    rows = table.index[table["run"] == run]
    start = int(rng.integers(0, len(rows) // 2))
    table.loc[rows[start:], name] = table.loc[rows[start], name]
    return Made(_S, "frozen", ("signal",), (name[:-3], f"run {run}"))


def signals_shifted(*, one_run: bool) -> Spoil:
    def spoil(tables: Tables, table: pd.DataFrame, rng: np.random.Generator) -> Made | None:
        shift = int(rng.choice([-1, 1]))
        run = int(rng.choice(tables.runs))
        rows = table["run"] == run if one_run else table["run"].notna()
        parts = table.loc[rows].groupby("run")[tables.voltages]
        table.loc[rows, tables.voltages] = parts.transform(lambda own: own.shift(shift).bfill().ffill())
        return Made(_S, "rows-shifted", ("signals",), (f"run {run}",) if one_run else (), shift=shift)

    return _signals(spoil)


@_signals
def run_of_signals_reversed(tables: Tables, table: pd.DataFrame, rng: np.random.Generator) -> Made | None:
    run = int(rng.choice(tables.runs))
    rows = table["run"] == run
    table.loc[rows, tables.voltages] = table.loc[rows, tables.voltages].to_numpy()[::-1]
    return Made(_S, "rows-reversed", ("signals",), (f"run {run}",))


@_signals
def run_of_signals_copied(tables: Tables, table: pd.DataFrame, rng: np.random.Generator) -> Made | None:
    if len(tables.runs) < 2:
        return None
    one, other = rng.choice(tables.runs, 2, replace=False).tolist()
    source, target = table[table["run"] == one], table["run"] == other
    if len(source) != target.sum():
        return None
    table.loc[target, tables.voltages] = source[tables.voltages].to_numpy()
    return Made(_C, "copied", ("signals",), (f"run {one}", f"run {other}"))


SLIPS: dict[str, Spoil] = {
    **{f"all loads in {unit}": all_loads(unit) for unit in FORCES},
    **{f"torques in {unit}": torques(unit) for unit in TORQUES},
    **{f"forces in {unit}": forces(unit) for unit in ("kN", "lbf")},
    "one axis in kgf": loads_of_axis("kgf"),
    "one run in kN": loads_of_run(1e-3),
    "one run in lbf": loads_of_run(1.0 / 4.4482216152605),
    "one run's load turned": loads_of_run(-1.0),
    **{f"readings in {unit}": readings(True, factor) for unit, (_, factor) in READINGS.items()},
    **{f"angles in {unit}": readings(False, factor) for unit, factor in ANGLES.items()},
    "one run's readings in mm": readings(True, 1e-3, one_run=True),
    "fringes of half a wavelength": readings(True, 2.0 / WAVELENGTH_UM, kind="counted-in-fringes"),
    "fringes of a quarter": readings(True, 4.0 / WAVELENGTH_UM, kind="counted-in-fringes"),
    "a channel turned": channel_turned,
    "two channels exchanged": channels_exchanged,
    "two load axes exchanged": axes_exchanged,
    "labels of two runs exchanged": labels_of_two_runs,
    "readings a step off": readings_shifted,
    "a reading frozen": reading_frozen,
    "a run of readings copied": run_of_readings_copied,
    "a run's signals doubled": signals_of_run(2.0),
    "a run's signals in V": signals_of_run(1e-3),
    "a run's signals turned": signals_of_run(-1.0),
    "one signal of a run doubled": signal_of_run(2.0),
    "all signals in V": all_signals_in_volts,
    "a cell wired backwards": cell_backwards,
    "two signals exchanged": signals_exchanged,
    "two signals exchanged under one axis": signals_exchanged_under_one_axis,
    "two signals exchanged from a run on": signals_exchanged_from_a_run_on,
    "a signal frozen": signal_frozen,
    "signals a step off": signals_shifted(one_run=False),
    "a run's signals a step off": signals_shifted(one_run=True),
    "a run's signals reversed": run_of_signals_reversed,
    "a run of signals copied": run_of_signals_copied,
}
