"""Guesses of `truing init` from names of raw files: globs, poses and targets in names, photographs, network tables."""

from __future__ import annotations

import fnmatch
import glob
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from truing.formats.guess import MappingKeys
from truing.formats.source import PICTURES

if TYPE_CHECKING:
    from truing.formats.guess import Guess


_TOKEN = re.compile(r"\d+|[^\W\d_]+|[\W_]+")
_WORD = re.compile(r"[^\W_]+")
_WORD_AND_NUMBER = re.compile(r"([^\W\d_]+)_?(\d+)")
_ENDING = re.compile(r"[^\W\d_]*\.\w+$")
_SCAN_WORDS = {
    "pose",
    "scan",
    "scans",
    "frame",
    "reference",
    "ref",
    "surface",
    "cloud",
    "messung",
    "stellung",
    "referenz",
}

_NUMBERED = re.compile(r"(?P<pose>.+)[-_ ]\d+")
_IN_FOLDERS = r"(?P<pose>[^/]+)/[^/]+$"
_IN_NAMES = r"^(?P<pose>.+)[-_ ]\d+\."
_BY_CONTRACT = "images"

_NEEDED = (
    "beside photographs: scale_bars.csv (bar,first,second,length_mm,sigma_mm), and image_targets.csv "
    "(family,code,body,target) where codes are not the targets' own names",
)

_Group = TypeVar("_Group")
_FEWEST_POSES = 3  # of files that are poses

_ADJUSTED = ("aicon", "colmap", "photomodeler")
_INSTEAD = "not read, because the rays in the same folder give these points with their full covariance"


Entry = tuple["RawGroup", "Guess", list[str]]  # files, their guess, and the lines of their entry


@dataclass(frozen=True)
class RawGroup:
    """Raw files with the same mapping: glob, an example, number, names, and glob without other files."""

    glob: str
    example: Path
    count: int
    names: tuple[str, ...] = ()
    path: str | list[str] = ""


def common_glob(names: Sequence[str]) -> str:
    """Glob of names: their common start and end, or token by token if they have the same structure."""
    first, *others = tokens = [_TOKEN.findall(name) for name in names]
    if similar_names(tokens):
        same = [all(name_tokens[i] == token for name_tokens in others) for i, token in enumerate(first)]
        parts = (glob.escape(token) if is_same else "*" for token, is_same in zip(first, same, strict=True))
        return re.sub(r"\*+", "*", "".join(parts))
    before, after = _common_affixes(tokens)
    return glob.escape("".join(first[:before])) + "*" + glob.escape("".join(first[len(first) - after :]))


def glob_without_others(pattern: str, names: Sequence[str], others: Sequence[str]) -> str | list[str]:
    """Glob that finds files but not ``others`` of their folder, else one by digits, else the names."""
    strange = [other for other in others if other not in names]
    folder, slash, last = pattern.rpartition("/")
    if not fnmatch.filter(strange, last):
        return pattern
    digits = list(dict.fromkeys(re.sub(r"\d", "[0-9]", glob.escape(name)) for name in names))
    patterns = (
        digits
        if not any(fnmatch.filter(strange, pattern) for pattern in digits)
        else [glob.escape(name) for name in names]
    )
    paths = [f"{folder}{slash}{pattern}" for pattern in patterns]
    return paths if len(paths) > 1 else paths[0]


def similar_names(tokens: Sequence[Sequence[str]]) -> bool:
    """True if names have the same structure: equal numbers of tokens, numbers, words and marks in order."""
    return len({tuple(_kind(token) for token in name_tokens) for name_tokens in tokens}) == 1


def _kind(token: str) -> str:
    return "number" if token.isdecimal() else "word" if token[0].isalpha() else token


def _common_affixes(tokens: Sequence[Sequence[str]]) -> tuple[int, int]:
    """Number of tokens that all names share at the start, and at the end."""
    least = min(map(len, tokens))
    before = next((i for i in range(least) if len({name_tokens[i] for name_tokens in tokens}) > 1), least)
    least -= before
    after = next((i for i in range(least) if len({name_tokens[-1 - i] for name_tokens in tokens}) > 1), least)
    return before, after


