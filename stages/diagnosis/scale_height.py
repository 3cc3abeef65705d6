"""At which height lengths are right in points that photographs gave: where their scale bars lie."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.stages.common.point_arrays import number_column, positions

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.inference.observations import Epochs

_SI = 1e-3
_EXACT_MM = 1e-6  # bars without any uncertainty count alike


def scale_height(tables: Mapping[str, pa.Table], poses: Epochs) -> float:
    """The mean height, m, in the model's frame, of the bars' middles, each as its calibration counts in the scale.

    Without bars the mean height of all measured points, whose survey gives the scale then.
    """
    if "object_points" in tables and "scale_bars" in tables:
        height, weight = _of_bars(tables["object_points"], tables["scale_bars"], poses)
        if weight.sum() > 0:
            return float(np.sum(height * weight) / weight.sum())
    measured = poses.measured
    inside = np.einsum("bkd,bde->bke", np.nan_to_num(measured.values) - poses.frames.t[:, None], poses.frames.R)
    return float(inside[..., 2][measured.seen].mean())


def _of_bars(points: pa.Table, bars: pa.Table, poses: Epochs) -> tuple[NDArray, NDArray]:
    """Heights (N,) of the middles of bars in the poses, m, and the weights of their lengths."""
    names = tuple(dict.fromkeys(points.column("point").to_pylist()))
    own = tuple(poses.conditions.poses)
    pose, point = positions(points.column("pose"), own), positions(points.column("point"), names)
    kept = pose >= 0
    place = np.full((len(own), len(names), 3), np.nan)
    place[pose[kept], point[kept]] = np.column_stack([number_column(points, f"{a}_mm") for a in "xyz"])[kept] * _SI
    inside = np.einsum("bkd,bde->bke", place - poses.frames.t[:, None], poses.frames.R)
    ends = [positions(bars.column(name), names) for name in ("first", "second")]
    uncertain = np.hypot(number_column(bars, "sigma_mm"), number_column(bars, "repeat_sigma_mm"))
    weight = (number_column(bars, "length_mm") / np.maximum(uncertain, _EXACT_MM)) ** 2
    scaling = np.array([serves == "scale" for serves in bars.column("serves").to_pylist()])
    known = (ends[0] >= 0) & (ends[1] >= 0) & scaling & np.isfinite(weight)
    height = 0.5 * (inside[:, ends[0][known], 2] + inside[:, ends[1][known], 2])
    seen = np.isfinite(height)
    return height[seen], np.broadcast_to(weight[known], height.shape)[seen]
