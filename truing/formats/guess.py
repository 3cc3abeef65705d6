"""Guesses of the content of an unknown file, if its content or name identifies the program."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

_TRACKER = {"feature", "id", "x", "y", "z"}
_METASHAPE = re.compile(r"#?\s*Label[,;\t].*\bX_est\b")
_WHERE = "say under from_name or constants which pose and body it is"
_AXES_ONLY = 4  # columns of a list without sigmas
_OF_VSTARS = re.compile(r"(CODE|TARGET|NUGGET|AUTOBAR|SCALE|CSB)", re.IGNORECASE)
_FLAGS_FROM = 7  # columns of an adjustment's list after id, three coordinates and three sigmas
_BETWEEN = ("_", ".", ":", "-", " ", "")
_UNIT_BEHIND = re.compile(r"[\s_]*[\[(/]?\s*(mm|cm|um|µm|m|in)\s*[\])]?$")
_FEWEST = 2  # targets side by side
# names of forces, motions and settings: their components are no coordinates
_NO_POINTS = re.compile(
    r"force|moment|torque|\bload|sensor|accel|gyro|veloc|speed|goal|command|setpoint|roll|pitch|yaw|"
    r"(?:^|[ _])q[wxyz]\b",
    re.I,
)
_OF_INSPECTION = re.compile(
    r"nom(inal)?|soll|meas(ured)?|act(ual)?|ist|mess|dev(iation)?|abw(eichung)?|tol|error", re.I
)
_OF_AXES = re.compile(  # positions in a robot's program: KUKA's E6AXIS, jointtarget of ABB and of Rokae, UR's movej
    r"E6AXIS\s+(?P<kuka>\w+)\s*=\s*\{\s*A1|jointtarget\s+\w+\s*:?=\s*(?P<target>\[\[|j:\s*\{)|(?P<ur>movej\s*\(\s*\[)",
    re.IGNORECASE,
)
_ANGLE = r"[-+\d.eE]+"
_SIX = r"\s*,\s*".join([_ANGLE] * 6)
_LONGEST_LINE = 500
_NUMBERED = r"\w*\d"
# Lines of a log of joints: KUKA's axes as KRL writes them, and a jointtarget without its keyword.
_KUKA_LINE = rf"(?P<place>{_NUMBERED}\b)?.*\{{\s*(E6AXIS\s*:\s*)?A1\s+{_ANGLE}\s*,\s*A2\s"
_ABB_LINE = rf".*?(?P<place>{_NUMBERED})?\W*\[\s*\[\s*{_SIX}\s*\]\s*,\s*\[\s*9E"
_LOGS_OF_AXES = {
    "KUKA": (re.compile(_KUKA_LINE, re.IGNORECASE), r"\{.*A1\s"),
    "ABB": (re.compile(_ABB_LINE, re.IGNORECASE), r"\[\s*\["),
}
_COORDINATE = r"[-+]?\d*\.?\d+(?:[eE][-+]?\d+)?"
_NAMED_PLACE = re.compile(rf"\s*(?P<name>[^,;\t|]*?::[^,;\t|]*?\S)(?:\s+{_COORDINATE}){{3}}\s*")
_RAYS = ("image", "camera", "point", "x_px", "y_px")
_CAMERA = ("camera", "width_px", "height_px", "focal_px", "x0_px", "y0_px", "A1", "A2", "A3", "B1", "B2", "C1", "C2")
_POINT = ("target", "x", "y", "z")
_ONE_POSE = "one pose is taken: say under from_name, split or constants which pose each image belongs to"
OF_RIGS = "no table: relations of the cameras of a COLMAP model; its images suffice"
_RIGS = ("# Rig calib list", "# Frame list")
_CARTESIAN = "a program of FANUC with Cartesian positions; record them as joints: their representation in the program"
_OF_FANUC = "positions of a FANUC program, in degrees"
_COUPLED = (
    "the numbers of the positions are assumed to be the poses; where J3 of this robot is measured from the horizontal, "
    "joint 3 turns by J2 + J3: say so with plus"
)
_OF_GSI = "Leica GSI: coordinates, each in the unit of its word"
_NO_SCALE = "COLMAP knows no scale and no sigma: declare scale_bars or known_points"

MappingKeys = dict[str, Any]  # keys of [files.<table>], as campaign.toml has them


@dataclass(frozen=True)
class OtherWay:
    """Second possible reading of a file: the other guess, and the question that decides, with the value of each.

    doubt: what the reading that is taken assumes.
    """

    key: str
    text: str
    taken: str
    other: str
    guess: Guess
    doubt: str


@dataclass(frozen=True)
class Guess:
    """Proposal for a file: keys for [files.<table>], its columns, table, and points to check.

    others: other tables read with the same keys. known: no table of the file is needed; the first note gives the
    reason. other_tables: proposals for further tables in the file. ways: other readings that are possible. answered:
    keys that are no guesses, because a person gave them. doubts: statements to confirm, next to those that the keys
    imply. machine: keys of [mechanism], where the file holds nominal geometry. poses: keys of [poses] that a
    person gave.
    """

    mapping: MappingKeys = field(default_factory=dict)
    columns: tuple[str, ...] = ()
    table: str | None = None
    notes: tuple[str, ...] = ()
    others: tuple[str, ...] = ()
    known: bool = False
    other_tables: tuple[Guess, ...] = ()
    ways: tuple[OtherWay, ...] = field(default=(), compare=False, repr=False)
    answered: frozenset[str] = frozenset()
    doubts: tuple[str, ...] = ()
    machine: MappingKeys = field(default_factory=dict)
    poses: MappingKeys = field(default_factory=dict)


def metashape(lines: Sequence[str]) -> Guess | None:
    """Return a guess for markers of Metashape's reference pane, whose header line begins like a comment."""
    heading = next((line for line in lines[:10] if _METASHAPE.match(line)), None)
    if heading is None:
        return None
    note = f"Metashape: measured are X_est Y_est Z_est; {_WHERE}"
    names = tuple(re.split(r"[,;\t]", heading.lstrip("# ")))
    stated = re.search(r"\((mm|cm|m|ft|in)\)", " ".join(lines[:10]))
    keys = {"unit": stated[1]} if stated is not None and stated[1] != "m" else {}
    guess = _points("metashape", names, note, **keys)
    return guess if stated is None else replace(guess, answered=frozenset({"unit"}))


