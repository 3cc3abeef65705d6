"""Prior knowledge of a network: codes of targets, scale bars, known points, cameras."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import TableRow
from truing.estimation.bundle.camera import PARAMETERS, UNITS
from truing.formats.faultlog import FaultLog
from truing.formats.raw_tables import CAMERAS, COORDINATE_SIGMAS, IMAGE_TARGETS, KNOWN_POINTS, SCALE_BARS
from truing.formats.row_collection import CollectedRows, collect_rows
from truing.formats.source import OF_IMAGES, CampaignFiles
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import Fault
from truing.schemas.photographs import FAMILIES, RINGS
from truing.stages.common.table_arrays import SmallTable, check_sigma, check_unique_keys, numbers, with_filled_column
from truing.stages.image_tables.point_names import survey_names

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.photographs import GivenCamera

_FORMAT = ("width_px", "height_px", "balancing_radius_px", "pixel_um")
_NO_VALUES = ("name", "of", "poses", "images")
_SAME = 1e-9  # of a number: as alike as two files write it


def read_known(source: CampaignFiles, settings: Campaign, log: FaultLog) -> dict[str, SmallTable]:
    """All prior knowledge of a network, by artifact; faults go into ``log``."""
    mapped = [table for table in OF_IMAGES if getattr(settings.files, table)]
    if source.entries("images") and source.entries("image_points"):
        expected = "either photographs (images) or rays measured elsewhere (image_points), not both"
        log.add(Fault("campaign.toml", expected, column=f"files.{[*mapped, 'images'][0]}"))
        log.raise_faults()
    targets = read_image_targets(source, tuple(board.label for board in settings.photographs.boards), log)
    names = None if targets is None else targets.table
    known_tables = {
        "image_targets": targets,
        "scale_bars": read_scale_bars(source, names, log),
        "known_points": read_known_points(source, names, log),
        "cameras_given": read_cameras(source, settings, log),
    }
    return {name: table for name, table in known_tables.items() if table is not None}


def read_image_targets(source: CampaignFiles, boards: tuple[str, ...], log: FaultLog) -> SmallTable | None:
    """Target of each code; None without such a table.

    Codes that are searched for in photographs must exist, or be corners of one of the ``boards``.
    """
    rows = collect_rows(source, IMAGE_TARGETS, log)
    if rows is None or lacks_columns(rows, IMAGE_TARGETS.required):
        return None
    if source.entries("images"):
        check_codes(rows, boards, log)
    check_unique_keys(rows, log, "family", "code")
    check_unique_keys(rows, log, "body", "target")
    return SmallTable(_as_artifact("image_targets", rows.table), dict(rows.left_out))


def read_scale_bars(source: CampaignFiles, targets: pa.Table | None, log: FaultLog) -> SmallTable | None:
    """The calibrated lengths, their ends by the names that points have; None where there are none."""
    rows = collect_rows(source, SCALE_BARS, log, "pose")
    if rows is None or lacks_columns(rows, SCALE_BARS.required):
        return None
    check_unique_keys(rows, log, *(("pose", "bar") if "pose" in rows.table.column_names else ("bar",)))
    rows.fault(log, numbers(rows, "length_mm") <= 0.0, "length_mm", "a number above 0")
    check_sigma(rows, numbers(rows, "sigma_mm"), "sigma_mm", "mm", log)
    if "repeat_sigma_mm" in rows.table.column_names:
        check_sigma(rows, numbers(rows, "repeat_sigma_mm"), "repeat_sigma_mm", "mm", log, or_zero=True)
    table = rows.table
    ends = [_named_points(table, name, targets) for name in ("first", "second")]
    rows.fault(log, ends[0] == ends[1], "second", "another point than the first")
    for name, values in zip(("first", "second"), ends, strict=True):
        table = table.set_column(table.column_names.index(name), name, pa.array(values, pa.string()))
    table = with_filled_column(table, "repeat_sigma_mm", 0.0, pa.float64())
    table = with_filled_column(table, "serves", "scale", pa.string())
    return SmallTable(_as_artifact("scale_bars", table), dict(rows.left_out))


def read_known_points(source: CampaignFiles, targets: pa.Table | None, log: FaultLog) -> SmallTable | None:
    """Points whose coordinates are known, with their standard deviations; None where there are none."""
    rows = collect_rows(source, KNOWN_POINTS, log, "pose")
    if rows is None or lacks_columns(rows, KNOWN_POINTS.required):
        return None
    table = rows.table
    point = _named_points(table, "point", targets)
    if {"body", "target"} <= set(table.column_names):
        both = zip(table.column("body").to_pylist(), table.column("target").to_pylist(), strict=True)
        named = np.array([f"{body}/{target}" if body and target else "" for body, target in both], dtype=object)
        point = np.where(named != "", named, point)
    rows.fault(log, point == "", "point", "the name of a point, or body and target")
    if "point" in table.column_names:
        table = table.drop_columns("point")
    table = table.append_column("point", pa.array(point, pa.string()))
    for name in COORDINATE_SIGMAS:
        if name not in table.column_names or table.column(name).null_count:
            log.add(Fault(rows.first_file, "a standard deviation in every row", column=name))
            return None
        check_sigma(rows, numbers(rows, name), name, "mm", log)
    table = table.drop_columns([name for name in ("body", "target") if name in table.column_names])
    return SmallTable(_as_artifact("known_points", table), dict(rows.left_out))


def lacks_columns(collected: CollectedRows, required: tuple[str, ...]) -> bool:
    """True if columns are missing; the fault was reported when the file was read."""
    return any(name not in collected.table.column_names for name in required)


def _named_points(table: pa.Table, column: str, targets: pa.Table | None) -> NDArray[np.object_]:
    """Points by their own names, where a column may call them by their codes."""
    if column not in table.column_names:
        return np.full(len(table), "", dtype=object)
    return survey_names(np.array([name or "" for name in table.column(column).to_pylist()], dtype=object), targets)[0]


def _as_artifact(name: str, table: pa.Table) -> pa.Table:
    """A table in the artifact's columns and types; its faults are reported elsewhere."""
    artifact = ARTIFACTS[name]
    names = [key for key in (*artifact.columns, *artifact.optional) if key in table.column_names]
    text = "pose" in names and pa.types.is_string(table.schema.field("pose").type)
    schema = artifact.arrow_schema("string" if text else "int64", tuple(names))
    return table.select(schema.names).cast(pa.schema([field.with_nullable(True) for field in schema]))


