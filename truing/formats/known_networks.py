"""Exports of photogrammetric programs that the look of a file gives away: which tables they hold, and how they are
read."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

_RAYS = ("image", "camera", "point", "x_px", "y_px")
_CAMERA = ("camera", "width_px", "height_px", "focal_px", "x0_px", "y0_px", "A1", "A2", "A3", "B1", "B2", "C1", "C2")
_POINT = ("target", "x", "y", "z")
_ONE_POSE = "one pose is taken: say under from_name, split or constants which pose each image belongs to"
OF_RIGS = "no table: how cameras of a COLMAP model hang together; its images hold what is needed"
_RIGS = ("# Rig calib list", "# Frame list")
_NO_SCALE = "COLMAP knows no scale and no sigma: declare scale_bars or known_points"


@dataclass(frozen=True)
class KnownNetwork:
    """What a file holds: the tables, keys for [files.<table>], the columns, what to look at again."""

    tables: tuple[str, ...]
    mapping: dict[str, Any]
    columns: tuple[str, ...]
    note: str


def by_format(file_format: str, name: str) -> KnownNetwork | None:
    """What a file of a format holds that its name has told."""
    if file_format == "colmap":
        return _colmap(name.lower().split(".")[0])
    pose = {"constants": {"pose": 1}}
    return {
        "phc": KnownNetwork(("image_points",), pose, _RAYS, f"AICON's image coordinates; {_ONE_POSE}"),
        "ior": KnownNetwork(("cameras",), {}, _CAMERA, "AICON's interior orientations: what is estimated, free says"),
        "scale": KnownNetwork(("scale_bars",), {}, ("bar", "first", "second", "length_mm", "sigma_mm"), "AICON's bars"),
        "gsi": KnownNetwork(
            ("points",), {"constants": {"body": "body"}}, _POINT, "Leica GSI: coordinates, each in the unit of its word"
        ),
    }.get(file_format)


def by_look(lines: Sequence[str]) -> KnownNetwork | None:
    """What a text holds whose first lines only one program writes."""
    head = "\n".join(lines[:12])
    for model, mark in (("cameras", "# Camera list"), ("images", "# Image list"), ("points3d", "# 3D point list")):
        if head.startswith(mark):
            return _colmap(model, named=True)
    if head.startswith("<?xml") and re.search(r"<(chunk|document|marker)\b", head):
        note = f"Metashape: projections of markers, whose sigma is [noise] image_px; {_ONE_POSE}"
        calibrated = any("<calibration" in line for line in lines)
        tables = ("image_points", "cameras") if calibrated else ("image_points",)
        return KnownNetwork(tables, {"format": "metashape", "constants": {"pose": 1}}, _RAYS, note)
    if _is_photomodeler(lines):
        note = f"PhotoModeler: marks with sigmas, cameras, points; {_ONE_POSE}"
        mapping = {"format": "photomodeler", "constants": {"pose": 1}}
        return KnownNetwork(("image_points", "cameras"), mapping, _RAYS, note)
    if re.match(r"\*?1[01]\d{4}[+-]\S{8}", head) and re.search(r"\b81....[+-]\d{8}", head):
        return by_format_named("gsi")
    return None


def tells_of_rigs(name: str, head: str = "") -> bool:
    """Whether a file is one of those of a COLMAP model that hold no table, by its name or its first line."""
    return name.lower().startswith(("rigs.bin", "frames.bin")) or head.startswith(_RIGS)


def by_format_named(file_format: str) -> KnownNetwork | None:
    """What a file holds whose name does not tell its format, so that it has to be named."""
    known = by_format(file_format, "")
    if known is None:
        return None
    return KnownNetwork(known.tables, {"format": file_format, **known.mapping}, known.columns, known.note)


def _colmap(model: str, *, named: bool = False) -> KnownNetwork | None:
    own = {"format": "colmap"} if named else {}
    if model == "images":
        return KnownNetwork(("image_points",), {**own, "constants": {"pose": 1}}, _RAYS, f"{_NO_SCALE}; {_ONE_POSE}")
    if model == "cameras":
        return KnownNetwork(("cameras",), own, _CAMERA, "COLMAP's cameras, to start from")
    note = f"{_NO_SCALE}; better read the images: their rays are adjusted with their covariance"
    return KnownNetwork(("points",), {**own, "constants": {"pose": 1, "body": "body"}}, _POINT, note)


def _is_photomodeler(lines: Sequence[str]) -> bool:
    """Whether five lines of numbers follow a title, then the first photo's name behind its number."""
    counts = [len(line.split()) for line in lines[1:5]]
    numbers = all(re.fullmatch(r"[-+.\deE\s]+", line) for line in lines[1:5])
    return len(lines) > 6 and numbers and counts == [4, 9, 10, 10] and re.match(r"\s*\d+ \S", lines[5]) is not None
