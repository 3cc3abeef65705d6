"""Which poses and which runs repeat one another."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index
from truing.estimation.quality import repeated_groups
from truing.schemas.columns import COLUMNS
from truing.stages.common.point_arrays import number_column

DECLARED, SAME_READINGS, SAME_LOADS = "repeat_of", "the same readings", "the same loads in the same order"
_SAME = 5.0  # sigmas of an actuator's reading that are one and the same position


def repeated_poses(configurations: pa.Table, drives: tuple[str, ...], actuator_mm: float) -> tuple[list[Index], str]:
    """Rows of the configurations that repeat one another, group by group, and how that is known.

    A column ``repeat_of`` says so where there is one; else readings (of actuators, or drives) that agree do.
    """
    if DECLARED in configurations.column_names:
        return _declared(configurations), DECLARED
    readings = drive_readings(configurations, drives)
    if not readings.shape[1]:
        return [], SAME_READINGS
    return repeated_groups(readings, np.full(readings.shape[1], max(_SAME * actuator_mm, 1e-9))), SAME_READINGS


def _declared(configurations: pa.Table) -> list[Index]:
    poses = [str(pose) for pose in configurations.column("pose").to_pylist()]
    first = {pose: of for pose, of in zip(poses, configurations.column(DECLARED).to_pylist(), strict=True) if of}
    root = []
    for pose in poses:
        met = {pose}
        while (of := first.get(pose)) is not None and of not in met:
            pose = of
            met.add(of)
        root.append(pose)
    rows = np.array(root, dtype=object)
    groups = (np.flatnonzero(rows == pose) for pose in dict.fromkeys(root))
    return [group for group in groups if len(group) > 1]


def drive_readings(configurations: pa.Table, drives: tuple[str, ...]) -> Array:
    """(B, D) readings of actuators or drives, those that vary."""
    names = [name for name in configurations.column_names if COLUMNS["rho"].matches(name) or name in drives]
    columns = [number_column(configurations, name) for name in names]
    varying = [column for column in columns if np.isfinite(column).any() and np.nanstd(column) > 0.0]
    return np.column_stack(varying) if varying else np.zeros((configurations.num_rows, 0))
