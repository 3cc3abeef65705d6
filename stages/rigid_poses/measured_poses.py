"""Poses that an instrument measured as such, beside those from targets or in their place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from stages.common.point_arrays import number_column, positions
from stages.rigid_poses.body_pose import BodyPoses
from stages.rigid_poses.scan_poses import without_targets
from truing.estimation.rigid_poses.rigid import FitStatus, RigidFit
from truing.estimation.rotation import exp_so3

if TYPE_CHECKING:
    import pyarrow as pa

METHOD = "measured"


def with_measured(bodies: Sequence[BodyPoses], measured: pa.Table, poses: tuple[int | str, ...]) -> list[BodyPoses]:
    """The bodies with their measured poses as a further method, and bodies of which nothing else is known."""
    import pyarrow.compute as pc

    found = {body.name: body for body in bodies}
    for name in dict.fromkeys(measured.column("body").to_pylist()):
        rows = measured.filter(pc.equal(measured.column("body"), name))
        body = found.get(name) or without_targets(name, poses, METHOD)
        found[name] = replace(
            body,
            fits={**body.fits, METHOD: _fit(rows, poses)},
            rejections={**body.rejections, METHOD: np.zeros(len(poses), np.int64)},
        )
    return list(found.values())


def _fit(rows: pa.Table, poses: tuple[int | str, ...]) -> RigidFit:
    """The measured poses of one body as a batch over all poses; one that was not measured has too few points."""
    count, place = len(poses), positions(rows.column("pose"), poses)
    R, t, covariance = np.full((count, 3, 3), np.nan), np.full((count, 3), np.nan), np.full((count, 6, 6), np.nan)
    status = np.full(count, str(FitStatus.TOO_FEW_POINTS), dtype=object)
    R[place] = exp_so3(np.column_stack([number_column(rows, f"r{a}_rad") for a in "xyz"]))
    t[place] = 1e-3 * np.column_stack([number_column(rows, f"p{a}_mm") for a in "xyz"])
    for i in range(6):
        for j in range(i, 6):
            covariance[place, i, j] = covariance[place, j, i] = number_column(rows, f"cov_{i}_{j}")
    status[place] = str(FitStatus.OK)
    one = np.where(status == FitStatus.OK, 1.0, np.nan)
    nothing = np.zeros(count, np.int64)
    return RigidFit(R, t, one, covariance, 0.0 * one, np.full(count, np.nan), nothing, status.astype(str), nothing)
