"""What a page consists of: a head, sections, and in them figures with captions and tables as shown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import plotly.graph_objects as go

# Rows of a listing that a page holds, so that a thousand poses of many bodies stay below some megabytes.
MOST_ROWS = 2000

# Figures with their captions; a sentence behind the mark of colour that it stands beside.
Drawn = list[tuple[object, str]]
Verdict = tuple[str, str]


@dataclass(frozen=True)
class Listing:
    """A table as shown: heads, rows of text, and per row a class of colour (pass, warn, fail, found or changed)."""

    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    marks: tuple[str, ...] = ()
    caption: str = ""
    folded: bool = False
    held_by: str = ""  # the artifact that holds all rows, where the page cannot
    csv: str = ""  # the same for a machine, to be copied as a whole
    by_leg: bool = False  # its first cells name the leg; legs chosen in the view leave their rows

    @property
    def shown(self) -> tuple[tuple[str, ...], ...]:
        """The rows that stand on the page."""
        return self.rows[:MOST_ROWS]

    @property
    def note(self) -> str:
        """What a reader must know about rows that do not stand on the page."""
        if len(self.rows) <= MOST_ROWS:
            return ""
        where = f"; all are in {self.held_by}" if self.held_by else ""
        return f"The first {MOST_ROWS:,} of {len(self.rows):,} rows{where}."


@dataclass(frozen=True)
class ReportSection:
    """One part of the page: sentences to begin with, then figures with captions, tables, and parts of its own.

    ``said`` are further sentences, each a mark of colour and words; ``see`` the sections where more of it stands.
    """

    id: str
    title: str
    lead: str
    figures: tuple[tuple[go.Figure, str], ...] = ()
    listings: tuple[Listing, ...] = ()
    state: str = ""  # pass, fail, changed, or what is not evaluated
    statements: tuple[tuple[str, str], ...] = ()
    parts: tuple[ReportSection, ...] = ()
    see: tuple[tuple[str, str], ...] = ()  # id of a section, words


@dataclass(frozen=True)
class PageHead:
    """The top of the page: the campaign, the sentences of the verdict, and the tiles of key figures."""

    campaign: str
    verdicts: tuple[tuple[str, str], ...]  # mark (pass, warn, fail, found, none), sentence
    tiles: tuple[tuple[str, str], ...] = field(default=())  # what, how much


def all_of(sections: Sequence[ReportSection]) -> Iterator[ReportSection]:
    """Sections, each before its parts."""
    for section in sections:
        yield section
        yield from all_of(section.parts)
