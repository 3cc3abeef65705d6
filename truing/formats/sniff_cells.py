"""Proposals for a table of cells: meaning, units and notation of its columns."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from truing.formats.axis_directions import with_direction
from truing.formats.deviation_units import with_unit_of_deviations
from truing.formats.grad_units import with_unit_of_grad
from truing.formats.guess import Guess, MappingKeys, OtherWay, adjusted_points, is_id, parts_of_names, tracker
from truing.formats.heading import heading_of
from truing.formats.likely_notation import COMMA_DECIMAL, COMMA_THOUSANDS, ambiguous_comma, is_number, likely_notation
from truing.formats.named_chain import bare_chain_rows, chain_rows
from truing.formats.named_columns import bare_poses, is_one_motion, pose_columns
from truing.formats.named_joints import bare_joints
from truing.formats.named_loads import with_unit_of_channels
from truing.formats.named_pixels import rays_of
from truing.formats.nominal_machine import machine_of
from truing.formats.numbers import Notation
from truing.formats.probable_columns import columns_by_names
from truing.formats.proposed_angles import with_angles
from truing.formats.proposed_poses import (
    NamedCells,
    column_that_counts,
    proposal_of_bodies,
    proposal_of_chain,
    proposal_of_joints,
    proposal_of_poses,
)
from truing.formats.raw_tables import COORDINATES
from truing.formats.sniff_readings import guess_readings, has_frames
from truing.formats.times import time_format_of
from truing.formats.units import LONGEST_NAME, bare_and_unit, known_unit, may_be
from truing.schemas.columns import find_column

_ONE_MOTION = "a single rigid motion (4x4) between two frames, no measurement; it is not read"
_MARKER = re.compile(r"Marker\.(?P<name>.+)\.[^.]*\.Position\.[XYZ](?: \[.*\])?")
_POLAR = (
    "directions and distances of a total station, theodolite or laser tracker; export the adjusted coordinates X, Y, Z"
)
_HORIZONTAL = re.compile(
    r"hz|ha|h(orizontal)?[ _]?(angle|dir(ection)?|winkel|richtung)|az(imuth)?|bearing|richtung", re.I
)
_VERTICAL = re.compile(r"v|va|v(ertical)?[ _]?(angle|winkel)|zen(ith)?([ _]?angle)?|zenitwinkel|el(ev(ation)?)?", re.I)
_DISTANCE = re.compile(r"sd|d|s(lope|lant)?[ _]?dist(ance)?|(schr(ä|ae)g)?(strecke|distanz)|r(ange)?|distance", re.I)
_OF_COORDINATES = ("points", "targets", "poses", "scans", "surfaces")
_OF_UNITS = r"units?|einheit|unité"
_OF_EACH_POSE = ("time_s", "temperature_c")  # columns that tables of coordinates do not have
_AXES = 3
_SEVERAL = 2
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
    mapping: MappingKeys,
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
    return with_angles(records, lambda decimal: _sniff_decimal(decimal, dict(mapping), separator, about))


def _sniff_decimal(records: list[list[str]], mapping: MappingKeys, separator: str, about: _Surroundings) -> Guess:
    notation = likely_notation(records[1:] or records)
    guess = _guess_by_notation(records, dict(mapping), separator, notation, about)
    if notation != COMMA_DECIMAL or (cell := ambiguous_comma(records)) is None:
        return guess
    text = f"Decimal mark of numbers such as {cell}; with . the comma separates thousands"
    guess_with_thousands = _guess_by_notation(records, dict(mapping), separator, COMMA_THOUSANDS, about)
    doubt = f"the comma of numbers such as {cell} is assumed to be the decimal mark"
    return replace(guess, ways=(*guess.ways, OtherWay("decimal", text, ",", ".", guess_with_thousands, doubt)))


@dataclass(frozen=True)
class _Surroundings:
    """Lines before each record, cells of comments, unit of lengths by words of the file, and a robot's joints."""

    first_lines: tuple[int, ...]
    comments: tuple[Sequence[str], ...]
    unit: str | None
    joints: tuple[str, ...]
    is_of_joints: bool

    def joints_of(self, columns: int) -> tuple[str, ...]:
        """Return the names of the joints in this many columns without names; numbers if only the file's name says that
        it holds joint readings."""
        numbered = tuple(f"joint{number}" for number in range(1, columns + 1)) if self.is_of_joints else ()
        return self.joints or numbered


