"""Tables of a campaign of photographs as one network: given cameras, rays, bars, and their names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index, TableRow
from truing.estimation.bundle.camera import PARAMETERS, Camera
from truing.estimation.bundle.network import (
    Bars,
    ImagePoints,
    KnownPoints,
    Markers,
    NamedNetwork,
    Names,
    Network,
    Pose,
    Rays,
)
from truing.stages.common.point_arrays import number_column, points_and_cov, pose_ids, positions, text_column

_CORNERS = 4


def given_cameras(photographs: pa.Table, declared: pa.Table | None) -> tuple[tuple[Camera, ...], Array]:
    """Cameras (C) of all photographs, in order of appearance, and their initial interior parameters (C, 10), NaN for
    unknown c."""
    rows = photographs.to_pylist()
    known: dict[str, list[TableRow]] = {}
    for row in [] if declared is None else declared.to_pylist():
        known.setdefault(row["camera"], []).append(row)
    names = list(dict.fromkeys(row["camera"] for row in rows))
    cameras, interior = [], np.zeros((len(names), len(PARAMETERS)))
    for number, name in enumerate(names):
        rows_of_camera = [row for row in rows if row["camera"] == name]
        reported = known.get(name, [])
        cameras.append(_camera(name, rows_of_camera[0], reported))
        if reported:
            interior[number] = [row["value"] if row["value"] is not None else np.nan for row in reported]
        else:
            interior[number, 0] = np.nan
        if np.isnan(interior[number, 0]):
            texts = [row["principal_distance_px"] for row in rows_of_camera if row["principal_distance_px"]]
            interior[number, 0] = np.median(texts) if texts else np.nan
    return tuple(cameras), interior


def _camera(name: str, photograph: TableRow, reported: list[TableRow]) -> Camera:
    first = reported[0] if reported else {}
    width, height = (first.get(key) or photograph[key] for key in ("width_px", "height_px"))
    radius = first.get("balancing_radius_px") or (float(np.hypot(width, height) / 3) if not reported else 0.0)
    pitch = 1e-6 * first["pixel_um"] if first.get("pixel_um") else None
    free = tuple(row["parameter"] for row in reported if row["free"]) if reported else PARAMETERS
    return Camera(name, int(width), int(height), radius, pitch, free)


def image_points(table: pa.Table, photographs: pa.Table) -> ImagePoints:
    """Rows of image_points, with images numbered as in photographs."""
    kinds = tuple(dict.fromkeys(table.column("kind").to_pylist()))
    poses = pose_ids(photographs)
    keys = list(zip(photographs.column("pose").to_pylist(), photographs.column("image").to_pylist(), strict=True))
    number = {key: n for n, key in enumerate(keys)}
    pairs = zip(table.column("pose").to_pylist(), table.column("image").to_pylist(), strict=True)
    image = np.array([number[pair] for pair in pairs], dtype=np.int64)
    cov = np.empty((len(table), 2, 2))
    cov[:, 0, 0], cov[:, 1, 1] = number_column(table, "cov_xx_px2"), number_column(table, "cov_yy_px2")
    cov[:, 0, 1] = cov[:, 1, 0] = number_column(table, "cov_xy_px2")
    return ImagePoints(
        image,
        positions(table.column("pose"), poses),
        text_column(table, "point"),
        text_column(table, "body"),
        text_column(table, "target"),
        np.column_stack([number_column(table, "x_px"), number_column(table, "y_px")]),
        cov,
        positions(table.column("kind"), kinds),
        kinds,
        np.column_stack([_optional(table, "semi_major_px"), _optional(table, "semi_minor_px")]),
        _optional(table, "axis_angle_rad"),
    )


def _optional(table: pa.Table, name: str) -> Array:
    return number_column(table, name) if name in table.column_names else np.full(len(table), np.nan)


def named_network(
    table: ImagePoints,
    photographs: pa.Table,
    cameras: tuple[Camera, ...],
    tables: Mapping[str, pa.Table],
    marker_mm: float | None,
) -> NamedNetwork:
    """Network of all rays with a point name."""
    poses = pose_ids(photographs)
    rows = np.flatnonzero(table.point != "")
    keys: dict[tuple[int, str], int] = {}
    point = np.array(
        [keys.setdefault(key, len(keys)) for key in zip(table.pose[rows].tolist(), table.point[rows], strict=True)],
        dtype=np.int64,
    )
    first = rows[np.unique(point, return_index=True)[1]] if len(rows) else rows
    point_pose = np.array([pose for pose, _ in keys], dtype=np.int64)
    names = np.array([name for _, name in keys], dtype=object)
    rays = Rays(table.image[rows], point, table.xy_px[rows], table.cov_px2[rows], table.kind[rows])
    bars, bar_names = _bars(tables.get("scale_bars"), poses, keys)
    network = Network(
        cameras,
        positions(photographs.column("camera"), tuple(camera.name for camera in cameras)),
        positions(photographs.column("pose"), poses),
        point_pose,
        rays,
        bars,
        _known_points(tables.get("known_points"), poses, keys),
    )
    images = text_column(photographs, "image")
    markers = _markers(point_pose, names, table.body[first], tables.get("image_targets"), marker_mm)
    who = (table.body[first], table.target[first])
    return NamedNetwork(network, poses, images, names, *who, table.kinds, rows, bar_names, markers)


def stated_sizes(targets: pa.Table | None, column: str) -> dict[str, float]:
    """Sizes in mm from a column of image_targets, by name body/target."""
    if targets is None or column not in targets.column_names:
        return {}
    rows = targets.select(["body", "target", column]).to_pylist()
    return {f"{row['body']}/{row['target']}": row[column] for row in rows if row[column]}


def radii(targets: pa.Table | None, target_mm: float | None) -> dict[str, float]:
    """Radii in m of circular targets by point name; the default size under ""."""
    radius_of_target = {} if target_mm is None else {"": 0.5e-3 * target_mm}
    return radius_of_target | {name: 0.5e-3 * size for name, size in stated_sizes(targets, "diameter_mm").items()}


def bar_ends(
    bars: pa.Table | None, poses: Sequence[Pose], keys: Mapping[tuple[int, str], int]
) -> list[tuple[int, int, int, int]]:
    """(row of the table, pose, first point, second point) for each pose that has both ends of a bar."""
    if bars is None:
        return []
    poses_of_bars = bars.column("pose").to_pylist() if "pose" in bars.column_names else [None] * len(bars)
    result = []
    for row, (first, second) in enumerate(
        zip(bars.column("first").to_pylist(), bars.column("second").to_pylist(), strict=True)
    ):
        for pose, name in enumerate(poses):
            ends = (keys.get((pose, first)), keys.get((pose, second)))
            if poses_of_bars[row] in (None, name) and None not in ends:
                result.append((row, pose, ends[0], ends[1]))
    return result  # type: ignore[return-value]


def _bars(
    table: pa.Table | None, poses: Sequence[Pose], keys: Mapping[tuple[int, str], int]
) -> tuple[Bars, tuple[str, ...]]:
    """Bars that give the scale, and their names, without those that check it."""
    if table is None:
        return Bars.none(), ()
    serves, bar = table.column("serves").to_pylist(), table.column("bar").to_pylist()
    names = tuple(dict.fromkeys(name for name, use in zip(bar, serves, strict=True) if use == "scale"))
    ends = [end for end in bar_ends(table, poses, keys) if serves[end[0]] == "scale"]
    first_row = [bar.index(name) for name in names]
    length, sigma = number_column(table, "length_mm") * 1e-3, number_column(table, "sigma_mm") * 1e-3
    repeat = number_column(table, "repeat_sigma_mm") * 1e-3
    row, _, first, second = (np.array([end[k] for end in ends], dtype=np.int64) for k in range(4))
    number = np.array([names.index(bar[r]) for r in row], dtype=np.int64)
    return Bars(number, first, second, repeat[row], length[first_row], sigma[first_row]), names


def _known_points(table: pa.Table | None, poses: Sequence[Pose], keys: Mapping[tuple[int, str], int]) -> KnownPoints:
    if table is None:
        return KnownPoints.none()
    xyz, cov = points_and_cov(table)
    poses_of_points = table.column("pose").to_pylist() if "pose" in table.column_names else [None] * len(table)
    points = [
        (keys[pose, name], row)
        for row, name in enumerate(table.column("point").to_pylist())
        for pose, identifier in enumerate(poses)
        if poses_of_points[row] in (None, identifier) and (pose, name) in keys
    ]
    point, rows = np.array(points, dtype=np.int64).reshape(-1, 2).T
    return KnownPoints(point, xyz[rows], cov[rows])


def _markers(pose: Index, names: Names, body: Names, targets: pa.Table | None, marker_mm: float | None) -> Markers:
    """Square markers of known edge with all four corners in a pose."""
    sizes = stated_sizes(targets, "size_mm")
    corners: dict[tuple[int, str], dict[int, int]] = {}
    for number, (p, name) in enumerate(zip(pose.tolist(), names.tolist(), strict=True)):
        stem, _, corner = name.rpartition(".")
        known = stem in sizes or stem.startswith(("aruco", "apriltag")) or (body[number] and marker_mm)
        if known and corner.isdecimal() and int(corner) < _CORNERS:
            corners.setdefault((p, stem), {})[int(corner)] = number
    complete_markers = [
        ([corner_points[k] for k in range(_CORNERS)], sizes.get(stem) or marker_mm)
        for (_, stem), corner_points in corners.items()
        if len(corner_points) == _CORNERS and (sizes.get(stem) or marker_mm)
    ]
    if not complete_markers:
        return Markers.none()
    return Markers(
        np.array([marker for marker, _ in complete_markers]),
        np.array([1e-3 * float(size or 0.0) for _, size in complete_markers]),
    )
