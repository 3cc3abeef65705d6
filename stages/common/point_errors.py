"""Common errors of object points: within a pose, and of parameters common to all poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index
from truing.estimation.rigid_poses.points import PointErrors
from truing.stages.common.point_arrays import (
    number_column,
    number_columns,
    pose_ids,
    positions,
    sigmas_and_correlations,
)

_PAIRS = tuple(f"corr_{a}_{b}" for a in "xyz" for b in "xyz")


def point_errors(
    observations: pa.Table,
    correlations: pa.Table | None,
    sensitivities: pa.Table | None,
    object_points: pa.Table | None = None,
) -> PointErrors | None:
    """Errors of object points from a network; None without common errors.

    Errors of single points are those of object_points, in the datum of the correlations; else of the observations.
    """
    if correlations is None or "point" not in observations.column_names or not correlations.num_rows:
        return None
    poses, points = pose_ids(observations), tuple(dict.fromkeys(observations.column("point").to_pylist()))
    pose = positions(observations.column("pose"), poses)
    of_row = _ObservationRows(pose * len(points) + positions(observations.column("point"), points), poses, points)
    first, second = of_row.find(correlations, "point"), of_row.find(correlations, "other_point")
    known = (first >= 0) & (second >= 0)
    order = np.flatnonzero(known)[np.argsort(pose[first[known]], kind="stable")]
    first, second = first[order], second[order]
    between = number_columns(correlations, _PAIRS)[order].reshape(-1, 3, 3)
    start = np.searchsorted(pose[first], np.arange(len(poses) + 1))
    sigma, corr = sigmas_and_correlations(observations if object_points is None else _same_rows(object_points, of_row))
    parameters, effect = _effects(sensitivities, of_row, len(pose))
    return PointErrors(pose, sigma, corr, first, second, between, start, parameters, effect)


def _same_rows(object_points: pa.Table, of_row: _ObservationRows) -> pa.Table:
    """The object points in the order of the observations."""
    rows = of_row.find(object_points, "point")
    order = np.empty(len(of_row.code), np.int64)
    order[rows[rows >= 0]] = np.flatnonzero(rows >= 0)
    return object_points.take(order)


@dataclass(frozen=True)
class _ObservationRows:
    """Row of observations by pose and point, by code (N,) = pose * points + point."""

    code: Index
    poses: tuple[int | str, ...]
    points: tuple[str, ...]

    def find(self, table: pa.Table, point: str) -> Index:
        """Rows (M,) for a table's poses and points; -1 for none."""
        pose, name = positions(table.column("pose"), self.poses), positions(table.column(point), self.points)
        wanted = np.where((pose >= 0) & (name >= 0), pose * len(self.points) + name, -1)
        order = np.argsort(self.code)
        found = np.minimum(np.searchsorted(self.code[order], wanted), len(order) - 1)
        return np.where(self.code[order][found] == wanted, order[found], -1)


def _effects(table: pa.Table | None, of_row: _ObservationRows, count: int) -> tuple[tuple[str, ...], Array]:
    if table is None or not table.num_rows:
        return (), np.zeros((count, 3, 0))
    parameters = tuple(dict.fromkeys(table.column("parameter").to_pylist()))
    row, column = of_row.find(table, "point"), positions(table.column("parameter"), parameters)
    effect = np.zeros((count, 3, len(parameters)))
    values = number_columns(table, [f"effect_{a}_mm" for a in "xyz"]) * 1e-3
    effect[row[row >= 0], :, column[row >= 0]] = values[row >= 0]
    return parameters, effect


def common_correlation(table: pa.Table | None, parameters: tuple[str, ...]) -> Array:
    """Correlations (K, K) of common parameters, by name."""
    out = np.eye(len(parameters))
    if table is not None and table.num_rows:
        i, j = (positions(table.column(name), parameters) for name in ("parameter", "other_parameter"))
        known = (i >= 0) & (j >= 0)
        out[i[known], j[known]] = out[j[known], i[known]] = number_column(table, "correlation")[known]
    return out