def _guess_by_notation(
    records: list[list[str]], mapping: MappingKeys, separator: str, notation: Notation, about: _Surroundings
) -> Guess:
    """Return a proposal for records whose numbers are written in a notation."""
    if any(len(name) > LONGEST_NAME for name in records[0]):
        return Guess(mapping, notes=(f"a name of more than {LONGEST_NAME} characters names no column",))
    heading = heading_of(records, lambda cell: is_number(cell, notation), about.comments)
    names, data = heading.names, records[heading.rows :]
    has_header = heading.is_row or heading.names[0] != "1"
    known = tracker(names, notation.thousands) if has_header else None
    known = known or (None if has_header else adjusted_points(records, lambda cell: is_number(cell, notation)))
    if known is not None:
        return _with_parts_of_points(replace(known, mapping={**mapping, **known.mapping}), records)
    mapping |= {"separator": separator} if separator != "," else {}
    mapping |= {"header": False} if not heading.is_row else {}
    if has_header and not heading.is_row:
        mapping |= {"names": list(names)} | ({"skip_lines": about.first_lines[heading.rows]} if heading.rows else {})
    mapping |= {"decimal": notation.decimal} if notation.decimal != "." else {}
    mapping |= {"thousands": notation.thousands} if notation.thousands else {}
    cells = NamedCells(names, data, notation.matrix(data))
    if not has_header:
        return _with_unit_in_words(_without_names(cells, mapping, notation, about), about.unit)
    words = " ".join(cell for line in about.comments for cell in line)
    if (machine := machine_of(cells, words, about.unit)) is not None:
        return machine
    if (rays := rays_of(cells, mapping)) is not None:
        return rays
    guess = _with_times(_guess_by_names(cells.without_empty_columns(), mapping, about.joints), names, data, notation)
    guess = with_unit_of_deviations(guess, names, cells.values, about.unit)
    guess = with_direction(guess, names, data, cells.values)
    guess = with_unit_of_channels(guess, about.unit)
    guess = with_unit_of_grad(guess, names, cells.values)
    return _with_unit_in_words(_with_unit_of_rows(guess, names, data), about.unit)


def _with_times(guess: Guess, names: tuple[str, ...], data: list[list[str]], notation: Notation) -> Guess:
    """Return a proposal that reads its column of times, in seconds or by a format; without it where none reads it."""
    other_tables = tuple(_with_times(following, names, data, notation) for following in guess.other_tables)
    ways = tuple(replace(way, guess=_with_times(way.guess, names, data, notation)) for way in guess.ways)
    guess = replace(guess, other_tables=other_tables, ways=ways)
    columns = dict(guess.mapping.get("columns", {}))
    raw = columns.get("time_s")
    if raw not in names or "time_format" in guess.mapping:
        return guess
    cells = [row[names.index(raw)] for row in data]
    if all(is_number(cell, notation) for cell in cells if cell.strip()):
        unit, units = bare_and_unit(raw)[1], guess.mapping.get("units", {})
        is_known = unit in (None, "s") or "time_s" in units
        return guess if is_known else replace(guess, mapping={**guess.mapping, "units": {**units, "time_s": unit}})
    time_format = time_format_of(cells)
    if time_format is None:
        del columns["time_s"]
        other_keys = {key: value for key, value in guess.mapping.items() if key != "columns"}
        return replace(guess, mapping={**other_keys, **({"columns": columns} if columns else {})})
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
        replace(guess, other_tables=tuple(_with_unit_in_words(one, unit) for one in guess.other_tables))
        if guess.other_tables
        else guess
    )
    if unit is None or guess.table not in _OF_COORDINATES or "unit" in guess.mapping:
        return guess
    raw = [name for name in guess.mapping.get("columns", {}).values() if isinstance(name, str)]
    if any(bare_and_unit(name)[1] is not None for name in raw) or not may_be(unit, find_column("x_mm")):
        return guess
    note = f"the file's words give the unit of coordinates: {unit}"
    answered = guess.answered | {"unit"}
    return replace(guess, mapping={**guess.mapping, "unit": unit}, notes=(*guess.notes, note), answered=answered)


