"""Poses and runs that repeat one another."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index
from truing.estimation.quality import repeated_groups
from truing.schemas.columns import COLUMNS
from truing.stages.common.point_arrays import number_column

DECLARED, SAME_READINGS, SAME_LOADS = "repeat_of", "the same readings", "the same loads in the same order"
_SAME = 5.0  # difference of actuator readings within one position, in sigmas


def repeated_poses(configurations: pa.Table, drives: tuple[str, ...], actuator_mm: float) -> tuple[list[Index], str]:
    """Rows of the configurations that repeat one another, by group, and the evidence.

    The column ``repeat_of`` has precedence; else equal readings (of actuators or drives) count.
    """
    if DECLARED in configurations.column_names:
        return declared_repeats(configurations), DECLARED
    readings = drive_readings(configurations, drives)
    if not readings.shape[1]:
        return [], SAME_READINGS
    return repeated_groups(readings, np.full(readings.shape[1], max(_SAME * actuator_mm, 1e-9))), SAME_READINGS


def declared_repeats(configurations: pa.Table) -> list[Index]:
    """Rows of the configurations, by group, that the column ``repeat_of`` joins."""
    poses = [str(pose) for pose in configurations.column("pose").to_pylist()]
    first = {
        pose: repeated_pose
        for pose, repeated_pose in zip(poses, configurations.column(DECLARED).to_pylist(), strict=True)
        if repeated_pose
    }
    root = []
    for pose in poses:
        met = {pose}
        while (repeated_pose := first.get(pose)) is not None and repeated_pose not in met:
            pose = repeated_pose
            met.add(repeated_pose)
        root.append(pose)
    rows = np.array(root, dtype=object)
    groups = (np.flatnonzero(rows == pose) for pose in dict.fromkeys(root))
    return [group for group in groups if len(group) > 1]


def drive_readings(configurations: pa.Table, drives: tuple[str, ...]) -> Array:
    """(B, D) varying readings of actuators or drives."""
    names = [name for name in configurations.column_names if COLUMNS["rho"].matches(name) or name in drives]
    columns = [number_column(configurations, name) for name in names]
    varying = [column for column in columns if np.isfinite(column).any() and np.nanstd(column) > 0.0]
    return np.column_stack(varying) if varying else np.zeros((configurations.num_rows, 0))