def distinguishing_pattern(names: Sequence[str], column: str) -> MappingKeys:
    """A ``from_name`` that gives each file its own value of a column: a number if possible, else all that varies."""
    tokens = [_TOKEN.findall(name) for name in names]
    if similar_names(tokens):
        varying = [i for i, column_of in enumerate(zip(*tokens, strict=True)) if len(set(column_of)) > 1]
        numbers = [i for i in varying if all(name_tokens[i].isdecimal() for name_tokens in tokens)]
        own_number = [i for i in numbers if len({int(name_tokens[i]) for name_tokens in tokens}) == len(names)]
        if own_number and numbers == varying:
            parts = [r"\d+" if i in varying else re.escape(token) for i, token in enumerate(tokens[0])]
            parts[own_number[-1]] = rf"(?P<{column}>\d+)"
            return {"from_name": "".join(parts)}
    before, after = _common_affixes(tokens)
    if before and any(len(name_tokens) == before + after for name_tokens in tokens):
        before -= 1  # a token missing in one name is no value, because the token before it is in all names
    first = tokens[0]
    head, tail = "".join(first[:before]), "".join(first[len(first) - after :])
    return {"from_name": f"{re.escape(head)}(?P<{column}>.+){re.escape(tail)}"}


def bodies_and_targets(names: Sequence[str]) -> MappingKeys:
    """The ``from_name`` of files with one target each, with the word before it as body; none if none fits."""
    expression = _one_body(names) or _several_bodies(names)
    if expression is None:
        return {}
    matches = [match.groupdict() for name in names if (match := re.search(expression, name))]
    single = len(matches) == len(names) and len({tuple(groups.items()) for groups in matches}) == len(names)
    return {"from_name": expression} if single else {}


def numbers_beside(names: Sequence[str], expression: str) -> str:
    """Words with numbers in which names differ next to the target that ``expression`` takes from them.

    Such as ``step 5, step 10`` of ``step_5deg`` and ``step_10deg``; empty without such.
    """
    if "(?P<target>" not in expression or "(?P<pose>" in expression:
        return ""
    rests = [_ENDING.sub("", name[match.end("target") :]) for name in names if (match := re.search(expression, name))]
    numbered = [_WORD_AND_NUMBER.findall(rest) for rest in rests]
    found = dict.fromkeys(pair for pairs in numbered for pair in pairs)
    return ", ".join(" ".join(pair) for pair in found if not all(pair in pairs for pairs in numbered))


def _one_body(names: Sequence[str]) -> str | None:
    """Names with the same first word, which is the body; the varying part is the target."""
    words = [_WORD.findall(Path(name).name.partition(".")[0]) for name in names]
    before, _ = _common_affixes(words)
    if not before or any(len(name_words) == before for name_words in words):
        return None
    follows = _text_after_target([name_words[before:] for name_words in words])
    remaining = [name_words[before:] for name_words in words]
    if all(
        len(name_words) == 2 and name_words[1].isdecimal() and name_words[0].isalpha() for name_words in remaining
    ):  # SMR_1 SMR_2 base_1 base_2
        return rf"{re.escape(words[0][before - 1])}_(?P<body>[^\W\d_]+)_(?P<target>\d+)"
    return rf"(?P<body>{re.escape(words[0][before - 1])})[\W_]+(?P<target>.+?){follows}"


def _several_bodies(names: Sequence[str]) -> str | None:
    """Names whose first word is the body, with several targets each."""
    words = [_WORD.findall(Path(name).name.partition(".")[0]) for name in names]
    if any(len(name_words) < 2 for name_words in words) or len({name_words[0] for name_words in words}) == len(names):
        return None
    bodies = "|".join(re.escape(body) for body in dict.fromkeys(name_words[0] for name_words in words))
    return rf"(?P<body>{bodies})[\W_]+(?P<target>.+?){_text_after_target([name_words[1:] for name_words in words])}"


def _text_after_target(words: Sequence[Sequence[str]]) -> str:
    """Text after the target: the first word in all names, or their ending."""
    common = next((word for word in words[0][1:] if all(word in name_words[1:] for name_words in words)), None)
    return r"\." if common is None else rf"_{re.escape(common)}"


def scanned_body(pattern: str) -> str:
    """Body of dense scans: the word of the file's name that does not mean scan."""
    stem = Path(pattern).stem
    words = re.findall(r"[^\W\d_]+", stem.split("*")[-1] or stem)
    return next((word for word in words if word.casefold() not in _SCAN_WORDS), "body")


def is_picture(path: Path) -> bool:
    """True if a file is a photograph by its extension."""
    return path.suffix.lower().removeprefix(".") in PICTURES


def photograph_entries(folder: Path, pictures: Sequence[Path]) -> list[tuple[str, Path, int, Guess]]:
    """One entry per folder tree and extension: glob, an example, number, and keys of [files.images]."""
    from truing.formats.guess import Guess

    groups: dict[tuple[str, str], list[Path]] = {}
    for path in pictures:
        relative = path.relative_to(folder)
        top = relative.parts[0] if len(relative.parts) > 1 else ""
        groups.setdefault((top, path.suffix), []).append(relative)
    tops = len({top for top, _ in groups})
    result = []
    for (top, suffix), paths in sorted(groups.items()):
        pattern, mapping = _read_by(top, suffix, paths, alone=tops == 1)
        guess = Guess(
            mapping={} if top == _BY_CONTRACT else mapping, table="images", notes=(*_NEEDED, *_remarks(mapping))
        )
        result.append((pattern, folder / paths[0], len(paths), guess))
    return result


