"""Proposals for a table of cells: meaning, units and notation of its columns."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from truing.arrays import Array
from truing.formats.deviation_units import with_unit_of_deviations
from truing.formats.guess import (
    Guess,
    OtherWay,
    adjusted_points,
    is_id,
    parts_of_names,
    tracker,
    wide_template,
)
from truing.formats.heading import heading_of
from truing.formats.named_bench import (
    Proposal,
    axis_rows,
    positions_of_axis,
    positions_side_by_side,
    readings_under_load,
)
from truing.formats.named_chain import (
    LINK,
    ChainRows,
    bare_chain_rows,
    chain_rows,
    controller_columns,
    is_within_metres,
)
from truing.formats.named_columns import (
    SHIFTS,
    PoseMapping,
    bare_poses,
    is_one_motion,
    pose_columns,
    poses_side_by_side,
)
from truing.formats.named_joints import JointReadings, bare_joints, configurations_of_joints
from truing.formats.named_loads import LoadMapping, channels_without_loads, load_columns
from truing.formats.numbers import Notation
from truing.formats.probable_columns import columns_by_names
from truing.formats.shapes import COORDINATES, WRENCH
from truing.formats.times import time_format_of
from truing.formats.units import LONGEST_NAME, bare_and_unit, known_unit, may_be
from truing.schemas.columns import find_column

_SAMPLES = 10  # rows per load from which on they are probably samples of one load step
_ONE_MOTION = "a single rigid motion (4x4): how two frames lie to each other, no measurement; it is not read"
_A_COORDINATE_PER_ROW = "a row for each coordinate; export a table of points with columns X, Y and Z"
_CHANNELS_ALONE = (
    "channels of a sensor without loads: put the load of each row beside them, as columns such as Fx [N] and Mz [N m]"
)
_MARKER = re.compile(r"Marker\.(?P<name>.+)\.[^.]*\.Position\.[XYZ](?: \[.*\])?")
_POLAR = "directions and distances of a total station or theodolite; export the adjusted coordinates X, Y, Z"
_HORIZONTAL = re.compile(r"hz|ha|h(orizontal)?[ _]?(angle|dir(ection)?|winkel|richtung)|azimuth|bearing|richtung", re.I)
_VERTICAL = re.compile(r"v|va|v(ertical)?[ _]?(angle|winkel)|zenith([ _]?angle)?|zenitwinkel|elevation", re.I)
_DISTANCE = re.compile(r"sd|d|s(lope|lant)?[ _]?dist(ance)?|(schr(ä|ae)g)?(strecke|distanz)|range|distance", re.I)
_OF_COORDINATES = ("points", "targets", "poses", "scans", "surfaces")
_OF_UNITS = r"units?|einheit|unité"
_OF_EACH_POSE = ("time_s", "temperature_c")  # columns that tables of coordinates do not have
_AXES = 3
_SEVERAL = 2
_OF_BODIES = r"body|(rigid|tracked)[ _]?body|model|object|subject|segment|tool|k(ö|oe)rper"
_COMMA_DECIMAL, _COMMA_THOUSANDS = Notation(",", None), Notation(".", ",")
_OPEN_COMMA = re.compile(r"[-+]?[1-9]\d{0,2},\d{3}")
_NOTATIONS = (
    Notation(".", None),
    _COMMA_DECIMAL,
    _COMMA_THOUSANDS,
    Notation(",", "."),
    Notation(".", "'"),
    Notation(",", " "),
)
_SIGNS = (
    ("interferometer", {"channel", "reading"}),
    ("quadrature", {"signal_x", "signal_y"}),
    ("quadrature", {"phase_deg", "radius"}),
    ("positioning", {"target_mm", "position_mm"}),
    ("published", {"theoretical_maximum"}),
    ("published", {"measured_positive", "measured_negative"}),
    ("displacement", {"dx_mm", "dy_mm", "dz_mm"}),
    ("signals", {"v1_mv"}),
    ("configurations", {"pose", "time_s"}),
    ("configurations", {"rho1_mm"}),
    ("poses", {"pose", "x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz"}),
    ("poses", {"pose", "x_mm", "y_mm", "z_mm", "rx_rad", "ry_rad", "rz_rad"}),
    ("poses", {"pose", "x_mm", "y_mm", "z_mm", "euler_a_deg", "euler_b_deg", "euler_c_deg"}),
    ("points", {"pose", "x_mm", "y_mm", "z_mm"}),
    ("targets", {"target", "x_mm", "y_mm", "z_mm"}),
    ("points", {"x_mm", "y_mm", "z_mm"}),
)


def sniff_cells(
    records: list[list[str]],
    mapping: dict[str, Any],
    separator: str = ",",
    *,
    first_lines: Sequence[int] = (),
    comments: Sequence[Sequence[str]] = (),
    unit: str | None = None,
    joints: Sequence[str] = (),
    is_of_joints: bool = False,
) -> Guess:
    """Return a proposal for records of equally many cells, the first of which may be a header.

    first_lines: number of lines before each record; absent: records follow each other from the first line on. comments:
    cells of lines that are no records. unit: of all coordinates, by words of the file. joints: as in `sniff_file`.
    is_of_joints: whether the file's name says that it holds joint readings.
    """
    lines = tuple(first_lines) or tuple(range(len(records)))
    about = _Surroundings(lines, tuple(comments), unit, tuple(joints), is_of_joints)
    notation = _notation(records[1:] or records)
    guess = _guess_by_notation(records, dict(mapping), separator, notation, about)
    if notation != _COMMA_DECIMAL or (cell := _open_cell(records)) is None:
        return guess
    text = f"Decimal mark of numbers such as {cell}; with . the comma separates thousands"
    other = _guess_by_notation(records, dict(mapping), separator, _COMMA_THOUSANDS, about)
    doubt = f"the comma of numbers such as {cell} is assumed to be the decimal mark"
    return replace(guess, ways=(*guess.ways, OtherWay("decimal", text, ",", ".", other, doubt)))


@dataclass(frozen=True)
class _Surroundings:
    """Lines before each record, cells of comments, unit of lengths by words of the file, and a robot's joints."""

    first_lines: tuple[int, ...]
    comments: tuple[Sequence[str], ...]
    unit: str | None
    joints: tuple[str, ...]
    is_of_joints: bool

    def joints_of(self, columns: int) -> tuple[str, ...]:
        """Return the names of the joints in so many columns without names: numbers if only the file's name tells."""
        numbered = tuple(f"joint{number}" for number in range(1, columns + 1)) if self.is_of_joints else ()
        return self.joints or numbered