def tracker(names: Sequence[str], thousands: str | None) -> Guess | None:
    """Return a guess for a laser tracker's list of readings."""
    if not ({name.casefold() for name in names} >= _TRACKER and thousands == ","):
        return None
    note = "a laser tracker's export: say under from_name or constants which body and target it is"
    return _points("tracker", tuple(names), note)


def adjusted_points(records: Sequence[Sequence[str]], is_number: Callable[[str], bool]) -> Guess | None:
    """Return a guess for a list of points without header: V-STARS' ``id x y z sx sy sz``, or AICON's with rays and
    flags."""
    width = len(records[0])
    names = tuple(str(i + 1) for i in range(width))
    if width < 4 or not all(is_number(cell) for record in records for cell in record[1:]):
        return None
    if _is_word_before_numbers(records):
        return None
    if is_id(records) and width >= _FLAGS_FROM and _are_sigmas(records):
        if width >= _FLAGS_FROM + 2 and all(cell.isdigit() for record in records for cell in record[_FLAGS_FROM:]):
            note = f"AICON: id x y z sx sy sz rays used, where 0 under used is a point to leave out; {_WHERE}"
            return _points("aicon", names, note, select={"used": "1"})
        return _vstars(names)
    is_named = all(record[0][:1].isalpha() for record in records)
    has_sigmas = _AXES_ONLY < width <= _FLAGS_FROM + 1
    is_own = width == _AXES_ONLY and all(_OF_VSTARS.match(record[0]) for record in records)
    return _vstars(names) if is_named and (has_sigmas or is_own) else None


