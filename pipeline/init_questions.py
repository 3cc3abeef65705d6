"""Questions of `truing init`: what a raw file leaves open, and the answers, by options or on a terminal."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import ValidationError

from truing.formats.guess import MappingKeys
from truing.formats.raw_tables import COORDINATES
from truing.formats.units import UnknownUnit, conversion, dimension
from truing.pipeline.campaign_template import assumed_unit, has_open_rotation, taken_unit, unread_units
from truing.schemas.columns import find_column
from truing.schemas.faults import CampaignFaults, Fault
from truing.schemas.near_names import did_you_mean
from truing.schemas.sections import MeasuredPoses

if TYPE_CHECKING:
    from truing.formats.guess import Guess

OPTION = "--answer"
PLACEHOLDER = "body"  # name of a body that no file names
TARGET = "reflector"  # name of the only target of a body
NUMBER_OF_POSE = r".*?(?P<pose>\d+)"  # in the name of a measured place
_LOAD_AXES = ("fx", "fy", "fz", "mx", "my", "mz")
_CONSTANTS = {
    "body": "Name of the rigid body that carries all these targets",
    "channel": "Channel of these readings",
    "load_axis": "Component of the load",
    "load": "Load of all rows, N or N m",
    "run": "Name of the run that all rows belong to",
    "pose": "Number of the pose that all rows belong to",
}
_EULER = {"rx_rad": "euler_a_deg", "ry_rad": "euler_b_deg", "rz_rad": "euler_c_deg"}
_UNIT_OF = "unit_of_"  # before the dimension of columns whose heads name an unknown unit
_UNITS_OF = tuple(
    f"{_UNIT_OF}{one}" for one in ("length", "angle", "force", "torque", "voltage", "time", "temperature")
)
_KEYS = (
    *(
        "decimal",
        "convention",
        "loads",
        "join",
        "numbers",
        "words",
        "groups",
        "axis",
        "sign",
        "table",
        "unit",
        "rotation",
        "euler",
        "approach",
    ),
    "coverage",
    *_CONSTANTS,
    *_UNITS_OF,
)


@dataclass(frozen=True)
class Question:
    """An open point of a raw file: key and text, the value that is taken (empty: none), and all values if few."""

    key: str
    text: str
    taken: str
    values: tuple[str, ...] = ()

    def expected(self, answer: str) -> str | None:
        """Expected form of an answer; None if it is valid."""
        if self.values:
            return None if answer in self.values else " or ".join(self.values)
        if self.key == "unit":
            try:
                conversion(answer, "mm")
            except UnknownUnit:
                return "a unit of length, such as mm, m, um or in"
            return None
        if self.key == "euler":
            return _fault_of_order(answer)
        if self.key.startswith(_UNIT_OF):
            return _fault_of_unit(answer, self.key.removeprefix(_UNIT_OF))
        if self.key in ("coverage", "load"):
            return None if _is_number(answer, positive=self.key == "coverage") else f"a number, such as {self.taken}"
        return None if answer.isprintable() and answer.strip() else "a name"

    @property
    def prompt(self) -> str:
        """The question on a terminal, with the value that Enter takes."""
        values = f" ({' or '.join(self.values)})" if self.values else ""
        return f"  {self.text}{values} [{self.taken or 'say it later'}]: "


Ask = Callable[[Question], str | None]


@dataclass
class Answers:
    """Answers to questions, by glob (empty: any file) and key; ``ask`` returns None without a terminal."""

    given: dict[tuple[str, str], str] = field(default_factory=dict)
    ask: Ask = lambda _: None
    used: dict[tuple[str, str], str] = field(default_factory=dict)
    met: dict[tuple[str, str], Question] = field(default_factory=dict)
    faults: list[Fault] = field(default_factory=list)
    _spent: set[tuple[str, str]] = field(default_factory=set)

    def settled(self, glob: str, guess: Guess, *, is_only_table: bool) -> Guess:
        """A guess with every open point answered that has an answer; others stay marked as guesses."""
        passed: set[str] = set()
        while question := next(
            (q for q in questions(guess, is_only_table) if q.key not in guess.answered | passed), None
        ):
            self.met[glob, question.key] = question
            answer = self._answer(glob, question)
            if answer is None:
                passed.add(question.key)
                continue
            self.used[glob, question.key] = answer
            guess = _answered(guess, question.key, answer)
        return guess

    def _answer(self, glob: str, question: Question) -> str | None:
        place = next((place for place in ((glob, question.key), ("", question.key)) if place in self.given), None)
        if place is None:
            return self.ask(question)
        self._spent.add(place)
        answer = self.given[place]
        if (expected := question.expected(answer)) is None:
            return answer
        self.faults.append(Fault(OPTION, f"for {question.key} {expected}", value=_written(place, answer)))
        return None

    def open_points(self) -> Iterator[dict[str, object]]:
        """Yield what the files left open: the question, its possible values, the assumed one, and whether it was
        answered."""
        for (glob, key), question in self.met.items():
            answer = self.used.get((glob, key))
            fact = {"path": glob, "key": key, "question": question.text, "values": list(question.values)}
            yield {**fact, "taken": (answer or question.taken) or None, "answered": answer is not None}

    def raise_faults(self) -> None:
        """Raise CampaignFaults if an answer is invalid, or answers no question of these files."""
        open_points = ", ".join(f"{glob}:{key}" for glob, key in self.met) or "none: nothing is open in these files"
        expected = f"an answer to an open point of these files ({open_points})"
        unused = [
            Fault(OPTION, expected, value=_written(place, answer))
            for place, answer in self.given.items()
            if place not in self._spent
        ]
        if self.faults or unused:
            raise CampaignFaults([*self.faults, *unused])

    def command(self, folder: Path, *, every_key: bool) -> str:
        """Command that gives the same answers without questions."""
        words = [word for place, answer in self.used.items() for word in (OPTION, _written(place, answer))]
        return shlex.join(["truing", "init", str(folder), *(["--all"] if every_key else []), *words])


def parsed_answers(texts: Sequence[str]) -> dict[tuple[str, str], str]:
    """Answers by glob and key from ``key=value`` or ``glob:key=value``; raises CampaignFaults with all faults."""
    answers, faults = dict[tuple[str, str], str](), list[Fault]()
    for text in texts:
        place, equals, answer = text.partition("=")
        glob, _, key = place.rpartition(":")
        if not equals:
            faults.append(Fault(OPTION, "key=value or file:key=value, such as unit=m", value=text))
        elif key not in _KEYS:
            faults.append(Fault(OPTION, f"one of the keys {', '.join(_KEYS)}{did_you_mean(key, _KEYS)}", value=text))
        elif answers.setdefault((glob, key), answer) != answer:
            faults.append(Fault(OPTION, "one answer for each file and key", value=text))
    if faults:
        raise CampaignFaults(faults)
    return answers


def questions(guess: Guess, is_only_table: bool) -> Iterator[Question]:
    """Open points of a guess; ``is_only_table``: whether no other file holds points."""
    mapping = guess.mapping
    if guess.machine:
        yield from _of_ways(guess)
    if guess.table is None or guess.known:
        return
    yield from _of_ways(guess)
    if guess.table == "targets" and is_only_table and "leg" not in {*guess.columns, *mapping.get("columns", {})}:
        text = "A survey of the targets, or their points in one pose"
        others: tuple[str, ...] = ("targets", "points")
        if "target" in mapping.get("columns", {}):
            text, others = f"{text}, or one target in as many poses, numbered by its names", (*others, "poses")
        yield Question("table", text, "targets", others)
    if (unit := _open_unit(guess)) is not None:
        yield Question("unit", "Unit of the coordinates, which the file does not give; it scales all lengths", unit)
    yield from _of_unread_units(mapping)
    for of, (taken, columns) in _without_units(mapping).items():
        names = ", ".join(str(mapping["columns"][column]) for column in columns)
        yield Question(f"{_UNIT_OF}{of}", f"Unit of {names}, which the file does not give", taken)
    if has_open_rotation(mapping):
        yield Question(
            "rotation", "Three angles in rad: a rotation vector, or Euler angles", "vector", ("vector", "euler")
        )
    if "euler_a_deg" in mapping.get("columns", {}) and not guess.poses:
        text = "Order of the three Euler angles: XYZ about rotating axes, xyz about fixed axes, or other axes"
        yield Question("euler", text, "")
    if "coverage" in mapping:
        text = "Coverage factor k of the uncertainties, which are divided by it; 1: one sigma"
        yield Question("coverage", text, f"{mapping['coverage']:g}")
    for key, text in _CONSTANTS.items():
        if key in mapping.get("constants", {}):
            yield Question(key, text, str(mapping["constants"][key]), _values(key))
    if guess.table in ("points", "targets") and not names_a_body(guess):
        yield Question("body", _CONSTANTS["body"], "")


def _of_ways(guess: Guess) -> Iterator[Question]:
    return (Question(way.key, way.text, way.taken, (way.taken, way.other)) for way in guess.ways)


def _values(key: str) -> tuple[str, ...]:
    column = find_column(key) if key == "channel" else None
    return column.choices if column is not None else _LOAD_AXES if key == "load_axis" else ()


def _open_unit(guess: Guess) -> str | None:
    """Assumed unit of coordinates without any; None if it is given."""
    taken = {assumed_unit(name, guess) for name in COORDINATES} - {None}
    return taken.pop() if len(taken) == 1 else None


def _of_unread_units(mapping: MappingKeys) -> Iterator[Question]:
    """Yield one question for each dimension of columns whose heads name a unit that is not known."""
    columns: dict[str, list[str]] = {}
    for column in unread_units(mapping):
        columns.setdefault(_dimension(column), []).append(mapping["columns"][column])
    for of, names in columns.items():
        yield Question(f"{_UNIT_OF}{of}", f"Unit of {', '.join(names)}, whose heads name no known unit of {of}", "")


def _without_units(mapping: MappingKeys) -> dict[str, tuple[str, list[str]]]:
    """Assumed unit and columns of forces and torques whose names give no unit, by their dimension.

    A unit of loads scales a calibration; that of signals is only one of its numbers, so it is not asked.
    """
    found: dict[str, tuple[str, list[str]]] = {}
    unread = unread_units(mapping)
    for column, raw in mapping.get("columns", {}).items():
        of = _dimension(column)
        if of in ("force", "torque") and column not in unread and (unit := taken_unit(column, raw, mapping)):
            found.setdefault(of, (unit, []))[1].append(column)
    return found


def _dimension(column: str) -> str:
    known = find_column(column)
    return dimension(known.unit) if known is not None and known.unit else ""


def _fault_of_order(answer: str) -> str | None:
    """Expected form of an answer for the order of Euler angles; None if it is valid."""
    try:
        MeasuredPoses(euler=answer)
    except ValidationError:
        return "three axes, neighbours different, such as XYZ, zyx or ZXZ"
    return None


def _fault_of_unit(answer: str, of: str) -> str | None:
    """Expected form of an answer for a unit of a dimension; None if it is valid."""
    try:
        return None if dimension(answer) == of else f"a unit of {of}"
    except UnknownUnit as error:
        return f"a unit of {of}: {error}"


def _answered(guess: Guess, key: str, answer: str) -> Guess:
    """The guess by an answer, which is no guess any more."""
    if (way := next((way for way in guess.ways if way.key == key), None)) is not None:
        if answer == way.other:
            return replace(way.guess, answered=guess.answered | {key})
        left = tuple(one for one in guess.ways if one is not way)
        return replace(guess, ways=left, answered=guess.answered | {key})
    guess = replace(guess, answered=guess.answered | {key})
    constants = guess.mapping.get("constants", {})
    if key == "table":
        return _one_target(guess) if answer == "poses" else guess if answer == guess.table else _one_pose(guess)
    if key.startswith(_UNIT_OF):
        of = key.removeprefix(_UNIT_OF)
        columns = [column for column in unread_units(guess.mapping) if _dimension(column) == of]
        columns += _without_units(guess.mapping).get(of, ("", []))[1]
        units = {**guess.mapping.get("units", {}), **dict.fromkeys(columns, answer)}
        return replace(guess, mapping={**guess.mapping, "units": units})
    if key == "euler":
        return replace(guess, poses={"euler": answer})
    if key == "rotation":
        return _with_angles(guess, {name: name for name in _EULER} if answer == "vector" else _EULER)
    if key in _CONSTANTS:
        return replace(
            guess, mapping={**guess.mapping, "constants": {**constants, key: _typed(answer, constants.get(key))}}
        )
    return replace(guess, mapping={**guess.mapping, key: float(answer) if key == "coverage" else answer})


def _with_angles(guess: Guess, names: Mapping[str, str]) -> Guess:
    """The same columns with other names of the angles, in rad."""
    columns = {names.get(column, column): raw for column, raw in guess.mapping["columns"].items()}
    units = {**guess.mapping.get("units", {}), **dict.fromkeys(names.values(), "rad")}
    return replace(guess, mapping={**guess.mapping, "columns": columns, "units": units})


def names_a_body(guess: Guess) -> bool:
    """True if anything names the body of a file's targets."""
    mapping = guess.mapping
    if any("(?P<body>" in pattern for pattern in mapping.get("split", {}).values()):
        return True
    given = (*guess.columns, *mapping.get("columns", {}), *mapping.get("constants", {}), mapping.get("wide", ""))
    return "body" in given or "body" in mapping.get("from_name", "") or "constants" in mapping or "{body}" in given[-1]


