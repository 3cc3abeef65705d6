"""Measured minus predicted of every reading of a bench, beside its load and its noise, in the order taken."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from truing.report.load_steps import STEP, in_channel_order, load_steps
from truing.report.tables import Tables, filled

if TYPE_CHECKING:
    import pandas as pd

# A normal distribution's standard deviation over the median of its absolute values.
_MEDIAN_TO_SIGMA = 1.4826


def reading_misses(tables: Tables) -> pd.DataFrame | None:
    """One row per reading: run, step, channel, role, before, after, unit, time_s, loads by axis, sigma; None without.

    Rows are in the order taken. ``sigma`` is the declared noise of the reading, ``noise_floor`` what declared noise
    alone leaves in a channel's errors, NaN where it has none; ``noise`` is that, or else what is left in the channel
    (from the median of its sizes).
    """
    errors = filled(tables, "reading_errors")
    if errors is None:
        return None
    found = errors.rename(columns={"missed_before": "before", "missed_after": "after"})
    found = found.merge(_steps(tables), on=STEP, how="left").merge(_sigma(tables), on=[*STEP, "channel"], how="left")
    found = found.sort_values(["start", "time_s", "step"], kind="stable").reset_index(drop=True)
    left = found["after"].abs().groupby(found["channel"]).transform("median") * _MEDIAN_TO_SIGMA
    if "noise_floor" not in found:
        found["noise_floor"] = np.nan
    return found.assign(noise=found["noise_floor"].fillna(left))


def channels_of(misses: pd.DataFrame) -> list[str]:
    """The channels that were read: displacements, rotations, then signals by number."""
    return in_channel_order(misses["channel"].unique())


def _steps(tables: Tables) -> pd.DataFrame:
    """The load steps with the time at which their run began."""
    steps = load_steps(tables).drop(columns="role")
    return steps.assign(start=steps.groupby("run")["time_s"].transform("min"))


def _sigma(tables: Tables) -> pd.DataFrame:
    import pandas

    readings = filled(tables, "readings")
    if readings is None:
        return pandas.DataFrame({"run": [], "step": [], "channel": [], "sigma": []}).astype({"channel": object})
    return readings[[*STEP, "channel", "sigma"]]


def root_mean_square(values: pd.Series) -> float:
    """Of what is known; NaN of nothing."""
    known = values.dropna().to_numpy(dtype=float)
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")
