"""Metashape's markers as XML: marker positions in images, and the calibration of the cameras if exported."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from truing.formats.interior_orientation import CORNER, Row, camera_row
from truing.formats.raw import RawBatch, Unusable, Wanted, integer_columns, one_batch
from truing.formats.xml_document import Lines, read_xml

_CALIBRATION = ("f", "cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2", "b1", "b2")
_PLACES = ("location", "projection")
_FREE = "c x0 y0 A1 A2 A3 B1 B2 C1 C2"
_ONLY = "[files.image_points] or [files.cameras]: its projections; coordinates in it are those that somebody gave"


def read_metashape_xml(path: Path, wanted: Wanted, table: str) -> Iterator[RawBatch]:
    """Yield the rows of ``table``, image_points or cameras; raises Unusable if the file is damaged or holds none."""
    if table not in ("image_points", "cameras"):
        raise Unusable(_ONLY)
    root, lines = read_xml(path)
    if table == "image_points":
        rays = _rays(root, lines)
        yield from one_batch(rays, wanted, lines=rays.pop("line"))
        return
    cameras = [(row, lines[sensor]) for sensor in root.iter("sensor") if (row := _camera(sensor, lines)) is not None]
    names = cameras[0][0] if cameras else {"camera": 0}
    columns = {name: [row[name] for row, _ in cameras] for name in names}
    yield from one_batch(columns, wanted, lines=[line for _, line in cameras])


def _rays(root: ElementTree.Element, lines: Lines) -> dict[str, Any]:
    labels = {
        marker.get("id"): marker.get("label") or f"marker {marker.get('id')}"
        for marker in root.iter("marker")
        if marker.get("id") is not None
    }
    cameras = {camera.get("id"): camera for camera in root.iter("camera") if camera.get("id") is not None}
    rows = []
    for marker in root.iter("marker"):
        number = marker.get("marker_id", marker.get("id"))
        for node in (place_node for name in _PLACES for place_node in marker.iter(name)):
            camera = cameras.get(node.get("camera_id"))
            if camera is None or number not in labels:
                expected = "markers and cameras that the file lists, label by label"
                where = f"marker {number}, camera {node.get('camera_id')}"
                raise Unusable(expected, row=lines[node], value=where[:80])
            is_observed = node.get("valid", "true") != "false" and camera.get("enabled", "true") not in ("false", "0")
            rows.append(
                (
                    camera.get("label") or f"camera {camera.get('id')}",
                    camera.get("sensor_id") or "camera",
                    labels[number],
                    _number(node, "x", lines) - CORNER,
                    _number(node, "y", lines) - CORNER,
                    node.get("pinned", "true"),
                    "1" if is_observed else "0",
                    lines[node],
                )
            )
    names = ("image", "camera", "point", "x_px", "y_px", "pinned", "used", "line")
    return {name: [row[i] for row in rows] for i, name in enumerate(names)}


def _number(element: ElementTree.Element, name: str, lines: Lines) -> float:
    return _finite(element.get(name, ""), name, lines[element])


def _finite(text: str, name: str, line: int) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise Unusable("a number", row=line, column=name, value=text[:40])
    return value


def _camera(sensor: ElementTree.Element, lines: Lines) -> Row | None:
    """Return a sensor with a calibration as a camera, preferring the adjusted one; None without calibration."""
    calibrations = sensor.findall("calibration")
    calibration = next(
        (calibration_node for calibration_node in calibrations if calibration_node.get("class") == "adjusted"),
        calibrations[0] if calibrations else None,
    )
    resolution = sensor.find("resolution")
    if calibration is None or resolution is None:
        return None
    name = f"sensor {sensor.get('id')}"
    if calibration.get("type", sensor.get("type", "frame")) != "frame":
        raise Unusable(
            "a camera of type frame", row=lines[calibration], column="type", value=f"{name}: {calibration.get('type')}"
        )
    value = {key: _child_number(calibration, key, lines) for key in _CALIBRATION}
    f = value["f"]
    if f <= 0.0 or value["k4"]:
        found_f = f"{name}: f = {f}, k4 = {value['k4']}"
        raise Unusable("f above 0 and no k4", row=lines[calibration], column="calibration", value=found_f)
    sides = np.array([_number(resolution, side, lines) for side in ("width", "height")])
    width, height = integer_columns(sides, "pixels").tolist()
    radial = [value[f"k{i}"] / f ** (2 * i) for i in (1, 2, 3)]
    ten = [f, value["cx"], value["cy"], *radial, value["p1"] / f, value["p2"] / f, value["b1"] / f, value["b2"] / f]
    pixel = next(
        (property_node for property_node in sensor.findall("property") if property_node.get("name") == "pixel_width"),
        None,
    )
    pixel_um = None if pixel is None else 1e3 * _number(pixel, "value", lines)
    return {**camera_row(str(sensor.get("id")), (width, height), ten, pixel_um=pixel_um), "free": _FREE}


def _child_number(calibration: ElementTree.Element, name: str, lines: Lines) -> float:
    child = calibration.find(name)
    if child is None:
        return 0.0
    return _finite(child.text or "", name, lines[child])
