"""Tables of points as dense arrays in metres, for all stages that work on poses."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask
from truing.estimation.rigid_poses.points import FittedPoints, PointResiduals, PosePoints, SurveyPoints

_AXES = "xyz"
RECORDED_ANGLES = tuple(f"recorded_{a}_rad" for a in "abc")
_PAIRS = (("xy", 0, 1), ("xz", 0, 2), ("yz", 1, 2))


def text_column(table: pa.Table, name: str) -> NDArray[np.object_]:
    """A text column as an array of str."""
    return np.asarray(table.column(name).to_pylist(), dtype=object)


def decisions(excluded: Mask, kept: Mask) -> NDArray[np.object_]:
    """Decisions of a person from that column: excluded, kept, or None."""
    reasons = np.full(excluded.shape, None, dtype=object)
    reasons[kept], reasons[excluded] = "kept", "excluded"
    return reasons


def number_column(table: pa.Table, name: str) -> Array:
    """A column of numbers as float64, NaN where empty."""
    return np.asarray(table.column(name).to_numpy(zero_copy_only=False), dtype=float)


def number_columns(table: pa.Table, names: Iterable[str]) -> Array:
    """(N, K) columns of numbers, NaN if empty."""
    return np.column_stack([number_column(table, name) for name in names])


def pose_ids(table: pa.Table, name: str = "pose") -> tuple[int | str, ...]:
    """The poses of a table, each once, in order of appearance."""
    return tuple(dict.fromkeys(table.column(name).to_pylist()))


def roles_of(configurations: pa.Table, poses: tuple[int | str, ...]) -> NDArray[np.object_]:
    """Role (B,) of each pose; empty if the table lacks it."""
    index = positions(configurations.column("pose"), poses)
    roles = np.full(len(poses), "", object)
    roles[index[index >= 0]] = text_column(configurations, "role")[index >= 0]
    return roles


def survey_points(survey: pa.Table, body: str) -> SurveyPoints:
    """Survey of one body; no rows for an unsurveyed body."""
    rows = survey.filter(pc.equal(survey.column("body"), body))
    leg = np.nan_to_num(number_column(rows, "leg")).astype(np.int64)
    return SurveyPoints(tuple(rows.column("target").to_pylist()), *points_and_cov(rows), leg)


def pose_points(
    observations: pa.Table, body: str, poses: tuple[int | str, ...], targets: tuple[str, ...] | None = None
) -> PosePoints:
    """Observations of one body as dense arrays, in the given orders of poses and targets; other targets are omitted."""
    rows = observations.filter(pc.equal(observations.column("body"), body))
    if targets is None:
        targets = tuple(dict.fromkeys(rows.column("target").to_pylist()))
    known, cell = _cells(rows, poses, targets)
    points, cov = points_and_cov(rows)
    shape = (len(poses), len(targets))
    dense = PosePoints(poses, targets, np.zeros((*shape, 3)), np.zeros((*shape, 3, 3)), np.zeros(shape, bool))
    dense.points[cell], dense.cov[cell], dense.is_observed[cell] = points[known], cov[known], True
    return dense


def observation_rows(
    observations: pa.Table, body: str, poses: tuple[int | str, ...], targets: tuple[str, ...]
) -> Index:
    """(B, T) row of the observations of each point of a body; -1 if not measured."""
    at = np.flatnonzero(text_column(observations, "body") == body)
    known, cell = _cells(observations.take(at), poses, targets)
    dense = np.full((len(poses), len(targets)), -1, np.int64)
    dense[cell] = at[known]
    return dense


def pose_vectors(table: pa.Table) -> Array:
    """(N, 6) position in m and rotation vector in rad of each row of poses."""
    names = [*(f"p{a}_mm" for a in _AXES), *(f"r{a}_rad" for a in _AXES)]
    return number_columns(table, names) * ([1e-3] * 3 + [1.0] * 3)


def recorded_angles(table: pa.Table) -> Array | None:
    """(N, 3) Euler angles or rotation vectors of rows of measured poses, rad, as recorded; None for other notations."""
    if not set(RECORDED_ANGLES) <= set(table.schema.names):
        return None
    return number_columns(table, RECORDED_ANGLES)


def pose_covariances(table: pa.Table) -> Array:
    """(N, 6, 6) covariance of each row of poses, m and rad."""
    upper = [[number_column(table, f"cov_{min(i, j)}_{max(i, j)}") for j in range(6)] for i in range(6)]
    return np.moveaxis(np.array(upper), -1, 0)


def _cells(rows: pa.Table, poses: tuple[int | str, ...], targets: tuple[str, ...]) -> tuple[Mask, tuple[Index, Index]]:
    """Mask (N,) of rows with one of these poses and targets, and the indices of both."""
    at_pose, at_target = positions(rows.column("pose"), poses), positions(rows.column("target"), targets)
    known = (at_pose >= 0) & (at_target >= 0)
    return known, (at_pose[known], at_target[known])


def points_and_cov(rows: pa.Table) -> tuple[Array, Array]:
    """(N, 3) points in m and (N, 3, 3) covariances in m^2 from coordinates, sigmas and optional correlations."""
    points = number_columns(rows, [f"{a}_mm" for a in _AXES]) * 1e-3
    sigma, correlation = sigmas_and_correlations(rows)
    return points, correlation * sigma[:, :, None] * sigma[:, None, :]


def sigmas_and_correlations(rows: pa.Table) -> tuple[Array, Array]:
    """(N, 3) standard deviations in m and (N, 3, 3) correlations of each point."""
    sigma = number_columns(rows, [f"sigma_{a}_mm" for a in _AXES]) * 1e-3
    correlation = np.broadcast_to(np.eye(3), (len(sigma), 3, 3)).copy()
    for pair, i, j in _PAIRS:
        if f"corr_{pair}" in rows.schema.names:
            correlation[:, i, j] = correlation[:, j, i] = np.nan_to_num(number_column(rows, f"corr_{pair}"))
    return sigma, correlation


def positions(column: pa.ChunkedArray, order: tuple[int | str, ...]) -> Index:
    """Index of each value of a column in ``order``; -1 if absent."""
    if not order:
        return np.full(len(column), -1, np.int64)
    if pa.types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    indices = pc.index_in(column, value_set=pa.array(order, column.type))
    return np.asarray(pc.fill_null(indices, -1).to_numpy(), dtype=np.int64)


def fitted_points(
    tables: Mapping[str, pa.Table], body: str, poses: tuple[int | str, ...], targets: tuple[str, ...] | None = None
) -> FittedPoints:
    """Observations of a body with their residuals and poses, in the given orders of poses and targets."""
    points = pose_points(tables["observations"], body, poses, targets)
    residual = residual_points(tables["residuals"], body, poses, points.targets)
    used = used_targets(tables["residuals"], body, poses, points.targets)
    return FittedPoints(points, residual, used, *default_motions(tables["poses"], body, poses))


def used_targets(residuals: pa.Table, body: str, poses: tuple[int | str, ...], targets: tuple[str, ...]) -> Mask:
    """(B, T) mask of targets in the fit of the body's frame."""
    rows = residuals.filter(
        pc.and_(pc.equal(residuals.column("body"), body), pc.greater(residuals.column("weight"), 0.0))
    )
    used = np.zeros((len(poses), len(targets)), bool)
    used[_cells(rows, poses, targets)[1]] = True
    return used


