"""Find a sentence by the names and numbers in it."""

from __future__ import annotations

import re
from collections.abc import Iterable


def says(text: str | Iterable[str], *facts: str) -> bool:
    """True where one sentence of the text holds these facts as whole words, in this order."""
    parts = [text] if isinstance(text, str) else list(text)
    pattern = re.compile(".*?".join(rf"(?<![\w.,-]){re.escape(fact)}(?![\w-])" for fact in facts), re.DOTALL)
    return any(pattern.search(sentence) for sentence in _sentences(parts))


def assert_says(text: str | Iterable[str], *facts: str) -> None:
    """One sentence of the text holds these facts as whole words, in this order."""
    assert says(text, *facts), f"no sentence holds {facts} in this order: {text}"


def _sentences(parts: Iterable[str]) -> Iterable[str]:
    for part in parts:
        yield from re.split(r"(?<=[.!?])\s+(?=[A-Z0-9])|\n", part.replace("\u00a0", " "))