def is_body_open(guess: Guess) -> bool:
    """True if nothing names the body of a file's targets, or a placeholder alone."""
    has_placeholder = guess.mapping.get("constants", {}).get("body") == PLACEHOLDER and "body" not in guess.answered
    return has_placeholder or not names_a_body(guess)


def without_placeholder(mapping: MappingKeys) -> MappingKeys:
    """Keys of a file without the placeholder of its body."""
    constants = {
        key: value for key, value in mapping.get("constants", {}).items() if (key, value) != ("body", PLACEHOLDER)
    }
    kept = {key: value for key, value in mapping.items() if key != "constants"}
    return {**kept, **({"constants": constants} if constants else {})}


def _one_pose(guess: Guess) -> Guess:
    """A list of targets as the points of one pose."""
    constants = {"pose": 1, **guess.mapping.get("constants", {})}
    if "body" not in {*guess.columns, *guess.mapping.get("columns", {})}:
        constants.setdefault("body", "body")
    return replace(guess, table="points", mapping={**guess.mapping, "constants": constants})


def _one_target(guess: Guess) -> Guess:
    """A list of targets as one target in as many poses, whose numbers are those of the names."""
    raw = str(guess.mapping["columns"]["target"])
    numbered = {"split": {**guess.mapping.get("split", {}), raw: NUMBER_OF_POSE}}
    return replace(guess, table="points", mapping={**of_one_target(guess, PLACEHOLDER), **numbered})


