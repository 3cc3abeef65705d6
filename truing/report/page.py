"""Elements of a page: a head, and sections with figures, captions and listings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import plotly.graph_objects as go

# Rows of a listing that a page holds, so that a thousand poses of many bodies stay below some megabytes.
MOST_ROWS = 2000

# Figures with their captions; a sentence with its mark of colour.
Drawn = list[tuple[object, str]]
Verdict = tuple[str, str]


@dataclass(frozen=True)
class Listing:
    """A table of the page: heads, rows of text, and per row a class of colour (pass, warn, fail, found or changed)."""

    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    marks: tuple[str, ...] = ()
    caption: str = ""
    folded: bool = False
    held_by: str = ""  # the artifact that holds all rows, where the page shows only some
    csv: str = ""  # the same as CSV, to be copied as a whole
    by_leg: bool = False  # its first cells name the leg; choosing legs in the view selects their rows

    @property
    def shown(self) -> tuple[tuple[str, ...], ...]:
        """Rows shown on the page."""
        return self.rows[:MOST_ROWS]

    @property
    def note(self) -> str:
        """Note on the rows that are not shown."""
        if len(self.rows) <= MOST_ROWS:
            return ""
        where = f"; all are in {self.held_by}" if self.held_by else ""
        return f"The first {MOST_ROWS:,} of {len(self.rows):,} rows{where}."


@dataclass(frozen=True)
class ReportSection:
    """A section of the page: lead sentences, figures with captions, listings, and subsections.

    ``statements`` are further sentences, each with a mark of colour; ``see`` lists related sections.
    """

    id: str
    title: str
    lead: str
    figures: tuple[tuple[go.Figure, str], ...] = ()
    listings: tuple[Listing, ...] = ()
    state: str = ""  # pass, fail, changed, or not evaluated
    statements: tuple[tuple[str, str], ...] = ()
    parts: tuple[ReportSection, ...] = ()
    see: tuple[tuple[str, str], ...] = ()  # id of a section, words


@dataclass(frozen=True)
class PageHead:
    """Top of the page: campaign, sentences of the verdict, and tiles of key figures."""

    campaign: str
    verdicts: tuple[tuple[str, str], ...]  # mark (pass, warn, fail, found, none), sentence
    tiles: tuple[tuple[str, str], ...] = field(default=())  # what, how much


def all_of(sections: Sequence[ReportSection]) -> Iterator[ReportSection]:
    """Yield all sections, each before its subsections."""
    for section in sections:
        yield section
        yield from all_of(section.parts)
