"""Proposals for reading a raw file from its content: a draft of the mapping that a person completes."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from truing.formats.block_heads import heads_of_poses
from truing.formats.compression import DAMAGED, open_plain
from truing.formats.delimited import guess_separator, split_record
from truing.formats.guess import (
    OF_RIGS,
    Guess,
    MappingKeys,
    by_format,
    coded_alone,
    guess_by_first_lines,
    inspection,
    is_rig_file,
    metashape,
)
from truing.formats.heading import unit_in_words
from truing.formats.key_value_heading import NUMBERS_ALONE, HeadedTable, headed_table
from truing.formats.named_bench import cycles_side_by_side
from truing.formats.named_loads import load_columns
from truing.formats.presets import format_of
from truing.formats.probable_columns import columns_by_names
from truing.formats.proposed_loads import proposal_of_loads
from truing.formats.raw import Unusable
from truing.formats.sniff_cells import sniff_cells, table_of
from truing.formats.source import RawFile
from truing.schemas.mapping import FileMapping
from truing.schemas.memory import raise_shortage

_CONTRACTS = {"fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm", "load", "x_mm"}  # names that need no guess
_INDEXED = re.compile(r"\w+\[\d+, ?\d+\] ?= ?[-+\d.]+")
_LOOK = 1 << 16
_LINES = 60
_COMMENTS = ("#", "%", "//")
_COUNT = re.compile(rb"^(?:element vertex|POINTS) +(\d+)", re.MULTILINE)
_OF_JOINTS = re.compile(r"joint|gelenk|achswinkel|axis[_ -]?(angle|value)", re.IGNORECASE)
_DENSE = 1000  # a cloud with more points is a scan of a surface, not a set of targets
_SHOWN = 12
_SENTENCE = 4  # words
_FEWEST_WORDS = 3  # of a row that names groups of columns
_MOST_ABOVE = 20  # lines above a table
_WIDE_GAP = re.compile(r"\s{2,}|\t")
_LIKE_NUMBER = re.compile(r"\s*[-+]?[\d.,]+([eE][-+]?\d+)?\s*$")
_PROSE = "text without a table"
_BINARY = {  # of programs that also write text
    ".tdms": "save the channels as text: Write To Measurement File with .lvm, or the TDMS viewer's export",
    ".bin": "export as ASCII",
    ".xls": "save it as .xlsx or .csv",
}


def sniff_file(path: Path, joints: Sequence[str] = ()) -> Guess:
    """Return a proposal for one file, from its name and first lines; the content never causes an exception.

    joints: names of a robot's joints, from the base on, if its description is known.
    """
    raw = RawFile(path.name, path)
    file_format = format_of(raw, FileMapping(path="*"))
    if raw.suffix == ".eor":
        return Guess(
            notes=("AICON's orientations of images: read along with the image coordinates next to it",), known=True
        )
    if is_rig_file(path.name):
        return Guess(notes=(OF_RIGS,), known=True)
    try:
        if file_format in ("xlsx", "mat"):
            return _sniff_workbook(path, joints) if file_format == "xlsx" else _sniff_matlab(path)
        if file_format in ("delimited", "xyz", "aicon", "metashape xml"):
            return _sniff_text(path, joints)
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
        mapping, notes = columns_by_names(names)
        if (loads := load_columns(names)) is not None and not _CONTRACTS.intersection(names):
            return proposal_of_loads(loads, names, {}, mapping)
        return Guess(mapping, names, table_of({*names, *mapping.get("columns", {})}), tuple(notes))
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


def _sniff_text(path: Path, joints: Sequence[str]) -> Guess:
    with open_plain(path) as stream:
        head = stream.read(_LOOK)
    encoding, text = _decoded(head, is_complete=len(head) < _LOOK)
    if "\0" in text:
        cure = next((words for ending, words in _BINARY.items() if path.name.lower().endswith(ending)), None)
        return Guess(notes=("it holds no text that can be read" + ("" if cure is None else f"; {cure}"),))
    lines = [line for line in text.splitlines() if line.strip()]
    if lines and is_rig_file("", lines[0]):
        return Guess(notes=(OF_RIGS,), known=True)
    if (network := guess_by_first_lines(lines)) is not None:
        return network
    if (known := metashape(lines)) is not None:
        return known if encoding == "utf-8" else replace(known, mapping={"encoding": encoding, **known.mapping})
    if (report := inspection(text.splitlines())) is not None:
        return report if encoding == "utf-8" else replace(report, mapping={"encoding": encoding, **report.mapping})
    if sum(_INDEXED.match(line) is not None for line in lines) > len(lines) // 2:
        note = 'lines of name[i,j]=number: docs/own-files.md has such a file under "Positioning runs of an axis"'
        return Guess(notes=(note,))
    numbered = [(number, line) for number, line in enumerate(text.splitlines()) if line.strip()]
    if (headed := headed_table(numbered)) is not None:
        return _sniff_headed(headed, {} if encoding == "utf-8" else {"encoding": encoding}, joints)
    comment = next((mark for mark in _COMMENTS if lines and lines[0].lstrip().startswith(mark)), None)
    heads = heads_of_poses([line for _, line in numbered])
    if heads is not None:
        numbered = [(n, line) for n, line in numbered if re.search(heads, line) is None]
        comment = next((mark for mark in _COMMENTS if numbered and numbered[0][1].lstrip().startswith(mark)), None)
    lines_of_data = [(n, line) for n, line in numbered if comment is None or not line.lstrip().startswith(comment)]
    if not lines_of_data:
        return Guess(notes=("it holds no lines",))
    mapping: MappingKeys = {} if encoding == "utf-8" else {"encoding": encoding}
    mapping |= {} if comment is None else {"comment": comment}
    mapping |= {} if heads is None else {"heads": heads}
    mapping |= {"quote": ""} if _has_bare_quote([line for _, line in lines_of_data]) else {}
    remarks = [
        line.strip().lstrip(comment).strip() for _, line in numbered if comment and line.lstrip().startswith(comment)
    ]
    lines_of_data, kept = _without_footer(lines_of_data, is_complete=len(head) < _LOOK)
    mapping |= {} if kept is None else {"keep_lines": kept}
    guess = _sniff_records(
        lines_of_data[:_LINES], mapping, remarks, joints, is_of_joints=_OF_JOINTS.search(path.stem) is not None
    )
    guess = guess if heads is None else _of_several_poses(guess)
    if guess.mapping.get("format") == "vstars" and (select := coded_alone([line for _, line in lines_of_data])):
        note = "coded targets alone: the others get new numbers in every bundle"
        return replace(guess, mapping=guess.mapping | select, notes=(*guess.notes, note))
    if guess.table is None and (found := cycles_side_by_side(guess.columns, path.name)) is not None:
        return Guess({**guess.mapping, **found.mapping}, guess.columns, found.table, (found.note,), doubts=found.doubts)
    return guess


def _of_several_poses(guess: Guess) -> Guess:
    """Return a proposal whose rows have the pose of the line above their block: a list of targets is no survey."""
    columns = (*guess.columns, "pose")
    return replace(guess, columns=columns, table="points" if guess.table == "targets" else guess.table)


def _sniff_headed(table: HeadedTable, mapping: MappingKeys, joints: Sequence[str]) -> Guess:
    """Return a proposal for a table below a heading of keys and values."""
    lines = table.lines[:_LINES]
    separator = guess_separator([line for _, line in lines], '"')
    records = [split_record(line.encode(), separator, '"') for _, line in lines]
    kept = [place for place, record in enumerate(records) if len(record) == len(table.names)]
    mapping |= {"skip_lines": lines[0][0], "keep_lines": NUMBERS_ALONE}
    guess = sniff_cells([records[i] for i in kept], mapping, separator, comments=[table.names], joints=joints)
    return _without_columns(guess, table.repeated) if table.repeated else guess


def _without_columns(guess: Guess, names: Sequence[str]) -> Guess:
    """Return a proposal, in each of its ways, that leaves out some columns."""
    ignore = "|".join(filter(None, [guess.mapping.get("ignore"), *(re.escape(n).replace("\\ ", " ") for n in names)]))
    return replace(
        guess,
        mapping={**guess.mapping, "ignore": ignore},
        other_tables=tuple(_without_columns(one, names) for one in guess.other_tables),
        ways=tuple(replace(way, guess=_without_columns(way.guess, names)) for way in guess.ways),
    )


def _has_bare_quote(lines: Sequence[str]) -> bool:
    """True if a quotation mark is a unit, as in ``Deviation ["]``, and none quotes a cell."""
    marks = [line for line in lines if line.count('"') % 2]
    return bool(marks) and not any(re.search(r'(^|[,;\t ])"[^"]*"([,;\t ]|$)', line) for line in lines)


def _decoded(head: bytes, *, is_complete: bool) -> tuple[str, str]:
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16", head.decode("utf-16", errors="ignore")
    try:
        return "utf-8", head.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if not is_complete and error.start > len(head) - 4:
            return "utf-8", head[: error.start].decode("utf-8-sig")
    return "cp1252", head.decode("cp1252", errors="replace")


def _without_footer(numbered: list[tuple[int, str]], *, is_complete: bool) -> tuple[list[tuple[int, str]], str | None]:
    """Return lines without those below the table, and a ``keep_lines`` that leaves these out; None without such.

    Lines below a table have fewer cells than its rows, all of which have as many. is_complete: whether these are all
    lines of the file.
    """
    lines = [line for _, line in numbered]
    separator = guess_separator(lines[len(lines) // 3 : 2 * len(lines) // 3 + 1], '"')
    records = [split_record(line.encode(), separator, '"') for line in lines]
    widths = [len(record) for record in records]
    width = Counter(widths[len(widths) // 3 :]).most_common(1)[0][0]
    rows = [row for row, width_of_row in enumerate(widths) if width_of_row == width]
    below = records[rows[-1] + 1 :]
    is_footer = 0 < len(below) < len(rows) and rows[-1] - rows[0] + 1 == len(rows)
    is_footer = is_footer and not _may_be_cut(below, [records[row] for row in rows], width)
    if not (is_complete and is_footer) or separator == "whitespace" or _is_prose([[line] for line in lines]):
        return numbered, None
    mark = re.escape(separator) if separator in "|." else separator
    return numbered[: rows[-1] + 1], f"({mark}[^{separator}]*){{{width - 1}}}"


def _may_be_cut(below: Sequence[Sequence[str]], rows: Sequence[Sequence[str]], width: int) -> bool:
    """True if a line below a table may be a row of it, cut off or too long: it begins as the rows do."""
    is_numbered = 2 * sum(_LIKE_NUMBER.match(row[0]) is not None for row in rows) > len(rows)
    if is_numbered:
        return any(len(line) > width or _LIKE_NUMBER.match(line[0]) is not None for line in below)
    return any(len(line) > 1 for line in below)


def _sniff_records(
    numbered: list[tuple[int, str]],
    mapping: MappingKeys,
    remarks: list[str],
    joints: Sequence[str],
    *,
    is_of_joints: bool,
) -> Guess:
    """Return a proposal for lines with their numbers, from 0, and the lines of comments."""
    lines = [line for _, line in numbered]
    separator = guess_separator(lines[len(lines) // 3 :] or lines, '"')
    records = [split_record(line.encode(), separator, '"') for line in lines]
    if _is_prose(records):
        return Guess(notes=(_PROSE,), known=True)
    width = len(records[-1])
    skipped = _first_of_table(records, width)
    records_kept = [i for i in range(skipped, len(records)) if len(records[i]) == width]
    if width < 2 or len(records_kept) < 0.6 * (len(lines) - skipped):
        return Guess(mapping, notes=("its lines make no table",))
    above = [*remarks, *lines[:skipped][-1:]]
    comments = [cells for line in above for cells in _cells_of_heading(line, separator)]
    unit_of_heading = unit_in_words([*remarks, *lines[:skipped]])
    return sniff_cells(
        [records[i] for i in records_kept],
        mapping | ({"skip_lines": numbered[skipped][0]} if skipped else {}),
        separator,
        first_lines=[numbered[i][0] for i in records_kept],
        comments=comments,
        unit=unit_of_heading,
        joints=joints,
        is_of_joints=is_of_joints,
    )


def _cells_of_heading(line: str, separator: str) -> list[list[str]]:
    """Return the cells of a line above the numbers; of columns that blanks align also those that two blanks part, as
    names of two words are written: ``Meas X    Meas Y``."""
    cells = [split_record(line.encode(), separator, '"')]
    return [*cells, _WIDE_GAP.split(line.strip())] if separator == "whitespace" else cells


def _first_of_table(records: Sequence[Sequence[str]], width: int) -> int:
    """Return the first record of a table: behind lines above, some of which may have as many cells by chance."""
    has_width = [len(record) == width for record in records]
    numbers = [sum(_LIKE_NUMBER.match(cell) is not None for cell in record) for record in records]
    last_above = max((i for i, fits in enumerate(has_width[:_MOST_ABOVE]) if not fits), default=-1)
    if all(2 * count < numbers[-1] for count, fits in zip(numbers[:last_above], has_width, strict=False) if fits):
        return last_above + 1
    return next((i for i, fits in enumerate(has_width) if fits), 0)


def _is_prose(records: Sequence[Sequence[str]]) -> bool:
    """True if most cells, or most lines, are parts of sentences: several words of letters alone, and few numbers."""
    cells = [cell for record in records for cell in record]
    lines = [" ".join(record) for record in records]
    if not lines[0].endswith((".", "?", "!")):
        del lines[0]  # it may be a heading
    return any(2 * sum(map(_is_sentence, texts)) > len(texts) for texts in (cells, lines))


def _is_sentence(text: str) -> bool:
    words = len(set(re.findall(r"(?<!\S)[^\W\d_]+", text)))  # heads of many columns repeat few words
    return words >= max(_SENTENCE, 3 * len(re.findall(r"(?<!\S)[-+]?\d", text)))


def _sniff_workbook(path: Path, joints: Sequence[str]) -> Guess:
    """Return a proposal for the first sheet of a table and, next to it, of each other table; a note names the rest."""
    from truing.formats.workbook import first_rows, text_of

    try:
        sheets = first_rows(path, _LINES)
    except Unusable as error:
        return Guess(notes=(f"it cannot be read: expected {error.expected}",))
    guesses: dict[str, Guess] = {}
    for name, rows in sheets.items():
        texts = [[text_of(cell) for cell in row] for _, row in rows]
        width = max(len(row) for row in texts)
        texts = [[*row, *[""] * (width - len(row))] for row in texts]
        filled = [sum(cell != "" for cell in row) for row in texts]
        first = next(i for i, count in enumerate(filled) if count >= 0.6 * max(filled))
        first = _with_heads_above(texts, [number for number, _ in rows], first)
        keys: MappingKeys = {"sheet": name} if len(sheets) > 1 else {}
        before = [number - 1 for number, _ in rows]
        unit = unit_in_words([" ".join(row) for row in texts[:first]])
        keys |= {"skip_lines": before[first]} if first else {}
        guesses[name] = sniff_cells(
            texts[first:], keys, first_lines=before[first:], comments=texts[:first], unit=unit, joints=joints
        )
    if not guesses:
        return Guess(notes=("no sheet holds anything",))
    if (alike := _alike_sheets(guesses)) is not None:
        return alike
    kinds = {name: guess.table or "".join(guess.machine) for name, guess in guesses.items()}
    firsts = {kind: name for name, kind in reversed(kinds.items()) if kind}
    read = [name for name in guesses if name in firsts.values()] or [next(iter(guesses))]
    unread = [guess_of_sheet for guess_of_sheet in guesses if guess_of_sheet not in read]
    more = (f"sheet {read[0]} is read; there are {', '.join(unread[:_SHOWN])}",) if unread else ()
    best, *other_tables = (guesses[name] for name in read)
    return replace(best, notes=(*best.notes, *more), other_tables=(*best.other_tables, *other_tables))


def _with_heads_above(texts: list[list[str]], numbers: Sequence[int], first: int) -> int:
    """Return the first row of a table's heading: words for groups of columns, as of merged cells, stand right above
    the row that names each column."""
    while first > 0 and numbers[first - 1] == numbers[first] - 1:
        words = [cell for cell in texts[first - 1] if cell]
        if len(words) < _FEWEST_WORDS or any(map(_LIKE_NUMBER.match, words)) or not texts[first - 1][0]:
            return first
        first -= 1
    return first


def _alike_sheets(guesses: dict[str, Guess]) -> Guess | None:
    """Return one proposal for sheets of points that differ in their number alone, each a pose; None without such."""
    parts = [re.fullmatch(r"(?P<head>.*?)\d+", name) for name in guesses]
    heads = {match["head"] for match in parts if match is not None}
    keys = [{**guess.mapping, "sheet": ""} for guess in guesses.values()]
    first = next(iter(guesses.values()))
    is_like = len(parts) > 1 and all(parts) and len(heads) == 1 and all(key == keys[0] for key in keys)
    if (
        not is_like
        or first.table not in ("points", "targets")
        or "pose" in {*first.columns, *keys[0].get("columns", {})}
    ):
        return None
    head = heads.pop()
    named = {"sheet": f"{head}*", "from_name": rf"sheet {re.escape(head)}(?P<pose>\d+)"}
    note = f"{len(keys)} sheets {head}*, each taken for a pose"
    return replace(first, mapping={**first.mapping, **named}, table="points", notes=(*first.notes, note))


def _sniff_matlab(path: Path) -> Guess:
    from truing.formats.sniff_matlab import sniff_matlab

    return sniff_matlab(path)
