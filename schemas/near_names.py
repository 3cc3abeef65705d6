"""Names that differ only in spelling, and suggestions for mistyped names."""

from __future__ import annotations

import difflib
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from itertools import islice

_BETWEEN = re.compile(r"(?<!\d)[\s_.-]+|[\s_.-]+(?!\d)|\s+")  # 1-2 is not 12
_TRIED = 20  # measured names to search a hint for, because each is compared with every known name
_LEADING = re.compile(r"(?<![\d.,])0+(?=\d)")


def spelling(name: str) -> str:
    """Return a name without differences of spelling: capitals, blanks, hyphens, leading zeros."""
    return _LEADING.sub("", _BETWEEN.sub("", name.casefold()))


def similar_names(names: Iterable[object]) -> Iterator[list[str]]:
    """Yield groups of different names that differ only in spelling."""
    groups: dict[str, list[str]] = defaultdict(list)
    for name in dict.fromkeys(map(str, names)):
        groups[spelling(name)].append(name)
    yield from (group for group in groups.values() if len(group) > 1)


def nearest_name(name: str, known: Iterable[str]) -> str | None:
    """Return the known name that equals a mistyped one but for spelling, else the most similar; None if none is so."""
    every = list(known)
    if (same := _same_spelling(name, every)) is not None:
        return same
    close = difflib.get_close_matches(name, every, n=1)
    return close[0] if close else None


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return a suggestion as the end of a message; empty if no known name is near."""
    near = nearest_name(name, known)
    return "" if near is None else f"; did you mean {near}?"


_SHORTEST = 4  # letters of a name in which one wrong letter is no other word
_MISTYPED = 0.9  # similarity of a name with a letter too many, too few or exchanged


def mistyped_name(name: str, known: Iterable[str]) -> str | None:
    """Return the known name that differs from a name in its spelling or a letter or two, with the same numbers."""
    alike = [other for other in known if _numbers(other) == _numbers(name)]
    if (same := _same_spelling(name, alike)) is not None:
        return same
    slipped = (other for other in alike if len(other) >= _SHORTEST and is_one_slip_apart(name, other))
    return next(slipped, None) or next(iter(difflib.get_close_matches(name, alike, n=1, cutoff=_MISTYPED)), None)


def meant_by(names: Iterable[str], known: Iterable[str]) -> str:
    """Return a suggestion for the first of several measured names that is near a known name.

    Names with other numbers are other names, because measured points are numbered and not typed.
    """
    every = list(known)
    for name in islice(names, _TRIED):
        near = _same_spelling(name, every) or nearest_name(
            name, [other for other in every if _numbers(other) == _numbers(name)]
        )
        if near is not None:
            return f"; did you mean {near} by {name}?"
    return ""


def is_one_slip_apart(name: str, other: str) -> bool:
    """True if names differ in one letter: added, left out or another one, or two neighbours exchanged."""
    shorter, longer = sorted((name.casefold(), other.casefold()), key=len)
    at = next((i for i, (letter, two) in enumerate(zip(shorter, longer, strict=False)) if letter != two), len(shorter))
    if len(longer) - len(shorter) == 1:
        return shorter[at:] == longer[at + 1 :]
    if len(longer) != len(shorter) or at == len(shorter):
        return False
    exchanged = shorter[at : at + 2] == longer[at : at + 2][::-1]
    return shorter[at + 1 :] == longer[at + 1 :] or (exchanged and shorter[at + 2 :] == longer[at + 2 :])


def _same_spelling(name: str, known: Iterable[str]) -> str | None:
    wanted = spelling(name)
    return next((other for other in known if spelling(other) == wanted), None)


def _numbers(name: str) -> list[str]:
    return re.findall(r"[0-9]+", spelling(name))
