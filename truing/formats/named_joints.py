"""Recognition of a robot's joint readings: columns named as joints, or numbered families such as A1 to A6."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from truing.arrays import Array
from truing.formats.guess import MappingKeys
from truing.formats.units import bare_and_unit

_NOT_POSITIONS = re.compile(
    r"veloc|speed|effort|torque|current|accel|moment|target|command|cmd|goal|desired|soll|set[ _]?point|tcp|force|temp",
    re.IGNORECASE,
)
# What errors of a robot may depend on besides its joints.
_INPUTS = re.compile(r"torque|effort|current|(?<![a-z])tau|temp|humid|pressure|payload|speed|veloc", re.IGNORECASE)
_NUMBERED = re.compile(
    r"(?P<family>.*?(?:actual_?q|joint\w*?|axis\w*?|achse|gelenk|articula\w*?|(?<![a-z])(?:axe|asse|eje)"
    r"|(?<![a-z])(?:a|j|q|th(?:eta)?)|position)[ _.\[(-]*)"
    r"(?P<number>\d+)(?P<rest>[\])]?.*)",
    re.IGNORECASE,
)
_EXTERNAL = re.compile(r"e(\d)", re.IGNORECASE)  # an external axis: a rail next to A1 to A6
_INDEX = re.compile(r"[\[(]\d+[\])]$")  # position[1] has no unit
_LINEAR = ("m", "mm", "cm", "um", "in", "nm")
_FEWEST, _MOST = 3, 9
_ORIENTATION = 3  # angles of an orientation
_YASKAWA = ("S", "L", "U", "R", "B", "T")
_LARGEST_RAD = 2.0 * np.pi + 0.1
_LONGEST_SLIDE_M = 20.0
_MOMENTS = 1e8  # seconds since 1970 and larger: a date
_CONTRACT = ("pose", "role", "time_s", "temperature_c", "series", "payload_kg", "since_motion_s", "repeat_of")
_PER_SECOND = {"ns": 1e9, "us": 1e6, "ms": 1e3}


class SlideName(str):
    """Name of a joint that slides."""

    __slots__ = ()


@dataclass(frozen=True)
class NamedJoints:
    """Columns of joints in order: name of the joint, raw name, and unit; whether the unit is a guess."""

    names: tuple[str, ...]
    raw: tuple[str, ...]
    units: tuple[str, ...]
    is_guess: bool

    def columns(self) -> dict[str, str]:
        """Return the columns of configurations by their raw names."""
        return {
            f"{name}_{_suffix(unit)}": raw for name, raw, unit in zip(self.names, self.raw, self.units, strict=True)
        }

    def other_units(self) -> dict[str, str]:
        """Return units that differ from those in the names of the columns."""
        return {
            f"{name}_{_suffix(unit)}": unit
            for name, unit in zip(self.names, self.units, strict=True)
            if unit != _suffix(unit)
        }


def _suffix(unit: str) -> str:
    return unit if unit in ("rad", "deg", "mm") else "mm" if unit in _LINEAR else "rad"


def joint_columns(
    names: Sequence[str], data: Sequence[Sequence[str]], values: Array, joints: Sequence[str] = ()
) -> NamedJoints | None:
    """Return the joints in a table of cells (N, W) and their numbers, by a robot's joints or by numbered names.

    joints: names of the robot's joints from the base on; empty if no description is known.
    """
    raw = _match_by_name(names, joints) or _match_by_cells(names, data, joints) or _match_by_number(names, len(joints))
    raw = raw or _match_with_external(names, joints)
    called = None if raw is not None or joints else _called_joints(names)
    if raw is None and called is None and not joints:
        raw = _in_angles(names) or _by_letters(names)
    named = tuple(joints) or tuple(f"joint{number}" for number in range(1, len(raw or ()) + 1))
    if called is not None:
        raw, named = called, tuple(bare_and_unit(name)[0] for name in called)
    if raw is None:
        return None
    stated = [None if _INDEX.search(name) else bare_and_unit(name)[1] for name in raw]
    columns = values[:, [list(names).index(name) for name in raw]]
    if not np.isfinite(columns).any(axis=0).all():
        return None
    units = tuple(
        unit or assumed
        for unit, assumed in zip(stated, _assumed_units(np.nanmax(np.abs(columns), 0), named), strict=True)
    )
    return NamedJoints(named, raw, units, None in stated)


def _assumed_units(largest: Array, joints: Sequence[str]) -> list[str]:
    """Return the units of joints by their largest readings (n,): all turning ones have one unit, all slides another."""
    slides = np.array([isinstance(joint, SlideName) for joint in joints], bool)
    turn = "rad" if largest[~slides].max(initial=0.0) <= _LARGEST_RAD else "deg"
    slide = "m" if largest[slides].max(initial=0.0) <= _LONGEST_SLIDE_M else "mm"
    return [slide if is_slide else turn for is_slide in slides]


def _match_by_name(names: Sequence[str], joints: Sequence[str]) -> tuple[str, ...] | None:
    """Return the columns whose names contain the joints as whole words, one for each joint."""
    free = [name for name in names if not _NOT_POSITIONS.search(name)]
    matches = [name for joint in joints if (name := _holding(free, joint))]
    return tuple(matches) if matches and len(set(matches)) == len(joints) else None


def _holding(names: Sequence[str], joint: str) -> str | None:
    pattern = re.compile(rf"(?:^|[^A-Za-z0-9]){re.escape(joint)}(?:$|[^A-Za-z0-9])", re.IGNORECASE)
    matching = [name for name in names if pattern.search(f" {name} ")]
    return min(matching, key=len) if matching else None


def _match_by_cells(
    names: Sequence[str], data: Sequence[Sequence[str]], joints: Sequence[str]
) -> tuple[str, ...] | None:
    """Return columns ``position0 ..`` next to columns ``name0 ..`` whose cells name the joints."""
    read_by_cells = {}
    for index, name in enumerate(names):
        cells = {row[index].strip() for row in data}
        if (number := re.search(r"name\D?(\d+)\D*$", name)) and len(cells) == 1:
            read_by_cells[cells.pop()] = number[1]
    at = {match[1]: name for name in names if (match := re.search(r"position\D?(\d+)\D*$", name))}
    places_of_joints = [at.get(read_by_cells.get(joint, "")) for joint in joints]
    return tuple(places_of_joints) if places_of_joints and all(places_of_joints) else None  # type: ignore[arg-type]


def _match_by_number(names: Sequence[str], count: int) -> tuple[str, ...] | None:
    """Return the first family of names that differ in a number alone, as many as there are joints."""
    families: dict[tuple[str, str], dict[int, str]] = {}
    for name in names:
        if _NOT_POSITIONS.search(name) or not (match := _NUMBERED.fullmatch(bare_and_unit(name)[0])):
            continue
        family = families.setdefault((match["family"].casefold(), match["rest"].casefold()), {})
        family.setdefault(int(match["number"]), name)  # slides have another unit than joints that turn
    for family in families.values():
        _add_slide(family, names)
        numbers = sorted(family)
        steady = numbers == list(range(numbers[0], numbers[0] + len(numbers))) and numbers[0] in (0, 1)
        size = len(numbers)
        if steady and (size == count or (count == 0 and _FEWEST <= size <= _MOST)):
            return tuple(family[number] for number in numbers)
    return None


def _match_with_external(names: Sequence[str], joints: Sequence[str]) -> tuple[str, ...] | None:
    """Return numbered joints together with external axes E1 .., which are as many lengths as the robot has slides."""
    found = {match[1]: name for name in names if (match := _EXTERNAL.fullmatch(bare_and_unit(name)[0].strip()))}
    external = [found[number] for number in sorted(found)]
    slides = [isinstance(joint, SlideName) for joint in joints]
    is_length = all(bare_and_unit(name)[1] in (None, *_LINEAR) for name in external)
    if not external or len(external) != sum(slides) or not is_length:
        return None
    numbered = _match_by_number(names, len(joints) - len(external))
    if numbered is None:
        return None
    turning, sliding = iter(numbered), iter(external)
    return tuple(next(sliding) if is_slide else next(turning) for is_slide in slides)


def _add_slide(family: dict[int, str], names: Sequence[str]) -> None:
    """Add the column Z, a length, in place of the only number that a family of angles lacks, as of a SCARA robot."""
    if not family:
        return
    missing = set(range(min(family), max(family) + 1)) - set(family)
    slides = [name for name in names if bare_and_unit(name)[0].strip().casefold() == "z"]
    is_angle = all(bare_and_unit(name)[1] in ("deg", "rad", "mrad") for name in family.values())
    if len(missing) == len(slides) == 1 and is_angle and bare_and_unit(slides[0])[1] in ("mm", "m", "in"):
        family[missing.pop()] = slides[0]


def _called_joints(names: Sequence[str]) -> tuple[str, ...] | None:
    """Return the columns whose names end in ``_joint``, as robots of ROS have them."""
    called = [n for n in names if not _NOT_POSITIONS.search(n) and re.fullmatch(r"\w+_joint", bare_and_unit(n)[0])]
    return tuple(called) if _FEWEST <= len(called) <= _MOST else None


def _in_angles(names: Sequence[str]) -> tuple[str, ...] | None:
    """Return the run of columns in angles that is longer than an orientation, such as ``S [rad]``, ``L [rad]``.

    Some makers call their joints by letters. None if other columns hold angles too.
    """

    def is_angle(name: str) -> bool:
        bare, unit = bare_and_unit(name)
        return unit in ("rad", "deg") and bare.isidentifier() and not _NOT_POSITIONS.search(name)

    runs = [tuple(run) for turns, run in groupby(names, is_angle) if turns]
    return runs[0] if len(runs) == 1 and _ORIENTATION < len(runs[0]) <= _MOST else None


def _by_letters(names: Sequence[str]) -> tuple[str, ...] | None:
    """Return the columns S, L, U, R, B, T, the joints of Yaskawa's arms from the base on; T is then no time."""
    bare = [bare_and_unit(name)[0].strip() for name in names]
    is_clear = all(bare.count(letter) == 1 for letter in _YASKAWA)
    return tuple(names[bare.index(letter)] for letter in _YASKAWA) if is_clear else None


