"""A survey whose targets have words before the numbers of the measured ones, for `truing init`: B101 next to 101."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from truing.formats.guess import MappingKeys
from truing.pipeline.init_questions import is_body_open, without_placeholder
from truing.pipeline.init_survey import SurveyRows, rows_of

if TYPE_CHECKING:
    from truing.formats.guess import Guess
    from truing.pipeline.init_entries import RawGroup

_File = tuple["RawGroup", "Guess"]
_PARTS = r"(?P<body>[^\W\d_]+)[\s_.\-]*(?P<target>\d+)"
_OF_LEGS = {"base": r"b|base|basis|g|gestell|frame", "platform": r"p|plate?|platform|plattform|top"}


def with_prefixed_survey(folder: Path, files: Sequence[_File]) -> list[_File]:
    """Take the words before the numbers of surveyed targets as bodies, if these are the groups of measured ones."""
    surveys = [n for n, (group, guess) in enumerate(files) if guess.table == "targets" and group.count == 1]
    measured = [n for n, (_, guess) in enumerate(files) if guess.table == "points" and _groups(guess)]
    result = list(files)
    if len(surveys) != 1 or len(measured) != 1 or not is_body_open(files[surveys[0]][1]):
        return result
    (first,), (second,) = surveys, measured
    rows = rows_of(folder, *files[first], {"body": "body"})
    words = {} if rows is None else _words(rows, _groups(files[second][1]))
    if not words:
        return result
    has_legs = any("legs" in guess.machine for _, guess in files)
    names = _names_of_legs(list(words.values())) if has_legs else {}
    result[first] = files[first][0], _surveyed(files[first][1], names)
    result[second] = files[second][0], _measured(files[second][1], words, names, files[first][0].glob)
    return result


def _groups(guess: Guess) -> Mapping[str, str]:
    """Body of each target, where targets that keep their distances are taken as bodies; empty for other guesses."""
    is_grouped = any(way.key == "groups" and way.taken == "bodies" for way in guess.ways)
    found: Mapping[str, str] = guess.mapping.get("rename", {}).get("body", {}) if is_grouped else {}
    return {re.sub(r"\\(.)", r"\1", target): body for target, body in found.items()}


def _words(rows: SurveyRows, groups: Mapping[str, str]) -> dict[str, str]:
    """The survey's word for each group of measured targets; empty unless each group has one of its own."""
    parts = [match for name in rows.targets if (match := re.fullmatch(_PARTS, name))]
    word_of = {match["target"]: match["body"] for match in parts}
    if len(word_of) < len(rows.targets) or not set(groups) <= set(word_of):
        return {}
    pairs = {(body, word_of[target]) for target, body in groups.items()}
    words = dict(pairs)
    return words if len(pairs) == len(words) == len(set(words.values())) else {}


def _names_of_legs(words: Sequence[str]) -> dict[str, str]:
    """Base and platform by two words that mean them; empty for others."""
    found = {
        word: name for word in words for name, pattern in _OF_LEGS.items() if re.fullmatch(pattern, word, re.IGNORECASE)
    }
    return found if len(words) == len(found) == len(set(found.values())) else {}


def _surveyed(guess: Guess, names: Mapping[str, str]) -> Guess:
    raw = str(guess.mapping.get("columns", {}).get("target", "target"))
    columns = {key: name for key, name in guess.mapping.get("columns", {}).items() if key != "target"}
    keys: MappingKeys = {"columns": columns, "split": {**guess.mapping.get("split", {}), raw: _PARTS}}
    keys |= {"rename": {"body": dict(names)}} if names else {}
    doubt = "words before the numbers of targets are assumed to be bodies, as in the files of points"
    mapping = {**without_placeholder(guess.mapping), **keys}
    return replace(guess, mapping=mapping, doubts=(*guess.doubts, doubt), answered=guess.answered | {"body"})


def _measured(guess: Guess, words: Mapping[str, str], names: Mapping[str, str], survey: str) -> Guess:
    bodies = {target: words[body] for target, body in guess.mapping["rename"]["body"].items()}
    renames = {target: names.get(body, body) for target, body in bodies.items()}
    mapping = {**guess.mapping, "rename": {**guess.mapping["rename"], "body": renames}}
    ways = tuple(way for way in guess.ways if way.key != "groups")
    note = f"bodies by {survey}, whose groups of targets keep their distances here"
    return replace(guess, mapping=mapping, ways=ways, notes=(*guess.notes, note), answered=guess.answered | {"body"})
