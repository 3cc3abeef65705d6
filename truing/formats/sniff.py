"""Looking at a raw file and proposing how to read it: a start for the mapping that a person completes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from schemas.mapping import FileMapping
from schemas.memory import raise_shortage
from truing.formats.compression import DAMAGED, open_plain
from truing.formats.delimited import guess_separator, split_record
from truing.formats.known_exports import Known, adjusted_points, coded_alone, is_id, metashape, tracker, wide_template
from truing.formats.known_networks import OF_RIGS, KnownNetwork, by_format, by_look, tells_of_rigs
from truing.formats.load_columns import load_columns
from truing.formats.numbers import Notation
from truing.formats.presets import format_of
from truing.formats.source import RawFile

_INDEXED = re.compile(r"\w+\[\d+, ?\d+\] ?= ?[-+\d.]+")
_LOOK = 1 << 16
_LINES = 60
_COMMENTS = ("#", "%", "//")
_NOTATIONS = (
    Notation(".", None),
    Notation(",", None),
    Notation(".", ","),
    Notation(",", "."),
    Notation(".", "'"),
    Notation(",", " "),
)
_SIGNS = (
    ("interferometer", {"channel", "reading"}),
    ("quadrature", {"signal_x", "signal_y"}),
    ("quadrature", {"phase_deg", "radius"}),
    ("positioning", {"target_mm", "position_mm"}),
    ("displacement", {"dx_mm", "dy_mm", "dz_mm"}),
    ("signals", {"v1_mv"}),
    ("configurations", {"pose", "time_s"}),
    ("configurations", {"rho1_mm"}),
    ("points", {"pose", "x_mm"}),
    ("targets", {"target", "x_mm"}),
    ("points", {"x_mm"}),
)
_KNOWN = {
    "pose": r"pose|frame|pos(e|ition)?[ _]?(nr|no|id)|epoche?|station|aufnahme|messung|stellung",
    "role": r"role|rolle",
    "body": r"body|rigid[ _]?body|k(ö|oe)rper",
    "target": r"target|marker|point([ _]?(id|name))?|label|punkt(nr|nummer|name)?|ziel(marke)?|nom|cible",
    "x_mm": r"x",
    "y_mm": r"y",
    "z_mm": r"z",
    "sigma_x_mm": r"(sigma|s|std|mx)[ _]?x",
    "sigma_y_mm": r"(sigma|s|std|my)[ _]?y",
    "sigma_z_mm": r"(sigma|s|std|mz)[ _]?z",
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
_DENSE = 1000  # a cloud of more points than this is a scan of a surface, not a set of targets
_UNIT = re.compile(r"^(.*?)[\s_]*[\s_\[(/]\s*(mm|cm|um|µm|m|in|deg|rad|s|ms|°C|K)\s*[\])]?$")


@dataclass(frozen=True)
class Guess:
    """What a file seems to hold: keys for [files.<table>], its columns, the table, what to look at again, and the
    other tables that are read from it with the same keys. known: no table of it is wanted; the first note says why."""

    mapping: dict[str, Any] = field(default_factory=dict)
    columns: tuple[str, ...] = ()
    table: str | None = None
    notes: tuple[str, ...] = ()
    others: tuple[str, ...] = ()
    known: bool = False


def sniff_file(path: Path) -> Guess:
    """A proposal for one file, from its name and its first lines; never raises on what the file holds."""
    raw = RawFile(path.name, path)
    file_format = format_of(raw, FileMapping(path="*"))
    if raw.suffix == ".eor":
        return Guess(
            notes=("AICON's orientations of images: read along with the image coordinates beside it",), known=True
        )
    if tells_of_rigs(path.name):
        return Guess(notes=(OF_RIGS,), known=True)
    try:
        if file_format in ("delimited", "xyz", "aicon", "metashape xml"):
            return _sniff_text(path)
        if (network := by_format(file_format, path.name)) is not None:
            return _network(network)
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
            return Guess(notes=("it is no whole Parquet file",))
        mapping, notes = _columns(names)
        return Guess(mapping, names, _table({*names, *mapping.get("columns", {})}), tuple(notes))
    if file_format == "rtl":
        note = "positioning runs of an axis, targets in mm and deviations in um; the file's name names the run"
        return Guess({}, ("pass", "target", "deviation"), "positioning", (note,))
    if file_format in ("c3d", "trc"):
        note = "every frame is a pose; split the labels into body and target, or name the body under constants"
        return Guess({"constants": {"body": "body"}}, ("frame", "label", "x", "y", "z"), "points", (note,))
    if _cloud_size(path) >= _DENSE:
        note = "a dense scan, taken to be in mm (else: unit); the file's name says the pose and the body"
        return Guess({}, ("x", "y", "z"), "scans", (note,))
    note = "a cloud without names: the file's name says the pose, and the targets are found by their geometry"
    return Guess({"constants": {"body": "platform"}}, ("x", "y", "z"), "points", (note,))


def _cloud_size(path: Path) -> int:
    """How many points the header of a PLY or PCD announces; 0 where it announces none."""
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
    if lines and tells_of_rigs("", lines[0]):
        return Guess(notes=(OF_RIGS,), known=True)
    if (network := by_look(lines)) is not None:
        return _network(network)
    if (known := metashape(lines)) is not None:
        return _known_export(known, encoding)
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
    notation = _notation(records[1:] or records)
    has_header = len(records) > 1 and not any(_is_number(cell, notation) for cell in records[0])
    names = tuple(records[0]) if has_header else tuple(str(i + 1) for i in range(width))
    mapping |= {"skip_lines": skipped} if skipped else {}
    known = tracker(names, notation.thousands) if has_header else None
    known = known or (None if has_header else adjusted_points(records, lambda cell: _is_number(cell, notation)))
    if known is not None:
        return Guess({**mapping, **known[0]}, known[1], "points", (known[2],))
    mapping |= {"separator": separator} if separator != "," else {}
    mapping |= {"header": False} if not has_header else {}
    mapping |= {"decimal": notation.decimal} if notation.decimal != "." else {}
    mapping |= {"thousands": notation.thousands} if notation.thousands else {}
    found, notes = _columns(names) if has_header else _positions(records, notation)
    table = _table({*names, *found.get("columns", {})})
    if table == "quadrature" and "phase_deg" in found.get("columns", {}):
        steps = {"constants": {"run": "1", "channel": "dz", "load_axis": "fz", "load": 0}, "number_rows": {"step": 1}}
        notes = [*notes, "phases of one channel, a step per row, taken to be without a load: say which channel it is"]
        return Guess(mapping | found | steps, names, table, tuple(notes))
    if has_header and table in (None, "configurations") and (loads := load_columns(names)) is not None:
        table, keys, note = loads
        time = {key: name for key, name in found.get("columns", {}).items() if key == "time_s"}
        return Guess({**mapping, **keys, "columns": {**time, **keys["columns"]}}, names, table, (note,))
    if has_header and table in (None, "configurations") and (template := wide_template(names)) is not None:
        return _side_by_side(template, names, mapping | found)
    return Guess(mapping | found, names, table, tuple(notes))


def _network(known: KnownNetwork) -> Guess:
    return Guess(known.mapping, known.columns, known.tables[0], (known.note,), known.tables[1:])


def _known_export(known: Known, encoding: str) -> Guess:
    return Guess(
        {**({} if encoding == "utf-8" else {"encoding": encoding}), **known[0]}, known[1], "points", (known[2],)
    )


def _side_by_side(template: tuple[str, str | None], names: tuple[str, ...], mapping: dict[str, Any]) -> Guess:
    """A table with the coordinates of several targets in every row: points, a row of the file being a pose."""
    wide, unit = template
    numbered = {} if "pose" in {*names, *mapping.get("columns", {})} else {"number_rows": {"pose": 1}}
    more = {"wide": wide, **({} if unit in (None, "mm") else {"unit": unit}), "constants": {"body": "body"}, **numbered}
    note = "several targets side by side: say in wide which part of the names is the body, or name it under constants"
    own = {"columns": {"pose": mapping["columns"]["pose"]}} if "pose" in mapping.get("columns", {}) else {}
    kept = {key: value for key, value in mapping.items() if key not in ("columns", "units")}
    return Guess({**kept, **own, **more}, names, "points", (note,))


def _notation(records: list[list[str]]) -> Notation:
    """The way of writing numbers that reads most cells; the plainest among equals."""
    cells = [cell for record in records for cell in record]
    return max(_NOTATIONS, key=lambda notation: sum(_is_number(cell, notation) for cell in cells))


def _is_number(cell: str, notation: Notation) -> bool:
    return re.match(notation.pattern, cell.strip()) is not None


def _columns(names: tuple[str, ...]) -> tuple[dict[str, Any], list[str]]:
    """Which column seems to be what, and its unit, where its name is not the contract's already."""
    columns, units, notes = {}, {}, []
    for name in names:
        bare, unit = _bare(name)
        known = _meant(bare)
        if known is None or name == known or known in columns or known in names:
            continue
        columns[known] = name
        if unit is not None and not known.endswith(f"_{unit}") and unit not in ("s", "°C"):
            units[known] = unit
        notes.append(f"{name} is taken for {known}" + (f", in {unit}" if unit else ""))
    mapping: dict[str, Any] = {"columns": columns} if columns else {}
    return mapping | ({"units": units} if units else {}), notes


