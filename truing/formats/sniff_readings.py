"""Proposals for tables of readings: of a bench, of joints, of an axis, and of targets side by side."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

from truing.formats.guess import Guess, MappingKeys, OtherWay, wide_template
from truing.formats.named_bench import (
    Proposal,
    axis_rows,
    columns_in_counts,
    is_deviation_by_name,
    is_over_angle,
    positions_of_axis,
    positions_side_by_side,
    readings_under_load,
)
from truing.formats.named_joints import configurations_of_joints
from truing.formats.named_loads import channels_without_loads, load_columns, with_recorded_runs
from truing.formats.named_temperatures import temperature_columns
from truing.formats.proposed_loads import proposal_of_loads, with_doubt_on_samples
from truing.formats.proposed_poses import NamedCells, column_that_counts, doubt_on_computed_poses, proposal_of_joints

_A_COORDINATE_PER_ROW = "a row for each coordinate; export a table of points with columns X, Y and Z"
_CHANNELS_ALONE = (
    "channels of a sensor without loads: put the load of each row next to them, as columns such as Fx [N] and Mz [N m]"
)
_IN_IMAGE = 2  # coordinates
_OF_PIXELS = re.compile(r"[xyuv]\w*\s*[\[(_ ]\s*(px|pix|pixels?)\s*[\])]?", re.IGNORECASE)
_PIXELS = (
    "image coordinates of targets: [files.image_points] with pose, image and point beside them, and [[cameras]]: "
    "docs/how-to/rays.md"
)
_OVER_ANGLE = (
    "readings over an angle, as of a ball bar or of dial gauges: truing reads no circular and no run-out tests, "
    "because nothing relates them to readings of joints or axes"
)


def guess_readings(
    cells: NamedCells,
    mapping: MappingKeys,
    table: str | None,
    by_names: tuple[MappingKeys, list[str]],
    joints: Sequence[str],
) -> Guess:
    """Return a proposal for readings of a bench, of joints or of a sensor, or of targets side by side."""
    (keys, notes), names = by_names, cells.names
    meant = keys.get("columns", {})
    loads = load_columns(names) if table != "signals" else None
    if table is None and (proposal := _bench_readings(cells)) is not None:
        empty = {"missing": [""]} if cells.has_empty else {}
        bench_keys = mapping | proposal.mapping | empty
        return Guess(bench_keys, names, proposal.table, (proposal.note,), doubts=proposal.doubts)
    if loads is not None:
        loads = with_recorded_runs(loads, names, cells.rows)
        return with_doubt_on_samples(proposal_of_loads(loads, names, mapping, keys), names, cells.values)
    if table != "signals":
        if (readings := configurations_of_joints(names, cells.rows, cells.values, meant, joints)) is not None:
            guess = proposal_of_joints(readings, mapping, names)
            return replace(guess, doubts=(*guess.doubts, *doubt_on_computed_poses(names)))
        if table is None and (axes := axis_rows(names, cells.values)):
            return proposal_of_axis(axes, names, mapping, meant)
        if (template := wide_template(names)) is not None:
            hidden = {"missing": [""]} if cells.has_empty or has_frames(names) else {}
            return _side_by_side(template, names, mapping | keys | hidden)
    if table == "configurations" and "pose" not in {*names, *meant}:
        columns = {**column_that_counts(cells, names), **meant}
        keys = {**keys, **({"columns": columns} if columns else {})}
        keys |= {} if "pose" in columns else {"number_rows": {"pose": 1}}
    if table is None:
        notes = [_A_COORDINATE_PER_ROW] if _has_axes_in_rows(cells.rows) else []
        notes += [_CHANNELS_ALONE] if channels_without_loads(names) else []
        notes += [_OVER_ANGLE] if not notes and is_over_angle(names) else []
        in_counts = columns_in_counts(names)
        notes += [_in_counts(in_counts)] if in_counts and not notes else []
        notes += [_PIXELS] if sum(_OF_PIXELS.fullmatch(name.strip()) is not None for name in names) == _IN_IMAGE else []
    return Guess(mapping | keys, names, table, tuple(notes))


def _in_counts(names: Sequence[str]) -> str:
    """Return the entry to write by hand for encoders in counts: no file states the size of a count."""
    entry = f'columns = {{ motor_deg = {{ name = "{names[0]}", scale = 0.001, unit = "deg" }}, ... }}'
    return (
        f"encoders in counts: {', '.join(names)}. Say how far a count is, and which column is the command, in "
        f'[files.configurations]: {entry}, with [mechanism] type = "axis" (docs/axis.md)'
    )


def _bench_readings(cells: NamedCells) -> Proposal | None:
    """Return the proposal for readings under load, or for positions of an axis; None without either."""
    return (
        readings_under_load(cells.names)
        or positions_of_axis(cells.names, cells.rows, cells.values)
        or positions_side_by_side(cells.names, cells.values)
    )


def has_frames(names: Sequence[str]) -> bool:
    """True if rows are frames of motion capture, in any of which a marker may be hidden."""
    return names[0].strip().casefold() == "frame"


def _has_axes_in_rows(data: list[list[str]]) -> bool:
    """True if a column names the axis of each row, as an inspection program lists its checks."""
    return any({"x", "y", "z"} == {cell.strip().casefold() for cell in column} for column in zip(*data, strict=True))


def proposal_of_axis(
    axes: Sequence[Proposal], names: tuple[str, ...], mapping: MappingKeys, meant: Mapping[str, str]
) -> Guess:
    """Return the proposal of an axis; of two, in degrees and in millimetres, the first is taken."""
    more = {key: raw for key, raw in meant.items() if key in ("pose", "role", "time_s")}
    numbered = {} if "pose" in more or "pose" in names else {"number_rows": {"pose": 1}}
    guesses = []
    for axis in axes:
        warm = temperature_columns(names, {*more.values(), *axis.mapping["columns"].values()})
        units = {**axis.mapping.get("units", {}), **warm.get("units", {})}
        keys = {**mapping, **axis.mapping, "columns": {**more, **axis.mapping["columns"], **warm["columns"]}}
        keys |= {**({"units": units} if units else {}), **numbered}
        guesses.append(Guess(keys, names, axis.table, (axis.note,), doubts=axis.doubts))
    if len(guesses) == 1:
        return _with_sign_of_readings(guesses[0])
    taken, alternative = ("mm", "deg") if "command_mm" in guesses[0].mapping["columns"] else ("deg", "mm")
    text, doubt = "Unit of the axis, which no name gives", f"no unit is given; the axis is assumed to be in {taken}"
    return replace(guesses[0], ways=(OtherWay("axis", text, taken, alternative, guesses[1], doubt),))


def _with_sign_of_readings(guess: Guess) -> Guess:
    """Return a proposal of an axis with the question of the sign, where an instrument's readings are deviations."""
    columns, units = guess.mapping["columns"], guess.mapping.get("units", {})
    column = next((name for name in ("deviation_deg", "deviation_mm") if name in columns), None)
    if column is None or is_deviation_by_name(columns[column]):
        return guess
    raw = columns[column]
    turned = {"name": raw, "scale": -1.0, "unit": units.get(column, column.rsplit("_", 1)[-1])}
    remaining_units = {name: unit for name, unit in units.items() if name != column}
    mapping = {key: value for key, value in guess.mapping.items() if key != "units"}
    mapping |= {"columns": {**columns, column: turned}, **({"units": remaining_units} if remaining_units else {})}
    text = f"{raw}: place of the axis minus its command, or command minus place"
    doubt = f"{raw} is assumed to be the deviation from the command: place minus command, not command minus place"
    way = OtherWay("sign", text, "place-command", "command-place", replace(guess, mapping=mapping), doubt)
    return replace(guess, ways=(way,))


def _side_by_side(template: tuple[str, str | None], names: tuple[str, ...], mapping: MappingKeys) -> Guess:
    """Return a proposal for a table with coordinates of several targets in every row: points, one row per pose."""
    wide, unit = template
    numbered = {} if "pose" in {*names, *mapping.get("columns", {})} else {"number_rows": {"pose": 1}}
    bodies = {} if "{body}" in wide else {"constants": {"body": "body"}}
    more = {"wide": wide, **({} if unit in (None, "mm") else {"unit": unit}), **bodies, **numbered}
    note = "several targets side by side"
    note += "" if not bodies else ": say in wide which part of the names is the body, or name it under constants"
    arguments = {"columns": {"pose": mapping["columns"]["pose"]}} if "pose" in mapping.get("columns", {}) else {}
    mapping_kept = {key: value for key, value in mapping.items() if key not in ("columns", "units")}
    return Guess({**mapping_kept, **arguments, **more}, names, "points", (note,))
