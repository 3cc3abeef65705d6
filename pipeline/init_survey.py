"""Evidence in rows for `truing init`: bodies and unit of points by a survey, and lost targets."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from truing.formats.guess import MappingKeys
from truing.formats.named_chain import is_within_metres
from truing.formats.named_columns import OF_BASE, TOOL
from truing.formats.presets import target_column
from truing.formats.proposed_poses import perhaps_in_metres
from truing.formats.units import conversion
from truing.pipeline.campaign_template import assumed_unit
from truing.pipeline.init_preview import batches
from truing.pipeline.init_questions import PLACEHOLDER, is_body_open, names_a_body, without_placeholder
from truing.pipeline.init_robot import Robot, last_link
from truing.schemas.faults import CampaignFaults

if TYPE_CHECKING:
    from truing.arrays import Array
    from truing.formats.guess import Guess
    from truing.pipeline.init_entries import RawGroup

_UNITS = ("mm", "m", "cm", "um", "in", "ft")
_WITHIN = 0.02  # of the ratio of distances
_MOST_ROWS, _MOST_PAIRS, _FEWEST_PAIRS = 400, 200, 3
_LOST, _MOST_LOOKED_AT = "0 0 0", 100_000
_MOST_FILES, _MOST_OF_GROUP = 20, 60
BASE = "base"  # first link of a table of Denavit and Hartenberg
_PLACE = ("x_mm", "y_mm", "z_mm")


@dataclass(frozen=True)
class Survey:
    """Targets of a survey: the body of each, and its place, mm; no places if their unit is a guess."""

    name: str
    bodies: Mapping[str, str]
    places: Mapping[str, Array]


def with_survey(folder: Path, guesses: Sequence[tuple[RawGroup, Guess]]) -> list[tuple[RawGroup, Guess]]:
    """Complete guesses of points by the only survey of the folder: the body of each target, and the unit."""
    surveys = [(group, guess) for group, guess in guesses if guess.table == "targets"]
    if len(surveys) != 1 or (survey := _survey(folder, *surveys[0])) is None:
        return list(guesses)
    return [(group, _completed(folder, group, guess, survey)) for group, guess in guesses]


def _survey(folder: Path, group: RawGroup, guess: Guess) -> Survey | None:
    rows = rows_of(folder, group, guess, {})
    if rows is None or len(set(rows.targets)) < len(rows.targets):
        return None
    is_sure = assumed_unit("x_mm", guess) is None
    bodies = dict(zip(rows.targets, rows.bodies, strict=True)) if names_a_body(guess) else {}
    return Survey(group.glob, bodies, dict(zip(rows.targets, rows.places, strict=True)) if is_sure else {})


def _completed(folder: Path, group: RawGroup, guess: Guess, survey: Survey) -> Guess:
    if guess.table != "points" or guess.known:
        return guess
    lacks_body = is_body_open(guess)
    rows = rows_of(folder, group, guess, {"body": PLACEHOLDER} if lacks_body else {})
    if rows is None:
        return guess
    if lacks_body and (keys := _keys_of_bodies(guess, rows.targets, survey.bodies)):
        note = f"bodies by {survey.name}"
        answered = guess.answered | {"body"}
        rows = replace(rows, bodies=[survey.bodies[target] for target in rows.targets])
        mapping = {**without_placeholder(guess.mapping), **keys}
        guess = replace(guess, mapping=mapping, notes=(*guess.notes, note), answered=answered)
    if assumed_unit("x_mm", guess) is None or (unit := _unit(rows, survey.places)) is None:
        return guess
    note = f"unit {unit}: distances between targets are then those of {survey.name}"
    return replace(
        guess, mapping={**guess.mapping, "unit": unit}, notes=(*guess.notes, note), answered=guess.answered | {"unit"}
    )


def _keys_of_bodies(guess: Guess, targets: Sequence[str], bodies: Mapping[str, str]) -> MappingKeys:
    """Return keys that give each target the body of the survey; empty if one of them is not in it."""
    present = list(dict.fromkeys(targets))
    if not present or not all(target in bodies for target in present):
        return {}
    constants, columns = guess.mapping.get("constants", {}), guess.mapping.get("columns", {})
    raw = columns.get("target") or target_column(guess.mapping.get("format", ""))
    if len({bodies[target] for target in present}) == 1:
        return {"constants": {**constants, "body": bodies[present[0]]}}
    if raw is None:
        return {}
    by_name = {re.escape(target): body for target, body in bodies.items()}
    renames = {**guess.mapping.get("rename", {}), "body": by_name}
    return {"columns": {**columns, "body": raw}, "rename": renames}


def _unit(rows: SurveyRows, places: Mapping[str, Array]) -> str | None:
    """Return the unit by which distances within poses are those between surveyed targets; None if none fits."""
    by_pose: dict[str, list[int]] = {}
    for row, (pose, target) in enumerate(zip(rows.poses, rows.targets, strict=True)):
        if target in places:
            by_pose.setdefault(pose, []).append(row)
    ratios = []
    for poses in by_pose.values():
        for i, j in combinations(poses, 2):
            if rows.bodies[i] != rows.bodies[j]:
                continue
            read = float(np.linalg.norm(rows.places[i] - rows.places[j]))
            known = float(np.linalg.norm(places[rows.targets[i]] - places[rows.targets[j]]))
            if read > 0.0 and known > 0.0:
                ratios.append(known / read)
        if len(ratios) >= _MOST_PAIRS:
            break
    if len(ratios) < _FEWEST_PAIRS:
        return None
    ratio = float(np.median(ratios))
    close = [unit for unit in _UNITS if abs(ratio / conversion(unit, "mm")[0] - 1.0) < _WITHIN]
    return close[0] if close else None


def with_lost_points(folder: Path, guesses: Sequence[tuple[RawGroup, Guess]]) -> list[tuple[RawGroup, Guess]]:
    """Declare ``0 0 0`` as missing in points in which an instrument wrote it, probably for a lost target."""
    return [(group, _without_zeros(folder, group, guess)) for group, guess in guesses]


def _without_zeros(folder: Path, group: RawGroup, guess: Guess) -> Guess:
    if guess.table != "points" or guess.known or "missing" in guess.mapping or "format" in guess.mapping:
        return guess
    constants = {} if names_a_body(guess) else {"body": PLACEHOLDER}
    examples = [group.example.parent / name for name in group.names[:_MOST_FILES]] or [group.example]
    files = (
        rows_of(folder, replace(group, example=example_file), guess, constants, most=_MOST_LOOKED_AT)
        for example_file in examples
    )
    if not any(rows is not None and (rows.places == 0.0).all(axis=1).any() for rows in files):
        return guess
    doubt = "rows with coordinates 0 0 0 are assumed to be lost targets"
    return replace(guess, mapping={**guess.mapping, "missing": [_LOST]}, doubts=(*guess.doubts, doubt))


def with_tip(folder: Path, files: Sequence[tuple[RawGroup, Guess]], robot: Robot | None) -> list[Guess]:
    """Return the guesses; points without a body, next to a robot's joints, get its last link. Points all below 10 are
    in m."""
    guesses = [guess for _, guess in files]
    tip = last_link(robot, guesses)
    if tip is None:
        return guesses
    is_lone = sum(guess.table == "poses" for guess in guesses) == 1
    links = {} if robot is not None else _ends_of_chain(guesses, tip)
    on_tip = [
        _with_lone_body(guess, tip)
        if is_lone and guess.table == "poses"
        else _on_last_link(folder, group, _on_end(guess, links), tip)
        for group, guess in files
    ]
    names = [_names_on(folder, group, guess, tip) for (group, _), guess in zip(files, on_tip, strict=True)]
    return [
        _survey_on(folder, group, guess, tip, set().union(*names))
        for (group, _), guess in zip(files, on_tip, strict=True)
    ]


def _names_on(folder: Path, group: RawGroup, guess: Guess, link: str) -> set[str]:
    """Names of the points that a file has on a link."""
    if guess.table != "points" or guess.mapping.get("constants", {}).get("body") != link:
        return set()
    rows = rows_of(folder, group, guess, {})
    return set() if rows is None else set(rows.targets)


def _survey_on(folder: Path, group: RawGroup, guess: Guess, link: str, names: set[str]) -> Guess:
    """The guess of a survey without a body, all of whose targets are among the points on a link."""
    if guess.table != "targets" or guess.known or not is_body_open(guess):
        return guess
    rows = rows_of(folder, group, guess, {"body": PLACEHOLDER})
    if rows is None or not set(rows.targets) or not set(rows.targets) <= names:
        return guess
    constants = {**guess.mapping.get("constants", {}), "body": link}
    note = f"targets of {link}, as the points of the same names"
    mapping = {**guess.mapping, "constants": constants}
    return replace(guess, mapping=mapping, notes=(*guess.notes, note), answered=guess.answered | {"body"})


def _ends_of_chain(guesses: Sequence[Guess], tip: str) -> dict[str, str]:
    """Link of each of two measured bodies, of which one is called the base: ``base``, and the last link."""
    bodies = [str(g.mapping.get("constants", {}).get("body", "")) for g in guesses if g.table == "poses"]
    fixed = [body for body in bodies if OF_BASE.fullmatch(body)]
    if len(bodies) != 2 or len(fixed) != 1:
        return {}
    return {body: BASE if body in fixed else tip for body in bodies}


def _on_end(guess: Guess, links: Mapping[str, str]) -> Guess:
    """The guess of poses of a body with the link that it is fixed to."""
    constants = guess.mapping.get("constants", {})
    body = constants.get("body", "")
    if guess.table != "poses" or links.get(body, body) == body:
        return guess
    doubts = (*guess.doubts, f"body {body} of the file is assumed to be fixed to link {links[body]}")
    return replace(guess, mapping={**guess.mapping, "constants": {**constants, "body": links[body]}}, doubts=doubts)


def _with_lone_body(guess: Guess, tip: str) -> Guess:
    """The guess of poses whose only body is taken to be fixed to the last link, whatever the instrument calls it."""
    body = guess.mapping.get("constants", {}).get("body", tip)
    if body == tip:
        return guess
    doubts = () if body == TOOL else (f"body {body} of the file is assumed to be fixed to link {tip}",)
    constants = {**guess.mapping["constants"], "body": tip}
    return replace(guess, mapping={**guess.mapping, "constants": constants}, doubts=(*guess.doubts, *doubts))


def _on_last_link(folder: Path, group: RawGroup, guess: Guess, tip: str) -> Guess:
    constants = guess.mapping.get("constants", {})
    on_tip = replace(guess, mapping={**guess.mapping, "constants": {**constants, "body": tip}})
    if guess.table == "poses" and constants.get("body") == TOOL:
        return on_tip
    if guess.table != "points" or guess.known or not is_body_open(guess):
        return guess
    rows = rows_of(folder, group, guess, {"body": PLACEHOLDER})
    in_metres = rows is not None and assumed_unit("x_mm", guess) == "mm" and is_within_metres(rows.places)
    return perhaps_in_metres(on_tip, in_metres)


@dataclass(frozen=True)
class SurveyRows:
    """Rows of a table of points: names as text, and places (N, 3) in mm."""

    poses: list[str]
    bodies: list[str]
    targets: list[str]
    places: Array


def rows_of(
    folder: Path, group: RawGroup, guess: Guess, constants: Mapping[str, str | int], most: int = _MOST_ROWS
) -> SurveyRows | None:
    """Return the first rows of a file by a guess; None if it cannot be read so."""
    added = {**guess.mapping.get("constants", {}), **constants}
    mapping = {**guess.mapping, "constants": added} if added else guess.mapping
    texts: dict[str, list[str]] = {"pose": [], "body": [], "target": []}
    places: list[Array] = []
    try:
        for batch in batches(folder, group.example, str(guess.table), "photogrammetry", mapping):
            names, count = batch.columns, min(batch.rows, most - len(texts["target"]))
            if not {"target", *_PLACE} <= set(names):
                return None
            for name, values in texts.items():
                values += map(str, names[name].slice(0, count).to_pylist()) if name in names else [""] * count
            columns = [np.array(names[name].slice(0, count).to_pylist(), dtype=float) for name in _PLACE]
            places.append(np.column_stack(columns))
            if len(texts["target"]) >= most:
                break
    except CampaignFaults:
        return None
    all_places = np.concatenate(places) if places else np.empty((0, len(_PLACE)))
    return SurveyRows(texts["pose"], texts["body"], texts["target"], all_places) if len(all_places) else None


def rows_of_files(
    folder: Path, group: RawGroup, guess: Guess, constants: Mapping[str, str | int], most: int = _MOST_ROWS
) -> SurveyRows | None:
    """The rows of the first files of a group, one after the other; None if one of them cannot be read."""
    examples = [group.example.parent / name for name in group.names[:_MOST_OF_GROUP]] or [group.example]
    read = [
        rows_of(folder, replace(group, example=example_file), guess, constants, most=most) for example_file in examples
    ]
    parts = [rows for rows in read if rows is not None]
    if len(parts) < len(read) or not parts:
        return None
    return SurveyRows(
        [pose for rows in parts for pose in rows.poses],
        [body for rows in parts for body in rows.bodies],
        [target for rows in parts for target in rows.targets],
        np.concatenate([rows.places for rows in parts]),
    )