def _with_unit_of_rows(guess: Guess, names: Sequence[str], data: list[list[str]]) -> Guess:
    """Return a proposal for coordinates with the unit that a column names in every row alike."""
    places = [place for place, name in enumerate(names) if re.fullmatch(_OF_UNITS, name.strip(), re.IGNORECASE)]
    stated = {row[place].strip() for place in places for row in data}
    unit = known_unit(stated.pop()) if len(places) == 1 and len(stated) == 1 else None
    return _with_unit_in_words(guess, unit)


def _without_names(cells: NamedCells, mapping: MappingKeys, notation: Notation, about: _Surroundings) -> Guess:
    """Return a proposal for a table of cells whose columns have no names."""
    names, data, values = cells.names, cells.rows, cells.values
    joints = about.joints_of(values.shape[1])
    if (poses := bare_poses(values)) is not None:
        return proposal_of_poses(poses, cells, mapping, joints)
    if is_one_motion(values):
        return Guess(mapping, names, None, (_ONE_MOTION,), known=True)
    if values.shape[1] == len(joints) and np.isfinite(values).all():
        return proposal_of_joints(bare_joints(values, joints), mapping, names)
    if joints and (rows := bare_chain_rows(values, joints)) is not None:
        return proposal_of_chain(rows, mapping, names)
    found, notes = _positions(data, notation)
    table = table_of({*names, *found.get("columns", {})})
    raw = found.get("columns", {}).get("target")
    if raw is not None and (parts := parts_of_names([row[raw - 1] for row in data], str(raw), ())):
        found, table = found | parts, "points"
    return Guess(mapping | found, names, table, tuple(notes))


def _guess_by_names(cells: NamedCells, mapping: MappingKeys, joints: Sequence[str]) -> Guess:
    """Return a proposal for a table of cells by the names of its columns."""
    names = cells.names
    if (markers := _guess_markers(names, mapping)) is not None:
        return markers
    if (several := proposal_of_bodies(cells, mapping)) is not None:
        return several
    if (poses := pose_columns(names, cells.values)) is not None:
        return proposal_of_poses(poses, cells, mapping, joints)
    if is_polar(names):
        return Guess(mapping, names, None, (_POLAR,), known=True)
    keys, notes = columns_by_names(names)
    numbered = {**column_that_counts(cells, names), **keys.get("columns", {})}
    if (rows := chain_rows(names, cells.rows, cells.values, numbered, joints)) is not None:
        return proposal_of_chain(rows, mapping, names)
    table = table_of({*names, *keys.get("columns", {})})
    if table in _OF_COORDINATES:
        keys, notes = columns_by_names(names, _OF_EACH_POSE)
    if table == "quadrature" and "phase_deg" in keys.get("columns", {}):
        steps = {"constants": {"run": "1", "channel": "dz", "load_axis": "fz", "load": 0}, "number_rows": {"step": 1}}
        notes = [*notes, "phases of one channel, a step per row"]
        return Guess(mapping | keys | steps, names, table, tuple(notes))
    if table not in (None, "configurations", "signals"):
        return _guess_table(cells, mapping, table, (keys, notes))
    return guess_readings(cells, mapping, table, (keys, notes), joints)


def _guess_table(cells: NamedCells, mapping: MappingKeys, table: str, by_names: tuple[MappingKeys, list]) -> Guess:
    """Return a proposal for a table whose characteristic columns are named; by_names: keys of columns, and notes."""
    (keys, notes), names = by_names, cells.names
    doubts: tuple[str, ...] = ()
    if table in ("points", "targets") and _repeats_targets(cells, keys):
        table = "points"  # a survey has every target once
        if (pose := _pose_column(cells, keys)) is not None:
            keys = {**keys, "columns": {"pose": pose, **keys.get("columns", {})}}
            doubts = (f"column {pose} is assumed to number the poses: each of its values has every target once",)
    keys = _with_parts_of_names(cells, keys)
    if table == "targets" and any("(?P<pose>" in pattern for pattern in keys.get("split", {}).values()):
        table = "points"  # a survey has no poses
    return Guess(mapping | keys, names, table, tuple(notes), doubts=doubts)