def _is_word_before_numbers(records: Sequence[Sequence[str]]) -> bool:
    """True if the name of each point is one word and a number, in columns of their own, such as ``point 1``."""
    words, numbers = {record[0] for record in records}, [record[1].strip() for record in records]
    is_one_word = len(words) == 1 and not any(cell.isdecimal() for cell in words)
    return is_one_word and all(map(str.isdecimal, numbers)) and len(set(numbers)) == len(records) >= _FEWEST


def coded_alone(lines: Sequence[str], separators: str = ",;\t ") -> MappingKeys:
    """Return a ``select`` for coded targets, which keep their numbers between bundles, if there are others too."""
    names = [re.split(f"[{separators}]", line.strip(), maxsplit=1)[0] for line in lines if line.strip()]
    coded = sum(re.fullmatch(r"CODE\d+", name) is not None for name in names)
    return {"select": {"target": r"CODE\d+"}} if 0 < coded < len(names) else {}


def _vstars(names: tuple[str, ...]) -> Guess:
    return _points("vstars", names, f"V-STARS: id x y z sx sy sz; {_WHERE}")


def _points(file_format: str, names: tuple[str, ...], note: str, **more: Any) -> Guess:
    return Guess({"format": file_format, **more, "constants": {"body": "body"}}, names, "points", (note,))


def inspection(lines: Sequence[str]) -> Guess | None:
    """Return a guess for a report of an inspection program with a row for each coordinate."""
    from truing.formats.inspection import COLUMNS, inspected_points

    points = inspected_points(lines)
    if points is None:
        return None
    cells = [value for row in points.rows for value in row[2:]]
    has_commas = any("," in cell for cell in cells) and not any("." in cell for cell in cells)
    has_parts = len({row[0] for row in points.rows}) > 1
    keys: MappingKeys = {"decimal": ","} if has_commas else {}
    keys |= {"columns": {"pose": "part"}} if has_parts else {}
    note = f"a report with a row for each coordinate, the measured ones of which are read{_unit_words(points.unit)}"
    guess = _points("inspection", COLUMNS if has_parts else COLUMNS[1:], note, **keys)
    return replace(guess, answered=frozenset() if points.unit is None else frozenset({"unit"}))


def _unit_words(unit: str | None) -> str:
    return "" if unit is None else f", in {unit}"


def is_id(records: Sequence[Sequence[str]]) -> bool:
    """True if the first column holds point numbers: unique integers, next to coordinates that are not."""
    first = [record[0] for record in records]
    marks = [re.search(r"\d[.,]\d", cell) is not None for record in records for cell in record[1:4]]
    return all(cell.isdigit() for cell in first) and len(set(first)) == len(first) and bool(marks) and all(marks)


def _are_sigmas(records: Sequence[Sequence[str]]) -> bool:
    """True if columns 5 to 7 are positive and mostly below one."""
    cells = [cell.replace(",", ".") for record in records for cell in record[4:7]]
    values = [float(cell) if re.fullmatch(r"\d+\.\d+", cell) else -1.0 for cell in cells]
    return all(value >= 0.0 for value in values) and sum(value < 1.0 for value in values) > 0.5 * len(values)


def wide_template(names: Sequence[str]) -> tuple[str, str | None] | None:
    """Return the name template of coordinates of several targets in one row, and their unit if the names end with
    one."""
    units_of_names = [_UNIT_BEHIND.search(name) for name in names]
    behind = {
        match[0] for name, match in zip(names, units_of_names, strict=True) if match and re.search(r"[xyzXYZ]", name)
    }
    best: tuple[int, int, str, str | None] = (0, 0, "", None)
    for rank, between in enumerate(_BETWEEN):
        for ending in ("", *sorted(behind)):
            for template in (f"{{target}}{between}{{axis}}{ending}", f"{{axis}}{between}{{target}}{ending}"):
                count = _targets_of(template, names)
                unit = _UNIT_BEHIND.search(ending)
                best = max(
                    best, (count, -rank, template, unit[1] if unit else None), key=lambda candidate: candidate[:2]
                )
    if best[0] < _FEWEST or _NO_POINTS.search(" ".join(names)) or _are_of_one_point(best[2], names):
        return None
    with_bodies = best[2].replace("{target}", "{body}:{target}")  # Vicon's subject:marker
    return (with_bodies if _targets_of(with_bodies, names) == best[0] else best[2]), best[3]


