"""Points of a chain's links that are left out: excluded by a person, or gross errors of single poses."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pyarrow as pa

from truing.arrays import Mask
from truing.estimation.rigid_poses.points import PosePoints
from truing.inference.screening import alone_in_time
from truing.simulation.inputs import order_in_time
from truing.stages.common.point_arrays import number_column, point_residuals


def gross_errors(tables: Mapping[str, pa.Table], body: str, points: PosePoints) -> Mask:
    """Mask (B, T) of the points that a person excluded, and of those that the rigid fits reject in single poses.

    A target that is rejected in successive poses may have moved: it is kept.
    """
    table = tables.get("residuals")
    if table is None or not table.num_rows:
        return np.zeros(points.is_observed.shape, bool)
    residuals = point_residuals(table, body, points.poses, points.targets)
    rows = tables["configurations"]
    time = number_column(rows, "time_s") if "time_s" in rows.schema.names else None
    values = np.where(points.is_observed[..., None], residuals.values, np.nan)
    alone = alone_in_time(values, order_in_time(time, len(points.poses)), residuals.rejected & points.is_observed)
    return np.asarray(residuals.excluded | alone | (residuals.rejected & ~np.isfinite(residuals.values).all(-1)))
