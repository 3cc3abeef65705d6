"""What a file of unknown layout seems to hold."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Guess:
    """What a file seems to hold: keys for [files.<table>], its columns, the table, what to look at again, and the
    other tables that are read from it with the same keys. known: no table of it is wanted; the first note says why.
    beside: what other tables it holds, each with keys of its own."""

    mapping: dict[str, Any] = field(default_factory=dict)
    columns: tuple[str, ...] = ()
    table: str | None = None
    notes: tuple[str, ...] = ()
    others: tuple[str, ...] = ()
    known: bool = False
    beside: tuple[Guess, ...] = ()