def _guess_markers(names: tuple[str, ...], mapping: MappingKeys) -> Guess | None:
    """Return a proposal for markers of motion capture next to poses of rigid bodies; None without markers."""
    markers = [match["name"] for name in names if (match := _MARKER.fullmatch(name))]
    if len(markers) < _SEVERAL * _AXES or not any(name.startswith("Rigid Body.") for name in names):
        return None
    has_body = all(":" in name for name in markers)
    wide = f"Marker.{'{body}:' if has_body else ''}{{target}}.{{id}}.Position.{{axis}}"
    keys: MappingKeys = {"wide": wide, "missing": [""], **({} if has_body else {"constants": {"body": "body"}})}
    keys |= {"columns": {"pose": names[0]}} if has_frames(names) else {"number_rows": {"pose": 1}}
    note = "markers of motion capture; poses of rigid bodies in the same file are not read, because markers give them"
    return Guess({**mapping, **keys}, names, "points", (note,))


def is_polar(names: Sequence[str]) -> bool:
    """True if columns are a horizontal and a vertical angle and a distance, and none are coordinates."""
    bare = [bare_and_unit(name)[0] for name in names]
    kinds = (_HORIZONTAL, _VERTICAL, _DISTANCE)
    return all(any(kind.fullmatch(name) for name in bare) for kind in kinds) and not {"x", "y", "z"} <= {
        name.casefold() for name in bare
    }


def _repeats_targets(cells: NamedCells, keys: MappingKeys) -> bool:
    """True if a name of a target occurs twice."""
    columns = keys.get("columns", {})
    name_columns = [raw for name in ("body", "target") if (raw := columns.get(name, name)) in cells.names]
    targets = [tuple(row) for row in cells.of(name_columns)[0]]
    return len(set(targets)) < len(targets)


def _pose_column(cells: NamedCells, keys: MappingKeys) -> str | None:
    """Return the free column whose every value has each target at most once, as a pose has; None without a single one.

    A column with another value in nearly every row, such as a time, does not identify poses.
    """
    names, columns = cells.names, keys.get("columns", {})
    if "pose" in names or "pose" in columns or "target" not in {*names, *columns}:
        return None
    name_columns = [raw for name in ("body", "target") if (raw := columns.get(name, name)) in names]
    targets, count = cells.of(name_columns)[0], len(cells.rows)
    candidates = []
    for name in dict.fromkeys(names):
        if not name or name in {*columns, *columns.values(), "body", "target"}:
            continue
        values = [text.strip() for text in cells.texts(name)]
        rows = {(value, *target) for value, target in zip(values, targets, strict=True)}
        if len(rows) == count and all(values) and _SEVERAL <= len(set(values)) <= count / _AXES:
            candidates.append(name)
    return candidates[0] if len(candidates) == 1 else None


def _with_parts_of_names(cells: NamedCells, keys: MappingKeys) -> MappingKeys:
    """Add keys that take names such as ``Pose01::base::P1`` apart, if all targets have as many parts."""
    raw = keys.get("columns", {}).get("target")
    if raw is None:
        return keys
    return keys | parts_of_names(cells.texts(raw), raw, {*cells.names, *keys["columns"]})


def _positions(records: list[list[str]], notation: Notation) -> tuple[MappingKeys, list[str]]:
    """Return the coordinates of a file without header: the first three columns of numbers, after a name if any."""
    width = len(records[0])
    numbers = [all(is_number(record[i], notation) for record in records) for i in range(width)]
    named = [record[1:] for record in records] if width > _AXES + 1 and not numbers[0] else records
    if width > _AXES and (is_id(named) or _counts(named)):
        numbers[width - len(named[0])] = False  # numbers of targets, or of rows, perhaps behind a word
    first = next((i for i in range(len(numbers) - 2) if all(numbers[i : i + 3])), None)
    if first is None:
        return {}, ["three columns of numbers side by side were not found"]
    if sum(numbers) > _AXES:
        text = f"{sum(numbers)} columns of numbers without names: not taken for coordinates"
        return {}, [f"{text}; columns = {{ x_mm = {first + 1}, ... }} where they are"]
    columns: MappingKeys = {name: first + 1 + i for i, name in enumerate(COORDINATES)}
    named_columns = [i for i in range(first) if all(record[i].strip() for record in records)]
    if named_columns:  # the nearest one with a name in every row: a column of names may be empty next to numbers
        columns = {"target": named_columns[-1] + 1, **columns}
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
