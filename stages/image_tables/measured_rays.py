"""Rays that were measured elsewhere: image points and the photographs that they belong to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from truing.formats.faultlog import FaultLog
from truing.formats.gather import Gathered, gather
from truing.formats.shapes import IMAGE_POINTS
from truing.formats.source import CampaignFiles
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import Fault
from truing.stages.common.gathered import check_sigma, check_variance
from truing.stages.image_tables.point_names import Names, kind_of, own_names

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]

ONE_CAMERA = "camera"
"""What the camera is called where nothing names it."""

_MARGIN = 0.01
_UNKNOWN = ", or an empty cell where none is known: [noise] image_px holds there"
_COVARIANCE = ("cov_xx_px2", "cov_xy_px2", "cov_yy_px2")
_CIRCLE = ("semi_major_px", "semi_minor_px", "axis_angle_rad", "contrast")


@dataclass(frozen=True)
class MeasuredRays:
    """The tables image_points and photographs, what was left out, by (file, reason), and how many rays came without a
    standard deviation."""

    image_points: pa.Table
    photographs: pa.Table
    left_out: Mapping[tuple[str, str], int]
    without_sigma: int = 0


def read_rays(
    source: CampaignFiles, settings: Any, targets: pa.Table | None, cameras: pa.Table | None, log: FaultLog
) -> MeasuredRays | None:
    """The rays of [files.image_points]; None where there are none, or none that could be read.

    Names of codes become those of the table image_targets (``targets``); formats come from ``cameras``.
    """
    found = gather(source, IMAGE_POINTS, log, "pose")
    if found is None:
        return None
    missing = [name for name in IMAGE_POINTS.required if name not in found.table.column_names]
    if missing:
        return None  # told when the file was read
    point, body, target = _names(found, targets)
    camera = _text(found, "camera", ONE_CAMERA)
    _once(found, log, point)
    _one_camera(found, log, camera)
    covariance = _covariance(found, settings, log)
    kind = _text(found, "kind")
    kind = np.array([own or kind_of(name) for own, name in zip(kind, _text(found, "point"), strict=True)], dtype=object)
    columns = {
        "pose": found.table.column("pose"),
        "image": _text(found, "image"),
        "camera": camera,
        "point": point,
        "body": body,
        "target": target,
        "kind": kind,
        "x_px": found.table.column("x_px"),
        "y_px": found.table.column("y_px"),
        **dict(zip(_COVARIANCE, covariance.T, strict=True)),
        **{name: found.table.column(name) for name in _CIRCLE if name in found.table.column_names},
    }
    image_points = _as_table("image_points", columns)
    photographs = _photographs(image_points, cameras, found, log)
    _within_format(found, camera, cameras, log)
    return MeasuredRays(image_points, photographs, dict(found.left_out), _without_sigma(found))


def _names(found: Gathered, targets: pa.Table | None) -> tuple[Names, Names, Names]:
    point, body, target = own_names(_text(found, "point"), targets)
    given_body, given_target = _text(found, "body"), _text(found, "target")
    told = given_target != ""
    both = told & (given_body != "")
    joined = np.array([f"{b}/{t}" for b, t in zip(given_body, given_target, strict=True)], dtype=object)
    named = np.where(both, joined, np.where(told, given_target, point))
    own_body = np.where(told | (given_body != ""), given_body, body)
    return named, own_body, np.where(told, given_target, target)


def _text(found: Gathered, name: str, otherwise: str = "") -> Names:
    if name not in found.table.column_names:
        return np.full(len(found.table), otherwise, dtype=object)
    return np.array([value or otherwise for value in found.table.column(name).to_pylist()], dtype=object)


def _once(found: Gathered, log: FaultLog, point: Names) -> None:
    """No image shows a point twice."""
    seen: set[tuple[object, object, object]] = set()
    again = np.zeros(len(point), dtype=bool)
    keys = zip(found.table.column("pose").to_pylist(), _text(found, "image"), point, strict=True)
    for row, key in enumerate(keys):
        again[row] = bool(key[2]) and key in seen
        seen.add(key)
    column = "point" if "point" in found.table.column_names else "target"
    found.fault(log, again, column, "each point once in an image")


def _one_camera(found: Gathered, log: FaultLog, camera: Names) -> None:
    """An image was taken by one camera."""
    first: dict[tuple[object, object], object] = {}
    keys = zip(found.table.column("pose").to_pylist(), _text(found, "image"), strict=True)
    other = np.array([first.setdefault(key, one) != one for key, one in zip(keys, camera, strict=True)], dtype=bool)
    found.fault(log, other, "camera", "one camera for all points of an image")


def _within_format(found: Gathered, camera: Names, cameras: pa.Table | None, log: FaultLog) -> None:
    """No ray lies outside the format that its camera is given, but for a hundredth of it."""
    formats = {} if cameras is None else {row["camera"]: row for row in cameras.to_pylist()}
    for side, name in (("width_px", "x_px"), ("height_px", "y_px")):
        at = _numbers(found, name)
        for one, given in formats.items():
            if (size := given.get(side)) is not None:
                outside = (camera == one) & ((at < -_MARGIN * size) | (at > (1 + _MARGIN) * size))
                found.fault(log, outside, name, f"a place within the format of camera {one}, {side} {size}")


def _covariance(found: Gathered, settings: Any, log: FaultLog) -> Array:
    """xx, xy, yy (N, 3) in px^2: as given, else of the sigmas, else as declared."""
    names = found.table.column_names
    declared = settings.noise.image_px
    out = np.full((len(found.table), 3), np.nan)
    if declared is not None:
        out[:] = [declared**2, 0.0, declared**2]
    for k, name in ((0, "sigma_x_px"), (2, "sigma_y_px")):
        if name in names:
            sigma = _numbers(found, name)
            check_sigma(found, sigma, name, "px", log, cure=_UNKNOWN)
            out[:, k] = np.where(np.isfinite(sigma), sigma**2, out[:, k])
            out[:, 1] = 0.0
    for k, name in enumerate(_COVARIANCE):
        if name in names:
            out[:, k] = _numbers(found, name)
            if k != 1:
                check_variance(found, out[:, k], name, "px", log)
    if not np.isfinite(out).all():
        log.lacks("noise.image_px", "a standard deviation of image coordinates", found.first_file)
        return np.ones_like(out)
    improper = (out[:, 0] <= 0.0) | (out[:, 2] <= 0.0) | (out[:, 0] * out[:, 2] <= out[:, 1] ** 2)
    if improper.any() and _COVARIANCE[0] in names:
        found.fault(log, improper, _COVARIANCE[0], "a covariance: xx and yy above 0, xy within their product")
    return np.asarray(out)


def _without_sigma(found: Gathered) -> int:
    """How many rays have no standard deviation of their own."""
    own = np.zeros(len(found.table), dtype=bool)
    for name in ("sigma_x_px", _COVARIANCE[0]):
        if name in found.table.column_names:
            own |= np.isfinite(_numbers(found, name))
    return int(np.count_nonzero(~own))


def _numbers(found: Gathered, name: str) -> Array:
    return np.asarray(found.table.column(name).to_numpy(zero_copy_only=False), dtype=float)


def _photographs(image_points: pa.Table, cameras: pa.Table | None, found: Gathered, log: FaultLog) -> pa.Table:
    """One row per image, in order of appearance, with the format that its camera is given."""
    keys = ("pose", "image", "camera")
    images = list(dict.fromkeys(zip(*(image_points.column(key).to_pylist() for key in keys), strict=True)))
    given = {} if cameras is None else {row["camera"]: row for row in cameras.to_pylist()}
    for camera in dict.fromkeys(camera for _, _, camera in images):
        if given.get(camera, {}).get("width_px") is None:
            said = f"[[cameras]] or the table cameras with width_px and height_px of camera {camera}"
            log.add(Fault(found.first_file, said, column="camera", value=str(camera)))
    formats = [given.get(camera, {}) for _, _, camera in images]
    columns: dict[str, Any] = {key: [image[k] for image in images] for k, key in enumerate(keys)}
    columns |= {"file": [None] * len(images), "principal_distance_px": [None] * len(images)}
    columns |= {name: [one.get(name) for one in formats] for name in ("width_px", "height_px")}
    columns["pose"] = _chosen(image_points.column("pose"), columns["pose"])
    return _as_table("photographs", columns)


def _chosen(column: pa.ChunkedArray, values: list[Any]) -> pa.Array:
    import pyarrow as pa

    return pa.array(values, column.type)


def _as_table(name: str, columns: Mapping[str, Any]) -> pa.Table:
    """The columns as an artifact, its poses of the kind that they are."""
    import pyarrow as pa

    pose = columns["pose"]
    identifier = "int64" if pa.types.is_int64(pose.type) else "string"
    artifact = ARTIFACTS[name]
    names = [key for key in (*artifact.columns, *artifact.optional) if key in columns]
    schema = artifact.arrow_schema(identifier, tuple(names))
    cast = [_typed(columns[key], schema.field(key).type) for key in schema.names]
    return pa.table(cast, schema=pa.schema([field.with_nullable(True) for field in schema]))


def _typed(values: Any, kind: pa.DataType) -> pa.Array:
    import pyarrow as pa

    if isinstance(values, pa.Array | pa.ChunkedArray):
        return values.cast(kind)
    return pa.array(values, kind)