def _meant(bare: str) -> str | None:
    """The column of the contract that a name without its unit seems to mean."""
    if reading := _READING.fullmatch(bare.lower()):
        return f"rho{reading[1]}_mm"
    return next((column for column, pattern in _KNOWN.items() if re.fullmatch(pattern, bare.casefold())), None)


def _bare(name: str) -> tuple[str, str | None]:
    match = _UNIT.match(name.strip())
    return (match[1].strip(" _[(/"), match[2]) if match and match[1].strip(" _[(/") else (name.strip(), None)


def _positions(records: list[list[str]], notation: Notation) -> tuple[dict[str, Any], list[str]]:
    """Coordinates in a file without header: the first three columns of numbers, after a name if there is one."""
    numbers = [all(_is_number(record[i], notation) for record in records) for i in range(len(records[0]))]
    numbers[0] = numbers[0] and not is_id(records)
    first = next((i for i in range(len(numbers) - 2) if all(numbers[i : i + 3])), None)
    if first is None:
        return {}, ["three columns of numbers side by side were not found"]
    columns: dict[str, Any] = {name: first + 1 + i for i, name in enumerate(("x_mm", "y_mm", "z_mm"))}
    if first > 0:
        columns = {"target": first, **columns}
    return {"columns": columns}, [
        f"columns {first + 1} to {first + 3} are taken for x, y, z in mm; take this entry out where they are not"
    ]


def _table(names: set[str]) -> str | None:
    return next(_matching(names), None)


def _matching(names: set[str]) -> Iterator[str]:
    yield from (table for table, wanted in _SIGNS if wanted <= names)