def check_codes(collected: CollectedRows, boards: tuple[str, ...], log: FaultLog) -> None:
    """A fault at every family that no photograph is searched for, and at every code that its family does not have."""
    families = [family or "" for family in collected.table.column("family").to_pylist()]
    codes = [code or "" for code in collected.table.column("code").to_pylist()]
    named = ("circle", *FAMILIES, *boards)
    unknown = np.array([family not in named for family in families], dtype=bool)
    collected.fault(log, unknown, "family", f"one of {', '.join(FAMILIES)}, or the name of a board")
    for family in sorted(set(families) & set(FAMILIES)):
        is_of_family = np.array([name == family for name in families], dtype=bool)
        absent = np.array([code not in _codes(family) for code in codes], dtype=bool)
        collected.fault(log, is_of_family & absent, "code", f"one of the {len(_codes(family))} codes of {family}")


@cache
def _codes(family: str) -> frozenset[str]:
    if family in RINGS:
        from truing.estimation.image_targets.ring_codes import family_of_rings

        return frozenset(map(str, family_of_rings(family).numbers))
    from truing.estimation.image_targets.marker_codes import codes_of

    return frozenset(map(str, range(codes_of(family))))


def read_cameras(source: CampaignFiles, settings: Campaign, log: FaultLog) -> SmallTable | None:
    """The cameras that the table cameras and [[cameras]] give, a row per parameter; None where neither gives any.

    A camera of both has the values of the table, completed by [[cameras]], which alone declares the free parameters.
    One that takes over photographs ``of`` another has what it is not given itself from that.
    """
    collected_rows = collect_rows(source, CAMERAS, log)
    rows: dict[str, TableRow] = {}
    left_out: dict[tuple[str, str], int] = {}
    if collected_rows is not None and not lacks_columns(collected_rows, CAMERAS.required):
        check_unique_keys(collected_rows, log, "camera")
        rows = {row["camera"]: row for row in collected_rows.table.to_pylist()}
        left_out = dict(collected_rows.left_out)
        for row in rows.values():
            row["free"] = _free(row.get("free"), collected_rows.first_file, log)
    file = "" if collected_rows is None else collected_rows.first_file
    seen: set[str] = set()
    for camera in settings.cameras:
        if camera.name in seen:
            log.add(Fault("campaign.toml", "each camera once", column="cameras.name", value=camera.name))
        seen.add(camera.name)
        known = _row(camera, rows, file, log)
        if known is not None:
            rows[camera.name] = known
    return SmallTable(cameras_table(rows), left_out) if rows else None