def default_rotations(poses_table: pa.Table, body: str, poses: tuple[int | str, ...]) -> Array:
    """(B, 3, 3) rotation from the body frame to the measurement, through its parents; identity for missing poses."""
    R, t = default_motions(poses_table, body, poses)
    return np.where(np.isfinite(t[:, :1, None]), R, np.eye(3))


def default_motions(poses_table: pa.Table, body: str, poses: tuple[int | str, ...]) -> tuple[Array, Array]:
    """R (B, 3, 3) and t (B, 3), m, from the body frame to the measurement, through its parents; NaN for missing
    poses."""
    from truing.estimation.rotation import exp_so3

    rows = poses_table.filter(pc.and_(poses_table.column("default"), pc.equal(poses_table.column("body"), body)))
    index = positions(rows.column("pose"), poses)
    motions = np.full((len(poses), 6), np.nan)
    motions[index[index >= 0]] = pose_vectors(rows)[index >= 0]
    R = np.where(np.isfinite(motions).all(1)[:, None, None], exp_so3(np.nan_to_num(motions[:, 3:])), np.nan)
    parent = next(iter(rows.column("parent").to_pylist()), "measurement")
    if parent not in poses_table.column("body").unique().to_pylist():  # measurement frame, or a base in its place
        return R, motions[:, :3]
    above, origin = default_motions(poses_table, parent, poses)
    return above @ R, origin + (above @ motions[:, :3, None])[..., 0]


def point_residuals(
    table: pa.Table, body: str, poses: tuple[int | str, ...], targets: tuple[str, ...]
) -> PointResiduals:
    """Residuals of a body's points, in the given orders of poses and targets."""
    rows = table.filter(pc.equal(table.column("body"), body))
    (known, cell), shape = _cells(rows, poses, targets), (len(poses), len(targets))
    residual_arrays = PointResiduals(np.full((*shape, 3), np.nan), np.zeros(shape, bool), np.zeros(shape, bool))
    residual_arrays.values[cell] = number_columns(rows, [f"d{a}_mm" for a in _AXES])[known] * 1e-3
    residual_arrays.rejected[cell] = np.asarray(rows.column("rejected").to_pylist(), bool)[known]
    if "decision" in rows.schema.names:
        residual_arrays.excluded[cell] = (text_column(rows, "decision") == "excluded")[known]
    return residual_arrays


def residual_points(residuals: pa.Table, body: str, poses: tuple[int | str, ...], targets: tuple[str, ...]) -> Array:
    """(B, T, 3) residuals of a body's targets in m, body frame; NaN for missing or rejected targets."""
    residuals_of_points = point_residuals(residuals, body, poses, targets)
    return np.where(residuals_of_points.rejected[..., None], np.nan, residuals_of_points.values)
