"""Plan of a chain's poses: those for verification, their order, and the table."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from truing.arrays import Array
from truing.estimation.design.pose_order import PoseOrder, order_poses
from truing.stages.common.chain_candidates import JointRanges
from truing.stages.common.missing_data import HELD_OUT
from truing.stages.configurations.tables import first_number

if TYPE_CHECKING:
    from truing.stages.configurations.chosen import DesignOptions


def verification_poses(drawn: NDArray, chosen: NDArray, ranges: JointRanges, count: int) -> Array:
    """Return candidates far from the chosen poses and from each other, in shares of the ranges of the joints."""
    distance = np.abs((drawn[:, None] - chosen) / ranges.width).max(-1).min(1)
    chosen_poses: list[int] = []
    for _ in range(count):
        chosen_poses.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.abs((drawn - drawn[chosen_poses[-1]]) / ranges.width).max(-1))
    return np.asarray(drawn[chosen_poses])


def ordered_poses(
    readings: NDArray, ranges: JointRanges, existing: Array | None, options: DesignOptions, rng: np.random.Generator
) -> PoseOrder:
    """Return the order in which no function of a reading follows time: the reading, its sine and its cosine."""
    share = (readings - ranges.low) / ranges.width
    start = np.full(share.shape[1], 0.5) if existing is None else (existing[-1] - ranges.low) / ranges.width
    groups = np.stack([readings, np.sin(readings), np.cos(readings)], -1).transpose(1, 0, 2)
    return order_poses(share, start, groups, rng, options.trade_off)


def plan_table(
    ranges: JointRanges, readings: NDArray, order: PoseOrder, options: DesignOptions, extend: pa.Table | None
) -> pa.Table:
    """Return the chosen poses and those for verification in their order, numbered after those of ``extend``."""
    roles = np.repeat(["calibration", HELD_OUT], [options.poses, options.verification])[order.order].tolist()
    return ranges.table(
        readings[order.order],
        pose=pa.array(np.arange(len(readings)) + first_number(extend)),
        role=pa.array(roles, pa.string()),
    )


def poses_to_fit(ranges: JointRanges, existing: NDArray | None, table: pa.Table) -> pa.Table:
    """Return the poses that are kept and those of a plan, without those for verification."""
    poses_of_plan = table.filter(pc.not_equal(table.column("role"), HELD_OUT)).select([c.name for c in ranges.columns])
    all_poses = poses_of_plan if existing is None else pa.concat_tables([ranges.table(existing), poses_of_plan])
    return all_poses.append_column("pose", pa.array(np.arange(len(all_poses))))
