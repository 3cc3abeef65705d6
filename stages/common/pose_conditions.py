"""What is known of each pose beside its points: readings, covariates, and the direction from which actuators came."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from schemas.covariates import stand_in
from stages.common.point_arrays import number_column, positions
from truing.simulation.inputs import APPROACH, LAST_STEP, MEMORY, ORDER
from truing.simulation.unknowns import Conditions

if TYPE_CHECKING:
    import pyarrow as pa

# An actuator's direction of approach is that of its last movement larger than so many reading sigmas.
_MOVED = 5.0
# How much of a movement a memory keeps from pose to pose.
_KEPT = 0.7


def pose_conditions(
    configurations: pa.Table, poses: tuple[int | str, ...], legs: int, reading_sigma: float
) -> Conditions:
    """Readings (B, L) in m and covariates by column; NaN where a pose has none; directions where poses have a time."""
    place = positions(configurations.column("pose"), poses)

    def dense(values: NDArray) -> NDArray:
        found = np.full((len(poses), *values.shape[1:]), np.nan)
        found[place[place >= 0]] = values[place >= 0]
        return found

    names = [f"rho{leg}_mm" for leg in range(1, legs + 1)]
    readings = dense(np.column_stack([number_column(configurations, name) for name in names]) * 1e-3)
    covariates = {
        stand_in(field.name): dense(number_column(configurations, field.name))
        for field in configurations.schema
        if field.name not in ("pose", "role", *names) and _is_number(field.type)
    }
    covariates[ORDER] = order_in_time(covariates.get("time_s"), len(poses))
    if "time_s" in covariates:
        covariates[APPROACH] = approach(readings, covariates["time_s"], _MOVED * reading_sigma)
        covariates[LAST_STEP] = remembered(readings, covariates["time_s"], 0.0)
        covariates[MEMORY] = remembered(readings, covariates["time_s"], _KEPT)
    return Conditions(readings, covariates, poses, _span(covariates.get("time_s")))


def _span(time: NDArray | None) -> tuple[float, float] | None:
    known = np.empty(0) if time is None else time[np.isfinite(time)]
    return (float(known.min()), float(known.max())) if len(known) else None


def order_in_time(time: NDArray | None, poses: int) -> NDArray:
    """Rank (B,) of each pose in time over the whole campaign; as in the table where there is no time, or none here."""
    known = np.zeros(poses) if time is None else np.where(np.isfinite(time), time, np.inf)
    rank = np.empty(poses)
    rank[np.argsort(known, kind="stable")] = np.arange(poses)
    return rank


def remembered(readings: NDArray, time: NDArray, kept: float) -> NDArray:
    """Sum (B, L), m, of each actuator's movements up to a pose in time order, every earlier one ``kept`` times as much
    as the next; 0 for the first."""
    order = np.argsort(time, kind="stable")
    steps = np.nan_to_num(np.diff(readings[order], axis=0))
    total = np.zeros_like(readings)
    for before, now, step in zip(order[:-1], order[1:], steps, strict=True):
        total[now] = kept * total[before] + step
    return total


def _is_number(kind: pa.DataType) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_floating(kind) or pa.types.is_integer(kind))


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


def chosen(conditions: Conditions, rows: NDArray) -> Conditions:
    """The conditions of some poses (rows: mask)."""
    return Conditions(
        conditions.readings[rows],
        {name: value[rows] for name, value in conditions.covariates.items()},
        tuple(pose for pose, kept in zip(conditions.poses, rows, strict=True) if kept),
        conditions.span_s,
    )
