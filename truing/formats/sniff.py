"""Proposals for reading a raw file from its content: a draft of the mapping that a person completes."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from truing.arrays import Array
from truing.formats.compression import DAMAGED, open_plain
from truing.formats.delimited import guess_separator, split_record
from truing.formats.guess import (
    OF_RIGS,
    Guess,
    adjusted_points,
    by_format,
    coded_alone,
    guess_by_first_lines,
    is_id,
    is_rig_file,
    metashape,
    tracker,
    wide_template,
)
from truing.formats.named_columns import Loads, PoseMapping, bare_poses, is_one_motion, load_columns, pose_columns
from truing.formats.numbers import Notation
from truing.formats.presets import format_of
from truing.formats.raw import Unusable
from truing.formats.shapes import COORDINATES
from truing.formats.source import RawFile
from truing.formats.units import bare_and_unit, expanded, may_be
from truing.schemas.columns import find_column
from truing.schemas.mapping import FileMapping, is_uncertainty
from truing.schemas.memory import raise_shortage

if TYPE_CHECKING:
    from truing.formats.matlab import Variable

_ONE_MOTION = "a single rigid motion (4x4): how two frames lie to each other, no measurement; it is not read"
_CONTRACTS = {"fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm", "load", "x_mm"}  # names that need no guess
_DATE = "%Y%m%d%H%M%S"
_INDEXED = re.compile(r"\w+\[\d+, ?\d+\] ?= ?[-+\d.]+")
_LOOK = 1 << 16
_LINES = 60
_LONGEST_NAME = 200  # the search for meanings in names tries many ways to split them
_COMMENTS = ("#", "%", "//")
_AXES = 3
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
_KNOWN = {
    "pose": r"pose|frame|pos(e|ition)?[ _]?(nr|no|id)|epoche?|station|aufnahme|messung|stellung",
    "role": r"role|rolle",
    "body": r"body|rigid[ _]?body|k(ö|oe)rper",
    "target": r"target|marker|point([ _]?(id|name))?|label|punkt(nr|nummer|name)?|ziel(marke)?|nom|cible",
    "x_mm": r"x",
    "y_mm": r"y",
    "z_mm": r"z",
    "sigma_x_mm": r"(sigma|s|std|sd|mx)[ _]?x|u[ _]?x|u[ _]?\(?95\)?[ _]?x|[23][ _]?(σ|sigma)[ _]?x",
    "sigma_y_mm": r"(sigma|s|std|sd|my)[ _]?y|u[ _]?y|u[ _]?\(?95\)?[ _]?y|[23][ _]?(σ|sigma)[ _]?y",
    "sigma_z_mm": r"(sigma|s|std|sd|mz)[ _]?z|u[ _]?z|u[ _]?\(?95\)?[ _]?z|[23][ _]?(σ|sigma)[ _]?z",
    "time_s": r"t|time|zeit|temps|timestamp",
    "temperature_c": r"temp(erature?|eratur)?",
    "leg": r"leg|bein|jambe",
    "phase_deg": r"phase",
    "radius": r"radius",
    "signal_x": r"signal[ _]?x|cos(ine|inus)?",
    "signal_y": r"signal[ _]?y|sin(e|us)?",
}
_READING = re.compile(r"(?:rho|actuator|aktor|st(?:ö|oe)(?:ß|ss)el|v(?:é|e)rin)[ _]?([1-9]\d*)")
_COUNT = re.compile(rb"^(?:element vertex|POINTS) +(\d+)", re.MULTILINE)
_DENSE = 1000  # a cloud with more points is a scan of a surface, not a set of targets
_SHOWN = 12


def sniff_file(path: Path) -> Guess:
    """Return a proposal for one file, from its name and first lines; the content never causes an exception."""
    raw = RawFile(path.name, path)
    file_format = format_of(raw, FileMapping(path="*"))
    if raw.suffix == ".eor":
        return Guess(
            notes=("AICON's orientations of images: read along with the image coordinates beside it",), known=True
        )
    if is_rig_file(path.name):
        return Guess(notes=(OF_RIGS,), known=True)
    try:
        if file_format in ("xlsx", "mat"):
            return _sniff_workbook(path) if file_format == "xlsx" else _sniff_matlab(path)
        if file_format in ("delimited", "xyz", "aicon", "metashape xml"):
            return _sniff_text(path)
        if (network := by_format(file_format, path.name)) is not None:
            return network
        return _sniff_other(path, file_format)
    except (*DAMAGED, OSError, UnicodeError) as error:
        return Guess(notes=(f"it cannot be read: {error}",))


def _sniff_other(path: Path, file_format: str) -> Guess:
    if file_format == "parquet":
        import pyarrow as pa
        import pyarrow.parquet as pq

        try:
            names = tuple(pq.read_schema(path).names)
        except pa.ArrowException as error:
            raise_shortage(error)
            return Guess(notes=("the Parquet file is damaged",))
        mapping, notes = _columns(names)
        if (loads := load_columns(names)) is not None and not _CONTRACTS.intersection(names):
            return _loads(loads, names, {}, mapping)
        return Guess(mapping, names, _table({*names, *mapping.get("columns", {})}), tuple(notes))
    if file_format == "rtl":
        note = "positioning runs of an axis, targets in mm and deviations in um; the file's name names the run"
        return Guess({}, ("pass", "target", "deviation"), "positioning", (note,))
    if file_format in ("c3d", "trc"):
        note = "every frame is a pose; split the labels into body and target, or name the body under constants"
        return Guess({"constants": {"body": "body"}}, ("frame", "label", "x", "y", "z"), "points", (note,))
    if _cloud_size(path) >= _DENSE:
        note = "a dense scan; the file's name says the pose and the body"
        return Guess({}, ("x", "y", "z"), "scans", (note,))
    note = "a cloud without names: the file's name says the pose, and the targets are found by their geometry"
    return Guess({"constants": {"body": "platform"}}, ("x", "y", "z"), "points", (note,))


def _cloud_size(path: Path) -> int:
    """Return the number of points in the header of a PLY or PCD; 0 without one."""
    with open_plain(path) as stream:
        announced = _COUNT.search(stream.read(_LOOK))
    return int(announced[1]) if announced else 0


def _sniff_text(path: Path) -> Guess:
    with open_plain(path) as stream:
        head = stream.read(_LOOK)
    encoding, text = _decoded(head, whole=len(head) < _LOOK)
    if "\0" in text:
        return Guess(notes=("it holds no text that can be read",))
    lines = [line for line in text.splitlines() if line.strip()]
    if lines and is_rig_file("", lines[0]):
        return Guess(notes=(OF_RIGS,), known=True)
    if (network := guess_by_first_lines(lines)) is not None:
        return network
    if (known := metashape(lines)) is not None:
        return known if encoding == "utf-8" else replace(known, mapping={"encoding": encoding, **known.mapping})
    if sum(_INDEXED.match(line) is not None for line in lines) > len(lines) // 2:
        note = 'lines of name[i,j]=number: docs/own-files.md has such a file under "Positioning runs of an axis"'
        return Guess(notes=(note,))
    comment = next((mark for mark in _COMMENTS if lines and lines[0].lstrip().startswith(mark)), None)
    whole = [line for line in lines if comment is None or not line.lstrip().startswith(comment)]
    lines = whole[:_LINES]
    if not lines:
        return Guess(notes=("it holds no lines",))
    mapping: dict[str, Any] = {} if encoding == "utf-8" else {"encoding": encoding}
    mapping |= {} if comment is None else {"comment": comment}
    guess = _sniff_records(lines, mapping)
    if guess.mapping.get("format") == "vstars" and (select := coded_alone(whole)):
        note = "coded targets alone: the others are numbered anew in every bundle"
        return replace(guess, mapping=guess.mapping | select, notes=(*guess.notes, note))
    return guess


def _decoded(head: bytes, *, whole: bool) -> tuple[str, str]:
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16", head.decode("utf-16", errors="ignore")
    try:
        return "utf-8", head.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if not whole and error.start > len(head) - 4:
            return "utf-8", head[: error.start].decode("utf-8-sig")
    return "cp1252", head.decode("cp1252", errors="replace")


def _sniff_records(lines: list[str], mapping: dict[str, Any]) -> Guess:
    separator = guess_separator(lines[len(lines) // 3 :] or lines, '"')
    records = [split_record(line.encode(), separator, '"') for line in lines]
    width = len(records[-1])
    skipped = next((i for i, record in enumerate(records) if len(record) == width), 0)
    records = [record for record in records[skipped:] if len(record) == width]
    if width < 2 or len(records) < 0.6 * (len(lines) - skipped):
        return Guess(mapping, notes=("its lines make no table",))
    return sniff_cells(records, mapping | ({"skip_lines": skipped} if skipped else {}), separator)


def sniff_cells(records: list[list[str]], mapping: dict[str, Any], separator: str = ",") -> Guess:
    """Return a proposal for records of equally many cells, the first of which may be a header."""
    notation = _notation(records[1:] or records)
    guess = _by_notation(records, dict(mapping), separator, notation)
    if notation != _COMMA_DECIMAL or (cell := _open_cell(records)) is None:
        return guess
    return replace(guess, otherwise=(cell, _by_notation(records, dict(mapping), separator, _COMMA_THOUSANDS)))


def _open_cell(records: list[list[str]]) -> str | None:
    """Return a number whose comma may separate thousands as well; None if another cell decides."""
    commas = [cell for record in records[1:] or records for cell in record if "," in cell]
    return commas[0] if all(_OPEN_COMMA.fullmatch(cell.strip()) for cell in commas) else None


def _by_notation(records: list[list[str]], mapping: dict[str, Any], separator: str, notation: Notation) -> Guess:
    """Return a proposal for records whose numbers are written in a notation."""
    if any(len(name) > _LONGEST_NAME for name in records[0]):
        return Guess(mapping, notes=(f"a name of more than {_LONGEST_NAME} characters is none of a column",))
    width = len(records[0])
    has_header = len(records) > 1 and not any(_is_number(cell, notation) for cell in records[0])
    names = tuple(records[0]) if has_header else tuple(str(i + 1) for i in range(width))
    known = tracker(names, notation.thousands) if has_header else None
    known = known or (None if has_header else adjusted_points(records, lambda cell: _is_number(cell, notation)))
    if known is not None:
        return replace(known, mapping={**mapping, **known.mapping})
    mapping |= {"separator": separator} if separator != "," else {}
    mapping |= {"header": False} if not has_header else {}
    mapping |= {"decimal": notation.decimal} if notation.decimal != "." else {}
    mapping |= {"thousands": notation.thousands} if notation.thousands else {}
    values = notation.matrix(records[1:] if has_header else records)
    if (poses := pose_columns(names, values) if has_header else bare_poses(values)) is not None:
        return _poses(poses, names, mapping, records[1:], values)
    if not has_header and is_one_motion(values):
        return Guess(mapping, names, None, (_ONE_MOTION,), known=True)
    found, notes = _columns(names) if has_header else _positions(records, notation)
    table = _table({*names, *found.get("columns", {})})
    if table == "quadrature" and "phase_deg" in found.get("columns", {}):
        steps = {"constants": {"run": "1", "channel": "dz", "load_axis": "fz", "load": 0}, "number_rows": {"step": 1}}
        notes = [*notes, "phases of one channel, a step per row"]
        return Guess(mapping | found | steps, names, table, tuple(notes))
    if has_header and table in (None, "configurations") and (loads := load_columns(names)) is not None:
        return _loads(loads, names, mapping, found)
    if has_header and table in (None, "configurations") and (template := wide_template(names)) is not None:
        return _side_by_side(template, names, mapping | found)
    return Guess(mapping | found, names, table, tuple(notes))


def _poses(
    poses: PoseMapping, names: tuple[str, ...], mapping: dict[str, Any], records: list[list[str]], values: Array
) -> Guess:
    """Return a proposal for poses, and for the configurations that other columns of the same rows form."""
    keys = dict(poses.mapping)
    others = tuple(name for name in names if poses.taken and name not in poses.taken)
    meant = _columns(others)[0].get("columns", {})
    reported = {key: raw for key, raw in meant.items() if key in ("pose", "time_s", "temperature_c")}
    number = {"pose": reported["pose"]} if "pose" in reported else {}
    if number or "pose" in names:
        keys["columns"] = {**number, **keys["columns"]}
    elif poses.taken:
        keys["number_rows"] = {"pose": 1}
    own = [name for name in others if name not in number.values() and np.isfinite(values[:, names.index(name)]).any()]
    if not own:
        return Guess({**mapping, **keys}, names, "poses", poses.notes)
    time = [record[names.index(reported["time_s"])] for record in records] if "time_s" in reported else []
    lost = [reported.pop("time_s")] if len(set(time)) < len(time) else []  # repeated times define no order
    dates = {"time_format": _DATE} if time and all(re.fullmatch(r"(19|20)\d{12}", cell) for cell in time) else {}
    numbered = {key: keys[key] for key in ("number_rows",) if key in keys}
    ignore = "|".join(re.escape(name).replace("\\ ", " ") for name in (*poses.taken, *lost))
    entry = {**mapping, **({"columns": reported} if reported else {}), **dates, **numbered, "ignore": ignore}
    text = f"what else there is, pose by pose: {', '.join(own[:8])}{', ...' if len(own) > 8 else ''}"
    return Guess(
        {**mapping, **keys}, names, "poses", poses.notes, beside=(Guess(entry, names, "configurations", (text,)),)
    )


def _loads(loads: Loads, names: tuple[str, ...], mapping: dict[str, Any], meant: dict[str, Any]) -> Guess:
    """Return a proposal for a table of loads, ordered by a column that seems to be time, if any."""
    table, keys, note = loads
    time = {key: name for key, name in meant.get("columns", {}).items() if key == "time_s"}
    return Guess({**mapping, **keys, "columns": {**time, **keys["columns"]}}, names, table, (note,))


def _side_by_side(template: tuple[str, str | None], names: tuple[str, ...], mapping: dict[str, Any]) -> Guess:
    """Return a proposal for a table with coordinates of several targets in every row: points, one row per pose."""
    wide, unit = template
    numbered = {} if "pose" in {*names, *mapping.get("columns", {})} else {"number_rows": {"pose": 1}}
    more = {"wide": wide, **({} if unit in (None, "mm") else {"unit": unit}), "constants": {"body": "body"}, **numbered}
    note = "several targets side by side: say in wide which part of the names is the body, or name it under constants"
    own = {"columns": {"pose": mapping["columns"]["pose"]}} if "pose" in mapping.get("columns", {}) else {}
    kept = {key: value for key, value in mapping.items() if key not in ("columns", "units")}
    return Guess({**kept, **own, **more}, names, "points", (note,))


def _notation(records: list[list[str]]) -> Notation:
    """Return the notation that reads most cells; the simplest among equals."""
    cells = [cell for record in records for cell in record]
    return max(_NOTATIONS, key=lambda notation: sum(_is_number(cell, notation) for cell in cells))


def _is_number(cell: str, notation: Notation) -> bool:
    return re.match(notation.pattern, cell.strip()) is not None


def _columns(names: tuple[str, ...]) -> tuple[dict[str, Any], list[str]]:
    """Return the probable meaning and unit of each column whose name is not the contract's."""
    columns: dict[str, str] = {}
    units: dict[str, str] = {}
    taken: list[str] = []
    for name in names:
        bare, unit = bare_and_unit(name)
        if unit is not None and find_column(name) is not None:
            continue  # has the contract's name: target_mm is no target
        known = _probable_column(bare) or _probable_column(name)
        if known is None or name == known or known in columns or known in names or not may_be(unit, find_column(known)):
            continue
        columns[known] = name
        if unit is not None and unit not in ("s", "degC"):
            units[known] = unit
        taken.append(f"{name} is taken for {known}" + (f", in {unit}" if unit else ""))
    notes = ["; ".join(taken)] if taken else []
    mapping: dict[str, Any] = {"columns": columns} if columns else {}
    text = {
        raw: one for column, raw in columns.items() if is_uncertainty(column) and (one := expanded(raw)) is not None
    }
    if text:
        factor = next(iter(text.values())).coverage
        mapping["coverage"] = factor
        notes.append(f"{', '.join(text)}: expanded uncertainties, k = {factor:g} is taken; coverage = 1 for one sigma")
    own = {units.get(name) for name in COORDINATES}
    whole = own.pop() if len(own) == 1 and not any(name in names for name in COORDINATES) else None
    if whole not in (None, "mm"):
        mapping["unit"] = whole  # of all coordinates, and of uncertainties without their own unit
    else:
        whole = None
    left = {
        name: unit
        for name, unit in units.items()
        if unit != (whole if whole and name.endswith("_mm") else _unit_suffix(name))
    }
    return mapping | ({"units": left} if left else {}), notes