def _open_cell(records: list[list[str]]) -> str | None:
    """Return a number whose comma may separate thousands as well; None if another cell decides."""
    commas = [cell for record in records[1:] or records for cell in record if "," in cell]
    return commas[0] if all(_OPEN_COMMA.fullmatch(cell.strip()) for cell in commas) else None


def _guess_by_notation(
    records: list[list[str]], mapping: dict[str, Any], separator: str, notation: Notation, about: _Surroundings
) -> Guess:
    """Return a proposal for records whose numbers are written in a notation."""
    if any(len(name) > LONGEST_NAME for name in records[0]):
        return Guess(mapping, notes=(f"a name of more than {LONGEST_NAME} characters names no column",))
    heading = heading_of(records, lambda cell: _is_number(cell, notation), about.comments)
    names, data = heading.names, records[heading.rows :]
    has_header = heading.is_row or heading.names[0] != "1"
    known = tracker(names, notation.thousands) if has_header else None
    known = known or (None if has_header else adjusted_points(records, lambda cell: _is_number(cell, notation)))
    if known is not None:
        return _with_parts_of_points(replace(known, mapping={**mapping, **known.mapping}), records)
    mapping |= {"separator": separator} if separator != "," else {}
    mapping |= {"header": False} if not heading.is_row else {}
    if has_header and not heading.is_row:
        mapping |= {"names": list(names)} | ({"skip_lines": about.first_lines[heading.rows]} if heading.rows else {})
    mapping |= {"decimal": notation.decimal} if notation.decimal != "." else {}
    mapping |= {"thousands": notation.thousands} if notation.thousands else {}
    values = notation.matrix(data)
    if not has_header:
        return _with_unit_in_words(_without_names(names, data, values, mapping, notation, about), about.unit)
    guess = _with_times(_guess_by_names(names, data, values, mapping, about.joints), names, data, notation)
    guess = with_unit_of_deviations(guess, names, values, about.unit)
    return _with_unit_in_words(with_unit_of_rows(guess, names, data), about.unit)


