"""Poses out of photographs: what cameras and bars give to all of them alike, and what each has of its own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stages.point_arrays import number_column, positions
from stages.rigid_poses.point_errors import common_correlation
from truing.estimation.uncertainty_budget import Source

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]

_EFFECTS = (*(f"effect_{a}_mm" for a in "xyz"), *(f"effect_r{a}_rad" for a in "xyz"))
_TO_SI = np.array([1e-3] * 3 + [1.0] * 3)
BARS = Source("lengths of scale bars, common to all poses", "B")
CAMERAS = Source("cameras as the rays of all poses tell them, common to all", "A")
OWN = Source("rays of the pose itself, and the survey", "A")


def parts_of_network(
    tables: Mapping[str, pa.Table], body: str, poses: tuple[int | str, ...], covariance: Array
) -> Mapping[Source, Array] | None:
    """The parts (B, 6, 6) of a body's covariance in m and rad; None where its points are not of photographs."""
    import pyarrow.compute as pc

    effects = tables.get("pose_sensitivities")
    if effects is None or not effects.num_rows:
        return None
    rows = effects.filter(pc.equal(effects.column("body"), body))
    if not rows.num_rows:
        return None
    parameters = tuple(dict.fromkeys(rows.column("parameter").to_pylist()))
    by = np.zeros((len(poses), 6, len(parameters)))
    place = positions(rows.column("pose"), poses), positions(rows.column("parameter"), parameters)
    by[place[0], :, place[1]] = np.column_stack([number_column(rows, name) for name in _EFFECTS]) * _TO_SI
    correlation = common_correlation(tables.get("camera_correlations"), parameters)
    bar = np.array([name.startswith("bar ") for name in parameters], dtype=bool)
    common = by @ correlation @ np.swapaxes(by, 1, 2)
    by_bars = by[:, :, bar] @ correlation[np.ix_(bar, bar)] @ np.swapaxes(by[:, :, bar], 1, 2)
    parts = {CAMERAS: common - by_bars, OWN: covariance - common}
    return {BARS: by_bars, **parts} if bar.any() else parts


def has_scale(tables: Mapping[str, pa.Table]) -> bool:
    """Whether scale bars stand behind the poses, and their uncertainty in the budgets."""
    lengths = tables.get("scale_bar_lengths")
    return lengths is not None and "scale" in lengths.column("serves").to_pylist()
