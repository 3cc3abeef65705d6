"""The load steps of a bench as the page reads them: loads by axis, channels in their order, steps beside their run."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from truing.report.tables import Tables, filled
from truing.schemas.columns import COLUMNS

if TYPE_CHECKING:
    import pandas as pd

LOADS = {"fx": "fx_n", "fy": "fy_n", "fz": "fz_n", "mx": "mx_nm", "my": "my_nm", "mz": "mz_nm"}
LOAD_UNITS = {axis: "N" if axis.startswith("f") else "N·m" for axis in LOADS}
CHANNELS = ("dx", "dy", "dz", "rx", "ry", "rz")
STEP = ["run", "step"]
SEVERAL = "several"


def is_bench(tables: Tables) -> bool:
    """Whether the campaign applied loads."""
    return any(name in tables for name in ("readings", "signals", "reading_errors"))


def load_steps(tables: Tables) -> pd.DataFrame:
    """Run, step, time_s, loads by axis (fx .. mz) and role, a row per load step of the readings and the signals."""
    import pandas

    known = [table for name in ("readings", "signals") if (table := filled(tables, name)) is not None]
    columns = [*STEP, "time_s", *LOADS.values()]
    if not known:
        return pandas.DataFrame(columns=[*STEP, "time_s", *LOADS, "role"])
    parts = [table[[*columns, *(["role"] if "role" in table else [])]] for table in known]
    whole = pandas.concat(parts, ignore_index=True).drop_duplicates(STEP)
    whole = whole.rename(columns={column: axis for axis, column in LOADS.items()})
    if "role" not in whole:
        whole = whole.assign(role=None)
    return whole.fillna(dict.fromkeys(LOADS, 0.0)).reset_index(drop=True)


def axes_of(steps: pd.DataFrame) -> list[str]:
    """The axes along which anything was applied."""
    return [axis for axis in LOADS if steps[axis].ne(0.0).any()]


def loaded_by_run(steps: pd.DataFrame) -> pd.Series:
    """What each row's run loads: an axis, ``several`` or ``none``."""
    loaded = steps[list(LOADS)].ne(0.0).groupby(steps["run"]).transform("any")
    number = loaded.sum(axis=1)
    return loaded.idxmax(axis=1).mask(number > 1, SEVERAL).mask(number == 0, "none")


def in_channel_order(names: Iterable[object]) -> list[str]:
    """Displacements, rotations, then signals by number."""
    known = list(dict.fromkeys(map(str, names)))
    return [*(c for c in CHANNELS if c in known), *sorted(set(known) - set(CHANNELS), key=lambda n: (len(n), n))]


def goes_back(steps: pd.DataFrame, axis: str) -> pd.Series:
    """Whether a step's load along an axis is smaller than that of the step before in its run."""
    size = steps[axis].abs()
    return size < size.groupby(steps["run"], sort=False).shift().fillna(0.0)


def signal_names(tables: Tables) -> list[str]:
    """``v1``, ``v2``: the signal channels."""
    signals = filled(tables, "signals")
    columns = [] if signals is None else [str(c) for c in signals.columns]
    return in_channel_order(c.removesuffix("_mv") for c in columns if COLUMNS["signal"].matches(c))