def _read_by(top: str, suffix: str, paths: Sequence[Path], *, alone: bool) -> tuple[str, MappingKeys]:
    """Glob for these photographs, and the source of their pose numbers; ``alone``: no other folder has any."""
    depth = max(len(path.parts) for path in paths)
    head = f"{glob.escape(top)}/" if top else ""
    if depth > (2 if top else 1):
        return f"{head}**/*{suffix}", {"from_name": _IN_FOLDERS}
    before = [match["pose"] if (match := _NUMBERED.fullmatch(path.stem)) else "" for path in paths]
    if (
        top and not alone and len(set(before)) == 1
    ):  # cameras number continuously, so the folder and not IMG_0412 gives the pose
        return f"{head}*{suffix}", {"from_name": _IN_FOLDERS}
    if all(before):
        return f"{head}*{suffix}", {"from_name": _in_names(before)}
    return f"{head}*{suffix}", {"constants": {"pose": 1}}


def _in_names(before: Sequence[str]) -> str:
    """Pattern for the pose in names with this start: the number alone if names end in different numbers."""
    parts = [re.fullmatch(r"(.*?)(\d+)", text) for text in before]
    heads = {part[1] if part else None for part in parts}
    (head,) = heads if len(heads) == 1 else (None,)
    return _IN_NAMES if not head else rf"^{re.escape(head)}(?P<pose>\d+)[-_ ]\d+\."


def _remarks(mapping: MappingKeys) -> tuple[str, ...]:
    if "constants" in mapping:
        return ("by their names, all photographs are of one pose",)
    return ()


def network_tables(guesses: Sequence[tuple[_Group, Guess]]) -> list[tuple[_Group, Guess]]:
    """One entry for each table of a file; adjusted points are not read if their rays are available."""
    every = [
        (group, replace(guess, table=table, others=()))
        for group, guess in guesses
        for table in (guess.table, *guess.others)
    ]
    has_rays = any(guess.table == "image_points" for _, guess in every)
    return [
        (
            group,
            replace(guess, table=None, notes=(_INSTEAD,), known=True)
            if has_rays and _is_adjusted(group, guess)
            else guess,
        )
        for group, guess in every
    ]


def _is_adjusted(group: Any, guess: Guess) -> bool:
    """True if a file is a program's list of adjusted points."""
    if guess.table not in ("points", "targets"):
        return False
    return guess.mapping.get("format") in _ADJUSTED or group.example.name.lower().startswith("points3d.bin")


def shortened_entries(entries: list[Entry], most: int) -> tuple[list[Entry], list[Entry]]:
    """Entry of each table with most files, others while there is space, and the remaining ones.

    Entries of one table in one file belong together, such as poses of several bodies. So do runs whose poses have an
    offset. Next to a file for each pose, a
    single file of points that names no pose is none of theirs.
    """
    firsts = {
        entry[1].table: number
        for number, entry in sorted(enumerate(entries), key=lambda numbered: (numbered[1][0].count, -numbered[0]))
    }
    poses = {entry[1].table for entry in entries if entry[0].count >= _FEWEST_POSES and _names_poses(entry[1])}
    order = sorted(range(len(entries)), key=lambda number: (number not in firsts.values(), number))
    order = [
        n for n in order if n in firsts.values() or entries[n][1].table not in poses or _names_poses(entries[n][1])
    ]
    shown: set[int] = set()
    needed = {(entries[number][0].glob, table) for table, number in firsts.items()}
    needed |= {(group.glob, guess.table) for group, guess, _ in entries if "pose" in guess.mapping.get("offset", {})}
    for number in order:
        most -= len(entries[number][2])
        if most >= 0 or (entries[number][0].glob, entries[number][1].table) in needed:
            shown.add(number)
    return [e for n, e in enumerate(entries) if n in shown], [e for n, e in enumerate(entries) if n not in shown]


def _names_poses(guess: Guess) -> bool:
    """True if names of files or columns give the poses of points."""
    keys = guess.mapping
    named = {*guess.columns, *keys.get("columns", {})}
    patterns = (keys.get("from_name", ""), *keys.get("split", {}).values())
    return guess.table == "points" and ("pose" in named or any("(?P<pose>" in pattern for pattern in patterns))