def _row(given_camera: GivenCamera, rows: Mapping[str, TableRow], file: str, log: FaultLog) -> TableRow | None:
    """A camera of [[cameras]], completed from the table or from its group of cameras; None where nothing does."""
    values = {
        name: value for name, value in given_camera.model_dump(exclude_unset=True).items() if name not in _NO_VALUES
    }
    if given_camera.of is not None:
        base = rows.get(given_camera.of)
        return {**base, **values} if base is not None else (_with_default_free(values) if values else None)
    known = rows.get(given_camera.name)
    if known is None:
        return _with_default_free(values)
    reported = {**known, "focal_px": _principal_distance(known)}
    stated = {**values, "focal_px": _principal_distance({"pixel_um": known.get("pixel_um"), **values})}
    for name, value in stated.items():
        other = reported.get(name)
        if name in ("free", "c_mm") or value is None or other is None:
            continue
        if abs(value - other) > _SAME * max(abs(value), abs(other)):
            expected = f"{other:g}, which {file} has of camera {given_camera.name}, or the key left out of one of them"
            log.add(Fault("campaign.toml", expected, column=f"cameras.{name}", value=f"{value:g}"))
    return {**known, **values}


def _with_default_free(values: TableRow) -> TableRow:
    return {**values, "free": PARAMETERS if values.get("free") is None else values["free"]}


def _free(words: str | None, file: str, log: FaultLog) -> tuple[str, ...]:
    if words is None:
        return PARAMETERS
    names = tuple(words.split())
    for name in names:
        if name not in (*PARAMETERS, "none"):
            log.add(Fault(file, f"names of {' '.join(PARAMETERS)} (or none)", column="free", value=name))
    return tuple(name for name in names if name in PARAMETERS)


def cameras_table(rows: dict[str, TableRow]) -> pa.Table:
    """The table cameras_given, a row per parameter, from one of each camera as the table cameras has it."""
    long = []
    for camera, row in rows.items():
        about = _camera_format(row)
        for parameter, unit in zip(PARAMETERS, UNITS, strict=True):
            key = f"{parameter}_px" if parameter in ("x0", "y0") else parameter
            value = _principal_distance(row) if parameter == "c" else row.get(key) or 0.0
            free = parameter in row["free"]
            long.append({"camera": camera, "parameter": parameter, "unit": unit, "value": value, "free": free} | about)
    return pa.Table.from_pylist(long, schema=ARTIFACTS["cameras_given"].arrow_schema())


def _camera_format(row: TableRow) -> TableRow:
    """The format of a camera and its balancing radius: a third of the format's diagonal where it is not given."""
    about = {name: row.get(name) for name in _FORMAT}
    if about["balancing_radius_px"] is None:
        width, height = about["width_px"], about["height_px"]
        about["balancing_radius_px"] = float(np.hypot(width, height) / 3) if width and height else 0.0
    return about


def _principal_distance(row: TableRow) -> float | None:
    if row.get("focal_px") is not None:
        return float(row["focal_px"])
    if row.get("c_mm") is not None and row.get("pixel_um"):
        return float(1e3 * row["c_mm"] / row["pixel_um"])
    return None


def regrouped(tables: Mapping[str, pa.Table], cameras: tuple[GivenCamera, ...], log: FaultLog) -> dict[str, pa.Table]:
    """Tables with columns pose, image and camera, in which photographs bear the camera that [[cameras]] gives them.

    tables: with photographs, against which the groups are checked.
    """
    groups = [camera_group for camera_group in cameras if camera_group.of is not None]
    if not groups:
        return dict(tables)
    owner: dict[tuple[str, str], str] = {}
    for pose, image, camera in _keys(tables["photographs"]):
        names_of_groups = [
            camera_group.name for camera_group in groups if _is_selected(camera_group, pose, image, camera)
        ]
        if len(names_of_groups) > 1:
            expected = f"one camera for image {image} of pose {pose}"
            log.add(Fault("campaign.toml", expected, column="cameras.images", value=", ".join(names_of_groups)))
        if names_of_groups:
            owner[pose, image] = names_of_groups[0]
    for group in groups:
        if group.name not in owner.values():
            expected = f"poses or images of photographs by camera {group.of}; none is camera {group.name}'s"
            log.add(Fault("campaign.toml", expected, column="cameras.of", value=group.of))
    return {name: _with_owners(table, owner) for name, table in tables.items()}


def _is_selected(given_camera: GivenCamera, pose: str, image: str, camera: str) -> bool:
    poses, images = (
        None if names is None else set(map(str, names)) for names in (given_camera.poses, given_camera.images)
    )
    return camera == given_camera.of and (poses is None or pose in poses) and (images is None or image in images)


def _keys(table: pa.Table) -> list[tuple[str, str, str]]:
    columns = (map(str, table.column(name).to_pylist()) for name in ("pose", "image", "camera"))
    return list(zip(*columns, strict=True))


def _with_owners(table: pa.Table, owner: Mapping[tuple[str, str], str]) -> pa.Table:
    names = [owner.get((pose, image), camera) for pose, image, camera in _keys(table)]
    return table.set_column(table.column_names.index("camera"), "camera", pa.array(names, pa.string()))
