"""Poses and load steps at which the machine may have been elsewhere: most values deviate, used or left out."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from truing.report.numbers import count_text, listed, p_equals, rough, rough_quantity
from truing.report.tables import Tables, table_or_none

_MOST = 0.5  # share of the values of a pose or load step that must be exceeded by those that deviate
_LISTED = 3  # names in a sentence at most
RARE = 0.01  # p-value, corrected for the number of poses, below which the values of a pose deviate together
_ELSEWHERE = (
    "This is no error of a single value: the machine or the instrument moved, or a recorded reading is wrong. Measure "
    "again, or find out what happened."
)


@dataclass(frozen=True)
class DeviatingEpoch:
    """A pose or load step, the number of values left out and measured there, and the largest deviation in sigma."""

    name: str
    left_out: int
    measured: int
    largest: float


def deviating_epochs(tables: Tables) -> list[DeviatingEpoch]:
    """Return the poses or load steps at which the diagnosis left out most of the measured values, the largest deviation
    first."""
    table = table_or_none(tables, "diagnosis_left_out")
    if table is None or "measured_there" not in table:
        return []
    known = table[table["measured_there"].notna()]
    keys = ["pose"] if "pose" in known else ["run", "step"]
    epochs = [
        DeviatingEpoch(_name(rows.iloc[0]), len(rows), int(rows["measured_there"].iloc[0]), float(rows["value"].max()))
        for _, rows in known.groupby(keys, sort=False)
    ]
    deviating = [epoch for epoch in epochs if epoch.left_out > _MOST * epoch.measured]
    return sorted(deviating, key=lambda epoch: -epoch.largest)


def deviating_words(epochs: list[DeviatingEpoch], *, model_fits: bool) -> str:
    """Return the sentences on deviating poses or load steps, and what to do; empty where there are none."""
    if not epochs:
        return ""
    worst, size = epochs[0], f"up to {rough(epochs[0].largest)} standard deviations"
    names = listed([epoch.name for epoch in epochs], _LISTED)
    if not model_fits:
        return f"Most values of {names} were left out; an incomplete model cannot tell why they deviate."
    if worst.measured == 1:
        why = (
            "One value cannot tell whether the measurement, a recorded reading or the machine is wrong. Measure again."
        )
        return f"Left out: {names}, whose measured value deviates by {size}. {why}"
    values = f"{worst.left_out} of {count_text(worst.measured, 'value')}"
    where = f"where {values} deviate" if len(epochs) == 1 else f"where most values deviate ({worst.name}: {values})"
    return f"Left out: {names}, {where}, by {size}. {_ELSEWHERE}"


def used_words(tables: Tables) -> str:
    """Return the sentences on poses whose values deviate together though none was left out; empty without any."""
    table = table_or_none(tables, "prediction")
    if table is None or "p_deviates" not in table:
        return ""
    rows = table[table["p_deviates"] < RARE].sort_values("p_deviates")
    if rows.empty:
        return ""
    worst = rows.iloc[0]
    size = f"rms {rough_quantity(worst['rms_after'], str(worst['unit']))}, p {p_equals(worst['p_deviates'])}"
    if len(rows) == 1:
        return f"Pose {worst['pose']} deviates as a whole ({size}). {_ELSEWHERE}"
    names = listed([str(pose) for pose in rows["pose"]], _LISTED)
    return f"Poses {names} deviate as a whole (pose {worst['pose']}: {size}). {_ELSEWHERE}"


def _name(row: pd.Series) -> str:
    return f"pose {row['pose']}" if "pose" in row else f"load step {row['step']} of run {row['run']}"
