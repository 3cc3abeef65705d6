"""Input of rays measured elsewhere: image points and their photographs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from truing.arrays import Array, TableRow
from truing.formats.faultlog import FaultLog
from truing.formats.raw_tables import IMAGE_POINTS
from truing.formats.row_collection import CollectedRows, collect_rows
from truing.formats.source import CampaignFiles
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import Fault
from truing.stages.common.table_arrays import check_sigma, check_variance, numbers
from truing.stages.image_tables.point_names import Names, kind_of, survey_names

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

Formats = Mapping[str, TableRow]  # a row of cameras_given by camera

ONE_CAMERA = "camera"
"""Default name of the camera."""

_MARGIN = 0.01
_UNKNOWN = ", or an empty cell if unknown: [noise] image_px then holds"
_COVARIANCE = ("cov_xx_px2", "cov_xy_px2", "cov_yy_px2")
_CIRCLE = ("semi_major_px", "semi_minor_px", "axis_angle_rad", "contrast")


@dataclass(frozen=True)
class RayTables:
    """The tables image_points, photographs and image_rejections, counts left out by (file, reason), and number of rays
    measured elsewhere without a standard deviation.
    """

    image_points: pa.Table
    photographs: pa.Table
    image_rejections: pa.Table
    left_out: Mapping[tuple[str, str], int]
    without_sigma: int = 0


def artifact_table(name: str, columns: Mapping[str, Any], identifier: str) -> pa.Table:
    """The columns as an artifact, NaN as empty; their faults are reported elsewhere."""
    schema = ARTIFACTS[name].arrow_schema(identifier, tuple(columns))
    made = [
        columns[field.name].cast(field.type)
        if isinstance(columns[field.name], pa.ChunkedArray)
        else pa.array(columns[field.name], field.type, from_pandas=True)
        for field in schema
    ]
    return pa.table(made, schema=pa.schema([field.with_nullable(True) for field in schema]))


def read_rays(
    source: CampaignFiles, settings: Campaign, known: Mapping[str, pa.Table], log: FaultLog
) -> RayTables | None:
    """The rays of [files.image_points]; None where there are none, or none that could be read.

    known: image_targets, which names codes, and cameras_given with the formats, where there are any.
    """
    rows = collect_rows(source, IMAGE_POINTS, log, "pose")
    if rows is None or any(name not in rows.table.column_names for name in IMAGE_POINTS.required):
        return None  # reported when the file was read
    point, body, target = _names(rows, known.get("image_targets"))
    camera = _text(rows, "camera", ONE_CAMERA)
    _check_unique_point(rows, log, point)
    _check_one_camera(rows, log, camera)
    covariance = _covariance(rows, settings, log)
    named = _text(rows, "point")
    kind = {name: kind_of(name) for name in set(named)}
    columns = {
        "pose": rows.table.column("pose"),
        "image": _text(rows, "image"),
        "camera": camera,
        "point": point,
        "body": body,
        "target": target,
        "kind": [own_kind or kind[name] for own_kind, name in zip(_text(rows, "kind"), named, strict=True)],
        "x_px": rows.table.column("x_px"),
        "y_px": rows.table.column("y_px"),
        **dict(zip(_COVARIANCE, covariance.T, strict=True)),
        **{name: rows.table.column(name) for name in _CIRCLE if name in rows.table.column_names},
    }
    identifier = "int64" if pa.types.is_int64(rows.table.column("pose").type) else "string"
    image_points = artifact_table("image_points", columns, identifier)
    cameras_given = known.get("cameras_given")
    formats = {} if cameras_given is None else {row["camera"]: row for row in cameras_given.to_pylist()}
    photographs = _photographs(image_points, formats, rows, log, identifier)
    _check_within_format(rows, camera, formats, log)
    none = ARTIFACTS["image_rejections"].empty(identifier)
    return RayTables(image_points, photographs, none, dict(rows.left_out), _without_sigma(rows))


def _names(collected: CollectedRows, targets: pa.Table | None) -> tuple[Names, Names, Names]:
    point, body, target = survey_names(_text(collected, "point"), targets)
    given_body, given_target = _text(collected, "body"), _text(collected, "target")
    has_target = given_target != ""
    both = has_target & (given_body != "")
    joined = np.array([f"{b}/{t}" for b, t in zip(given_body, given_target, strict=True)], dtype=object)
    named = np.where(both, joined, np.where(has_target, given_target, point))
    own_body = np.where(has_target | (given_body != ""), given_body, body)
    return named, own_body, np.where(has_target, given_target, target)


def _text(collected: CollectedRows, name: str, otherwise: str = "") -> Names:
    if name not in collected.table.column_names:
        return np.full(len(collected.table), otherwise, dtype=object)
    return np.array([value or otherwise for value in collected.table.column(name).to_pylist()], dtype=object)


def _check_unique_point(collected: CollectedRows, log: FaultLog, point: Names) -> None:
    """Fault of a point that occurs twice in an image."""
    seen: set[tuple[object, object, object]] = set()
    again = np.zeros(len(point), dtype=bool)
    keys = zip(collected.table.column("pose").to_pylist(), _text(collected, "image"), point, strict=True)
    for row, key in enumerate(keys):
        again[row] = bool(key[2]) and key in seen
        seen.add(key)
    column = "point" if "point" in collected.table.column_names else "target"
    collected.fault(log, again, column, "each point once in an image")


def _check_one_camera(collected: CollectedRows, log: FaultLog, camera: Names) -> None:
    """Fault of an image with several cameras."""
    first: dict[tuple[object, object], object] = {}
    keys = zip(collected.table.column("pose").to_pylist(), _text(collected, "image"), strict=True)
    second = np.array(
        [first.setdefault(key, camera_name) != camera_name for key, camera_name in zip(keys, camera, strict=True)],
        dtype=bool,
    )
    collected.fault(log, second, "camera", "one camera for all points of an image")


def _check_within_format(collected: CollectedRows, camera: Names, formats: Formats, log: FaultLog) -> None:
    """Fault of rays outside the format of their camera by more than a hundredth of it."""
    for side, name in (("width_px", "x_px"), ("height_px", "y_px")):
        at = numbers(collected, name)
        for one, size_given in formats.items():
            if (size := size_given.get(side)) is not None:
                outside = (camera == one) & ((at < -_MARGIN * size) | (at > (1 + _MARGIN) * size))
                collected.fault(log, outside, name, f"a position within the format of camera {one}, {side} {size}")


def _covariance(collected: CollectedRows, settings: Campaign, log: FaultLog) -> Array:
    """xx, xy, yy (N, 3) in px^2: as given, else of the sigmas, else as declared."""
    names = collected.table.column_names
    declared = settings.noise.image_px
    out = np.full((len(collected.table), 3), np.nan)
    if declared is not None:
        out[:] = [declared**2, 0.0, declared**2]
    for k, name in ((0, "sigma_x_px"), (2, "sigma_y_px")):
        if name in names:
            sigma = numbers(collected, name)
            check_sigma(collected, sigma, name, "px", log, cure=_UNKNOWN)
            out[:, k] = np.where(np.isfinite(sigma), sigma**2, out[:, k])
            out[:, 1] = 0.0
    for k, name in enumerate(_COVARIANCE):
        if name in names:
            out[:, k] = numbers(collected, name)
            if k != 1:
                check_variance(collected, out[:, k], name, "px", log)
    if not np.isfinite(out).all():
        log.add_missing("noise.image_px", "a standard deviation of image coordinates", collected.first_file)
        return np.ones_like(out)
    improper = (out[:, 0] <= 0.0) | (out[:, 2] <= 0.0) | (out[:, 0] * out[:, 2] <= out[:, 1] ** 2)
    if improper.any() and _COVARIANCE[0] in names:
        collected.fault(log, improper, _COVARIANCE[0], "a covariance: xx and yy above 0, xy within their product")
    return np.asarray(out)


def _without_sigma(collected: CollectedRows) -> int:
    """Number of rays without a standard deviation."""
    is_missing = np.zeros(len(collected.table), dtype=bool)
    for name in ("sigma_x_px", _COVARIANCE[0]):
        if name in collected.table.column_names:
            is_missing |= np.isfinite(numbers(collected, name))
    return int(np.count_nonzero(~is_missing))


def _photographs(
    image_points: pa.Table, formats: Formats, collected: CollectedRows, log: FaultLog, identifier: str
) -> pa.Table:
    """One row per image, in order of appearance, with the format that its camera is given."""
    keys = ("pose", "image", "camera")
    images = list(dict.fromkeys(zip(*(image_points.column(key).to_pylist() for key in keys), strict=True)))
    for camera in dict.fromkeys(camera for _, _, camera in images):
        if formats.get(camera, {}).get("width_px") is None:
            text = f"[[cameras]] or the table cameras with width_px and height_px of camera {camera}"
            log.add(Fault(collected.first_file, text, column="camera", value=str(camera)))
    columns: TableRow = {key: [image[k] for image in images] for k, key in enumerate(keys)}
    columns |= {"file": [None] * len(images), "principal_distance_px": [None] * len(images)}
    sides = ("width_px", "height_px")
    columns |= {name: [formats.get(camera, {}).get(name) for _, _, camera in images] for name in sides}
    return artifact_table("photographs", columns, identifier)
