"""Proposals for tables of poses and of joint readings, alone or side by side in the same rows."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from truing.arrays import Array
from truing.formats.guess import Guess, MappingKeys, OtherWay
from truing.formats.named_chain import LINK, ChainRows, controller_columns, is_within_metres
from truing.formats.named_columns import SHIFTS, PoseMapping, poses_side_by_side
from truing.formats.named_joints import JointReadings, configurations_of_joints
from truing.formats.probable_columns import columns_by_names
from truing.formats.raw_tables import COORDINATES
from truing.formats.units import bare_and_unit

_SEVERAL = 2
_OF_BODIES = r"body|(rigid|tracked)[ _]?body|model|object|subject|segment|tool|k(ö|oe)rper"
_COUNTER = r"no|nr|number|index|#|id|i|stage|stufe|epoche?"  # names of a column that may number poses


@dataclass(frozen=True)
class NamedCells:
    """Names of W columns, N rows of cells, and their numbers (N, W), NaN for other cells."""

    names: tuple[str, ...]
    rows: list[list[str]]
    values: Array

    def texts(self, name: str) -> list[str]:
        """Return the cells of a column."""
        column = self.names.index(name)
        return [row[column] for row in self.rows]

    def numbers(self, name: str) -> Array:
        """Return the numbers (N,) of a column."""
        return self.values[:, self.names.index(name)]

    def of(self, some: Sequence[str]) -> tuple[list[list[str]], Array]:
        """Return the cells and numbers of some columns."""
        columns = [self.names.index(name) for name in some]
        return [[row[column] for column in columns] for row in self.rows], self.values[:, columns]

    def without_empty_columns(self) -> NamedCells:
        """Return the columns that hold anything: an empty one is no name, no coordinate and no reading."""
        kept = [place for place in range(len(self.names)) if any(row[place].strip() for row in self.rows)]
        if len(kept) == len(self.names):
            return self
        rows = [[row[place] for place in kept] for row in self.rows]
        return NamedCells(tuple(self.names[place] for place in kept), rows, self.values[:, kept])

    @property
    def has_empty(self) -> bool:
        """True if any cell is empty."""
        return any(not cell.strip() for row in self.rows for cell in row)


def proposal_of_joints(read: JointReadings, mapping: MappingKeys, names: tuple[str, ...], **more: Any) -> Guess:
    return Guess({**mapping, **read.mapping, **more}, names, "configurations", (read.note,), doubts=read.doubts)


def doubt_on_computed_poses(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the doubt on coordinates next to joint readings that are probably no measurement."""
    if not (found := controller_columns(names)):
        return ()
    text = f"{', '.join(found)} are assumed to be computed by the controller from its joints, and are not read"
    return (f"{text} (measured by an instrument: rename them x, y, z)",)


def proposal_of_chain(rows: ChainRows, mapping: MappingKeys, names: tuple[str, ...]) -> Guess:
    """Return the proposal for rows of joint readings and points: points, and configurations of the same rows."""
    other_tables = (proposal_of_joints(rows.joints, mapping, names),)
    guess = Guess(
        {**mapping, **rows.points}, names, "points", (rows.note,), other_tables=other_tables, doubts=rows.doubts
    )
    return perhaps_in_metres(guess, rows.in_metres)


def perhaps_in_metres(guess: Guess, in_metres: bool) -> Guess:
    """Return a proposal whose coordinates without a unit are taken for m where that is more probable than mm."""
    if not in_metres:
        return guess
    text = "Unit of the coordinates, which the file does not give; it scales all lengths"
    doubt = "no unit is given; coordinates below 10 next to joints of a robot are assumed to be in m"
    taken = replace(guess, mapping={**guess.mapping, "unit": "m"})
    return replace(taken, ways=(OtherWay("unit", text, "m", "mm", guess, doubt),))


def proposal_of_bodies(cells: NamedCells, mapping: MappingKeys) -> Guess | None:
    """Return a proposal for the poses of several bodies side by side, an entry for each; None without them."""
    names, bodies = cells.names, poses_side_by_side(cells.names, cells.values)
    if len(bodies) < _SEVERAL:
        return None
    names_used = {name for poses in bodies for name in poses.taken}
    unused_names = tuple(name for name in names if name not in names_used)
    meant = columns_by_names(unused_names)[0].get("columns", {})
    number = {"pose": meant["pose"]} if "pose" in meant else column_that_counts(cells, unused_names)
    more = {} if number or "pose" in names else {"number_rows": {"pose": 1}}
    proposals = [
        Guess({**mapping, **p.mapping, "columns": {**number, **p.mapping["columns"]}, **more}, names, "poses", p.notes)
        for p in bodies
    ]
    proposals = [replace(guess, answered=frozenset({"body"})) for guess in proposals]  # by the names of the columns
    return replace(proposals[0], other_tables=tuple(proposals[1:]))


