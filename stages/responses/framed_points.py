"""Bodies over all poses, as tables have them, with what the errors of their points have in common."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rigid_poses.joint_frames import FramedBody, FramedPoints, mean_shape
from truing.stages.common.point_arrays import (
    default_motions,
    observation_rows,
    pose_points,
    residual_points,
    survey_points,
    text_column,
    used_targets,
)
from truing.stages.common.point_errors import common_correlation, point_errors

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

NETWORK = ("point_correlations", "point_sensitivities", "object_points")
_FEWEST = 3


def framed_points(tables: Mapping[str, pa.Table], poses: tuple[int | str, ...]) -> FramedPoints | None:
    """All bodies with what the errors of the observations have in common; None where points are independent."""
    errors = point_errors(tables["observations"], *(tables.get(name) for name in NETWORK))
    if errors is None:
        return None
    correlation = common_correlation(tables.get("camera_correlations"), errors.parameters)
    return FramedPoints(framed_bodies(tables, poses), errors, correlation)


def framed_bodies(tables: Mapping[str, pa.Table], poses: tuple[int | str, ...]) -> list[FramedBody]:
    """Every body that has poses, against its survey, or against the shape that its residuals were counted from."""
    table = tables["poses"]
    parents = dict(zip(text_column(table, "body"), text_column(table, "parent"), strict=True))
    observed = dict.fromkeys(text_column(tables["observations"], "body"))
    return [_framed(tables, name, parents[name], poses) for name in observed if name in parents]


def _framed(tables: Mapping[str, pa.Table], name: str, parent: str, poses: tuple[int | str, ...]) -> FramedBody:
    surveyed = survey_points(tables["survey"], name) if "survey" in tables else None
    found = pose_points(tables["observations"], name, poses, (surveyed and surveyed.targets) or None)
    R, t = default_motions(tables["poses"], name, poses)
    used = used_targets(tables["residuals"], name, poses, found.targets) & found.seen
    frame: Mask = np.ones(len(found.targets), bool)
    if surveyed is not None and surveyed.targets:
        source, cov, away = surveyed.points, surveyed.cov, surveyed.leg == 0
        cov_shape = cov
        frame = found.seen.any(axis=0) & (away if away.sum() >= _FEWEST else frame)
    else:
        source, cov_shape = mean_shape(
            R, t, used, found, residual_points(tables["residuals"], name, poses, found.targets)
        )
        cov = np.zeros_like(cov_shape)
    row = observation_rows(tables["observations"], name, poses, found.targets)
    return FramedBody(name, parent, found.targets, source, cov, cov_shape, frame, R, t, found.points, used, row)
