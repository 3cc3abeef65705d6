"""Recognition of rows that hold a robot's joint readings and the measured points of the same pose."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from truing.arrays import Array
from truing.formats.guess import MappingKeys, wide_template
from truing.formats.named_columns import place_columns
from truing.formats.named_joints import JointReadings, bare_joints, configurations_of_joints, joint_columns
from truing.formats.raw_tables import COORDINATES
from truing.formats.units import bare_and_unit

LINK = "tip"  # last link of rows of Denavit and Hartenberg
_TARGET = "reflector"
_OF_CONTROLLER = re.compile(r"tcp|flange|nominal|soll|command|cmd|target|goal|desired|planned|model|theo", re.I)
_WITHIN_M = 10.0  # coordinates of an arm next to joints in rad: m if all are smaller
_COORDINATES = ("x", "y", "z")
_AXES = len(_COORDINATES)


@dataclass(frozen=True)
class ChainRows:
    """Keys of [files.points] and of [files.configurations] for the same rows, a note, and statements to confirm.

    ``in_metres``: coordinates without a unit are probably in m, not mm.
    """

    points: MappingKeys
    joints: JointReadings
    note: str
    in_metres: bool
    doubts: tuple[str, ...] = ()


def chain_rows(
    names: Sequence[str],
    data: Sequence[Sequence[str]],
    values: Array,
    meant: MappingKeys,
    joints: Sequence[str],
) -> ChainRows | None:
    """Return the points and joints of a table of cells (N, W) and their numbers; None without both.

    meant: raw names by the contract's columns; joints: names of a robot's joints from the base on, or empty.
    Coordinates that a controller computes from its joints are no measurement: they are not taken.
    """
    used = tuple(joints) if joint_columns(names, data, values, joints) is not None else ()
    found = joint_columns(names, data, values, used)
    if found is None:
        return None
    remaining = [name for name in names if name not in found.raw and not _OF_CONTROLLER.search(bare_and_unit(name)[0])]
    keys, raw, note = _several_targets(remaining) or _one_target(remaining, meant)
    if not keys:
        return None
    rows = {"pose": meant["pose"]} if "pose" in meant else {}
    named = {key: meant[key] for key in ("target", "body") if key in meant and rows and "wide" not in keys}
    constants = {"body": LINK, **({} if "wide" in keys else {"target": _TARGET})}
    constants = {key: value for key, value in constants.items() if key not in named}
    counted = {} if rows or "pose" in names else {"number_rows": {"pose": 1}}
    columns = {**rows, **named, **keys.get("columns", {})}
    points = {**keys, "columns": columns, "constants": constants, **counted, **_missing(names, data, raw)}
    read = configurations_of_joints(names, data, values, meant, used)
    if read is None:  # the joints have the contract's names
        pose_keys = {"columns": rows} if rows else counted
        read = JointReadings({**pose_keys, "ignore": _ignored(raw)}, f"joint readings of {', '.join(found.names)}")
    read = replace(read, mapping={**read.mapping, **_first_of_each_pose(names, data, meant)})
    points_read = values[:, [list(names).index(name) for name in raw]]
    is_bare = {bare_and_unit(name)[1] for name in raw} == {None} and "unit" not in keys
    return ChainRows(
        {key: value for key, value in points.items() if value},
        *(read, note, is_bare and is_within_metres(points_read) and set(found.units) == {"rad"}),
    )


def is_within_metres(coordinates: Array) -> bool:
    """True if coordinates of an arm are probably in m: none reaches 10."""
    return float(np.nanmax(np.abs(coordinates))) < _WITHIN_M


def _missing(names: Sequence[str], data: Sequence[Sequence[str]], raw: Sequence[str]) -> dict[str, list[str]]:
    """Return the key for empty cells of some columns, if there are any."""
    columns = [list(names).index(name) for name in raw]
    return {"missing": [""]} if any(not row[column].strip() for row in data for column in columns) else {}


def _several_targets(names: Sequence[str]) -> tuple[MappingKeys, tuple[str, ...], str] | None:
    """Return keys of points for coordinates of several targets side by side, and their columns."""
    if (template := wide_template(names)) is None:
        return None
    wide, unit = template
    pattern = re.escape(wide).replace(r"\{target\}", r"\w.*?").replace(r"\{body\}", r"\w[^:]*")
    raw = tuple(name for name in names if re.fullmatch(pattern.replace(r"\{axis\}", "[xyzXYZ]"), name))
    keys = {"wide": wide, **({} if unit in (None, "mm") else {"unit": unit})}
    return keys, raw, "several targets side by side, next to joint readings"


def _one_target(names: Sequence[str], meant: MappingKeys) -> tuple[MappingKeys, tuple[str, ...], str]:
    """Return keys of points for the coordinates of one target, and their columns; empty without any."""
    known = tuple(meant[column] for column in COORDINATES if meant.get(column) in names)
    known = known or tuple(column for column in COORDINATES if column in names)
    raw = known if len(known) == _AXES else place_columns(names)
    if raw is None:
        return {}, (), ""
    unit = bare_and_unit(raw[0])[1]
    columns = {column: name for column, name in zip(COORDINATES, raw, strict=True) if column != name}
    keys = {"columns": columns, **({} if unit in (None, "mm") or raw == COORDINATES else {"unit": unit})}
    return keys, raw, f"{', '.join(raw)}: one target, next to joint readings"


def _first_of_each_pose(names: Sequence[str], data: Sequence[Sequence[str]], meant: MappingKeys) -> MappingKeys:
    """Return a ``select`` of one row per pose, where a row for each target repeats the joints."""
    if "target" not in meant or "pose" not in meant:
        return {}
    poses, targets = ([row[list(names).index(meant[key])].strip() for row in data] for key in ("pose", "target"))
    return {"select": {meant["target"]: re.escape(targets[0])}} if len(set(poses)) < len(poses) else {}


def bare_chain_rows(values: Array, joints: Sequence[str]) -> ChainRows | None:
    """Return the points and joints of numbers (N, W) without names: as many as a robot's joints, then x, y, z."""
    count = len(joints)
    if values.shape[1] != count + _AXES or not np.isfinite(values).all():
        return None
    read = bare_joints(values[:, :count], joints)
    ignore = _ignored([str(number) for number in range(count + 1, count + _AXES + 1)])
    columns = {name: count + number for number, name in enumerate(COORDINATES, start=1)}
    points = {"columns": columns, "constants": {"body": LINK, "target": _TARGET}, "number_rows": {"pose": 1}}
    doubts = (f"the first {count} columns are assumed to be joints, the last three coordinates of one target",)
    in_metres = "rad" in next(iter(read.mapping["columns"])) and is_within_metres(values[:, count:])
    joints_read = replace(read, mapping={**read.mapping, "ignore": ignore})
    return ChainRows(points, joints_read, f"columns {count + 1} to {count + _AXES}: one target", in_metres, doubts)


def controller_columns(names: Sequence[str]) -> tuple[str, ...]:
    """Return coordinates that a robot's controller computes from its joints, by their names."""
    of_controller = [name for name in names if _OF_CONTROLLER.search(bare_and_unit(name)[0])]
    return place_columns(of_controller) or ()


def _ignored(names: Sequence[str]) -> str:
    return "|".join(re.escape(name).replace("\\ ", " ") for name in names)