@dataclass(frozen=True)
class JointReadings:
    """Keys of [files.configurations] for joint readings, their description, and statements to confirm."""

    mapping: MappingKeys
    note: str
    doubts: tuple[str, ...] = ()


def configurations_of_joints(
    names: Sequence[str], data: Sequence[Sequence[str]], values: Array, meant: MappingKeys, joints: Sequence[str]
) -> JointReadings | None:
    """Return keys of [files.configurations] for joint readings; None without joints."""
    joints_found = joint_columns(names, data, values, joints)
    if joints_found is None:
        return None
    columns_of_meaning = {
        key: raw
        for key, raw in meant.items()
        if key in ("pose", "role", "time_s", "temperature_c") and raw not in joints_found.raw
    }
    columns_of_meaning |= _temperature(names, columns_of_meaning)
    units = joints_found.other_units()
    if "time_s" in columns_of_meaning:
        index = list(names).index(columns_of_meaning["time_s"])
        cells, time = [row[index] for row in data], values[:, index]
        if not all(map(str.strip, cells)) or len(set(cells)) < len(cells):
            columns_of_meaning.pop("time_s")  # repeated times define no order
        elif np.isfinite(time).all() and (unit := _unit_of_moments(float(time.max()))) is not None:
            units["time_s"] = unit
    columns = {column: raw for column, raw in {**columns_of_meaning, **joints_found.columns()}.items() if column != raw}
    if not columns and not units:
        return None  # named by the contract
    used_names = {*columns_of_meaning.values(), *joints_found.raw}
    ignore = "|".join(re.escape(name).replace("\\ ", " ") for name in names if name not in (*used_names, *_CONTRACT))
    mapping: MappingKeys = {"columns": columns, **({"units": units} if units else {})}
    mapping |= {} if "pose" in columns_of_meaning or "pose" in names else {"number_rows": {"pose": 1}}
    mapping |= {"ignore": ignore} if ignore else {}
    doubts: tuple[str, ...] = (_doubt(joints_found.units),) if joints_found.is_guess else ()
    if inputs := [name for name in names if name not in used_names and _INPUTS.search(name)]:
        doubts += (f"not read: {', '.join(inputs)}; errors are compared with each one that is taken out of ignore",)
    return JointReadings(mapping, f"joint readings of {', '.join(joints_found.names)}", doubts)


