"""Measured minus predicted of every reading of a bench, beside its load and its noise, in the order taken."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from truing.report.tables import Tables, filled

if TYPE_CHECKING:
    import pandas as pd

LOADS = {"fx": "fx_n", "fy": "fy_n", "fz": "fz_n", "mx": "mx_nm", "my": "my_nm", "mz": "mz_nm"}
LOAD_UNITS = {"fx": "N", "fy": "N", "fz": "N", "mx": "N·m", "my": "N·m", "mz": "N·m"}
CHANNELS = ("dx", "dy", "dz", "rx", "ry", "rz")
_STEP = ["run", "step"]
# A normal distribution's standard deviation over the median of its absolute values.
_MEDIAN_TO_SIGMA = 1.4826


def reading_misses(tables: Tables) -> pd.DataFrame | None:
    """One row per reading: run, step, channel, role, before, after, unit, time_s, loads by axis, sigma; None without.

    Rows are in the order taken. ``sigma`` is the declared noise, NaN where a channel has none; ``noise`` is that, or
    else what is left in the channel (from the median of its sizes).
    """
    errors = filled(tables, "reading_errors")
    if errors is None:
        return None
    found = errors.rename(columns={"missed_before": "before", "missed_after": "after"})
    found = found.merge(_steps(tables), on=_STEP, how="left").merge(_sigma(tables), on=[*_STEP, "channel"], how="left")
    found = found.sort_values(["start", "time_s", "step"], kind="stable").reset_index(drop=True)
    left = found["after"].abs().groupby(found["channel"]).transform("median") * _MEDIAN_TO_SIGMA
    return found.assign(noise=found["sigma"].fillna(left))


def channels_of(misses: pd.DataFrame) -> list[str]:
    """The channels that were read: displacements, rotations, then signals by number."""
    names = list(map(str, misses["channel"].unique()))
    signals = sorted((n for n in names if n not in CHANNELS), key=lambda n: (len(n), n))
    return [*(c for c in CHANNELS if c in names), *signals]


def load_steps(tables: Tables) -> pd.DataFrame:
    """Run, step, time_s, loads by axis, one row per load step of the readings and the signals."""
    import pandas

    known = [table for name in ("readings", "signals") if (table := filled(tables, name)) is not None]
    if not known:
        return pandas.DataFrame(columns=[*_STEP, "time_s", *LOADS])
    columns = [*_STEP, "time_s", *LOADS.values()]
    whole = pandas.concat([table[columns] for table in known], ignore_index=True).drop_duplicates(_STEP)
    whole = whole.rename(columns={column: axis for axis, column in LOADS.items()})
    return whole.fillna(dict.fromkeys(LOADS, 0.0)).reset_index(drop=True)


def _steps(tables: Tables) -> pd.DataFrame:
    """The load steps with the time at which their run began."""
    steps = load_steps(tables)
    return steps.assign(start=steps.groupby("run")["time_s"].transform("min"))


def _sigma(tables: Tables) -> pd.DataFrame:
    import pandas

    readings = filled(tables, "readings")
    if readings is None:
        return pandas.DataFrame({"run": [], "step": [], "channel": [], "sigma": []}).astype({"channel": object})
    return readings[[*_STEP, "channel", "sigma"]]


def root_mean_square(values: pd.Series) -> float:
    """Of what is known; NaN of nothing."""
    known = values.dropna().to_numpy(dtype=float)
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")
