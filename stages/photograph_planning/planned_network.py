"""Network for a plan of photographs: targets in one frame, camera, scale bars."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, cast

import numpy as np

from truing.arrays import Array, TableRow
from truing.estimation.bundle.camera import Camera
from truing.estimation.bundle.network import Bars
from truing.estimation.bundle.photograph_plan import PlannedTargets
from truing.estimation.bundle.planning import PlannedNetwork, PlannedObject
from truing.schemas.faults import CampaignFaults, Fault
from truing.simulation.mechanisms.legs.kinematics import forward
from truing.stages.common.nominal_mechanism import nominal_legs

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import LeggedMechanism

_FILE = "campaign.toml"
_XYZ = ("x_mm", "y_mm", "z_mm")
_WHENCE = (
    "a camera: [[cameras]] in campaign.toml, the run of earlier photographs (--run), or photographs with EXIF data; "
    "for poses of a machine use truing design"
)
_NORMAL = ("normal_x", "normal_y", "normal_z")
_NOMINAL = ("base", "platform")  # the bodies whose nominal places a mechanism gives


def planned_network(
    settings: Campaign,
    tables: Mapping[str, pa.Table],
    normals: pa.Table | None,
    camera: str | None,
    noise_px: Mapping[str, float],
) -> tuple[PlannedNetwork, PlannedTargets, tuple[str, ...]]:
    """Return the network, its targets, and notes on parts of the campaign left out of it; raises CampaignFaults.

    ``tables``: survey, and if present cameras_given, scale_bars, image_targets. ``noise_px``: noise of an image
    coordinate by camera, if the campaign declares none.
    """
    chosen, interior = _camera(tables.get("cameras_given"), camera)
    noise = settings.noise.image_px or noise_px.get(getattr(chosen, "name", ""), 0.0)
    faults = [] if noise else [Fault(_FILE, "the standard deviation of an image coordinate", column="noise.image_px")]
    faults += [] if isinstance(chosen, Camera) else [chosen]
    if faults or not isinstance(chosen, Camera):
        raise CampaignFaults(faults)
    targets, left_out = _targets(settings, tables, normals)
    bars, astray = _bars(tables.get("scale_bars"), targets)
    return PlannedNetwork(chosen, interior, noise, targets.layout, bars), targets, (*left_out, *astray)


def _camera(cameras: pa.Table | None, wanted: str | None) -> tuple[Camera | Fault, Array]:
    """Return the camera of this name, or the only camera."""
    rows = [] if cameras is None else cameras.to_pylist()
    names = list(dict.fromkeys(row["camera"] for row in rows))
    if wanted not in names and (wanted is not None or len(names) != 1):
        many = f"the name of one: {', '.join(names)}" if names else _WHENCE
        return Fault("--camera" if names else _FILE, many, value=wanted), np.empty(0)
    rows_of_camera = [row for row in rows if row["camera"] == (wanted or names[0])]
    first = rows_of_camera[0]
    interior = np.array([np.nan if row["value"] is None else row["value"] for row in rows_of_camera])
    if not first["width_px"] or not first["height_px"] or np.isnan(interior[0]):
        expected = "width_px, height_px and c_mm (with pixel_um) or focal_px"
        return Fault(_FILE, expected, column="cameras", value=first["camera"]), np.empty(0)
    free = tuple(row["parameter"] for row in rows_of_camera if row["free"])
    pitch = 1e-6 * first["pixel_um"] if first["pixel_um"] else None
    radius = first["balancing_radius_px"]
    return Camera(first["camera"], first["width_px"], first["height_px"], radius, pitch, free), interior


def _targets(
    settings: Campaign, tables: Mapping[str, pa.Table], normals: pa.Table | None
) -> tuple[PlannedTargets, tuple[str, ...]]:
    """Return the surveyed targets in one frame: that of the base, with the platform at the reference readings, or that
    of the survey without a mechanism."""
    rows = tables["survey"].to_pylist()
    legged = settings.mechanism.is_legged
    rows_used = [row for row in rows if not legged or row["body"] in _NOMINAL]
    turned = _directions(normals, {(row["body"], row["target"]) for row in rows_used})
    points = np.array([[row[name] for name in _XYZ] for row in rows_used]) * 1e-3
    directions = np.array([turned.get((row["body"], row["target"]), [np.nan] * 3) for row in rows_used])
    if legged:
        legs = nominal_legs(cast("LeggedMechanism", settings.mechanism))
        reached = forward(legs, legs.rho0)
        moves = np.array([row["body"] == "platform" for row in rows_used])
        points[moves] = points[moves] @ reached.R.T + reached.p
        directions[moves] = directions[moves] @ reached.R.T
    layout = PlannedObject(points, directions, _diameters(settings, tables.get("image_targets"), rows_used))
    left_out = sorted({row["body"] for row in rows} - {row["body"] for row in rows_used})
    statements = (f"Not planned for, because nothing gives their places: {', '.join(left_out)}.",) if left_out else ()
    return PlannedTargets(
        tuple(row["body"] for row in rows_used), tuple(row["target"] for row in rows_used), layout
    ), statements


def _directions(normals: pa.Table | None, known: set[tuple[str, str]]) -> dict[tuple[str, str], Array]:
    """Return the unit normal of each target in the given table, in its body's frame."""
    if normals is None:
        return {}
    if lacking := [name for name in ("body", "target", *_NORMAL) if name not in normals.column_names]:
        raise CampaignFaults(Fault("--normals", "this column", column=name) for name in lacking)
    directions: dict[tuple[str, str], Array] = {}
    faults = []
    for number, row in enumerate(normals.to_pylist(), start=2):
        key = (str(row["body"]), str(row["target"]))
        direction = np.array([row[name] if isinstance(row[name], int | float) else np.nan for name in _NORMAL])
        length = float(np.linalg.norm(direction))
        if key not in known:
            faults.append(Fault("--normals", "a surveyed target", row=number, value="/".join(key)))
        elif not 0.0 < length < np.inf:
            faults.append(Fault("--normals", "three numbers that make a direction", row=number, value=str(direction)))
        else:
            directions[key] = direction / length
    if faults:
        raise CampaignFaults(faults)
    return directions


