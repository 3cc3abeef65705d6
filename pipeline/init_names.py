"""Poses and bodies in names of groups and targets, for `truing init`; distances between targets decide."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from truing.formats.guess import OtherWay
from truing.formats.presets import target_column
from truing.pipeline.init_questions import is_body_open, names_a_body, without_placeholder
from truing.pipeline.init_survey import SurveyRows, rows_of, rows_of_files

if TYPE_CHECKING:
    from truing.arrays import Array
    from truing.formats.guess import Guess
    from truing.pipeline.init_entries import RawGroup

_WORD = r"(?:pose?|position|shot|set|epoch|frame|meas|messung|stellung|aufnahme|lage)"
_BETWEEN = r"[\s_.\-#]*"
_OF_GROUPS = (  # Base_pose01, pose01 Base, Base 1
    rf"(?P<body>.*?){_BETWEEN}{_WORD}{_BETWEEN}(?P<pose>\d+)",
    rf"{_WORD}{_BETWEEN}(?P<pose>\d+)[\s_.\-]+(?P<body>.*[^\W\d].*)",
    r"(?P<body>.*[^\W\d])[\s_.\-#]+[pm](?P<pose>\d+)",  # Base_P01
    rf"(?P<body>.*[^\W\d]){_BETWEEN}(?P<pose>\d+)",
)
_WITHOUT_WORD = _OF_GROUPS[-2:]  # numbers that may be those of bodies
_OF_TARGETS = (  # P3_base12, P003_1, base12_P3
    r"[^\W\d]*?(?P<pose>\d+)[\s_.\-]+(?P<target>.*[^\W\d].*)",
    r"[^\W\d]*?(?P<pose>\d+)[\s_.\-]+(?P<target>\d+)",
    r"(?P<target>.*\d)[\s_.\-]+[^\W\d]*?(?P<pose>\d+)",
)
_PREFIX = r"(?P<body>[^\W\d_]+)[\s_.\-]*\d.*"
_OF_BODIES = (  # base12 or base_12, base B12, leg1_L101
    _PREFIX,
    r"(?P<body>[^\W_]*[^\W\d_])[\s_.:\-]+(?P<target>\S.*)",
    r"(?P<body>[^\W\d_][^\W_]*)[\s_.:\-]+(?P<target>[^\W\d_]+\d\S*)",
)
_RIGID = 0.01  # change of distances, of their size: more is no body
_OF_SIGMA = 2.5631  # from the 10 % to the 90 % quantile of a normal distribution
_OF_MEDIAN = 1.4826  # from the median absolute deviation to the standard deviation of a normal distribution
_ROUNDED = 1e-6  # changes of distances that rounding makes, of their size
_APART = 5.0  # ratio of changes between and within bodies
_MOST_TARGETS = 60
_FEWEST, _MOST_PAIRS, _MOST_ROWS = 3, 200, 20_000
_File = tuple["RawGroup", "Guess"]


@dataclass(frozen=True)
class _Reading:
    """Names read by a pattern: body, pose and target of each row, and the rms change of distances within bodies."""

    pattern: str
    bodies: list[str]
    poses: list[str]
    targets: list[str]
    change: float
    size: float

    @property
    def words(self) -> str:
        """The evidence: how much distances within a body change."""
        return f"distances between targets of a body stay the same within {self.change:.2g} of {self.size:.0f}"


def with_poses_of_names(folder: Path, files: Sequence[_File]) -> list[_File]:
    """Take names such as ``Base_pose01`` or ``P3_base12`` apart into pose, body and target, if distances agree."""
    return [(group, _with_poses(folder, group, guess)) for group, guess in files]


def _with_poses(folder: Path, group: RawGroup, guess: Guess) -> Guess:
    columns = guess.mapping.get("columns", {})
    raw = columns.get("target")
    has_pose = "pose" in {*columns, *guess.columns, *guess.mapping.get("number_rows", {})} or any(
        "(?P<pose>" in text for text in (guess.mapping.get("from_name", ""), *guess.mapping.get("split", {}).values())
    )
    if guess.table not in ("points", "targets") or guess.known or has_pose or "format" in guess.mapping or raw is None:
        return guess
    constants: dict[str, str | int] = {"pose": 1}
    constants |= {} if names_a_body(guess) else {"body": "body"}
    rows = rows_of(folder, group, replace(guess, table="points"), constants, most=_MOST_ROWS)
    if rows is None:
        return guess
    if names_a_body(guess):
        return _by_groups(guess, rows)
    return _by_targets(guess, rows, raw)


def _by_groups(guess: Guess, rows: SurveyRows) -> Guess:
    """The guess with poses in the names of its groups; numbers without a word may be bodies instead."""
    best = _best(_OF_GROUPS, rows.bodies, rows)
    if best is None:
        return guess
    note = f"groups such as {rows.bodies[0]} are read as body and pose: {best.words}"
    columns, split = dict(guess.mapping.get("columns", {})), dict(guess.mapping.get("split", {}))
    raw = columns.pop("body", None)
    pattern = best.pattern if all(best.bodies) else best.pattern.replace("?P<body>", "?:")
    if raw is None:  # the group is a part of a longer name
        split = {name: text.replace("(?P<body>", "(?P<group>") for name, text in split.items()}
        raw = "group"
    keys = {**guess.mapping, "columns": columns, "split": {**split, raw: f"(?i){pattern}"}}
    doubt = f"numbers in groups such as {rows.bodies[0]} are assumed to be poses"
    question = f"{rows.bodies[0]}: its number is that of the pose, or part of the name of the body"
    as_poses = replace(guess, table="points", mapping=keys, notes=(*guess.notes, note))
    if best.pattern not in _WITHOUT_WORD:  # the names say pose, and distances agree
        return as_poses
    if len(set(best.bodies)) == 1:  # leg1, leg2, ...: bodies of the same shape
        doubt = f"numbers in groups such as {rows.bodies[0]} are assumed to name bodies"
        return replace(guess, ways=(*guess.ways, OtherWay("numbers", question, "bodies", "poses", as_poses, doubt)))
    return replace(as_poses, ways=(*guess.ways, OtherWay("numbers", question, "poses", "bodies", guess, doubt)))


def _by_targets(guess: Guess, rows: SurveyRows, raw: str) -> Guess:
    """The guess with poses in the names of its targets."""
    best = _best(_OF_TARGETS, rows.targets, rows)
    if best is None:
        return guess
    columns = {key: name for key, name in guess.mapping["columns"].items() if key != "target"}
    split = {**guess.mapping.get("split", {}), raw: best.pattern}
    note = f"names such as {rows.targets[0]} are read as pose and target: {best.words}"
    doubt = f"numbers in names such as {rows.targets[0]} are assumed to be poses"
    question = f"{rows.targets[0]}: its number is that of the pose, or part of the name of the target"
    way = OtherWay("numbers", question, "poses", "targets", guess, doubt)
    keys = {**guess.mapping, "columns": columns, "split": split}
    return replace(guess, table="points", mapping=keys, notes=(*guess.notes, note), ways=(*guess.ways, way))


def _best(patterns: Sequence[str], names: Sequence[str], rows: SurveyRows) -> _Reading | None:
    """The reading of names with the smallest change of distances within bodies; None without several poses."""
    readings = [reading for pattern in patterns if (reading := _reading(pattern, names, rows)) is not None]
    return min(readings, key=lambda reading: reading.change / reading.size, default=None)


def _reading(pattern: str, names: Sequence[str], rows: SurveyRows) -> _Reading | None:
    matches = [re.fullmatch(pattern, name, re.IGNORECASE) for name in names]
    parts = [match.groupdict() for match in matches if match is not None]
    if len(parts) < len(names):
        return None
    poses = [part["pose"] for part in parts]
    targets = [part.get("target", target) for part, target in zip(parts, rows.targets, strict=True)]
    given = [part["body"] for part in parts] if "body" in parts[0] else [""] * len(parts)
    bodies = given if any(given) else _prefixes(targets)
    keys = list(zip(poses, bodies, targets, strict=True))
    if len(set(poses)) < 2 or len(set(keys)) < len(keys):
        return None
    changes, sizes = _changes(poses, bodies, targets, rows.places, within=True)
    if len(changes) < _FEWEST:
        return None
    change, size = float(np.sqrt(np.mean(changes**2))), float(np.median(sizes))
    return _Reading(pattern, given, poses, targets, change, size) if size > 0.0 and change < _RIGID * size else None


def _prefixes(targets: Sequence[str]) -> list[str]:
    """The word before the number of each target; empty names if a target has none."""
    return _bodies_by(_PREFIX, targets)


def _bodies_by(pattern: str, targets: Sequence[str]) -> list[str]:
    """The body in the name of each target by a pattern; empty names if a target has none."""
    matches = [re.fullmatch(pattern, target) for target in targets]
    return [match["body"] if match else "" for match in matches] if all(matches) else [""] * len(targets)


def _changes(
    poses: Sequence[str],
    bodies: Sequence[str],
    targets: Sequence[str],
    places: Array,
    *,
    within: bool,
    spread: Callable[[Array], float] | None = None,
) -> tuple[Array, Array]:
    """Standard deviation over the poses of each distance between targets within (or between) bodies, and its mean."""
    held: dict[tuple[str, str], dict[str, int]] = {}
    for row, key in enumerate(zip(bodies, targets, strict=True)):
        held.setdefault(key, {})[poses[row]] = row
    changes, sizes = [], []
    for first_target, second_target in _pairs(list(held), within=within):
        common_poses = [pose for pose in held[first_target] if pose in held[second_target]]
        if len(common_poses) > 1:
            first, second = ([held[key][pose] for pose in common_poses] for key in (first_target, second_target))
            distances = np.linalg.norm(places[first] - places[second], axis=1)
            changes.append((spread or _std)(distances))
            sizes.append(float(np.mean(distances)))
    return np.array(changes), np.array(sizes)


def _pairs(keys: Sequence[tuple[str, str]], *, within: bool) -> Iterator[tuple[tuple[str, str], tuple[str, str]]]:
    wanted = [pair for pair in combinations(keys, 2) if (pair[0][0] == pair[1][0]) == within]
    step = max(1, len(wanted) // _MOST_PAIRS)
    yield from wanted[::step]


def with_bodies_of_targets(folder: Path, files: Sequence[_File]) -> list[_File]:
    """Take the words before the numbers of targets as bodies, if these move as bodies: distances within stay."""
    return [(group, _with_bodies(folder, group, guess)) for group, guess in files]


def with_bodies_of_survey(folder: Path, files: Sequence[_File]) -> list[_File]:
    """Take the words that are bodies in names of measured targets as bodies in a survey without bodies, too."""
    ways = [way for _, guess in files if guess.table == "points" for way in guess.ways if way.key == "words"]
    patterns = {
        pattern
        for _, guess in files
        if guess.table == "points" and any(way.key == "words" for way in guess.ways)
        for pattern in guess.mapping["split"].values()
        if pattern in _OF_BODIES
    }
    if len(patterns) != 1:
        return list(files)
    (pattern,) = patterns
    return [
        (group, _surveyed_bodies(guess, pattern, ways[0]) if _are_named(folder, group, guess, pattern) else guess)
        for group, guess in files
    ]


def _are_named(folder: Path, group: RawGroup, guess: Guess, pattern: str) -> bool:
    """True if the names of all targets of a survey without bodies hold a body."""
    if guess.table != "targets" or guess.known or not is_body_open(guess) or "format" in guess.mapping:
        return False
    rows = rows_of(folder, group, guess, {"body": "body"}, most=_MOST_ROWS)
    return rows is not None and all(_bodies_by(pattern, rows.targets))


def _surveyed_bodies(guess: Guess, pattern: str, way: OtherWay) -> Guess:
    raw = guess.mapping.get("columns", {}).get("target", "target")
    split = {**guess.mapping.get("split", {}), str(raw): pattern}
    mapping = {**without_placeholder(guess.mapping), "split": split}
    note = "bodies by the names of targets, as in the files of points"
    ways = (*guess.ways, replace(way, guess=guess))
    return replace(guess, mapping=mapping, notes=(*guess.notes, note), ways=ways)


def _with_bodies(folder: Path, group: RawGroup, guess: Guess) -> Guess:
    if guess.table != "points" or guess.known or not is_body_open(guess):
        return guess
    guess = _with_uncoded(folder, group, guess)
    default_column = target_column(guess.mapping["format"]) if "format" in guess.mapping else "target"
    raw = guess.mapping.get("columns", {}).get("target", default_column)
    rows = None if raw is None else rows_of_files(folder, group, guess, {"body": "body"}, most=_MOST_ROWS)
    if rows is None:
        return guess
    by_words = next(
        (proposal for pattern in _OF_BODIES if (proposal := _by_words(guess, rows, raw, pattern)) is not None), None
    )
    return by_words or _by_distances(guess, rows, raw) or guess


def _by_distances(guess: Guess, rows: SurveyRows, raw: str | int) -> Guess | None:
    """The guess with targets that keep their distances as bodies; None if all do, or none clearly."""
    groups = _rigid_groups(rows)
    if len(groups) < 2:
        return None
    bodies = _words_of_groups(groups) or [f"body{number}" for number in range(1, len(groups) + 1)]
    named = {re.escape(target): body for body, members in zip(bodies, groups, strict=True) for target in members}
    sizes = " and ".join(str(len(members)) for members in groups)
    doubt = f"{sizes} targets that keep their distances are assumed to be bodies {bodies[0]}, ..., {bodies[-1]}"
    doubt += ": name them" if bodies[0] == "body1" else ", by the words before the numbers in their names"
    columns, renames = guess.mapping.get("columns", {}), guess.mapping.get("rename", {})
    keys = {"columns": {**columns, "body": raw}, "rename": {**renames, "body": named}}
    question = f"{sizes} targets keep their distances: bodies of their own, or one body"
    way = OtherWay("groups", question, "bodies", "one", guess, doubt)
    return replace(guess, mapping={**without_placeholder(guess.mapping), **keys}, ways=(*guess.ways, way))


def _words_of_groups(groups: Sequence[Sequence[str]]) -> list[str]:
    """The word in the names of each group's targets, such as base for base_B01; empty unless each has its own."""
    for pattern in _OF_BODIES:
        words = [set(_bodies_by(pattern, own)) for own in groups]
        if all(len(word) == 1 for word in words) and len(bodies := set().union(*words) - {""}) == len(groups):
            return [word.pop() for word in words] if bodies else []
    return []


