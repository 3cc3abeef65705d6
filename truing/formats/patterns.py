"""Regular expressions of campaign.toml, which may not take for ever: a repeat within a repeat can try every way out."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache
from time import perf_counter
from typing import Any, AnyStr, Generic

SECONDS = 1.0  # of processor time, that one text may take
_IN_ALL = 10.0  # seconds that an expression may take for all texts, besides
_PER_TEXT = 2e-4  # seconds for each: a hundred times what usual ones take
_LONGEST = 1 << 20  # characters of a text; what is tried out is kept in memory
_REPEATS = re.compile(r"[*+?{]|\\[1-9g]|\(\?P=")


class TooSlow(Exception):
    """An expression that cannot be decided in reasonable time: its key in the mapping, and the text."""

    def __init__(self, key: str, text: str) -> None:
        self.key, self.text = key, text
        self.expected = (
            f"an expression that takes less than {SECONDS:g} s for every text; "
            "one of alternatives within a repeat, such as (a|aa)+, may try every way to match"
        )
        super().__init__(f"{key}: {text[:40]}")


class BoundedPattern(Generic[AnyStr]):
    """A compiled expression, as `re` would match it, that raises TooSlow where it takes too long; ``key`` is its place
    in the mapping."""

    def __init__(self, expression: AnyStr, key: str) -> None:
        self.key = key
        self._spent, self._asked = 0.0, 0
        # Without repeats it is decided at once in any case, by `re` some times faster.
        self._is_plain = _REPEATS.search(_text(expression)) is None
        self._found: Any = re.compile(expression) if self._is_plain else _interruptible(expression)

    @property
    def groupindex(self) -> Mapping[str, int]:
        """The named groups, and their numbers."""
        found: Mapping[str, int] = self._found.groupindex
        return found

    def search(self, text: AnyStr) -> re.Match[AnyStr] | None:
        """The first match anywhere; raises TooSlow."""
        return self._asked_for(self._found.search, text)

    def fullmatch(self, text: AnyStr) -> re.Match[AnyStr] | None:
        """The match of a whole text; raises TooSlow."""
        return self._asked_for(self._found.fullmatch, text)

    def _asked_for(self, method: Any, text: AnyStr) -> re.Match[AnyStr] | None:
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
    """The pattern as `regex` compiles it, which can be told to give up."""
    import regex

    return regex.compile(expression)


@lru_cache(maxsize=1000)
def bounded(expression: str, key: str) -> BoundedPattern[str]:
    """The pattern of an expression, compiled once."""
    return BoundedPattern(expression, key)


def _text(content: AnyStr) -> str:
    return content if isinstance(content, str) else content[:_LONGEST].decode("utf-8", errors="replace")
