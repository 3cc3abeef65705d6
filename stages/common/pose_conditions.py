"""Conditions of each pose: readings, covariates, and directions of approach of the actuators."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.schemas.covariates import column_alias
from truing.simulation.inputs import (
    APPROACH,
    LAST_STEP,
    MEMORY,
    ORDER,
    RATE,
    RELAXING,
    STOPPED,
    TIME,
    approach,
    fading_sum,
    histories,
    numbers_rows,
    order_in_time,
    rates,
    relaxing_states,
)
from truing.simulation.mechanisms.recording import Conditions
from truing.stages.common.point_arrays import number_column, number_columns, positions

# Smallest movement that defines an actuator's direction of approach, in sigmas of its reading.
_MOVED = 5.0
# Share of a movement that a memory effect keeps from pose to pose.
_KEPT = 0.7


def pose_conditions(
    configurations: pa.Table, poses: tuple[int | str, ...], legs: int, reading_sigma: float
) -> Conditions:
    """Readings (B, L) in m and covariates by column, NaN if missing; directions of approach for poses with a time."""
    index = positions(configurations.column("pose"), poses)

    def dense(values: NDArray) -> NDArray:
        filled = np.full((len(poses), *values.shape[1:]), np.nan)
        filled[index[index >= 0]] = values[index >= 0]
        return filled

    names = [f"rho{leg}_mm" for leg in range(1, legs + 1)]
    readings = dense(number_columns(configurations, names) * 1e-3)
    covariates = {
        column_alias(field.name): dense(number_column(configurations, field.name))
        for field in configurations.schema
        if field.name not in ("pose", "role", *names) and _is_number(field.type)
    }
    covariates = {name: values for name, values in covariates.items() if name == TIME or not numbers_rows(name, values)}
    time = covariates.get("time_s")
    covariates[ORDER] = order_in_time(time, len(poses))
    if time is not None:
        covariates[APPROACH] = approach(readings, time, _MOVED * reading_sigma)
        covariates[LAST_STEP] = fading_sum(readings, time, 0.0)
        covariates[MEMORY] = fading_sum(readings, time, _KEPT)
        covariates |= dict(zip(STOPPED, np.moveaxis(histories(readings, covariates[ORDER]), -1, 0), strict=True))
    if time is not None and counts_rows(configurations):
        del covariates["time_s"]  # numbers of rows, and no seconds
    elif time is not None:
        moving = rates(readings, time)
        covariates |= {} if moving is None else {RATE: moving}
        states = relaxing_states(readings, time)
        covariates |= {} if states is None else dict(zip(RELAXING, np.moveaxis(states, -1, 0), strict=True))
    return Conditions(readings, covariates, poses, _span(covariates.get("time_s")))


def counts_rows(configurations: pa.Table) -> bool:
    """True if times of configurations are the numbers of their rows, as where a campaign gives none."""
    times = number_column(configurations, "time_s")
    return np.array_equal(times, np.arange(float(len(times))))


def _span(time: NDArray | None) -> tuple[float, float] | None:
    known = np.empty(0) if time is None else time[np.isfinite(time)]
    return (float(known.min()), float(known.max())) if len(known) else None


def _is_number(kind: pa.DataType) -> bool:
    return bool(pa.types.is_floating(kind) or pa.types.is_integer(kind))