def _rigid_groups(rows: SurveyRows) -> list[list[str]]:
    """Targets in groups of three or more within which distances change at most a fifth as much as between them.

    Empty if any target is in none, or if the groups are not clear.
    """
    names = list(dict.fromkeys(rows.targets))
    poses = list(dict.fromkeys(rows.poses))
    rows_at = [(poses.index(pose), names.index(name)) for pose, name in zip(rows.poses, rows.targets, strict=True)]
    if len(poses) < 2 or not 2 * _FEWEST <= len(names) <= _MOST_TARGETS or len(set(rows_at)) < len(rows_at):
        return []
    places = np.full((len(poses), len(names), 3), np.nan)
    places[tuple(np.transpose(rows_at))] = rows.places
    distances = np.linalg.norm(places[:, :, None] - places[:, None], axis=-1)
    if (np.isfinite(distances).sum(axis=0) < 2).any():
        return []
    low, high = np.nanquantile(distances, (0.1, 0.9), axis=0)  # gross errors of single points are outside
    changes = (high - low) / _OF_SIGMA
    pairs = np.sort(changes[np.triu_indices(len(names), 1)])
    jumps = pairs[1:] / np.maximum(pairs[:-1], _ROUNDED * np.nanmedian(distances))
    if not len(jumps) or jumps.max() < _APART or pairs[jumps.argmax()] > _RIGID * np.nanmedian(distances):
        return []
    is_rigid = changes <= pairs[jumps.argmax()]
    rigid = [tuple(np.flatnonzero(row)) for row in is_rigid]
    groups = list(dict.fromkeys(rigid))
    is_partition = all(rigid[k] == members for members in groups for k in members) and all(
        len(members) >= _FEWEST for members in groups
    )
    return [[names[k] for k in members] for members in groups] if is_partition else []


