"""Elements of a page: a head, and sections with figures, captions and listings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING

from truing.schemas.stage_cost import StageCost

if TYPE_CHECKING:
    import plotly.graph_objects as go

# Rows of a listing that a page holds, so that a thousand poses of many bodies stay below some megabytes.
MOST_ROWS = 2000
# Id of the first screen, as in its address: report.html#verdict.
FIRST_SCREEN = "verdict"

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
    anchor: str = ""  # rows define their first cell, to which cells under this head lead
    links: tuple[str, ...] = ()  # per row, the page to which its first cell leads; empty where there is none
    by_leg: bool = False  # its first cells name the leg; choosing legs in the view selects their rows
    total: int = 0  # number of all rows, where only those shown were made

    @property
    def shown(self) -> tuple[tuple[str, ...], ...]:
        """Rows shown on the page."""
        return self.rows[:MOST_ROWS]

    @property
    def note(self) -> str:
        """Note on the rows that are not shown."""
        total = max(self.total, len(self.rows))
        if total <= MOST_ROWS:
            return ""
        file_text = f"; all are in {self.held_by}" if self.held_by else ""
        return f"The first {MOST_ROWS:,} of {total:,} rows{file_text}."


class Depth(StrEnum):
    """Part of a section that is shown at once; the rest opens on demand."""

    WHOLE = "whole"
    ESSENTIAL = "essential"  # sentences, and the first ``front`` figures
    APPENDIX = "appendix"  # the title alone


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
    comments: tuple[str, ...] = ()  # by a person, in campaign.toml
    depth: Depth = Depth.WHOLE
    front: int = 0  # figures that an essential section shows at once


@dataclass(frozen=True)
class RawFileFacts:
    """A raw file: name in the campaign's folder, bytes, lines (None of a file that is no text), SHA-256, and when it
    was last changed."""

    name: str
    size: int
    lines: int | None
    digest: str
    changed: str = ""


@dataclass(frozen=True)
class CampaignFacts:
    """Facts of a campaign from campaign.toml and the call that no table holds; empty where unknown.

    ``measured``: first and last day of the measurement; ``made``: day of the page; ``logo``: a data URI; ``comments``:
    id of a section and text; ``declared``: keys of campaign.toml on which results rest, with their values;
    ``software``: programs and libraries with their versions; ``persons``: name and role; ``files``: raw files.
    """

    title: str = ""
    laboratory: str = ""
    customer: str = ""
    operator: str = ""  # who measured
    logo: str = ""
    item: str = ""  # what is calibrated, as [certificate] names it
    machine: str = ""
    instrument: str = ""
    measured: tuple[str, ...] = ()
    made: str = ""
    version: str = ""
    comments: tuple[tuple[str, str], ...] = ()
    declared: tuple[tuple[str, str], ...] = ()
    software: tuple[tuple[str, str], ...] = ()
    persons: tuple[tuple[str, str], ...] = ()
    files: tuple[RawFileFacts, ...] = ()
    costs: tuple[StageCost, ...] = ()  # of the stages before the page

    def comments_on(self, section: str) -> tuple[str, ...]:
        """Return the comments on a section, by its id."""
        return tuple(text for name, text in self.comments if name == section)


NO_FACTS = CampaignFacts()


@dataclass(frozen=True)
class ErrorChange:
    """The rms error that the page is about: without and with the causes, against noise, each with its unit."""

    of: str  # what the errors are of: "measured minus predicted, held-out poses"
    before: str
    after: str
    floor: str = ""
    note: str = ""  # what the uncertainty is
    between: str = "without → with the causes found"  # models before and after


@dataclass(frozen=True)
class FirstScreen:
    """First screen of the page: machine, instrument, dates and counts, its drawing, and one change of an error."""

    facts: tuple[tuple[str, str], ...] = ()  # what, value
    drawing: str = ""  # SVG
    change: ErrorChange | None = None
    links: tuple[tuple[str, str], ...] = ()  # id of a section, words


@dataclass(frozen=True)
class PageHead:
    """Top of the page: campaign, sentences of the verdict, and either its first screen or tiles of key figures."""

    campaign: str
    verdicts: tuple[tuple[str, str], ...]  # mark (pass, warn, fail, found, none), sentence
    tiles: tuple[tuple[str, str], ...] = field(default=())  # what, how much
    about: CampaignFacts = NO_FACTS
    screen: FirstScreen = FirstScreen()
    leading: int = 1  # sentences of the verdict on the first screen


def all_of(sections: Sequence[ReportSection]) -> Iterator[ReportSection]:
    """Yield all sections, each before its subsections."""
    for section in sections:
        yield section
        yield from all_of(section.parts)
