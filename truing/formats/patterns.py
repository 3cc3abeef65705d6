"""Regular expressions of campaign.toml with a time limit, since nested repeats may take exponential time."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache
from time import perf_counter
from typing import Any, AnyStr, Generic

SECONDS = 1.0  # of processor time, per text
_IN_ALL = 10.0  # seconds for all texts of an expression, plus
_PER_TEXT = 2e-4  # seconds per text: a hundred times the usual time
_LONGEST = 1 << 20  # characters of a text, to bound the memory of backtracking
_REPEATS = re.compile(r"[*+?{]|\\[1-9g]|\(\?P=")


class TooSlow(Exception):
    """An expression that exceeds its time limit: its key in the mapping, and the text."""

    def __init__(self, key: str, text: str) -> None:
        self.key, self.text = key, text
        self.expected = (
            f"an expression that takes less than {SECONDS:g} s for every text; "
            "one of alternatives within a repeat, such as (a|aa)+, may try every way to match"
        )
        super().__init__(f"{key}: {text[:40]}")


class BoundedPattern(Generic[AnyStr]):
    """A compiled expression with the methods of `re` that raises TooSlow beyond its time limit; ``key``: its place in
    the mapping."""

    def __init__(self, expression: AnyStr, key: str) -> None:
        self.key = key
        self._spent, self._asked = 0.0, 0
        # without repeats there is no backtracking, and `re` is faster
        self._is_plain = _REPEATS.search(_text(expression)) is None
        self._found: Any = re.compile(expression) if self._is_plain else _interruptible(expression)

    @property
    def groupindex(self) -> Mapping[str, int]:
        """Named groups with their numbers."""
        groups: Mapping[str, int] = self._found.groupindex
        return groups

    def search(self, text: AnyStr) -> re.Match[AnyStr] | None:
        """Return the first match anywhere; raises TooSlow."""
        return self._timed(self._found.search, text)

    def fullmatch(self, text: AnyStr) -> re.Match[AnyStr] | None:
        """Return the match of a whole text; raises TooSlow."""
        return self._timed(self._found.fullmatch, text)

    def _timed(self, method: Any, text: AnyStr) -> re.Match[AnyStr] | None:
        if self._is_plain:
            plain: re.Match[AnyStr] | None = method(text)
            return plain
        begin = perf_counter()
        try:
            if len(text) > _LONGEST:
                raise TimeoutError
            match: re.Match[AnyStr] | None = method(text, timeout=SECONDS, concurrent=False)
        except TimeoutError:
            raise TooSlow(self.key, _text(text)) from None
        self._spent += perf_counter() - begin
        self._asked += 1
        if self._spent > _IN_ALL + _PER_TEXT * self._asked:
            raise TooSlow(self.key, _text(text))
        return match


def _interruptible(expression: AnyStr) -> Any:
    """Return the pattern compiled by `regex`, which supports timeouts."""
    import regex

    return regex.compile(expression)


@lru_cache(maxsize=1000)
def bounded(expression: str, key: str) -> BoundedPattern[str]:
    """Return the pattern of an expression, compiled once."""
    return BoundedPattern(expression, key)


def _text(content: AnyStr) -> str:
    return content if isinstance(content, str) else content[:_LONGEST].decode("utf-8", errors="replace")
