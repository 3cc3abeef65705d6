"""Names of the inputs that effects may depend on, and functions that compute inputs from readings and time."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from enum import StrEnum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

_FEWEST_NUMBERED, _UNIT_AT_END = 8, re.compile(r"_[a-z]{1,4}$")
TIME, ORDER, TEMPERATURE = "time_s", "order", "temperature_c"
OWN_DRIVE, APPROACH, LAST_STEP, MEMORY = "own drive", "approach", "last step", "memory"
# States of stop operators, and their thresholds relative to the range of a reading.
STOPPED, STOPS = ("stop 1", "stop 2", "stop 3"), (0.08, 0.2, 0.4)
# The same for friction of any form: its path, on a finer scale of thresholds.
PATH, FINE_STOPS = "path", (0.02, 0.05, 0.08, 0.13, 0.2, 0.3, 0.4, 0.6)
# States that follow a reading's movements and relax, as a viscoelastic part does: a sum of them is any slow recovery.
RELAXING = ("relaxing 1", "relaxing 2", "relaxing 3")
_SLOWEST = 0.25  # longest time constant of a relaxing state, as a share of the time that is covered
_LEAST_STATE = 1e-3  # least size of a combination of states, relative to the largest
# Movement per second, of machines that were measured while they moved.
RATE = "rate"
# Inputs with a separate value for each actuator: its displacement, and its previous movements.
LOOKING_BACK = (APPROACH, LAST_STEP, MEMORY, PATH, *STOPPED, *RELAXING)
PER_ACTUATOR = (OWN_DRIVE, *LOOKING_BACK)
_MOST_LACKING = 0.1  # share of missing values up to which a column is interpolated
# Least readings of a path, and the largest typical deviation of one from the line between its neighbours, relative to
# half their distance. A sine with 9 readings a period has 0.7; readings in random order have 1.7.
_FEWEST_OF_A_PATH, _SMOOTH = 12, 0.7
_PAUSE = 3.0  # usual intervals between readings, beyond which a path begins anew


class Missing(StrEnum):
    """Input that a campaign did not record or vary, so that a cause cannot be tested."""

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
    WEIGHT = "no-weight"
    GRAVITY = "no-gravity"
    WAITS = "no-waits"
    BOTH_ENCODERS = "one-encoder"
    UNEVEN_PATH = "even-path"


GRAVITY_IN = "gravity "  # prefix of a body's name


def gravity_column(body: str) -> str:
    """Return the name of the covariate (B, 3) with the direction of gravity in the frame of a body."""
    return f"{GRAVITY_IN}{body}"


def drive_of(column: str) -> int | None:
    """Return the leg, from 1, whose displacement a column holds (``rho3_mm``: 3); None for other columns."""
    number = column.removeprefix("rho").removesuffix("_mm")
    return int(number) if column == f"rho{number}_mm" and number.isdigit() else None


def varying_columns(covariates: Mapping[str, NDArray], is_observed: NDArray | None = None) -> dict[str, NDArray]:
    """Return the numeric columns (B,) that vary over the epochs ``is_observed`` (B,); the order only if there is no
    time."""
    rows = slice(None) if is_observed is None else is_observed
    varying = {
        name: values
        for name, values in covariates.items()
        if np.ndim(values) == 1 and np.asarray(values).dtype.kind in "fiu" and np.isfinite(values).all()
        if np.size(values[rows]) and np.ptp(values[rows]) > 0
    }
    return {name: values for name, values in varying.items() if name != ORDER or TIME not in varying}


def between_neighbours(values: NDArray, time_s: NDArray) -> NDArray:
    """Fill a few missing values of a column (B,) by interpolation in time; return it unchanged if many are missing."""
    lacks = ~np.isfinite(values)
    if lacks.mean() > _MOST_LACKING or not np.isfinite(time_s).all():
        return values
    order = np.argsort(time_s)
    order = order[~lacks[order]]
    return np.where(lacks, np.interp(time_s, time_s[order], values[order]), values)


def middle_and_half(values: NDArray) -> tuple[float, float]:
    """Return the centre of the range of values, and half the range."""
    return float(values.max() + values.min()) / 2, float(values.max() - values.min()) / 2


def order_in_time(time: NDArray | None, poses: int) -> NDArray:
    """Return the rank (B,) of each pose in time; in order of the table if there is no time, untimed poses last."""
    known = np.zeros(poses) if time is None else np.where(np.isfinite(time), time, np.inf)
    rank = np.empty(poses)
    rank[np.argsort(known, kind="stable")] = np.arange(poses)
    return rank


def is_row_number(time: NDArray) -> bool:
    """Return True if times (B,) are the numbers of their rows, as where a campaign gives none: they are no seconds."""
    return bool((np.diff(np.sort(time)) == 1.0).all())


def numbers_rows(name: str, values: NDArray) -> bool:
    """Return True if a column (B,) counts its rows, such as a running number: it says no more than their order.

    Its name ends in no unit: a temperature may rise by one from row to row.
    """
    return len(values) >= _FEWEST_NUMBERED and not _UNIT_AT_END.search(name) and bool((np.diff(values) == 1.0).all())


def ranks(order: NDArray) -> NDArray:
    """Return the rank (B,) of each epoch, from 0, by its order in time (B,); equal values keep their sequence."""
    return np.asarray(np.argsort(np.argsort(order, kind="stable")))


def fading_sum(readings: NDArray, time: NDArray, share_left: float) -> NDArray:
    """Return the sum (B, L), m, of each actuator's movements up to a pose; 0 at the first pose in time.

    Each movement is weighted by ``share_left`` to the power of the number of later movements.
    """
    order = np.argsort(time, kind="stable")
    steps = np.nan_to_num(np.diff(readings[order], axis=0))
    total = np.zeros_like(readings)
    for before, now, step in zip(order[:-1], order[1:], steps, strict=True):
        total[now] = share_left * total[before] + step
    return total


def relaxing_states(readings: NDArray, time: NDArray) -> NDArray | None:
    """Return states (B, L, s) that follow the movements of readings (B, L) and relax; None without intervals.

    time: (B,) in s. Each of s states decays exponentially and grows by the movements, which are even between two poses.
    Time constants reach from the usual interval to a quarter of the time covered. The states of a reading are returned
    as combinations without correlation, of unit mean square; 0 at the first pose in time.
    """
    order = np.argsort(time, kind="stable")
    order = order[np.isfinite(time[order]) & np.isfinite(readings[order]).all(1)]
    interval = np.diff(time[order])
    usual = float(np.median(interval)) if len(interval) else 0.0
    longest = _SLOWEST * float(interval.sum())
    if usual <= 0.0 or longest <= usual:
        return None
    passed = interval[:, None] / np.geomspace(usual, longest, len(RELAXING))
    left, gained = (
        np.exp(-passed),
        np.where(passed > 0.0, -np.expm1(-passed) / np.where(passed > 0.0, passed, 1.0), 1.0),
    )
    states = np.zeros((*readings.shape, len(RELAXING)))
    steps = np.diff(readings[order], axis=0)
    for index, (before, now) in enumerate(pairwise(order)):
        states[now] = left[index] * states[before] + gained[index] * steps[index][:, None]
    for reading in range(states.shape[1]):
        directions, sizes, _ = np.linalg.svd(states[:, reading], full_matrices=False)
        states[:, reading] = np.sqrt(len(directions)) * np.where(
            sizes > _LEAST_STATE * max(sizes[0], 1e-300), directions, 0.0
        )
    return states


def approach(readings: NDArray, time: NDArray, least: float) -> NDArray:
    """Return the direction (B, L) of each actuator's last movement larger than ``least`` (m) in time; +1 before any."""
    order = np.argsort(time, kind="stable")
    steps = np.diff(readings[order], axis=0, prepend=readings[order][:1])
    moved = np.abs(np.nan_to_num(steps)) > least
    last = np.maximum.accumulate(np.where(moved, np.arange(len(order))[:, None], -1), axis=0)
    signs = np.take_along_axis(np.sign(steps), np.maximum(last, 0), 0)
    direction = np.ones_like(readings)
    direction[order] = np.where(last >= 0, signs, 1.0)
    return direction