def _unit_suffix(column: str) -> str | None:
    """Return the unit at the end of a column's name."""
    return column.rsplit("_", 1)[-1] if "_" in column else None


def _probable_column(bare: str) -> str | None:
    """Return the contract's column that a name without its unit seems to mean."""
    if reading := _READING.fullmatch(bare.lower()):
        return f"rho{reading[1]}_mm"
    return next((column for column, pattern in _KNOWN.items() if re.fullmatch(pattern, bare.casefold())), None)


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


def _table(names: set[str]) -> str | None:
    return next((table for table, wanted in _SIGNS if wanted <= names), None)


def _sniff_workbook(path: Path) -> Guess:
    """Return a proposal for the sheet with most content; a note names the others."""
    from truing.formats.workbook import first_rows, text_of

    try:
        sheets = first_rows(path, _LINES)
    except Unusable as error:
        return Guess(notes=(f"it cannot be read: expected {error.expected}",))
    guesses: dict[str, Guess] = {}
    for name, rows in sheets.items():
        texts = [[text_of(cell) for cell in row] for row in rows]
        width = max(len(row) for row in texts)
        texts = [[*row, *[""] * (width - len(row))] for row in texts]
        filled = [sum(cell != "" for cell in row) for row in texts]
        first = next(i for i, count in enumerate(filled) if count >= 0.6 * max(filled))
        keys: dict[str, Any] = {"sheet": name} if len(sheets) > 1 else {}
        guesses[name] = sniff_cells(texts[first:], {**keys, **({"skip_lines": first} if first else {})})
    if not guesses:
        return Guess(notes=("no sheet holds anything",))
    name, best = next(((n, g) for n, g in guesses.items() if g.table is not None), next(iter(guesses.items())))
    others = [other for other in guesses if other != name]
    more = (f"sheet {name} is read; there are {', '.join(others[:_SHOWN])}",) if others else ()
    return replace(best, notes=(*best.notes, *more))