def _are_of_one_point(template: str, names: Sequence[str]) -> bool:
    """True if the targets of a template are words for coordinates of one point: nominal, measured, deviation."""
    pattern = re.escape(template).replace(r"\{target\}", "(?P<target>.+?)").replace(r"\{axis\}", "[xyzXYZ]")
    targets = {match["target"] for name in names if (match := re.fullmatch(pattern, name))}
    return bool(targets) and all(_OF_INSPECTION.fullmatch(target) for target in targets)


def _targets_of(template: str, names: Sequence[str]) -> int:
    """Return the number of targets with all three coordinates by a template."""
    pattern = (
        re.escape(template)
        .replace(r"\{target\}", r"(?P<target>\w.*?)")
        .replace(r"\{body\}", r"(?P<body>\w[^:]*)")
        .replace(r"\{axis\}", "(?P<axis>[xyzXYZ])")
    )
    axes: dict[str, set[str]] = {}
    for name in names:
        if match := re.fullmatch(pattern, name):
            target_name = f"{match.groupdict().get('body', '')}:{match['target']}"
            axes.setdefault(target_name, set()).add(match["axis"].lower())
    return sum(len(axis) == 3 for axis in axes.values())


def by_format(file_format: str, name: str) -> Guess | None:
    """Return a guess for a photogrammetric program's file whose format follows from its name."""
    if file_format == "colmap":
        return _colmap(name.lower().split(".")[0])
    pose, bars = {"constants": {"pose": 1}}, ("bar", "first", "second", "length_mm", "sigma_mm")
    return {
        "phc": Guess(pose, _RAYS, "image_points", (f"AICON's image coordinates; {_ONE_POSE}",)),
        "ior": Guess({}, _CAMERA, "cameras", ("AICON's interior orientations; free says what is estimated",)),
        "scale": Guess({}, bars, "scale_bars", ("AICON's bars",)),
        "gsi": Guess({"constants": {"body": "body"}}, _POINT, "points", (_OF_GSI,)),
    }.get(file_format)


def guess_by_first_lines(lines: Sequence[str]) -> Guess | None:
    """Return a guess for a text whose first lines identify the program."""
    head = "\n".join(lines[:12])
    for model, mark in (("cameras", "# Camera list"), ("images", "# Image list"), ("points3d", "# 3D point list")):
        if head.startswith(mark):
            return _colmap(model, named=True)
    if head.startswith("<?xml") and re.search(r"<(chunk|document|marker)\b", head):
        note = f"Metashape: projections of markers, whose sigma is [noise] image_px; {_ONE_POSE}"
        others = ("cameras",) if any("<calibration" in line for line in lines) else ()
        mapping = {"format": "metashape", "constants": {"pose": 1}}
        return Guess(mapping, _RAYS, "image_points", (note,), others)
    if _is_photomodeler(lines):
        note = f"PhotoModeler: marks with sigmas, cameras, points; {_ONE_POSE}"
        mapping = {"format": "photomodeler", "constants": {"pose": 1}}
        return Guess(mapping, _RAYS, "image_points", (note,), ("cameras",))
    if (axes := next((m for line in lines if (m := _OF_AXES.search(line))), None)) is not None:
        return _positions_of_program(axes)
    if (log := _log_of_axes(lines)) is not None:
        return log
    if (places := _places_with_blanks(lines)) is not None:
        return places
    if head.startswith("/PROG"):
        return _positions_of_fanuc(lines)
    if re.match(r"\*?1[01]\d{4}[+-]\S{8}", head) and re.search(r"\b81....[+-]\d{8}", head):
        return Guess({"format": "gsi", "constants": {"body": "body"}}, _POINT, "points", (_OF_GSI,))
    return None


