"""The poses that dense scans gave, beside those from targets, and for bodies that have no targets in their place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from stages.common.point_arrays import PosePoints, number_column, positions, text_column
from stages.rigid_poses.body_pose import BodyPoses
from truing.estimation.rigid_poses.rigid import FitStatus, RigidFit
from truing.estimation.rotation import exp_so3

if TYPE_CHECKING:
    import pyarrow as pa

METHOD = "scan"


def with_scans(bodies: Sequence[BodyPoses], scans: pa.Table, poses: tuple[int | str, ...]) -> list[BodyPoses]:
    """The bodies with what their scans say as a further method, and bodies that were only scanned."""
    import pyarrow.compute as pc

    found = {body.name: body for body in bodies}
    for name in dict.fromkeys(scans.column("body").to_pylist()):
        rows = scans.filter(pc.equal(scans.column("body"), name))
        place = positions(rows.column("pose"), poses)
        rejected = np.zeros(len(poses), np.int64)
        rejected[place] = number_column(rows, "n_rejected").astype(np.int64)
        body = found.get(name) or without_targets(name, poses, METHOD)
        found[name] = replace(
            body,
            fits={**body.fits, METHOD: _fit(rows, place, len(poses))},
            rejections={**body.rejections, METHOD: rejected},
        )
    return list(found.values())


def _fit(rows: pa.Table, place: np.ndarray, count: int) -> RigidFit:
    """The scans of one body as a batch over all poses; a pose without a scan has too few points."""
    upper = np.array([[number_column(rows, f"cov_{min(i, j)}_{max(i, j)}") for j in range(6)] for i in range(6)])
    vector = np.column_stack([number_column(rows, f"r{a}_rad") for a in "xyz"])
    R, t, covariance = np.full((count, 3, 3), np.nan), np.full((count, 3), np.nan), np.full((count, 6, 6), np.nan)
    rms, n_used = np.full(count, np.nan), np.zeros(count, np.int64)
    status = np.full(count, str(FitStatus.TOO_FEW_POINTS), dtype=object)
    known = np.asarray(np.isfinite(vector).all(axis=1))
    R[place[known]] = exp_so3(vector[known])
    t[place] = 1e-3 * np.column_stack([number_column(rows, f"p{a}_mm") for a in "xyz"])
    covariance[place] = np.moveaxis(upper, -1, 0)
    rms[place] = 1e-3 * number_column(rows, "rms_mm")
    n_used[place] = number_column(rows, "n_used").astype(np.int64)
    status[place] = text_column(rows, "status")
    rms[status != FitStatus.OK] = np.nan
    one = np.where(status == FitStatus.OK, 1.0, np.nan)
    return RigidFit(R, t, one, covariance, 0.0 * one, rms, n_used, status.astype(str), np.zeros(count, np.int64))


def without_targets(name: str, poses: tuple[int | str, ...], default: str) -> BodyPoses:
    """A body that no target says anything of; ``default``: the method that its poses are to come from."""
    count = len(poses)
    none = np.zeros((count, 0), bool)
    points = PosePoints(poses, (), np.zeros((count, 0, 3)), np.zeros((count, 0, 3, 3)), none)
    residual, reason = np.zeros((count, 0, 3)), np.zeros((count, 0), dtype=object)
    nothing = np.zeros((none.shape[1], 3))
    known = (nothing, np.zeros((none.shape[1], 3, 3)), np.zeros(none.shape[1], bool), none, none)
    return BodyPoses(name, points, {}, default, residual, none, none, {}, reason, 1.0, *known)
