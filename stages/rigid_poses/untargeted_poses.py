"""Poses that dense scans gave or an instrument measured as such, next to those from targets or in their place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from truing.estimation.rigid_poses.body_poses import BodyPoses, without_targets
from truing.estimation.rigid_poses.rigid import FitStatus, RigidFit
from truing.estimation.rotation import exp_so3
from truing.stages.common.point_arrays import number_column, positions, text_column

if TYPE_CHECKING:
    import pyarrow as pa

SCAN, MEASURED = "scan", "measured"


def with_scans(bodies: Sequence[BodyPoses], scans: pa.Table, poses: tuple[int | str, ...]) -> list[BodyPoses]:
    """The bodies with what their scans say as a further method, and bodies that were only scanned."""
    import pyarrow.compute as pc

    found = {body.name: body for body in bodies}
    for name in dict.fromkeys(scans.column("body").to_pylist()):
        rows = scans.filter(pc.equal(scans.column("body"), name))
        place = positions(rows.column("pose"), poses)
        rejected = np.zeros(len(poses), np.int64)
        rejected[place] = number_column(rows, "n_rejected").astype(np.int64)
        body = found.get(name) or without_targets(name, poses, SCAN)
        found[name] = replace(
            body,
            fits={**body.fits, SCAN: _scan_fit(rows, place, len(poses))},
            rejections={**body.rejections, SCAN: rejected},
        )
    return list(found.values())


def _scan_fit(rows: pa.Table, place: np.ndarray, count: int) -> RigidFit:
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


def with_measured(bodies: Sequence[BodyPoses], measured: pa.Table, poses: tuple[int | str, ...]) -> list[BodyPoses]:
    """The bodies with their measured poses as a further method, and bodies of which nothing else is known."""
    import pyarrow.compute as pc

    found = {body.name: body for body in bodies}
    for name in dict.fromkeys(measured.column("body").to_pylist()):
        rows = measured.filter(pc.equal(measured.column("body"), name))
        body = found.get(name) or without_targets(name, poses, MEASURED)
        found[name] = replace(
            body,
            fits={**body.fits, MEASURED: _measured_fit(rows, poses)},
            rejections={**body.rejections, MEASURED: np.zeros(len(poses), np.int64)},
        )
    return list(found.values())


def _measured_fit(rows: pa.Table, poses: tuple[int | str, ...]) -> RigidFit:
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
