"""Cameras as known beforehand, by the table cameras and by [[cameras]], and which photographs are whose."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from truing.estimation.bundle.camera import PARAMETERS, UNITS
from truing.formats.faultlog import FaultLog
from truing.formats.gather import gather
from truing.formats.shapes import CAMERAS
from truing.formats.source import CampaignFiles
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import Fault
from truing.stages.common.gathered import SmallTable, once
from truing.stages.image_tables.known_beforehand import lacks

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.photographs import GivenCamera

Row = dict[str, Any]

_FORMAT = ("width_px", "height_px", "balancing_radius_px", "pixel_um")
_NO_VALUES = ("name", "of", "poses", "images")
_SAME = 1e-9  # of a number: as alike as two files write it


def read_cameras(source: CampaignFiles, settings: Any, log: FaultLog) -> SmallTable | None:
    """The cameras that the table cameras and [[cameras]] give, a row per parameter; None where neither gives any.

    A camera of both has the values of the table, completed by [[cameras]], which alone says what is free. One that
    takes over photographs ``of`` another has what it is not given itself from that.
    """
    found = gather(source, CAMERAS, log)
    rows: dict[str, Row] = {}
    left_out: dict[tuple[str, str], int] = {}
    if found is not None and not lacks(found, CAMERAS.required):
        once(found, log, ("camera",))
        rows = {row["camera"]: row for row in found.table.to_pylist()}
        left_out = dict(found.left_out)
        for row in rows.values():
            row["free"] = _free(row.get("free"), found.first_file, log)
    file = "" if found is None else found.first_file
    seen: set[str] = set()
    for given in settings.cameras:
        if given.name in seen:
            log.add(Fault("campaign.toml", "each camera once", column="cameras.name", value=given.name))
        seen.add(given.name)
        known = _row(given, rows, file, log)
        if known is not None:
            rows[given.name] = known
    return SmallTable(cameras_table(rows), left_out) if rows else None


def _row(given: GivenCamera, rows: Mapping[str, Row], file: str, log: FaultLog) -> Row | None:
    """A camera of [[cameras]] with what the table, or the camera that it is one of, says; None where nothing does."""
    own = {name: value for name, value in given.model_dump(exclude_unset=True).items() if name not in _NO_VALUES}
    if given.of is not None:
        base = rows.get(given.of)
        return {**base, **own} if base is not None else (_alone(own) if own else None)
    known = rows.get(given.name)
    if known is None:
        return _alone(own)
    told = {**known, "focal_px": _principal_distance(known)}
    stated = {**own, "focal_px": _principal_distance({"pixel_um": known.get("pixel_um"), **own})}
    for name, value in stated.items():
        other = told.get(name)
        if name in ("free", "c_mm") or value is None or other is None:
            continue
        if abs(value - other) > _SAME * max(abs(value), abs(other)):
            expected = f"{other:g}, which {file} has of camera {given.name}, or the key left out of one of them"
            log.add(Fault("campaign.toml", expected, column=f"cameras.{name}", value=f"{value:g}"))
    return {**known, **own}


def _alone(own: Row) -> Row:
    return {**own, "free": PARAMETERS if own.get("free") is None else own["free"]}


def _free(words: str | None, file: str, log: FaultLog) -> tuple[str, ...]:
    if words is None:
        return PARAMETERS
    names = tuple(words.split())
    for name in names:
        if name not in (*PARAMETERS, "none"):
            log.add(Fault(file, f"names of {' '.join(PARAMETERS)} (or none)", column="free", value=name))
    return tuple(name for name in names if name in PARAMETERS)


def cameras_table(rows: dict[str, dict[str, Any]]) -> pa.Table:
    """The table cameras_given, a row per parameter, from one of each camera as the table cameras has it."""
    import pyarrow as pa

    long = []
    for camera, row in rows.items():
        about = _about(row)
        for parameter, unit in zip(PARAMETERS, UNITS, strict=True):
            value = _principal_distance(row) if parameter == "c" else row.get(_key(parameter)) or 0.0
            free = parameter in row["free"]
            long.append({"camera": camera, "parameter": parameter, "unit": unit, "value": value, "free": free} | about)
    return pa.Table.from_pylist(long, schema=ARTIFACTS["cameras_given"].arrow_schema())


def _key(parameter: str) -> str:
    return f"{parameter}_px" if parameter in ("x0", "y0") else parameter


def _about(row: dict[str, Any]) -> dict[str, Any]:
    """The format of a camera and its balancing radius: a third of the format's diagonal where it is not given."""
    about = {name: row.get(name) for name in _FORMAT}
    if about["balancing_radius_px"] is None:
        width, height = about["width_px"], about["height_px"]
        about["balancing_radius_px"] = float(np.hypot(width, height) / 3) if width and height else 0.0
    return about


def _principal_distance(row: dict[str, Any]) -> float | None:
    if row.get("focal_px") is not None:
        return float(row["focal_px"])
    if row.get("c_mm") is not None and row.get("pixel_um"):
        return float(1e3 * row["c_mm"] / row["pixel_um"])
    return None


def regrouped(tables: Mapping[str, pa.Table], cameras: tuple[GivenCamera, ...], log: FaultLog) -> dict[str, pa.Table]:
    """Tables with columns pose, image and camera, in which photographs bear the camera that [[cameras]] gives them.

    tables: photographs among them, by which groups are held against what there is.
    """
    groups = [given for given in cameras if given.of is not None]
    if not groups:
        return dict(tables)
    owner: dict[tuple[str, str], str] = {}
    for pose, image, camera in _keys(tables["photographs"]):
        own = [given.name for given in groups if _is_of(given, pose, image, camera)]
        if len(own) > 1:
            expected = f"one camera for image {image} of pose {pose}"
            log.add(Fault("campaign.toml", expected, column="cameras.images", value=", ".join(own)))
        if own:
            owner[pose, image] = own[0]
    for given in groups:
        if given.name not in owner.values():
            expected = f"poses or images of photographs by camera {given.of}; none is camera {given.name}'s"
            log.add(Fault("campaign.toml", expected, column="cameras.of", value=given.of))
    return {name: _with_owners(table, owner) for name, table in tables.items()}


def _is_of(given: GivenCamera, pose: str, image: str, camera: str) -> bool:
    poses, images = (None if names is None else set(map(str, names)) for names in (given.poses, given.images))
    return camera == given.of and (poses is None or pose in poses) and (images is None or image in images)


def _keys(table: pa.Table) -> list[tuple[str, str, str]]:
    columns = (map(str, table.column(name).to_pylist()) for name in ("pose", "image", "camera"))
    return list(zip(*columns, strict=True))


def _with_owners(table: pa.Table, owner: Mapping[tuple[str, str], str]) -> pa.Table:
    import pyarrow as pa

    names = [owner.get((pose, image), camera) for pose, image, camera in _keys(table)]
    return table.set_column(table.column_names.index("camera"), "camera", pa.array(names, pa.string()))