def proposal_of_poses(poses: PoseMapping, cells: NamedCells, mapping: MappingKeys, joints: Sequence[str]) -> Guess:
    """Return a proposal for poses, and for the configurations that other columns of the same rows form."""
    keys, names = dict(poses.mapping), cells.names
    unused_names = tuple(name for name in names if poses.taken and name not in poses.taken)
    meant = columns_by_names(unused_names)[0].get("columns", {})
    reported = {key: raw for key, raw in meant.items() if key in ("pose", "time_s", "temperature_c")}
    number = {"pose": reported["pose"]} if "pose" in reported else column_that_counts(cells, unused_names)
    if number or "pose" in names:
        keys["columns"] = {**number, **keys["columns"]}
    elif poses.taken:
        keys["number_rows"] = {"pose": 1}
    body = _body_column(cells, unused_names)
    if body is not None:
        keys["columns"] = {"body": body[0], **keys["columns"]}
        keys.pop("constants", None)
    only = _only_body(cells, unused_names)
    named = frozenset[str]()
    if only is not None and "constants" in keys:
        keys, named = keys | {"constants": {"body": only}}, frozenset({"body"})
    inputs = [name for name in unused_names if name not in number.values() and np.isfinite(cells.numbers(name)).any()]
    if not inputs:
        return Guess({**mapping, **keys}, names, "poses", poses.notes, answered=named)
    repeated = _repeated_times(cells, reported, body)
    ignore = "|".join(re.escape(name).replace("\\ ", " ") for name in (*poses.taken, *repeated))
    readings = configurations_of_joints(unused_names, *cells.of(unused_names), {**meant, **number}, joints)
    if readings is not None:
        return _poses_beside_joints(poses, keys, cells, mapping, (readings, ignore))
    numbered = {key: keys[key] for key in ("number_rows",) if key in keys}
    reported = {key: raw for key, raw in reported.items() if raw not in repeated}
    one_body = {"select": {body[0]: re.escape(body[1])}} if body is not None else {}  # a row for each pose
    entry = {**mapping, **({"columns": reported} if reported else {}), **numbered, **one_body, "ignore": ignore}
    text = f"what else there is, pose by pose: {', '.join(inputs[:8])}{', ...' if len(inputs) > 8 else ''}"
    other_tables = (Guess(entry, names, "configurations", (text,)),)
    return Guess({**mapping, **keys}, names, "poses", poses.notes, other_tables=other_tables, answered=named)


def _repeated_times(cells: NamedCells, reported: Mapping[str, str], body: tuple[str, str] | None) -> list[str]:
    """Return the column of times of a body's rows if it repeats times, which then define no order."""
    if "time_s" not in reported:
        return []
    times, names = cells.texts(reported["time_s"]), cells.texts(body[0]) if body is not None else None
    if names is not None and body is not None:
        times = [time for time, name in zip(times, names, strict=True) if name.strip() == body[1]]
    return [reported["time_s"]] if len(set(times)) < len(times) else []


def _poses_beside_joints(
    poses: PoseMapping,
    keys: MappingKeys,
    cells: NamedCells,
    mapping: MappingKeys,
    read: tuple[JointReadings, str],
) -> Guess:
    """Return a proposal for poses of a robot's link, and for its joint readings in the same rows.

    read: joint readings, and the pattern of the columns that they ignore.
    """
    readings, ignore = read
    skipped = "|".join(filter(None, [ignore, readings.mapping.get("ignore")]))
    other_tables = proposal_of_joints(readings, mapping, cells.names, ignore=skipped)
    keys = keys | ({"constants": {"body": LINK}} if "constants" in keys else {})
    guess = Guess({**mapping, **keys}, cells.names, "poses", poses.notes, other_tables=(other_tables,))
    shifts = COORDINATES if COORDINATES[0] in keys["columns"] else SHIFTS
    is_in_rad = any(column.endswith("_rad") for column in readings.mapping["columns"])
    is_bare = "unit" not in keys and bare_and_unit(keys["columns"][shifts[0]])[1] is None
    in_metres = is_within_metres(cells.of([keys["columns"][column] for column in shifts])[1])
    return perhaps_in_metres(guess, is_bare and is_in_rad and in_metres)


def _only_body(cells: NamedCells, unused_names: Sequence[str]) -> str | None:
    """Return the body that a column names equally in every row; None without such a column."""
    for name in unused_names:
        bodies = {text.strip() for text in cells.texts(name)}
        body = bodies.pop() if len(bodies) == 1 else ""
        if re.fullmatch(_OF_BODIES, bare_and_unit(name)[0], re.IGNORECASE) and re.search(r"[^\W\d_]", body):
            return body
    return None


def _body_column(cells: NamedCells, unused_names: Sequence[str]) -> tuple[str, str] | None:
    """Return the column that names the body of each row, and its first body; None if it names fewer than two."""
    for name in unused_names:
        bodies = [text.strip() for text in cells.texts(name)]
        if re.fullmatch(_OF_BODIES, bare_and_unit(name)[0], re.IGNORECASE) and _SEVERAL <= len(set(bodies)) < len(
            bodies
        ):
            return name, bodies[0]
    return None


def column_that_counts(cells: NamedCells, unused_names: Sequence[str]) -> dict[str, str]:
    """Return the column that numbers the rows from its own start, by its name and its numbers."""
    for name in unused_names:
        column = cells.numbers(name)
        if re.fullmatch(_COUNTER, name.strip(" .").casefold()) and np.array_equal(
            np.diff(column), np.ones(len(column) - 1)
        ):
            return {"pose": name}
    return {}
