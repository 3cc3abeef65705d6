"""The campaign.toml of `truing init`: needed keys, and guesses marked as such."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from truing.pipeline.init_machine import MARK, columns_of, legs_of_table
from truing.pipeline.init_robot import mechanism_of
from truing.schemas.columns import find_column

if TYPE_CHECKING:
    from truing.formats.guess import Guess, MappingKeys
    from truing.pipeline.init_robot import Robot

_AT = 33  # column of remarks
_WITH_SIGMAS = ("vstars", "aicon", "colmap", "photomodeler")
_GUESSED = f"# A remark that begins with {MARK} marks a guess: delete the remark once the guess is right."
_KINDS = {
    "photogrammetry": "points and poses of bodies; interferometer: motion of a platform under load",
    "interferometer": "motion of a platform under load; photogrammetry: points and poses of bodies",
}
_NEEDED = "needed: one standard deviation of"
_OF_READINGS = {
    "interferometer": (
        ("linear_um = 0.5", f"{_NEEDED} a linear channel"),
        ("angular_arcsec = 0.2", f"{_NEEDED} an angular channel, where there is one"),
    ),
    "displacement": (
        ("displacement_mm = 0.001", f"{_NEEDED} a translation"),
        ("rotation_rad = 1e-6", f"{_NEEDED} a rotation"),
    ),
    "signals": (("signal_mv = 0.01", f"{_NEEDED} a signal"),),
}
_LEGS = (
    (
        "[mechanism]",
        "needed to calibrate or diagnose the machine; without it, results are poses and deformation of bodies",
    ),
    ('type = "6-pus"', "fixed legs, moved actuators; ups: legs of variable length"),
    ("reference_temperature_c = 20.0", ""),
    ("legs = [", "one such entry per leg, in leg order; a and u in the base frame, b in the platform's"),
    ("  { a_mm = [100.0, 0.0, 0.0], b_mm = [80.0, 0.0, 0.0], u = [0.0, 0.0, 1.0], length_mm = 500.0 },", ""),
    ("]", ""),
    ("[mechanism.tolerance]", "one standard deviation of manufacturing and assembly"),
    ("a_mm = 0.5", "and b_mm, u, length_mm"),
)

_OF_JOINTS = ("joint_deg = 0.0005", "one standard deviation of a joint's reading; absent: exact")
_OF_SLIDES = ("joint_mm = 0.001", "one standard deviation of the reading of a slide; absent: exact")
_OF_CHAIN = (  # where no file is read that says how the chain was measured
    ("point_mm = 0.005", f"{_NEEDED} a coordinate, where points are measured"),
    ("displacement_mm = 0.01", f"{_NEEDED} a coordinate, where poses are measured"),
    ("rotation_rad = 1e-5", f"{_NEEDED} a rotation about an axis, where poses are measured"),
)
_DEVIATIONS = ("deviation_deg", "deviation_mm")
_WHOLE_UNITS = {"metashape": "m", "vstars": "mm", "aicon": "mm", "tracker": "mm"}  # formats that name no unit
_SHOWN = 8


def starter_text(
    name: str, kind: str, guesses: Sequence[Guess], files: Sequence[str], robot: Robot | None = None
) -> str:
    """Text of the whole file; name and kind as TOML, files: the lines of [files], robot: of a description."""
    chain = list(mechanism_of(robot, guesses))
    tables = {guess.table for guess in guesses if guess.table}
    sections = list(_sections(guesses, tables, chain))
    noise = [
        *_noise(guesses, tables, kind),
        *(_noise_of_chain(guesses, tables) if chain else []),
    ]
    lines = [
        '# Settings of a measurement campaign. Complete the lines marked "needed", then run:  truing check .',
        "# A line after a # is inactive. Raw files are never changed. All keys, with explanations:  truing init --all",
        *([_GUESSED] if any(line.startswith(MARK) for line in (*files, *sections)) else []),
        "",
        "format = 1",
        "",
        "[campaign]",
        f"name = {name}",
        _remark(f'kind = "{kind}"', _KINDS[kind]),
        *([] if chain else _drives(guesses, tables)),
        *_with_head("[noise]", [_commented_line(line, remark) for line, remark in noise]),
        *sections,
        *files,
    ]
    return "\n".join(lines).rstrip() + "\n"


def known_sections(guesses: Sequence[Guess], robot: Robot | None) -> list[str]:
    """Lines of the sections that files give, such as [mechanism] of their nominal geometry; others are left out."""
    tables = {guess.table for guess in guesses if guess.table}
    lines = [*_sections(guesses, tables, list(mechanism_of(robot, guesses))), ""]
    kept: list[str] = []
    section: list[str] = []
    for line in lines:
        if line:
            section.append(line)
            continue
        kept += [*section, ""] if any(entry[0] not in "# " for entry in section) else []
        section = []
    return kept[:-1]


def _remark(line: str, remark: str) -> str:
    return f"{f'{line} ':<{_AT}}# {remark}" if remark else line


def _with_head(head: str, lines: list[str]) -> list[str]:
    return ["", head, *lines] if lines else []


def _commented_line(line: str, remark: str) -> str:
    return _remark(f"# {line}", remark)


def _any_file_has(guesses: Sequence[Guess], *columns: str) -> bool:
    """True if any file gives one of these columns, or one with such a prefix."""
    named = (name for guess in guesses for name in (*guess.columns, *guess.mapping.get("columns", {})))
    return any(name.startswith(columns) for name in named)


def _drives(guesses: Sequence[Guess], tables: set[str]) -> Iterator[str]:
    if "configurations" in tables and not _any_file_has(guesses, "rho") and not _axis_columns(guesses):
        yield _commented_line('drives = ["elevation_deg"]', "columns of configurations on which deformation may depend")


def _axis_columns(guesses: Sequence[Guess]) -> list[str]:
    """Columns of a single axis by name: a command and its encoders; empty if there is no axis."""
    configurations = [guess for guess in guesses if guess.table in ("configurations", "measured")]
    names = [name for guess in configurations for name in (*guess.columns, *guess.mapping.get("columns", {}))]
    names = ["measured" + name.removeprefix("deviation") if name in _DEVIATIONS else name for name in names]
    for unit in ("deg", "mm"):
        if f"command_{unit}" in names:
            return [c for what in ("command", "motor", "load", "measured") if (c := f"{what}_{unit}") in names]
    return []


def _axis(columns: Sequence[str]) -> Iterator[tuple[str, str]]:
    """[mechanism] of a single axis with these columns."""
    yield "[mechanism]", ""
    yield 'type = "axis"', ""
    yield f'kind = "{"rotary" if columns[0].endswith("_deg") else "linear"}"', "rotary or linear"
    for column in columns:
        quantity = column.partition("_")[0]
        if quantity != "measured":
            yield f'{quantity} = "{column}"', "" if quantity != "command" else "column of the command"
    yield 'loop = "motor"', "encoder in the controller's feedback loop: motor or load"


def _noise(guesses: Sequence[Guess], tables: set[str], kind: str) -> Iterator[tuple[str, str]]:
    """Keys of [noise] that the tables need."""
    if not tables and kind == "photogrammetry":
        yield "point_mm = 0.005", f"{_NEEDED} a coordinate of a point"
    if tables & {"points", "scans", "surfaces"}:
        of_points = [guess for guess in guesses if guess.table in ("points", "targets")]
        known = of_points and all(
            "sigma_x_mm" in (*guess.columns, *guess.mapping.get("columns", {}))
            or guess.mapping.get("format") in _WITH_SIGMAS
            for guess in of_points
        )
        yield (
            "point_mm = 0.005",
            "one standard deviation, if a file gives none" if known else f"{_NEEDED} a coordinate",
        )
    if "poses" in tables:
        given = "if the file gives none" if _any_file_has(guesses, "sigma_") else "for the positions of the poses"
        yield "displacement_mm = 0.01", f"{_NEEDED} a coordinate, {given}"
        yield "rotation_rad = 1e-5", f"{_NEEDED} a rotation about an axis, {given.replace('positions', 'orientations')}"
    if tables & {"images", "image_points"}:
        yield "image_px = 0.05", "one standard deviation of an image coordinate, if a file gives none"
    for column in _axis_columns(guesses):
        meaning = (
            "one standard deviation of the axis from its command; absent: 0" if column.startswith("command") else ""
        )
        yield f"{column} = 0.001", meaning or f"{_NEEDED} that encoder"
    if _any_file_has(guesses, "rho"):
        yield "actuator_mm = 0.001", "one standard deviation of an actuator's reading; absent: exact"
    done: set[str] = set()
    for table, keys in _OF_READINGS.items():
        for line, remark in keys if table in tables else ():
            if line not in done:
                yield line, remark
            done.add(line)


def _noise_of_chain(guesses: Sequence[Guess], tables: set[str]) -> Iterator[tuple[str, str]]:
    """Keys of [noise] of a chain besides those of its measured points or poses."""
    if not tables & {"points", "poses", "images", "image_points"}:
        yield from _OF_CHAIN
    yield _OF_JOINTS
    columns = [column for guess in guesses if guess.table == "configurations" for column in columns_of(guess)]
    if any(re.fullmatch(r"(?!rho)[a-z_]+\d*_mm", column) for column in columns):
        yield _OF_SLIDES


def _of_bodies(guesses: Sequence[Guess]) -> set[str]:
    """Bodies of the measured poses, where each file or group of columns names one."""
    return {str(g.mapping.get("constants", {}).get("body", "")) for g in guesses if g.table == "poses"}


def _only_body_of_points(guesses: Sequence[Guess]) -> str:
    """Body of all measured points, where the files name no other; else empty."""
    of_points = [guess for guess in guesses if guess.table in ("points", "targets")]
    bodies = {str(guess.mapping.get("constants", {}).get("body", "")) for guess in of_points}
    return bodies.pop() if len(bodies) == 1 else ""


def _sections(guesses: Sequence[Guess], tables: set[str], chain: Sequence[tuple[str, str]]) -> Iterator[str]:
    """Sections other than [noise], each after an empty line; ``chain``: lines and remarks of its [mechanism]."""
    is_one_target = any("target" in guess.mapping.get("constants", {}) for guess in guesses)
    is_one_body = bool(chain) and "points" not in tables and [g.table for g in guesses].count("poses") == 1
    is_one_body |= bool(chain) and _only_body_of_points(guesses) not in ("", "base")
    is_with_base = bool(chain) and "points" not in tables and _of_bodies(guesses) == {"base", "tip"}
    if is_one_target or is_one_body or is_with_base or (chain and _are_in_the_same_rows(guesses)):
        yield from ("", "[measurement]")
        why = f"one {'target' if is_one_target else 'body'} in each pose, so the"
        why = why if is_one_target or is_one_body else "the"
        is_moved = any("series" in guess.mapping.get("columns", {}) for guess in guesses)
        between = " within each series" if is_moved else ""
        yield f"{MARK} {why} instrument is assumed not to have moved{between}"
        yield 'frame = "series"' if is_moved else 'frame = "campaign"'
    elif "poses" in tables or chain:
        yield from ("", "[measurement]")
        yield _commented_line('frame = "campaign"', "the instrument did not move; absent: every pose has its own frame")
    if any("euler_a_deg" in guess.mapping.get("columns", {}) for guess in guesses):
        order = next((str(guess.poses["euler"]) for guess in guesses if "euler" in guess.poses), "")
        remark = "capitals for rotating axes, xyz for fixed axes"
        yield from ("", "[poses]")
        yield (
            _remark(f"euler = {json.dumps(order)}", remark)
            if order
            else _commented_line('euler = "XYZ"', f"needed: the order; {remark}")
        )
    if chain:
        yield from ("", *(_remark(line, remark) for line, remark in chain))
    elif legs := legs_of_table(guesses):
        yield from ("", *(_remark(line, remark) for line, remark in legs))
    elif _any_file_has(guesses, "rho"):
        yield ""
        yield from (_commented_line(line, remark) for line, remark in _LEGS)
    elif columns := _axis_columns(guesses):
        yield from ("", f"{MARK} the rows are assumed to be of one axis, controlled by the encoder of its motor")
        yield from (_remark(line, remark) for line, remark in _axis(columns))
    elif tables & {"points", "poses", "scans", "images", "image_points"}:
        yield from ("", _commented_line("[bodies]", ""))
        yield _commented_line(
            'reference = "base"', "body in whose frame the others are given; absent: the measurement frame"
        )
    if tables & {"interferometer", "displacement", "signals"}:
        yield from (
            "",
            "# [mechanism]: the platform on its legs or the sensor, type 6-upur; truing init --all shows its keys",
        )
    if tables & {"interferometer", "quadrature"}:
        yield from ("", _commented_line("[interferometer]", ""))
        yield _commented_line("wavelength_nm = 632.990577", "in vacuum")
        yield _commented_line("compensated = true", "readings already compensated for the refractive index of air")


def _are_in_the_same_rows(guesses: Sequence[Guess]) -> bool:
    """True if rows of a file hold readings of the machine and what an instrument measured."""
    measured = [guess.columns for guess in guesses if guess.table in ("points", "poses")]
    return any(guess.table == "configurations" and guess.columns in measured for guess in guesses)


def guess_lines(mapping: MappingKeys, guess: Guess) -> Iterator[str]:
    """Yield one marked remark with all guessed keys of an entry; none if nothing is guessed."""
    constants = {key: value for key, value in mapping.get("constants", {}).items() if key not in guess.answered}
    statements = (
        *guess.doubts,
        *(way.doubt for way in guess.ways),
        *_of_constants(constants),
        *_of_units(mapping, guess),
        *_of_rows(mapping, guess.answered),
    )
    if statements:
        yield f"{MARK} {'; '.join(statements)}"


def unconfirmed(file: Path) -> str:
    """Return the unconfirmed guesses by lines of campaign.toml; empty if there are none."""
    lines = file.read_text(encoding="utf-8").splitlines()
    found = [str(number) for number, line in enumerate(lines, 1) if line.strip().startswith(MARK)]
    if not found:
        return ""
    shown = ", ".join(found[:_SHOWN]) + (f" and {len(found) - _SHOWN} more" if len(found) > _SHOWN else "")
    many = len(found) > 1
    lines_text = f"line{'s' * many} {shown} of {file.name} mark{'s' * (not many)} {'guesses' if many else 'a guess'}"
    return f"{lines_text} of truing init ({MARK}): correct what is wrong, then delete the remark"


def _of_constants(constants: Mapping[str, object]) -> Iterator[str]:
    if "body" in constants:
        yield f'body = "{constants["body"]}" is a guess; all points are assumed to be on one rigid body'
    if "channel" in constants:
        yield f'channel = "{constants["channel"]}" is a guess; no file names the channel'
    if "load_axis" in constants and "load" not in constants:
        yield f'load_axis = "{constants["load_axis"]}" is a guess; no file names the component of the load'
    elif "load_axis" in constants:
        yield f'load_axis = "{constants["load_axis"]}", load = {constants["load"]}, assumed to be without a load'
    for name in ("run", "pose"):
        if name in constants:
            yield f"{name} = {constants[name]!r}, all rows are assumed to be one {name}".replace("'", '"')


def _of_units(mapping: MappingKeys, guess: Guess) -> Iterator[str]:
    from truing.formats.raw_tables import COORDINATE_SIGMAS, COORDINATES

    by_unit: dict[str, list[str]] = {}
    unread = unread_units(mapping)
    for words in dict.fromkeys(unread.values()):
        columns = [column for column, named in unread.items() if named == words]
        names = _span([mapping["columns"][column] for column in columns])
        yield f"{words} of {names} is not known as a unit of this quantity (needed: units = {{ {columns[0]} = ... }})"
    for column, raw in mapping.get("columns", {}).items():
        if column not in unread and (unit := taken_unit(column, raw, mapping)):
            by_unit.setdefault(unit, []).append(f"column {raw}" if isinstance(raw, int) else raw)
    common = _common_unit(mapping, guess)
    if common and "unit" not in guess.answered:
        yield f'no unit is given; coordinates are assumed to be in {common} (else: unit = "in")'
    elif by_unit:
        words = ", ".join(f"{unit} for {_span(names)}" for unit, names in by_unit.items())
        given = mapping.get("columns", {}).items()
        assumed = [column for column, raw in given if column not in unread and taken_unit(column, raw, mapping)]
        cure = (
            'unit = "in"' if set(assumed) <= {*COORDINATES, *COORDINATE_SIGMAS} else f"units = {{ {assumed[0]} = ... }}"
        )
        yield f"no unit is given; assumed are {words} (else: {cure})"


def unread_units(mapping: MappingKeys) -> dict[str, str]:
    """Words in brackets after raw names, by columns whose unit they seem to be but cannot be."""
    from truing.formats.units import unread_unit

    found = {}
    for column, raw in mapping.get("columns", {}).items():
        known = find_column(column)
        if known is not None and isinstance(raw, str) and taken_unit(column, raw, mapping, is_unread=True):
            found[column] = unread_unit(raw, known)
    return {column: words for column, words in found.items() if words is not None}


def assumed_unit(column: str, guess: Guess) -> str | None:
    """Assumed unit of a coordinate of a file; None if its unit is known, or there is no such column."""
    columns = guess.mapping.get("columns", {})
    common = _common_unit(guess.mapping, guess)
    return common or (taken_unit(column, columns[column], guess.mapping) if column in columns else None)


def taken_unit(column: str, raw: Any, mapping: MappingKeys, *, is_unread: bool = False) -> str | None:
    """Assumed unit of a raw column without a unit, or (``is_unread``) with any words as unit; None if it is known."""
    from truing.formats.units import bare_and_unit

    known = find_column(column)
    is_declared = column == raw or column in mapping.get("units", {}) or (column.endswith("_mm") and "unit" in mapping)
    if known is None or not known.unit or known.unit == "1" or is_declared or isinstance(raw, dict):
        return None
    if column == "time_s" and "time_format" in mapping:
        return None
    return known.unit if is_unread or isinstance(raw, int) or bare_and_unit(raw)[1] is None else None


def _common_unit(mapping: MappingKeys, guess: Guess) -> str | None:
    """Assumed unit of all coordinates of files without a unit; None if columns have units of their own."""
    from truing.formats.units import bare_and_unit

    if "unit" in mapping or "wide_values" in mapping or bare_and_unit(mapping.get("wide", ""))[1] is not None:
        return None
    is_bare = guess.table in ("points", "scans", "surfaces") and guess.columns == ("x", "y", "z")
    if "wide" in mapping or "rows_per_pose" in mapping or (is_bare and "columns" not in mapping):
        return "mm"
    return _WHOLE_UNITS.get(mapping.get("format", ""))


def _span(names: list[str]) -> str:
    return " ".join(names) if len(names) < 4 else f"{names[0]} to {names[-1]}"


def has_open_rotation(mapping: MappingKeys) -> bool:
    """True if three angles could be a rotation vector or Euler angles, because no name says which."""
    columns = mapping.get("columns", {})
    return columns.get("rx_rad") not in (None, "rx_rad") and "sigma_rx_rad" not in columns


def _of_rows(mapping: MappingKeys, answered: Collection[str]) -> Iterator[str]:
    if groups := re.findall(r"\(\?P<(\w+)>", mapping.get("from_name", "")):
        yield f"the files' names give {' and '.join(groups)}"
    if "coverage" in mapping and "coverage" not in answered:
        yield f"coverage = {mapping['coverage']:g}, uncertainties are assumed to be expanded (1: one sigma)"
    if has_open_rotation(mapping) and "rotation" not in answered:
        yield "the angles are assumed to be a rotation vector in rad (else: euler_a_deg, euler_b_deg, euler_c_deg)"
    if (axes := mapping.get("number_rows")) and "pose" in axes:
        yield "number_rows: every row is assumed to be a pose, in the order of measurement"
