"""Slips in single rows of actuator readings: stray or frozen readings, and rows out of order."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from truing.arrays import Array
from truing.belonging.reading_hypotheses import MeasuredMotion
from truing.belonging.relation import RecordSlip, SlipKind
from truing.belonging.slips_in_rows import RowOrder, stray_readings

MOVED = 10.0  # least movement of a leg for a comparison, in sigmas of a reading
_MOSTLY = 0.7  # share of the rows that moved
_FROZEN = 4  # fewest equal readings in successive rows


@dataclass(frozen=True)
class ReadingNames:
    """Names of the columns of readings (L) and of the poses (B), and columns that group poses with their values."""

    columns: tuple[str, ...]
    poses: tuple[str, ...]
    groups: tuple[tuple[str, tuple[str, ...]], ...] = ()


def stray_readings_by_name(motion: MeasuredMotion, required: Array, names: ReadingNames) -> list[tuple[str, str]]:
    """Return the pose and the column of single readings that do not belong to their pose."""
    determined = np.isfinite(required).all(axis=1)
    at = np.flatnonzero(determined)
    readings = stray_readings(motion.readings[determined], required[determined], motion.noise)
    return [(names.poses[at[row]], names.columns[leg]) for row, leg in readings.tolist()]


def stray_slips(strays: list[tuple[str, str]], names: ReadingNames) -> Iterator[RecordSlip]:
    """Yield the slip of poses of which most columns are stray, as the pose itself may be wrong; and of single
    readings."""
    poses = [pose for pose, _ in strays]
    poses_all_wrong = [pose for pose in dict.fromkeys(poses) if poses.count(pose) > 0.5 * len(names.columns)]
    cells = tuple(f"{column} in pose {pose}" for pose, column in strays if pose not in poses_all_wrong)
    if poses_all_wrong:
        yield RecordSlip(
            SlipKind.STRAY, "readings or measured position of", tuple(f"pose {pose}" for pose in poses_all_wrong)
        )
    if cells:
        yield RecordSlip(SlipKind.STRAY, "readings", cells)


def row_slips(order: RowOrder, names: ReadingNames) -> tuple[RecordSlip, ...]:
    """Return an order of rows as slips: all shifted, shifted from a pose on, reversed, or exchanged in cycles."""
    moved = order.moved
    if order.gain <= 0.0:
        return ()
    if order.shift:
        return (RecordSlip(SlipKind.ROWS_SHIFTED, "readings", (), shift=order.shift),)
    by = order.rows[moved] - moved
    steps, counts = np.unique(by, return_counts=True)
    if counts.max() >= _MOSTLY * len(moved) and len(moved) > 2:
        shift = int(steps[counts.argmax()])
        first, last = moved[by == shift][[0, -1]]
        ends = last + abs(shift) < len(order.rows) - 1
        where = f"from pose {names.poses[first]} {f'to pose {names.poses[last]}' if ends else 'on'}"
        return (RecordSlip(SlipKind.ROWS_SHIFTED, "readings", (where,), shift=shift),)
    if len(moved) > 2 and np.mean(order.rows[moved] + moved == len(order.rows) - 1) >= _MOSTLY:
        return (RecordSlip(SlipKind.ROWS_EXCHANGED, "readings", ("all rows, in reverse order",)),)
    rows = tuple(f"pose {names.poses[pose]} has the readings of {names.poses[order.rows[pose]]}" for pose in moved)
    return (RecordSlip(SlipKind.ROWS_EXCHANGED, "readings", rows),)


def frozen_readings(motion: MeasuredMotion, required: Array, names: ReadingNames) -> tuple[RecordSlip, ...]:
    """Return columns that repeat one number over poses which require clearly different ones."""
    frozen_slips = []
    for leg, name in enumerate(names.columns):
        value = motion.readings[:, leg]
        ends = np.flatnonzero(np.diff(value) != 0.0)
        numbers = np.unique(value)
        least = max(2.0 * MOVED * motion.noise, 1.5 * float(np.diff(numbers).min()) if len(numbers) > 1 else 0.0)
        for first, last in zip(np.r_[0, ends + 1], np.r_[ends + 1, len(value)], strict=True):
            wanted = required[first:last, leg]
            if last - first >= _FROZEN and np.ptp(np.nan_to_num(wanted)) > least:
                frozen_slips.append(
                    RecordSlip(SlipKind.FROZEN, "readings", (f"{name} from pose {names.poses[first]} on",))
                )
                break
    return tuple(frozen_slips)