def _diameters(settings: Campaign, image_targets: pa.Table | None, rows: list[TableRow]) -> Array:
    """Return the diameter (P,) of each target in m: its own, otherwise the common one; NaN if unknown."""
    reported = {} if image_targets is None else {(row["body"], row["target"]): row for row in image_targets.to_pylist()}
    usual = settings.photographs.target_mm
    diameters = [reported.get((row["body"], row["target"]), {}).get("diameter_mm") or usual for row in rows]
    return np.array([np.nan if value is None else 1e-3 * value for value in diameters])


def _bars(table: pa.Table | None, targets: PlannedTargets) -> tuple[Bars, tuple[str, ...]]:
    """Return the scale bars between targets of the plan, and notes on the others."""
    index_of = {f"{body}/{name}": i for i, (body, name) in enumerate(zip(targets.body, targets.name, strict=True))}
    rows = [] if table is None else [row for row in table.to_pylist() if row["serves"] == "scale"]
    rows_used = [row for row in rows if row["first"] in index_of and row["second"] in index_of]
    rows_used = list({row["bar"]: row for row in rows_used}.values())
    astray = sorted({row["bar"] for row in rows} - {row["bar"] for row in rows_used})
    statements = (f"Not used, because their ends are no surveyed targets: {', '.join(astray)}.",) if astray else ()
    if not rows_used:
        return Bars.none(), statements
    number = np.arange(len(rows_used))
    ends = np.array([[index_of[row["first"]], index_of[row["second"]]] for row in rows_used])
    length = np.linalg.norm(np.diff(targets.layout.points[ends], axis=1)[:, 0], axis=1)  # as the survey has it
    sigma, repeat = (np.array([1e-3 * row[name] for row in rows_used]) for name in ("sigma_mm", "repeat_sigma_mm"))
    return Bars(number, ends[:, 0], ends[:, 1], repeat, length, sigma), statements