def _sniff_matlab(path: Path) -> Guess:
    """Return a proposal for the only variable that is a table of poses or points; else the list of variables."""
    from truing.formats.matlab import open_variables

    try:
        with open_variables(path) as variables:
            return _of_variables(variables)
    except Unusable as error:
        return Guess(notes=(f"it cannot be read: expected {error.expected}",))


def _of_variables(variables: Mapping[str, Variable]) -> Guess:
    from truing.formats.matlab import blocks_of, shape_of

    variables = {name: value for name, value in variables.items() if name != "None"}  # unnamed objects
    listed = [f"{name} {shape_of(value)}" for name, value in variables.items()]
    text = f"variables: {', '.join(listed[:_SHOWN])}{', ...' if len(listed) > _SHOWN else ''}"
    tables = [name for name, value in variables.items() if isinstance(value, np.ndarray) and min(value.shape) > 1]
    for name in tables if len(tables) == 1 else ():
        keys = {} if len(variables) == 1 else {"variable": name}
        (block,) = blocks_of(variables, FileMapping(path="x.mat", variable=name))
        names = block.names
        cells = [[repr(float(value)) for value in row] for row in block.values[:_LINES]]
        guess = sniff_cells(cells, {}) if len(cells) > 1 else Guess()
        plain = {key: value for key, value in guess.mapping.items() if key in ("columns", "constants", "number_rows")}
        if guess.table == "poses" and names[0] == "m00":
            plain.pop("columns")  # they have these names already
        if guess.table == "poses" or (guess.table == "points" and len(variables) == 1 and len(cells) > _AXES):
            return Guess({**keys, **plain}, names, guess.table, (*guess.notes, text))
    example = next(iter(variables), "x")
    return Guess(notes=(f"{text}; say which: variable = {example!r}, and transpose where rows are columns",))