def of_one_target(guess: Guess, body: str) -> MappingKeys:
    """Keys of a file without names of targets, which are one target of a body."""
    mapping = without_placeholder(guess.mapping)
    columns = {key: name for key, name in mapping.get("columns", {}).items() if key != "target"}
    constants = {**mapping.get("constants", {}), "body": body, "target": TARGET}
    return {**mapping, "columns": columns, "constants": constants}


def _typed(answer: str, like: object) -> object:
    """An answer as a number, if the guess is a number and the answer can be one."""
    if isinstance(like, (int, float)) and _is_number(answer):
        return int(answer) if answer.strip().lstrip("+-").isdigit() else float(answer)
    return answer


def _is_number(text: str, *, positive: bool = False) -> bool:
    try:
        number = float(text)
    except ValueError:
        return False
    return abs(number) < float("inf") and (number > 0.0 or not positive)


def _written(place: tuple[str, str], answer: str) -> str:
    return f"{place[0]}:{place[1]}={answer}" if place[0] else f"{place[1]}={answer}"


def asking() -> Ask | None:
    """Function that asks on this terminal; None without a terminal."""
    return _ask if sys.stdin.isatty() and sys.stdout.isatty() else None


def _ask(question: Question) -> str | None:
    """The answer, asked until it is valid; Enter takes the guess, the end of the input leaves it a guess."""
    while True:
        try:
            answer = input(question.prompt).strip() or question.taken
            if not answer:
                return None
        except EOFError:
            sys.stdout.write("\n")
            return None
        if (expected := question.expected(answer)) is None:
            return answer
        sys.stdout.write(f"  found {answer!r}; expected {expected}\n")