def _with_times(guess: Guess, names: tuple[str, ...], data: list[list[str]], notation: Notation) -> Guess:
    """Return a proposal that reads its column of times, in seconds or by a format; without it where none reads it."""
    beside = tuple(_with_times(following, names, data, notation) for following in guess.beside)
    ways = tuple(replace(way, guess=_with_times(way.guess, names, data, notation)) for way in guess.ways)
    guess = replace(guess, beside=beside, ways=ways)
    columns = dict(guess.mapping.get("columns", {}))
    raw = columns.get("time_s")
    if raw not in names or "time_format" in guess.mapping:
        return guess
    cells = [row[names.index(raw)] for row in data]
    if all(_is_number(cell, notation) for cell in cells if cell.strip()):
        unit, units = bare_and_unit(raw)[1], guess.mapping.get("units", {})
        is_known = unit in (None, "s") or "time_s" in units
        return guess if is_known else replace(guess, mapping={**guess.mapping, "units": {**units, "time_s": unit}})
    time_format = time_format_of(cells)
    if time_format is None:
        del columns["time_s"]
        rest = {key: value for key, value in guess.mapping.items() if key != "columns"}
        return replace(guess, mapping={**rest, **({"columns": columns} if columns else {})})
    doubts = (*guess.doubts, time_format.doubt) if time_format.doubt else guess.doubts
    return replace(guess, mapping={**guess.mapping, "time_format": time_format.form}, doubts=doubts)


def _with_parts_of_points(guess: Guess, records: list[list[str]]) -> Guess:
    """Return a proposal for points whose names, in the first column, may have parts that name the body."""
    if guess.mapping.get("format") != "vstars" or not (keys := parts_of_names([r[0] for r in records], "id", ())):
        return guess
    return replace(guess, mapping={key: value for key, value in guess.mapping.items() if key != "constants"} | keys)


def _with_unit_in_words(guess: Guess, unit: str | None) -> Guess:
    """Return a proposal with the unit that words of the file state, if no name states one."""
    guess = (
        replace(guess, beside=tuple(_with_unit_in_words(one, unit) for one in guess.beside)) if guess.beside else guess
    )
    if unit is None or guess.table not in _OF_COORDINATES or "unit" in guess.mapping:
        return guess
    raw = [name for name in guess.mapping.get("columns", {}).values() if isinstance(name, str)]
    if any(bare_and_unit(name)[1] is not None for name in raw) or not may_be(unit, find_column("x_mm")):
        return guess
    note = f"the file's words give the unit of coordinates: {unit}"
    answered = guess.answered | {"unit"}
    return replace(guess, mapping={**guess.mapping, "unit": unit}, notes=(*guess.notes, note), answered=answered)


def with_unit_of_rows(guess: Guess, names: Sequence[str], data: list[list[str]]) -> Guess:
    """Return a proposal for coordinates with the unit that a column names in every row alike."""
    places = [place for place, name in enumerate(names) if re.fullmatch(_OF_UNITS, name.strip(), re.IGNORECASE)]
    stated = {row[place].strip() for place in places for row in data}
    unit = known_unit(stated.pop()) if len(places) == 1 and len(stated) == 1 else None
    return _with_unit_in_words(guess, unit)