def _with_uncoded(folder: Path, group: RawGroup, guess: Guess) -> Guess:
    """A guess of V-STARS' coded targets with the uncoded ones, if these keep their names and distances in all files."""
    if guess.mapping.get("format") != "vstars" or "select" not in guess.mapping or group.count < 2:
        return guess
    mapping = {key: value for key, value in guess.mapping.items() if key != "select"}
    with_note = replace(guess, mapping=mapping, notes=(*guess.notes, "uncoded targets keep their names over the files"))
    rows = rows_of_files(folder, group, with_note, {"body": "body"}, most=_MOST_ROWS)
    return with_note if rows is not None and _rigid_groups(rows) else guess


def _rigid_change(
    rows: SurveyRows, bodies: Sequence[str], spread: Callable[[Array], float]
) -> tuple[float, float] | None:
    """Rms change of distances within bodies and between them; None if bodies would not be rigid and move apart."""
    inner, sizes = _changes(rows.poses, bodies, rows.targets, rows.places, within=True, spread=spread)
    outer, _ = _changes(rows.poses, bodies, rows.targets, rows.places, within=False, spread=spread)
    if len(inner) < _FEWEST or not len(outer):
        return None
    change, between = (float(np.sqrt(np.mean(one**2))) for one in (inner, outer))
    return None if change > _RIGID * float(np.median(sizes)) or between < _APART * change else (change, between)


