"""Presets of file formats, which complete a mapping."""

from __future__ import annotations

from typing import Any

from truing.formats.file_format import FileFormat, installed_format
from truing.formats.source import RawFile
from truing.schemas.mapping import FORMATS, FileMapping

_AXES = {"x_mm": "x", "y_mm": "y", "z_mm": "z"}
_SIGMAS = {"sigma_x_mm": "sx", "sigma_y_mm": "sy", "sigma_z_mm": "sz"}
_VSTARS_NAMES = ("id", "x", "y", "z", "sx", "sy", "sz")
_AICON_NAMES = (*_VSTARS_NAMES, "rays", "used")
_POSITIONING = {"target_mm": "target", "direction": "direction", "cycle": "cycle", "position_mm": "position"}
_METASHAPE = {"target": "Label", "x_mm": "X_est", "y_mm": "Y_est", "z_mm": "Z_est"}
_MOTION_CAPTURE = {"missing": ("",), "columns": {"pose": "frame", "target": "label", **_AXES}}

_PRESETS: dict[str, dict[str, Any]] = {
    "vstars": {"header": False, "names": _VSTARS_NAMES, "columns": {"target": "id", **_AXES, **_SIGMAS}},
    "aicon": {
        "header": False,
        "separator": "whitespace",
        "names": _AICON_NAMES,
        "columns": {"target": "id", **_AXES, **_SIGMAS},
    },
    # the header line begins with the comment mark
    "metashape": {
        "header": True,
        "comment": "# Coord",
        "keep_lines": "^[^#]",
        "unit": "m",
        "missing": ("",),
        "columns": _METASHAPE,
    },
    "rtl": {"from_name": r"(?i)(?P<run>.+)\.rtl", "columns": _POSITIONING},
    "tracker": {"header": True, "thousands": ",", "columns": {"pose": "ID", **_AXES}},
    "xyz": {"header": False, "names": ("x", "y", "z"), "columns": _AXES},
    "ply": {"columns": _AXES},
    "pcd": {"columns": _AXES},
    "c3d": _MOTION_CAPTURE,
    "trc": _MOTION_CAPTURE,
    # rows without a point are no targets
    "colmap image_points": {"select": {"point": ".+"}},
    "colmap points": {"columns": {**_AXES, **_SIGMAS, "corr_xy": "rxy", "corr_xz": "rxz", "corr_yz": "ryz"}},
    "colmap": {"columns": _AXES},
    "photomodeler points": {"columns": {**_AXES, **_SIGMAS}},
    "inspection": {"missing": ("",), "columns": {"target": "name", **_AXES}},
    "gsi": {"missing": ("",), "columns": _AXES},
    "phc": {"select": {"used": "1"}},
    "scale": {"select": {"used": "1"}},
    "metashape xml image_points": {"select": {"used": "1"}},
}
_BY_SUFFIX = {
    ".parquet": "parquet",
    ".pq": "parquet",
    ".ply": "ply",
    ".pcd": "pcd",
    ".xyz": "xyz",
    ".c3d": "c3d",
    ".trc": "trc",
    ".rtl": "rtl",
    ".obc": "aicon",
    ".phc": "phc",
    ".ior": "ior",
    ".scale": "scale",
    ".gsi": "gsi",
    ".xml": "metashape xml",
    ".xlsx": "xlsx",
    ".xlsm": "xlsx",
    ".mat": "mat",
}
_OWN = {*FORMATS, *_BY_SUFFIX.values()}
_OF_MODELS = ("cameras.bin", "images.bin", "points3d.bin")


def format_of(raw: RawFile, entry: FileMapping) -> str:
    """Return the format of a raw file: declared, or from its name; several kinds of file of a program by their
    endings."""
    if entry.format == "aicon":
        return _BY_SUFFIX[raw.suffix] if raw.suffix in (".phc", ".ior", ".scale") else "aicon"
    if entry.format == "metashape":
        return "metashape xml" if raw.suffix == ".xml" else "metashape"
    if entry.format != "auto":
        return entry.format
    if raw.path.name.lower().startswith(_OF_MODELS):
        return "colmap"
    return _BY_SUFFIX.get(raw.suffix, "delimited")


def added_format(file_format: str) -> FileFormat | None:
    """Return the installed format of a name; None for a format or file kind of the project."""
    return None if file_format in _OWN else installed_format(file_format)


def target_column(file_format: str) -> str | None:
    """Return the raw column of the targets' names that a format's preset gives; None if it gives none."""
    return _PRESETS.get(file_format, {}).get("columns", {}).get("target") or (
        "target" if file_format == "gsi" else None
    )


def with_preset(entry: FileMapping, file_format: str, table: str) -> tuple[FileMapping, frozenset[str]]:
    """Return a mapping completed by its format's preset for a table, and the columns that only the preset names."""
    added = added_format(file_format)
    defaults = _PRESETS.get(f"{file_format} {table}", _PRESETS.get(file_format, {}))
    preset = defaults if added is None else added.checked_preset()
    absent = {key: value for key, value in preset.items() if key not in entry.model_fields_set}
    columns = {**preset.get("columns", {}), **entry.columns}
    missing = tuple(dict.fromkeys((*preset.get("missing", ()), *entry.missing)))
    completed = entry.model_copy(update={**absent, "columns": columns, "missing": missing})
    return completed, frozenset(columns) - frozenset(entry.columns)