def _without_names(
    names: tuple[str, ...],
    data: list[list[str]],
    values: Array,
    mapping: dict[str, Any],
    notation: Notation,
    about: _Surroundings,
) -> Guess:
    """Return a proposal for rows of cells (N, W) and their numbers, without names of columns."""
    joints = about.joints_of(values.shape[1])
    if (poses := bare_poses(values)) is not None:
        return _poses(poses, names, mapping, data, values, joints)
    if is_one_motion(values):
        return Guess(mapping, names, None, (_ONE_MOTION,), known=True)
    if values.shape[1] == len(joints) and np.isfinite(values).all():
        return _guess_joints(bare_joints(values, joints), mapping, names)
    if joints and (rows := bare_chain_rows(values, joints)) is not None:
        return _chain(rows, mapping, names)
    found, notes = _positions(data, notation)
    table = table_of({*names, *found.get("columns", {})})
    raw = found.get("columns", {}).get("target")
    if raw is not None and (parts := parts_of_names([row[raw - 1] for row in data], str(raw), ())):
        found, table = found | parts, "points"
    return Guess(mapping | found, names, table, tuple(notes))


def _guess_by_names(
    names: tuple[str, ...], data: list[list[str]], values: Array, mapping: dict[str, Any], joints: Sequence[str]
) -> Guess:
    """Return a proposal for rows of cells (N, W) and their numbers, by the names of the columns."""
    if (markers := _guess_markers(names, mapping)) is not None:
        return markers
    if (several := _guess_bodies(names, mapping, values)) is not None:
        return several
    if (poses := pose_columns(names, values)) is not None:
        return _poses(poses, names, mapping, data, values, joints)
    if is_polar(names):
        return Guess(mapping, names, None, (_POLAR,), known=True)
    found, notes = columns_by_names(names)
    numbered = {**_counted(names, names, values), **found.get("columns", {})}
    if (rows := chain_rows(names, data, values, numbered, joints)) is not None:
        return _chain(rows, mapping, names)
    table = table_of({*names, *found.get("columns", {})})
    if table in _OF_COORDINATES:
        found, notes = columns_by_names(names, _OF_EACH_POSE)
    doubts: tuple[str, ...] = ()
    if table in ("points", "targets") and _repeats_targets(names, data, found):
        table = "points"  # a survey has every target once
        if (pose := _pose_column(names, data, found)) is not None:
            found = {**found, "columns": {"pose": pose, **found.get("columns", {})}}
            doubts = (f"column {pose} is assumed to tell the poses: in each of its values every target stands once",)
    if table == "quadrature" and "phase_deg" in found.get("columns", {}):
        steps = {"constants": {"run": "1", "channel": "dz", "load_axis": "fz", "load": 0}, "number_rows": {"step": 1}}
        notes = [*notes, "phases of one channel, a step per row"]
        return Guess(mapping | found | steps, names, table, tuple(notes))
    if table not in (None, "configurations", "signals"):
        keys = _with_parts_of_names(names, data, found)
        if table == "targets" and any("(?P<pose>" in pattern for pattern in keys.get("split", {}).values()):
            table = "points"  # a survey has no poses
        return Guess(mapping | keys, names, table, tuple(notes), doubts=doubts)
    loads = load_columns(names) if table != "signals" else None
    meant = found.get("columns", {})
    proposals = readings_under_load(names), positions_of_axis(names, data, values), positions_side_by_side(names)
    for proposal in proposals:
        if proposal is not None and table is None:
            empty = {"missing": [""]} if any(not cell.strip() for row in data for cell in row) else {}
            return Guess(
                mapping | proposal.mapping | empty, names, proposal.table, (proposal.note,), doubts=proposal.doubts
            )
    if loads is None and table != "signals":
        if (read := configurations_of_joints(names, data, values, meant, joints)) is not None:
            guess = _guess_joints(read, mapping, names)
            return replace(guess, doubts=(*guess.doubts, *_not_measured(names)))
        if table is None and (found_axes := axis_rows(names, values)):
            return _guess_axis(found_axes, names, mapping, meant)
    if loads is not None:
        return _with_samples(proposal_of_loads(loads, names, mapping, found), names, values)
    if table != "signals" and (template := wide_template(names)) is not None:
        hidden = (
            {"missing": [""]} if any(not cell.strip() for row in data for cell in row) or _has_frames(names) else {}
        )
        return _side_by_side(template, names, mapping | found | hidden)
    if table == "configurations" and "pose" not in {*names, *found.get("columns", {})}:
        found = {**found, **({"columns": columns} if (columns := {**_counted(names, names, values), **meant}) else {})}
        found |= {} if "pose" in found.get("columns", {}) else {"number_rows": {"pose": 1}}
    if table is None:
        notes = [_A_COORDINATE_PER_ROW] if _has_axes_in_rows(data) else []
        notes += [_CHANNELS_ALONE] if channels_without_loads(names) else []
        return Guess(mapping | found, names, None, tuple(notes))
    return Guess(mapping | found, names, table, tuple(notes))