def _std(distances: Array) -> float:
    return float(np.std(distances, ddof=1))


def _spread(distances: Array) -> float:
    """Standard deviation of a normal distribution by the median of absolute deviations: of poses with exchanged labels
    there are few."""
    return float(_OF_MEDIAN * np.median(np.abs(distances - np.median(distances))))


def _by_words(guess: Guess, rows: SurveyRows, raw: str | int, pattern: str) -> Guess | None:
    """The guess with bodies in the names of its targets by a pattern; None if the distances do not support it."""
    split, bodies = guess.mapping.get("split", {}), _bodies_by(pattern, rows.targets)
    if len(set(bodies)) < 2:
        return None
    found = next((one for spread in (_std, _spread) if (one := _rigid_change(rows, bodies, spread)) is not None), None)
    if found is None:
        return None
    change, between = found
    named = sorted(set(bodies))
    shown = ", ".join(named[:4]) + (", ..." if len(named) > 4 else "")
    note = f"bodies {shown} by the names of targets: distances within change by {change:.2g}, between by {between:.2g}"
    doubt = f"the words {shown} before the numbers of targets are assumed to be bodies"
    mapping = {**without_placeholder(guess.mapping), "split": {**split, str(raw): pattern}}
    question = f"Words {shown} in names of targets: bodies, each with poses of its own, or parts of the names"
    way = OtherWay("words", question, "bodies", "names", guess, doubt)
    return replace(guess, mapping=mapping, notes=(*guess.notes, note), ways=(*guess.ways, way))