def rates(readings: NDArray, time: NDArray | None) -> NDArray | None:
    """Return the rate (B, n) of readings (B, n) along a smooth path, per s, 0 where unknown; None if they follow none.

    time: (B,) in s. Cubic splines between pauses give the rates, so that readings need not be evenly spaced.
    """
    if time is None:
        return None
    known = np.flatnonzero(np.isfinite(time) & np.isfinite(readings).all(1))
    in_time = known[np.argsort(time[known], kind="stable")]
    interval = np.diff(time[in_time])
    usual = float(np.median(interval)) if len(interval) else 0.0
    if len(in_time) < _FEWEST_OF_A_PATH or usual <= 0.0 or not _is_smooth(readings[in_time]):
        return None
    from scipy.interpolate import CubicSpline

    found = np.zeros(readings.shape)
    for part in np.split(in_time, 1 + np.flatnonzero((interval <= 0.0) | (interval > _PAUSE * usual))):
        if len(part) > 1:
            found[part] = CubicSpline(time[part], readings[part]).derivative()(time[part])
    return found


def _is_smooth(readings: NDArray) -> bool:
    """Return True if readings (B, n), in order of time, lie near the lines between their neighbours."""
    extent = np.ptp(readings, axis=0)
    path = readings[:, extent > 0.0] / extent[extent > 0.0]
    steps, bends = np.abs(np.diff(path, axis=0)), np.abs(np.diff(path, n=2, axis=0))
    return bool(path.size) and float(np.median(bends)) < _SMOOTH * float(np.median(steps))


def stop_states(steps: NDArray, extent: NDArray, stops: Sequence[float] = STOPS) -> NDArray:
    """Return states (B, n, s) in -1 .. 1 of s stop operators after steps (B, n) in order; ``extent`` (n,) of readings.

    A stop follows the reading within its threshold, as friction does; sums of them are any rate-independent hysteresis
    (Visintin, Differential models of hysteresis, 1994, chapter III).
    """
    reach = np.maximum(extent[:, None] * np.array(stops), 1e-300)
    state, states = np.zeros_like(reach), np.empty((len(steps), *reach.shape))
    for index, step in enumerate(steps):
        state = np.clip(state + step[:, None] / reach, -1.0, 1.0)
        states[index] = state
    return states


def histories(readings: NDArray, order: NDArray, stops: Sequence[float] = STOPS) -> NDArray:
    """Return the states (B, n, s) of s stop operators at readings (B, n), in order of time (B,); 0 where a reading is
    not finite."""
    history = np.zeros((*readings.shape, len(stops)))
    read = np.flatnonzero(np.isfinite(readings).all(1))
    read_in_order = read[np.argsort(order[read], kind="stable")]
    if len(read_in_order):
        steps = np.diff(readings[read_in_order], axis=0, prepend=readings[read_in_order][:1])
        history[read_in_order] = stop_states(steps, np.ptp(readings[read_in_order], axis=0), stops)
    return history