def _has_frames(names: Sequence[str]) -> bool:
    """True if rows are frames of motion capture, in any of which a marker may be hidden."""
    return names[0].strip().casefold() == "frame"


def _guess_markers(names: tuple[str, ...], mapping: dict[str, Any]) -> Guess | None:
    """Return a proposal for markers of motion capture beside poses of rigid bodies; None without markers."""
    markers = [match["name"] for name in names if (match := _MARKER.fullmatch(name))]
    if len(markers) < _SEVERAL * _AXES or not any(name.startswith("Rigid Body.") for name in names):
        return None
    has_body = all(":" in name for name in markers)
    wide = f"Marker.{'{body}:' if has_body else ''}{{target}}.{{id}}.Position.{{axis}}"
    keys: dict[str, Any] = {"wide": wide, "missing": [""], **({} if has_body else {"constants": {"body": "body"}})}
    keys |= {"columns": {"pose": names[0]}} if _has_frames(names) else {"number_rows": {"pose": 1}}
    note = "markers of motion capture; poses of rigid bodies in the same file are not read, because markers give them"
    return Guess({**mapping, **keys}, names, "points", (note,))


def is_polar(names: Sequence[str]) -> bool:
    """True if columns are a horizontal and a vertical angle and a distance, and none are coordinates."""
    bare = [bare_and_unit(name)[0] for name in names]
    kinds = (_HORIZONTAL, _VERTICAL, _DISTANCE)
    return all(any(kind.fullmatch(name) for name in bare) for kind in kinds) and not {"x", "y", "z"} <= {
        name.casefold() for name in bare
    }


def _has_axes_in_rows(data: list[list[str]]) -> bool:
    """True if a column names the axis of each row, as an inspection program lists its checks."""
    return any({"x", "y", "z"} == {cell.strip().casefold() for cell in column} for column in zip(*data, strict=True))


def _guess_axis(
    axes: Sequence[Proposal], names: tuple[str, ...], mapping: dict[str, Any], meant: Mapping[str, str]
) -> Guess:
    """Return the proposal of an axis; of two, in degrees and in millimetres, the first is taken."""
    more = {key: raw for key, raw in meant.items() if key in ("pose", "role", "time_s", "temperature_c")}
    numbered = {} if "pose" in more or "pose" in names else {"number_rows": {"pose": 1}}
    guesses = [
        Guess(
            {**mapping, **axis.mapping, "columns": {**more, **axis.mapping["columns"]}, **numbered},
            *(names, axis.table, (axis.note,)),
            doubts=axis.doubts,
        )
        for axis in axes
    ]
    if len(guesses) == 1:
        return guesses[0]
    taken, other = ("mm", "deg") if "command_mm" in guesses[0].mapping["columns"] else ("deg", "mm")
    text, doubt = "Unit of the axis, which no name gives", f"no unit is given; the axis is assumed to be in {taken}"
    return replace(guesses[0], ways=(OtherWay("axis", text, taken, other, guesses[1], doubt),))


def _guess_joints(read: JointReadings, mapping: dict[str, Any], names: tuple[str, ...], **more: Any) -> Guess:
    return Guess({**mapping, **read.mapping, **more}, names, "configurations", (read.note,), doubts=read.doubts)


