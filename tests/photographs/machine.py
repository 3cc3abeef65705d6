"""A photographed machine of few poses: its campaign folder of rays, and the resulting points."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from tests.blind.generator.quaternions import Array
from tests.blind.generator.schedule import random_moves
from tests.photographs.ray_folder import write_rays
from tests.photographs.rays import Photographed, Shooting, draw_rays

LINE = ("images", "bundle", "ingest", "qa", "pose", "uncertainty")


def photograph(folder: Path, *effects: Any, poses: int = 3) -> Photographed:
    """Write a campaign of rays into a folder."""
    moves = random_moves(poses, 0, np.random.default_rng(3))
    photographed = draw_rays(Shooting(), moves, [], effects, np.random.default_rng(1))
    write_rays(photographed, folder, seed=1)
    return photographed


def stated_covariance(tables: dict[str, pa.Table], pose: int) -> tuple[list[str], Array, Array]:
    """Names, coordinates (n, 3) and covariance (3n, 3n) in mm of a pose's points, as the artifacts tell them."""
    points = tables["object_points"].to_pandas().query("pose == @pose")
    sigma = points[["sigma_x_mm", "sigma_y_mm", "sigma_z_mm"]].to_numpy()
    names = points["point"].tolist()
    correlation = np.zeros((len(names), 3, len(names), 3))
    for k, row in enumerate(points.itertuples()):
        own = [[1, row.corr_xy, row.corr_xz], [row.corr_xy, 1, row.corr_yz], [row.corr_xz, row.corr_yz, 1]]
        correlation[k, :, k] = own
    pairs = tables["point_correlations"].to_pandas().query("pose == @pose")
    place = {name: k for k, name in enumerate(names)}
    i, j = pairs["point"].map(place).to_numpy(), pairs["other_point"].map(place).to_numpy()
    blocks = pairs[[f"corr_{a}_{b}" for a in "xyz" for b in "xyz"]].to_numpy().reshape(-1, 3, 3)
    correlation[i, :, j], correlation[j, :, i] = blocks, blocks.transpose(0, 2, 1)
    size = sigma.ravel()
    cov = correlation.reshape(len(size), len(size)) * size[:, None] * size
    return names, points[["x_mm", "y_mm", "z_mm"]].to_numpy(), cov


def copied(tables: dict[str, pa.Table], poses: Sequence[int]) -> dict[str, pa.Table]:
    """Tables of the given poses, which are numbered anew from 1 and may repeat."""
    again = {name: tables[name] for name in ("survey", "camera_correlations")}
    for name in ("configurations", "observations", "object_points", "point_correlations", "point_sensitivities"):
        frame = tables[name].to_pandas()
        rows = [frame[frame["pose"] == pose].assign(pose=number + 1) for number, pose in enumerate(poses)]
        again[name] = pa.Table.from_pandas(pd.concat(rows), tables[name].schema, preserve_index=False)
    return again


def moved(tables: dict[str, pa.Table], places: Array) -> dict[str, pa.Table]:
    """Tables with other observations: places (N, 3) in mm."""
    frame = tables["observations"].to_pandas()
    frame[["x_mm", "y_mm", "z_mm"]] = places
    return tables | {"observations": pa.Table.from_pandas(frame, tables["observations"].schema, preserve_index=False)}


def drawn_again(tables: dict[str, pa.Table], pose: int, times: int) -> dict[str, pa.Table]:
    """One pose again and again, as poses 1, 2, ..., its points moved by draws from their whole covariance."""
    names, _, cov = stated_covariance(tables, pose)
    errors = np.random.default_rng(5).multivariate_normal(np.zeros(len(cov)), cov, times, method="eigh")
    again = copied(tables, [pose] * times)
    seen = again["observations"].to_pandas()
    place = seen["pose"].to_numpy() - 1, [names.index(point) for point in seen["point"]]
    return moved(again, seen[["x_mm", "y_mm", "z_mm"]].to_numpy() + errors.reshape(times, -1, 3)[place])