def _doubt(units: Sequence[str]) -> str:
    return f"no unit is given; joint readings are assumed to be in {' and '.join(dict.fromkeys(units))}"


def _temperature(names: Sequence[str], columns: Mapping[str, str]) -> dict[str, str]:
    """Return the column that a word of its name calls a temperature, if no column is known to be one."""
    known = "temperature_c" in columns or "temperature_c" in names
    warm = None if known else next((name for name in names if re.search(r"temperatur", name, re.IGNORECASE)), None)
    return {} if warm is None else {"temperature_c": warm}


def _unit_of_moments(largest: float) -> str | None:
    """Return the unit of times since 1970 by their size; None for seconds."""
    return next((unit for unit, factor in _PER_SECOND.items() if largest > _MOMENTS * factor), None)


def bare_joints(values: Array, joints: Sequence[str]) -> JointReadings:
    """Return keys of [files.configurations] for numbers (N, W) without names, one column per joint."""
    units = _assumed_units(np.abs(values).max(axis=0), joints)
    columns = {
        f"{name}_{_suffix(unit)}": at for at, (name, unit) in enumerate(zip(joints, units, strict=True), start=1)
    }
    other = {column: unit for column, unit in zip(columns, units, strict=True) if unit != _suffix(unit)}
    note = f"numbers without names, as many as joints: {', '.join(joints)}"
    mapping: MappingKeys = {"columns": columns, **({"units": other} if other else {}), "number_rows": {"pose": 1}}
    return JointReadings(mapping, note, (_doubt(units),))
