"""Names of what effects depend on: columns of the campaign, and what is known of each actuator by itself."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

TIME, ORDER, TEMPERATURE = "time_s", "order", "temperature_c"
OWN_DRIVE, APPROACH, LAST_STEP, MEMORY = "own drive", "approach", "last step", "memory"
# What is known of each actuator by itself: its own displacement, and how it came to the pose.
LOOKING_BACK = (APPROACH, LAST_STEP, MEMORY)
PER_ACTUATOR = (OWN_DRIVE, *LOOKING_BACK)
_MOST_LACKING = 0.1  # of a column, that neighbours in time tell


class Missing(StrEnum):
    """What a campaign did not record or vary, so that a cause cannot be tested."""

    TEMPERATURE = "no-temperature"
    TIME = "no-time"
    APPROACH = "no-approach"
    DRIVES = "no-drives"
    UP = "no-up"
    STILL = "no-still"
    POSES = "few-poses"
    TURNS = "no-turns"
    PAYLOAD = "no-payload"
    TILT = "no-tilt"


GRAVITY_IN = "gravity "  # before a body's name


def gravity_column(body: str) -> str:
    """Return the covariate (B, 3) that holds the direction of gravity in a body's frame."""
    return f"{GRAVITY_IN}{body}"


def drive_of(column: str) -> int | None:
    """Return which leg's displacement a column is, counted from 1; none where it is another."""
    number = column.removeprefix("rho").removesuffix("_mm")
    return int(number) if column == f"rho{number}_mm" and number.isdigit() else None


def varying(covariates: Mapping[str, NDArray], seen: NDArray | None = None) -> dict[str, NDArray]:
    """Return the columns of numbers (B,) that vary, at epochs ``seen`` (B,); the order only where there is no time."""
    own = slice(None) if seen is None else seen
    found = {
        name: values
        for name, values in covariates.items()
        if np.ndim(values) == 1 and np.asarray(values).dtype.kind in "fiu" and np.isfinite(values).all()
        if np.size(values[own]) and np.ptp(values[own]) > 0
    }
    return {name: values for name, values in found.items() if name != ORDER or TIME not in found}


def between_neighbours(values: NDArray, time_s: NDArray) -> NDArray:
    """Return a column (B,) with what a few epochs lack from their neighbours in time; as it is where many lack it."""
    lacks = ~np.isfinite(values)
    if lacks.mean() > _MOST_LACKING or not np.isfinite(time_s).all():
        return values
    order = np.argsort(time_s)
    order = order[~lacks[order]]
    return np.where(lacks, np.interp(time_s, time_s[order], values[order]), values)


def middle_and_half(values: NDArray) -> tuple[float, float]:
    """Return the centre of values and half their range."""
    return float(values.max() + values.min()) / 2, float(values.max() - values.min()) / 2


def order_in_time(time: NDArray | None, poses: int) -> NDArray:
    """Rank (B,) of each pose in time over the whole campaign; as in the table where there is no time, or none here."""
    known = np.zeros(poses) if time is None else np.where(np.isfinite(time), time, np.inf)
    rank = np.empty(poses)
    rank[np.argsort(known, kind="stable")] = np.arange(poses)
    return rank


def ranks(order: NDArray) -> NDArray:
    """Return the rank (B,) of each epoch by its order in time (B,), from 0; of equal ones the first."""
    return np.asarray(np.argsort(np.argsort(order, kind="stable")))


def fading_sum(readings: NDArray, time: NDArray, kept: float) -> NDArray:
    """Sum (B, L), m, of each actuator's movements up to a pose in time order, every earlier one ``kept`` times as much
    as the next; 0 for the first."""
    order = np.argsort(time, kind="stable")
    steps = np.nan_to_num(np.diff(readings[order], axis=0))
    total = np.zeros_like(readings)
    for before, now, step in zip(order[:-1], order[1:], steps, strict=True):
        total[now] = kept * total[before] + step
    return total


def approach(readings: NDArray, time: NDArray, least: float) -> NDArray:
    """Direction (B, L) of each actuator's last movement larger than ``least`` (m) in time order; +1 before any."""
    order = np.argsort(time, kind="stable")
    steps = np.diff(readings[order], axis=0, prepend=readings[order][:1])
    moved = np.abs(np.nan_to_num(steps)) > least
    last = np.maximum.accumulate(np.where(moved, np.arange(len(order))[:, None], -1), axis=0)
    signs = np.take_along_axis(np.sign(steps), np.maximum(last, 0), 0)
    direction = np.ones_like(readings)
    direction[order] = np.where(last >= 0, signs, 1.0)
    return direction
