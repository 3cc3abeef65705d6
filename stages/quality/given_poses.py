"""Relations of poses that an instrument measured directly, in place of points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from truing.arrays import Array, Mask
from truing.belonging.reading_tests import READINGS
from truing.belonging.relation import RelationState, RelationTest
from truing.estimation.rotation import exp_so3
from truing.quality.bodies import PoseSurroundings
from truing.stages.common.point_arrays import pose_covariances, pose_vectors, positions
from truing.stages.quality.belonging import related_readings

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import LeggedMechanism


@dataclass(frozen=True)
class _GivenPoses:
    """Poses of a body as measured: R (B, 3, 3), t (B, 3), m, covariance (B, 6, 6), m and rad, and those known (B,)."""

    R: Array
    t: Array
    covariance: Array
    ok: Mask


def readings_of_given_poses(
    poses: pa.Table, around: PoseSurroundings, configurations: pa.Table | None, settings: Campaign
) -> tuple[RelationTest, ...]:
    """Return the test of actuator readings against measured poses of the platform, and of the base if it was measured.

    An instrument that stood still in the frame of the base needs no base.
    """
    legs = len(cast("LeggedMechanism", settings.mechanism).legs)
    columns = {f"rho{leg + 1}_mm" for leg in range(legs)}
    if configurations is None or not columns <= set(configurations.column_names):
        return (RelationTest(READINGS, RelationState.NOT_TESTED, "no-readings"),)
    platform = _poses_of(poses, "platform", around)
    base = _poses_of(poses, "base", around)
    if not base.ok.any() and settings.is_frame_fixed:
        base = _GivenPoses(np.broadcast_to(np.eye(3), base.R.shape), base.t, base.covariance, np.ones_like(base.ok))
    right = np.ones_like(base.ok)
    return related_readings(base, platform, around, configurations, settings, right, are_given=True)


def _poses_of(poses: pa.Table, body: str, around: PoseSurroundings) -> _GivenPoses:
    poses_of_body = poses.filter(pc.equal(poses.column("body").cast(pa.string()), body))
    at = positions(poses_of_body.column("pose"), around.poses)
    vectors, covariances = pose_vectors(poses_of_body)[at >= 0], pose_covariances(poses_of_body)[at >= 0]
    at = at[at >= 0]
    known = np.isfinite(vectors).all(axis=1) & np.isfinite(covariances).all(axis=(1, 2))
    count = len(around.poses)
    given_poses = _GivenPoses(
        np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)), np.zeros((count, 6, 6)), np.zeros(count, bool)
    )
    rows = at[known]
    given_poses.R[rows], given_poses.t[rows] = exp_so3(vectors[known, 3:]), vectors[known, :3]
    given_poses.covariance[rows], given_poses.ok[rows] = covariances[known], True
    return given_poses