def _positions_of_program(match: re.Match[str]) -> Guess:
    """Return a guess for the positions in a robot's program: a pose per line, named as the position or in their order.

    They are in degrees, those of UR's programs in radians.
    """
    joints = [f"joint{number}" for number in range(1, 7)]
    unit = "deg" if match["ur"] is None else "rad"
    values = [rf"(?P<{joint}_{unit}>{_ANGLE})" for joint in joints]
    keys = {"separator": "|", "quote": "", "header": False, "names": ["line"]}
    inner = r"\s*,\s*".join(values)
    if match["ur"] is not None:
        keys |= {"keep_lines": "movej", "number_rows": {"pose": 1}}
        pattern, doubt = rf".*movej\s*\(\s*\[\s*{inner}.*", "the positions are assumed to be the poses in their order"
    else:
        doubt = "the numbers of the positions are assumed to be the poses"
        numbered = r"\w*?(?P<pose>\d+)"
        if match["kuka"] is not None:
            inner = r"\s*,\s*".join(rf"A{number}\s+{value}" for number, value in enumerate(values, start=1))
            keys, pattern = keys | {"keep_lines": "E6AXIS"}, rf".*E6AXIS\s+{numbered}\s*=\s*\{{\s*{inner}.*"
        else:
            first = r"\[\[" if match["target"].startswith("[") else r"j:\s*\{"
            keys |= {"keep_lines": "jointtarget"}
            pattern = rf".*jointtarget\s+{numbered}\s*:?=\s*{first}\s*{inner}.*"
    note = f"positions of a robot's program, in {'degrees' if unit == 'deg' else 'radians'}"
    return Guess({**keys, "split": {"line": pattern}}, tuple(joints), "configurations", (note,), doubts=(doubt,))


def _log_of_axes(lines: Sequence[str]) -> Guess | None:
    """Return a guess for a log with the joints of a pose in each line, in degrees; None without several such lines.

    A word that ends in a number, before the joints, names the pose; without one in every line, poses are counted.
    """
    joints = tuple(f"joint{number}" for number in range(1, 7))
    values = [rf"(?P<{joint}_deg>{_ANGLE})" for joint in joints]
    for maker, (pattern, keep) in _LOGS_OF_AXES.items():
        mark = re.compile(keep)
        candidates = [line for line in lines if len(line) <= _LONGEST_LINE and mark.search(line)]
        matches = [match for line in candidates if (match := pattern.match(line))]
        if len(matches) < _FEWEST:
            continue
        if maker == "KUKA":
            inner = r"\s*,\s*".join(rf"A{number}\s+{value}" for number, value in enumerate(values, start=1))
            behind, before = r"\b.*", ""
        else:
            inner, behind, before = r"\[\s*\[\s*" + r"\s*,\s*".join(values), r"\W*", r".*?"
        names = [match["place"] for match in matches]
        is_named = all(names) and len(set(names)) == len(names)
        keys: MappingKeys = {"separator": "|", "quote": "", "header": False, "names": ["line"], "keep_lines": keep}
        keys |= {} if is_named else {"number_rows": {"pose": 1}}
        named = rf"{before}\b[^\W\d]*(?P<pose>\d+){behind}" if is_named else ".*?"
        doubt = f"the {'numbers' if is_named else 'lines'} of the log are assumed to be the poses"
        split = {"line": rf"{named}{inner}.*"}
        note = f"joints in a log of {maker}, in degrees"
        return Guess({**keys, "split": split}, joints, "configurations", (note,), doubts=(doubt,))
    return None