def _not_measured(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the doubt on coordinates beside joint readings that are probably no measurement."""
    if not (found := controller_columns(names)):
        return ()
    text = f"{', '.join(found)} are assumed to be computed by the controller from its joints, and are not read"
    return (f"{text} (measured by an instrument: rename them x, y, z)",)


def _chain(rows: ChainRows, mapping: dict[str, Any], names: tuple[str, ...]) -> Guess:
    """Return the proposal for rows of joint readings beside points: points, and configurations of the same rows."""
    beside = (_guess_joints(rows.joints, mapping, names),)
    guess = Guess({**mapping, **rows.points}, names, "points", (rows.note,), beside=beside, doubts=rows.doubts)
    return perhaps_in_metres(guess, rows.in_metres)


def perhaps_in_metres(guess: Guess, in_metres: bool) -> Guess:
    """Return a proposal whose coordinates without a unit are taken for m where that is more probable than mm."""
    if not in_metres:
        return guess
    text = "Unit of the coordinates, which the file does not give; it scales all lengths"
    doubt = "no unit is given; coordinates below 10 beside joints of a robot are assumed to be in m"
    taken = replace(guess, mapping={**guess.mapping, "unit": "m"})
    return replace(taken, ways=(OtherWay("unit", text, "m", "mm", guess, doubt),))


def _repeats_targets(names: tuple[str, ...], data: list[list[str]], keys: Mapping[str, Any]) -> bool:
    columns = keys.get("columns", {})
    places = [names.index(columns.get(name, name)) for name in ("body", "target") if columns.get(name, name) in names]
    rows = [tuple(row[place] for place in places) for row in data]
    return len(set(rows)) < len(rows)


def _pose_column(names: tuple[str, ...], data: list[list[str]], keys: Mapping[str, Any]) -> str | None:
    """Return the free column whose every value has each target at most once, as a pose has; None without a single one.

    A column with another value in nearly every row, such as a time, tells no poses.
    """
    columns = keys.get("columns", {})
    if "pose" in names or "pose" in columns or "target" not in {*names, *columns}:
        return None
    places = [names.index(columns.get(name, name)) for name in ("body", "target") if columns.get(name, name) in names]
    free = [
        place
        for place, name in enumerate(names)
        if name and name not in {*columns, *columns.values(), "body", "target"}
    ]
    found = []
    for place in free:
        values = [row[place].strip() for row in data]
        rows = {(value, *(row[k] for k in places)) for value, row in zip(values, data, strict=True)}
        if len(rows) == len(data) and all(values) and _SEVERAL <= len(set(values)) <= len(data) / _AXES:
            found.append(names[place])
    return found[0] if len(found) == 1 else None


def _with_parts_of_names(names: tuple[str, ...], data: list[list[str]], keys: dict[str, Any]) -> dict[str, Any]:
    """Add keys that take names such as ``Pose01::base::P1`` apart, if all targets have as many parts."""
    raw = keys.get("columns", {}).get("target")
    if raw is None:
        return keys
    return keys | parts_of_names([row[names.index(raw)] for row in data], raw, {*names, *keys["columns"]})


def _guess_bodies(names: tuple[str, ...], mapping: dict[str, Any], values: Array) -> Guess | None:
    """Return a proposal for the poses of several bodies side by side, an entry for each; None without them."""
    bodies = poses_side_by_side(names, values)
    if len(bodies) < _SEVERAL:
        return None
    names_used = {name for poses in bodies for name in poses.taken}
    left = tuple(name for name in names if name not in names_used)
    meant = columns_by_names(left)[0].get("columns", {})
    number = {"pose": meant["pose"]} if "pose" in meant else _counted(left, names, values)
    more = {} if number or "pose" in names else {"number_rows": {"pose": 1}}
    found = [
        Guess({**mapping, **p.mapping, "columns": {**number, **p.mapping["columns"]}, **more}, names, "poses", p.notes)
        for p in bodies
    ]
    found = [replace(guess, answered=frozenset({"body"})) for guess in found]  # by the names of the columns
    return replace(found[0], beside=tuple(found[1:]))


def _poses(
    poses: PoseMapping,
    names: tuple[str, ...],
    mapping: dict[str, Any],
    records: list[list[str]],
    values: Array,
    joints: Sequence[str],
) -> Guess:
    """Return a proposal for poses, and for the configurations that other columns of the same rows form."""
    keys = dict(poses.mapping)
    others = tuple(name for name in names if poses.taken and name not in poses.taken)
    meant = columns_by_names(others)[0].get("columns", {})
    reported = {key: raw for key, raw in meant.items() if key in ("pose", "time_s", "temperature_c")}
    number = {"pose": reported["pose"]} if "pose" in reported else _counted(others, names, values)
    if number or "pose" in names:
        keys["columns"] = {**number, **keys["columns"]}
    elif poses.taken:
        keys["number_rows"] = {"pose": 1}
    bodies = _body_column(others, names, records)
    if bodies is not None:
        keys["columns"] = {"body": bodies[0], **keys["columns"]}
        keys.pop("constants", None)
    input_names = [
        name for name in others if name not in number.values() and np.isfinite(values[:, names.index(name)]).any()
    ]
    if not input_names:
        return Guess({**mapping, **keys}, names, "poses", poses.notes)
    own_rows = [record for record in records if bodies is None or record[names.index(bodies[0])].strip() == bodies[1]]
    time = [record[names.index(reported["time_s"])] for record in own_rows] if "time_s" in reported else []
    lost = [reported.pop("time_s")] if len(set(time)) < len(time) else []  # repeated times define no order
    numbered = {key: keys[key] for key in ("number_rows",) if key in keys}
    ignore = "|".join(re.escape(name).replace("\\ ", " ") for name in (*poses.taken, *lost))
    one_body = {"select": {bodies[0]: re.escape(bodies[1])}} if bodies is not None else {}  # a row for each pose
    entry = {**mapping, **({"columns": reported} if reported else {}), **numbered, **one_body, "ignore": ignore}
    if (
        read := configurations_of_joints(
            others, *_guess_columns(names, others, records, values), {**meant, **number}, joints
        )
    ) is not None:
        skipped = "|".join(filter(None, [ignore, read.mapping.get("ignore")]))
        beside = _guess_joints(read, mapping, names, ignore=skipped)
        keys |= {"constants": {"body": LINK}} if "constants" in keys else {}
        guess = Guess({**mapping, **keys}, names, "poses", poses.notes, beside=(beside,))
        shifts = COORDINATES if COORDINATES[0] in keys["columns"] else SHIFTS
        place = [names.index(keys["columns"][column]) for column in shifts]
        is_in_rad = any(column.endswith("_rad") for column in read.mapping["columns"])
        is_bare = "unit" not in keys and bare_and_unit(keys["columns"][shifts[0]])[1] is None
        return perhaps_in_metres(guess, is_bare and is_in_rad and is_within_metres(values[:, place]))
    text = f"what else there is, pose by pose: {', '.join(input_names[:8])}{', ...' if len(input_names) > 8 else ''}"
    return Guess(
        {**mapping, **keys}, names, "poses", poses.notes, beside=(Guess(entry, names, "configurations", (text,)),)
    )


def _body_column(others: Sequence[str], names: Sequence[str], records: list[list[str]]) -> tuple[str, str] | None:
    """Return the column that names the body of each row, and its first body; None if it names fewer than two."""
    for name in others:
        cells = [record[names.index(name)].strip() for record in records]
        if re.fullmatch(_OF_BODIES, bare_and_unit(name)[0], re.IGNORECASE) and _SEVERAL <= len(set(cells)) < len(cells):
            return name, cells[0]
    return None


def _counted(others: Sequence[str], names: Sequence[str], values: Array) -> dict[str, str]:
    """Return the column that numbers the rows from its own start, by its name and its numbers."""
    for name in others:
        column = values[:, names.index(name)]
        if re.fullmatch(r"no|nr|number|index|#|id|i", name.strip(" .").casefold()) and np.array_equal(
            np.diff(column), np.ones(len(column) - 1)
        ):
            return {"pose": name}
    return {}


def _guess_columns(
    names: Sequence[str], some: Sequence[str], records: list[list[str]], values: Array
) -> tuple[list[list[str]], Array]:
    """Return the cells and numbers of some columns."""
    places = [names.index(name) for name in some]
    return [[record[place] for place in places] for record in records], values[:, places]


def proposal_of_loads(
    loads: LoadMapping, names: tuple[str, ...], mapping: dict[str, Any], meant: dict[str, Any]
) -> Guess:
    """Return a proposal for a table of loads, ordered by a column that seems to be time, if any."""
    time = {key: name for key, name in meant.get("columns", {}).items() if key == "time_s"}
    keys = {**loads.mapping, "columns": {**time, **loads.mapping["columns"]}}
    guess = Guess({**mapping, **keys}, names, loads.table, (loads.note,), doubts=loads.doubts)
    if loads.otherwise is None:
        return guess
    taken, value = ("shown", "applied") if loads.is_shown else ("applied", "shown")
    text = "Forces and torques of these columns: loads applied to the sensor, or shown by the sensor"
    doubt = (
        f"forces and torques are assumed to be {'shown by the sensor itself' if loads.is_shown else 'applied loads'}"
    )
    other = proposal_of_loads(loads.otherwise, names, mapping, meant)
    return replace(guess, ways=(OtherWay("loads", text, taken, value, other, doubt),))


def _with_samples(guess: Guess, names: tuple[str, ...], values: Array) -> Guess:
    """Return a proposal, with the doubt whether rows of signals are samples of one load rather than load steps."""
    columns = [guess.mapping["columns"].get(load, load) for load in WRENCH]
    loads = values[:, [names.index(name) for name in columns if name in names]]
    steps = 1 + int(np.any(np.diff(loads, axis=0) != 0.0, axis=1).sum())
    if guess.table != "signals" or not loads.shape[1] or len(loads) < _SAMPLES * steps:
        return guess
    doubt = (
        "many rows have the load of the row before: if they are samples, [signals] average_samples = true takes means"
    )
    return replace(guess, doubts=(*guess.doubts, doubt))


def _side_by_side(template: tuple[str, str | None], names: tuple[str, ...], mapping: dict[str, Any]) -> Guess:
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


def _notation(records: list[list[str]]) -> Notation:
    """Return the notation that reads most cells; the simplest among equals."""
    cells = [cell for record in records for cell in record]
    return max(_NOTATIONS, key=lambda notation: sum(_is_number(cell, notation) for cell in cells))


def _is_number(cell: str, notation: Notation) -> bool:
    return re.match(notation.pattern, cell.strip()) is not None


def _positions(records: list[list[str]], notation: Notation) -> tuple[dict[str, Any], list[str]]:
    """Return the coordinates of a file without header: the first three columns of numbers, after a name if any."""
    width = len(records[0])
    numbers = [all(_is_number(record[i], notation) for record in records) for i in range(width)]
    if numbers[0] and width > _AXES and (is_id(records) or _counts(records)):
        numbers[0] = False  # numbers of targets, or of rows
    first = next((i for i in range(len(numbers) - 2) if all(numbers[i : i + 3])), None)
    if first is None:
        return {}, ["three columns of numbers side by side were not found"]
    if sum(numbers) > _AXES:
        text = f"{sum(numbers)} columns of numbers without names: not taken for coordinates"
        return {}, [f"{text}; columns = {{ x_mm = {first + 1}, ... }} where they are"]
    columns: dict[str, Any] = {name: first + 1 + i for i, name in enumerate(COORDINATES)}
    if first > 0:
        columns = {"target": first, **columns}
    shown = [[record[i] for i in range(first, first + 3)] for record in records]
    place = notation.matrix(shown)
    low, high = float(place.min()), float(place.max())
    return {"columns": columns}, [f"columns {first + 1} to {first + 3} are taken for x, y, z ({low:.4g} to {high:.4g})"]


def _counts(records: list[list[str]]) -> bool:
    """True if the first column counts: 1, 2, 3, ... or other successive integers."""
    first = [record[0].strip() for record in records]
    return all(cell.isdigit() for cell in first) and all(
        int(after) == int(before) + 1 for before, after in itertools.pairwise(first)
    )


def table_of(names: set[str]) -> str | None:
    """Table whose characteristic columns are all among these names."""
    return next((table for table, wanted in _SIGNS if wanted <= names), None)
