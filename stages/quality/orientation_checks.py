"""Check of measured orientations of a chain: do they turn with the links, in the frame of the measured positions."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Mask
from truing.belonging.orientations import TurningMisfit, turning_misfit
from truing.belonging.relation import RecordSlip, RelationState, RelationTest, SlipKind
from truing.belonging.rotation_writing import WrittenRotations
from truing.belonging.slips_in_rows import row_places
from truing.stages.common.chain_measurements import MeasuredLinks
from truing.stages.common.point_arrays import positions, recorded_angles
from truing.stages.quality.chain_slips import FEWEST_POSES, ComparedChain

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

JOINTS = "joints-against-links"
FRAMES_DIFFER = "frames-differ"  # those of measured positions and orientations
_DEG = np.pi / 180.0


def orientation_test(
    compared: ComparedChain, settings: Campaign, measured_poses: pa.Table | None = None
) -> RelationTest | None:
    """The test of the first measured link whose orientations do not turn with it, or with strays; None if all do."""
    strays: tuple[str, ...] = ()
    agreed: TurningMisfit | None = None
    measured, frames = compared.measured, compared.tree.frames(compared.conditions.readings)
    channels = measured.channels
    for k in np.flatnonzero(channels.is_rotation):
        for series in np.unique(compared.conditions.series):
            rows = compared.usable & measured.is_observed[:, k] & (compared.conditions.series == series)
            if rows.sum() < FEWEST_POSES:
                continue
            compared_turns = turning_misfit(
                frames.R[rows, channels.node[k]],
                _written(compared, int(k), settings, measured_poses).subset(rows),
                _positions(measured, int(k), rows, frames.t),
            )
            if compared_turns.stray.any():
                poses = np.array([str(pose) for pose in compared.conditions.poses])[rows][compared_turns.stray]
                strays, agreed = (*strays, *(f"pose {pose}" for pose in poses)), compared_turns
            if compared_turns.before > compared_turns.limit:
                test = RelationTest(
                    JOINTS,
                    RelationState.FAILS,
                    "no-slip",
                    misfit=compared_turns.before / _DEG,
                    limit=compared_turns.limit / _DEG,
                    unit="deg",
                    misfit_explained=compared_turns.after / _DEG if compared_turns.slips else None,
                )
                slips = compared_turns.slips
                if compared_turns.rows is not None:
                    poses = np.array([str(pose) for pose in compared.conditions.poses])[rows].tolist()
                    where = row_places(*compared_turns.rows, poses, ())
                    slips = tuple(replace(slip, subjects=(*slip.subjects, *where)) for slip in slips)
                return replace(test, slips=slips[:1], rivals=slips[1:])
            if compared_turns.apart is not None:
                return _in_different_frames(compared_turns)
    if agreed is None:
        return None
    return RelationTest(
        JOINTS,
        RelationState.ATTENTION,
        "strays",
        misfit=agreed.before / _DEG,
        limit=agreed.limit / _DEG,
        unit="deg",
        slips=(RecordSlip(SlipKind.STRAY, "measured orientations of", strays),),
    )


def _written(compared: ComparedChain, k: int, settings: Campaign, measured_poses: pa.Table | None) -> WrittenRotations:
    """Return the orientations (B, 3, 3) of a channel, with the angles from which they were read, if any."""
    reference, poses = compared.conditions.reference[:, k], compared.conditions.poses
    angles = None if measured_poses is None else recorded_angles(measured_poses)
    if measured_poses is None or angles is None:
        return WrittenRotations(reference, settings.poses.euler)
    link = compared.measured.channels.links[k]
    rows = np.array([body == link for body in measured_poses.column("body").to_pylist()])
    at = positions(measured_poses.column("pose").filter(pa.array(rows)), poses)
    recorded = np.zeros((len(poses), 3))
    recorded[at[at >= 0]] = angles[rows][at >= 0]
    return WrittenRotations.of_table(reference, settings.poses.euler, recorded)


def _in_different_frames(turns: TurningMisfit) -> RelationTest:
    """Return the failed test of positions and orientations of poses that contradict one another."""
    assert turns.apart is not None
    after = None if turns.apart_after is None else turns.apart_after / _DEG
    sizes = ("", turns.apart / _DEG, after, None, "deg", turns.slips[:1], turns.slips[1:])
    return RelationTest(JOINTS, RelationState.FAILS, FRAMES_DIFFER, *sizes)


def _positions(measured: MeasuredLinks, k: int, poses: Mask, by_chain: Array) -> tuple[Array, Array] | None:
    """Positions (B, 3) by the chain, and as measured, of the link whose orientations channel ``k`` holds, m; None
    unless every pose has one."""
    channels = measured.channels
    for other in np.flatnonzero((channels.node == channels.node[k]) & ~channels.is_rotation):
        if measured.is_observed[poses, other].all():
            return by_chain[poses, channels.node[k]], measured.values[poses, other]
    return None