def _places_with_blanks(lines: Sequence[str]) -> Guess | None:
    """Return a guess for lines of a name in parts, which holds blanks, and three numbers behind it, between blanks;
    such as ``A::Pose 1::T1 10.0 20.0 30.0``."""
    matches = [_NAMED_PLACE.fullmatch(line) for line in lines if not line.lstrip().startswith(("//", "#"))]
    names = [match["name"] for match in matches if match is not None]
    if len(names) < max(_FEWEST, len(matches)) or not any(" " in name for name in names):
        return None
    parts = parts_of_names(names, "name", ())
    if not parts:
        return None
    numbers = r"\s+".join(f"(?P<{axis}_mm>{_COORDINATE})" for axis in "xyz")
    comment = next((mark for mark in ("//", "#") if lines[0].lstrip().startswith(mark)), None)
    keys: MappingKeys = {} if comment is None else {"comment": comment}
    keys |= {"separator": "|", "quote": "", "header": False, "names": ["line"]}
    named = parts["split"]["name"].replace("(?P<body>", "(?P<group>").replace("(?P<target>", "(?P<point>")
    is_one_target = len({name.rsplit("::", 1)[-1] for name in names}) == 1  # then the groups are its places
    keys |= {"columns": {"target": "group"} if is_one_target else {"body": "group", "target": "point"}}
    split = {"line": rf"\s*(?P<name>.*?\S)\s+{numbers}\s*", "name": named}
    note = "names in parts, which hold blanks, and three coordinates behind them"
    return Guess({**keys, "split": split}, ("name", "x", "y", "z"), "points", (note,))


def _positions_of_fanuc(lines: Sequence[str]) -> Guess:
    """Return a guess for a program of FANUC, which holds joints or Cartesian positions."""
    if not any(re.match(r"\s*J1\s*=", line) for line in lines):
        return Guess(notes=(_CARTESIAN,), known=True)
    joints = tuple(f"J{number}" for number in range(1, 7))
    keys = {"format": "fanuc", "columns": {f"joint{number}_deg": name for number, name in enumerate(joints, 1)}}
    return Guess(keys, ("pose", *joints), "configurations", (_OF_FANUC,), doubts=(_COUPLED,))


def is_rig_file(name: str, head: str = "") -> bool:
    """True if a file belongs to a COLMAP model but holds no table, by its name or its first line."""
    return name.lower().startswith(("rigs.bin", "frames.bin")) or head.startswith(_RIGS)


def _colmap(model: str, *, named: bool = False) -> Guess | None:
    arguments = {"format": "colmap"} if named else {}
    if model == "images":
        mapping = {**arguments, "constants": {"pose": 1}}
        return Guess(mapping, _RAYS, "image_points", (f"{_NO_SCALE}; {_ONE_POSE}",))
    if model == "cameras":
        return Guess(arguments, _CAMERA, "cameras", ("COLMAP's cameras, to start from",))
    note = f"{_NO_SCALE}; better read the images: their rays are adjusted with their covariance"
    return Guess({**arguments, "constants": {"pose": 1, "body": "body"}}, _POINT, "points", (note,))


def _is_photomodeler(lines: Sequence[str]) -> bool:
    """True if a title is followed by five lines of numbers, then a number and the first photo's name."""
    counts = [len(line.split()) for line in lines[1:5]]
    numbers = all(re.fullmatch(r"[-+.\deE\s]+", line) for line in lines[1:5])
    return len(lines) > 6 and numbers and counts == [4, 9, 10, 10] and re.match(r"\s*\d+ \S", lines[5]) is not None


def parts_of_names(targets: Sequence[str], raw: str, known: Collection[str]) -> MappingKeys:
    """Return a ``split`` for names of targets in parts, such as ``A::base::P1``; empty if they have no parts.

    The last part is the target, the part before it the body, unless a column names it. A first part that differs is
    the pose.
    """
    parts = [name.split("::") for name in targets]
    count = len(parts[0])
    if count < 2 or any(len(part) != count or not all(part) for part in parts):
        return {}
    groups = ["target"]
    groups.insert(0, "body" if "body" not in known else "group")
    if count > 2:
        differs = len({part[0] for part in parts}) > 1 and "pose" not in known
        groups = ["pose" if differs else "collection", *(f"part{i}" for i in range(count - 3)), *groups]
    pattern = "::".join(f"(?P<{group}>.+)" if i == count - 1 else f"(?P<{group}>.+?)" for i, group in enumerate(groups))
    return {"split": {raw: pattern}}
