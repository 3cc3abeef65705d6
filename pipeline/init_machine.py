"""[mechanism] from tables of nominal geometry among raw files of `truing init`: rows of a chain, or legs."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from truing.arrays import TableRow
    from truing.formats.guess import Guess, MappingKeys

MARK = "# check:"
OF_ANY_CHAIN = (
    ("# gravity = [0.0, 0.0, -1.0]", "in the base frame; absent: effects of weight are not tested"),
    ("# [mechanism.tolerance]", "one standard deviation; absent: joint zeros exact, links free"),
    ("# offset_deg = 0.05", ""),
)
_BODIES_OF_LEGS = {
    "base": r"(base|basis|bottom|lower|fixed|ground|gestell|fest|unten|sockel|socle)(?![^\W\d_])",
    "platform": r"(platform|plattform|plate-?forme|plate|platte|moving|upper|top|oben|mobile?|nacelle)(?![^\W\d_])",
}
_JOINT = re.compile(r"(?!(?:command|motor|load|measured|deviation|temperature|rho\d+)_)([^\W\d]\w*?)_(?:deg|rad|mm)")


def of_table(guesses: Sequence[Guess]) -> Guess | None:
    """The only table of Denavit and Hartenberg among the files; None without a single one."""
    tables = [guess for guess in guesses if "dh" in guess.machine]
    return tables[0] if len(tables) == 1 else None


def gives_machine(guess: Guess, guesses: Sequence[Guess], *, is_described: bool) -> bool:
    """True if [mechanism] holds what a file says of the nominal geometry.

    is_described: whether the folder holds a robot's description, which has precedence.
    """
    if "legs" in guess.machine:
        return sum("legs" in one.machine for one in guesses) == 1
    table = None if is_described else of_table(guesses)
    return table is not None and (guess is table or guess is _masses_of(table, guesses))


def _in_frame_of_joint(row: TableRow, mass: TableRow) -> TableRow:
    """The mass of a link with its centre (mm) in the frame of the joint, as com_mm takes it; tables give it in the
    frame of Denavit and Hartenberg, behind the constant part of the row."""
    if not mass:
        return {}
    x, y, z = mass["com_mm"]
    if row.get("convention") != "modified":
        turn = math.radians(row["alpha_deg"])
        x += row["a_mm"]
        y, z = y * math.cos(turn) - z * math.sin(turn), y * math.sin(turn) + z * math.cos(turn)
    z += row["d_mm"] if row.get("kind", "revolute") == "revolute" else 0.0
    return {**mass, "com_mm": [round(length, 6) + 0.0 for length in (x, y, z)]}


def _masses_of(table: Guess, guesses: Sequence[Guess]) -> Guess | None:
    """The only table of masses of as many links as a table of Denavit and Hartenberg has rows."""
    masses = [guess for guess in guesses if len(guess.machine.get("masses", ())) == len(table.machine["dh"])]
    return masses[0] if len(masses) == 1 else None


def rows_of_table(table: Guess, guesses: Sequence[Guess]) -> Iterator[tuple[str, str]]:
    """Lines and remarks of [mechanism] by a table of Denavit and Hartenberg, with the masses of another table."""
    rows = table.machine["dh"]
    masses = _masses_of(table, guesses)
    with_masses = [{}] * len(rows) if masses is None else masses.machine["masses"]
    doubts = [*table.doubts, *(way.doubt for way in table.ways), *(() if masses is None else masses.doubts)]
    if doubts:
        yield f"{MARK} {'; '.join(doubts)}", ""
    yield "[mechanism]", ""
    yield 'type = "chain"', ""
    if joints := _names_of_joints(guesses, len(rows)):
        yield f"joints = {json.dumps(joints, ensure_ascii=False)}", ""
    yield "dh = [", "one row per joint; the last link is tip"
    for row, mass in zip(rows, with_masses, strict=True):
        yield f"  {_inline({**row, **_in_frame_of_joint(row, mass)})},", ""
    yield "]", ""
    payload = {} if masses is None else masses.machine.get("payload", {})
    yield from ((f"{key} = {as_toml(value)}", "") for key, value in payload.items())
    yield from OF_ANY_CHAIN


def slides_of_log(guesses: Sequence[Guess]) -> list[tuple[str, str]]:
    """Lines and remarks of [mechanism] for the linear axes of the only log of such; empty without a single one."""
    logs = [guess for guess in guesses if "screws" in guess.machine]
    if len(logs) != 1:
        return []
    machine = logs[0].machine
    return [
        (f"{MARK} x is assumed to carry y, and y to carry z", ""),
        ("[mechanism]", ""),
        ('type = "chain"', ""),
        (f"joints = {json.dumps(machine['joints'])}", ""),
        ("screws = [", "the axes in order, each carried by the one before"),
        *((f"  {_inline(screw)},", "") for screw in machine["screws"]),
        ("]", ""),
        ("home = { position_mm = [0.0, 0.0, 0.0] }", "place of the tip at positions zero; the last link is tip"),
        ("# [mechanism.tolerance]", "one standard deviation; absent: links free"),
        ("# length_mm = 0.1", ""),
    ]


def _names_of_joints(guesses: Sequence[Guess], count: int) -> list[str]:
    """Joints by the columns of a log, if these are not called joint1, joint2, ...; empty without as many."""
    joint_columns = [column for guess in guesses if guess.table == "configurations" for column in columns_of(guess)]
    found = [match[1] for column in joint_columns if (match := _JOINT.fullmatch(column))]
    is_like = len(found) == count and found != [f"joint{number}" for number in range(1, count + 1)]
    return found if is_like else []


def legs_of_table(guesses: Sequence[Guess]) -> list[tuple[str, str]]:
    """Lines and remarks of [mechanism] by the only table of legs; empty without a single one."""
    tables = [guess for guess in guesses if "legs" in guess.machine]
    if len(tables) != 1:
        return []
    (table,) = tables
    return [
        *([(f"{MARK} {'; '.join(table.doubts)}", "")] if table.doubts else []),
        ("[mechanism]", ""),
        (f"type = {as_toml(table.machine['type'])}", "legs of variable length"),
        ("reference_temperature_c = 20.0", ""),
        ("legs = [", "in leg order; a in the base frame, b in the platform's"),
        *((f"  {_inline(leg)},", "") for leg in table.machine["legs"]),
        ("]", ""),
        ("# [mechanism.tolerance]", "one standard deviation of manufacturing and assembly"),
        ("# a_mm = 0.5", "and b_mm, length_mm"),
    ]


def with_bodies_of_legs(guesses: Sequence[Guess]) -> list[Guess]:
    """Proposals whose bodies have the names of a machine on legs, base and platform, if a file gives its legs.

    A body that each entry names as a constant, such as ``Base`` or ``Top plate``, is one of them by its first word.
    """
    named = [(guess.mapping.get("constants") or {}).get("body") for guess in guesses]
    is_machine = sum("legs" in guess.machine for guess in guesses) == 1
    bodies = {body: body_of_legs(str(body)) for body in named if body is not None}
    if not is_machine or len(bodies) != len(_BODIES_OF_LEGS) or set(bodies.values()) != set(_BODIES_OF_LEGS):
        return list(guesses)
    return [
        guess if body is None else replace(guess, mapping=_of_body(guess.mapping, str(bodies[body])))
        for guess, body in zip(guesses, named, strict=True)
    ]


def body_of_legs(name: str) -> str | None:
    """Body of a machine on legs, base or platform, by the first word of another name for it; else None."""
    return next((body for body, words in _BODIES_OF_LEGS.items() if re.match(words, name, re.IGNORECASE)), None)


def _of_body(mapping: MappingKeys, body: str) -> MappingKeys:
    return {**mapping, "constants": {**mapping["constants"], "body": body}}


def columns_of(guess: Guess) -> tuple[str, ...]:
    """Columns that a file gives, by the names of the contract and by its own."""
    groups = [
        name for pattern in guess.mapping.get("split", {}).values() for name in re.findall(r"\(\?P<(\w+)>", pattern)
    ]
    return (*guess.columns, *guess.mapping.get("columns", {}), *groups)


def _inline(row: Mapping[str, object]) -> str:
    """A row of [mechanism] as an inline table; its keys are bare."""
    return "{ " + ", ".join(f"{key} = {as_toml(value)}" for key, value in row.items()) + " }"


def as_toml(value: object) -> str:
    """A value of a mapping as TOML."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{as_toml(str(key))} = {as_toml(inner)}" for key, inner in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(as_toml, value)) + "]"
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
