"""Uncertainties of object points that no choice of six coordinates shapes: as of a free network.

Held coordinates of a minimal datum have no uncertainty at all, and others the more the further they lie from them. What
follows judges points one by one, and so takes them as Baarda's S-transformation into inner constraints has them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import skew
from truing.stages.common.point_arrays import number_column, points_and_cov, pose_ids, positions
from truing.stages.common.point_errors import point_errors

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]

_SIGMA = ("sigma_x_mm", "sigma_y_mm", "sigma_z_mm")
_PAIRS = (("corr_xy", 0, 1), ("corr_xz", 0, 2), ("corr_yz", 1, 2))


def in_inner_datum(points: pa.Table, correlations: pa.Table | None) -> pa.Table:
    """The table object_points with standard deviations and correlations as of a free network, where coordinates of it
    are held; else as it is."""
    held = np.column_stack([number_column(points, name) for name in _SIGMA]) == 0.0
    errors = point_errors(points, correlations, None) if held.any() else None
    if errors is None:
        return points
    xyz, cov = points_and_cov(points)
    poses = pose_ids(points)
    of_pose = positions(points.column("pose"), poses)
    for pose in range(len(poses)):
        rows = np.flatnonzero(of_pose == pose)
        if held[rows].any():
            whole = _transformed(xyz[rows], errors.covariance(rows), with_scale=int(held[rows].sum()) > 6)
            each = np.arange(len(rows))
            cov[rows] = whole.reshape(len(rows), 3, len(rows), 3)[each, :, each, :]
    return _with(points, cov)


def _transformed(xyz: Array, cov: Array, *, with_scale: bool) -> Array:
    """The covariance (3n, 3n) in the datum of all points: nothing of it is a motion, or a growth, of all together."""
    x = xyz - xyz.mean(axis=0)
    parts = [np.tile(np.eye(3), (len(x), 1)), -skew(x).reshape(-1, 3)]
    G = np.concatenate([*parts, *([x.reshape(-1, 1)] if with_scale else [])], axis=1)
    S = np.eye(len(cov)) - G @ np.linalg.solve(G.T @ G, G.T)
    return np.asarray(S @ cov @ S.T)


def _with(points: pa.Table, cov: Array) -> pa.Table:
    import pyarrow as pa

    sigma = np.sqrt(np.einsum("nii->ni", cov))
    columns = {name: 1e3 * sigma[:, k] for k, name in enumerate(_SIGMA)}
    columns |= {name: cov[:, i, j] / (sigma[:, i] * sigma[:, j]) for name, i, j in _PAIRS}
    for name, values in columns.items():
        points = points.set_column(points.column_names.index(name), name, pa.array(values, pa.float64()))
    return points
