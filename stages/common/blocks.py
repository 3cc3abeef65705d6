"""Blocks of a campaign's epochs: series, runs, days, directions of approach, regions of the inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.inference.arrays import Array, Integers
from truing.inference.blocks import BlockKind, days, group_numbers, regions
from truing.stages.common.point_arrays import positions
from truing.stages.common.repeats import DECLARED, drive_readings, repeated_poses

_LABELS = {"series": BlockKind.SERIES, "run": BlockKind.RUN}


def groupings_of(
    inputs: Array, time_s: Array | None, approach: Array | None, labels: Mapping[BlockKind, Integers] | None = None
) -> dict[BlockKind, Integers]:
    """Groupings (B,) by kind, -1 for none: from inputs (B, D), times (B,), and directions (B, L) if known."""
    groupings = dict(labels or {})
    if time_s is not None:
        groupings[BlockKind.DAY] = days(time_s)
    if approach is not None and approach.shape[1]:
        groupings[BlockKind.DIRECTION] = group_numbers(approach)
    varies = np.isfinite(inputs).all(0) & (np.ptp(inputs, axis=0) > 0.0) if len(inputs) else np.zeros(0, bool)
    if varies.any():
        groupings[BlockKind.REGION] = regions(inputs[:, varies])
    return groupings


def labels_of(table: pa.Table | None, poses: Sequence[int | str]) -> dict[BlockKind, Integers]:
    """Series and run (B,) of each pose in the configurations, by number, -1 for none."""
    labels_by_kind = {}
    for name, kind in _LABELS.items() if table is not None else ():
        if table is not None and name in table.column_names:
            texts = [str(value) if value is not None else "" for value in table.column(name).to_pylist()]
            index, numbers = positions(table.column("pose"), tuple(poses)), np.full(len(poses), -1)
            label = np.where(np.array(texts) == "", -1, np.unique(texts, return_inverse=True)[1])
            numbers[index[index >= 0]] = label[index >= 0]
            labels_by_kind[kind] = numbers
    return labels_by_kind


def readings_of(table: pa.Table | None, poses: Sequence[int | str], drives: tuple[str, ...]) -> Array:
    """Varying readings (B, D) of actuators or drives, NaN for missing ones."""
    if table is None or not table.num_rows:
        return np.zeros((len(poses), 0))
    drive_values, index = drive_readings(table, drives), positions(table.column("pose"), tuple(poses))
    readings = np.full((len(poses), drive_values.shape[1]), np.nan)
    readings[index[index >= 0]] = drive_values[index >= 0]
    return readings


def repeats_of(
    table: pa.Table | None, poses: Sequence[int | str], drives: tuple[str, ...], actuator_mm: float
) -> Integers | None:
    """Numbers (B,) of commands that several poses share, -1 for single commands; None if no command is known."""
    if table is None or not table.num_rows:
        return None
    if DECLARED not in table.column_names and not drive_readings(table, drives).shape[1]:
        return None
    numbers = np.full(len(poses), -1)
    index = positions(table.column("pose"), tuple(poses))
    for number, rows in enumerate(repeated_poses(table, drives, actuator_mm)[0]):
        numbers[index[rows][index[rows] >= 0]] = number
    return numbers


def selected_groupings(groupings: Mapping[BlockKind, Integers], rows: NDArray[np.bool_]) -> dict[BlockKind, Integers]:
    """Groupings of selected epochs (mask B)."""
    return {kind: numbers[rows] for kind, numbers in groupings.items()}
