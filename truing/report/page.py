"""The page: sections put into one self-contained HTML file, the same bytes for the same tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import jinja2
    import plotly.graph_objects as go

# Rows of a listing that a page holds, so that a thousand poses of many bodies stay below some megabytes.
MOST_ROWS = 2000


@dataclass(frozen=True)
class Listing:
    """A table as shown: heads, rows of text, and per row a class of colour (pass, warn, fail or nothing)."""

    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    marks: tuple[str, ...] = ()
    caption: str = ""
    folded: bool = False
    held_by: str = ""  # the artifact that holds all rows, where the page cannot

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
class Section:
    """One part of the page: a sentence to begin with, then figures with captions, then tables."""

    id: str
    title: str
    lead: str
    figures: tuple[tuple[go.Figure, str], ...] = ()
    listings: tuple[Listing, ...] = ()
    state: str = ""


@dataclass(frozen=True)
class Head:
    """The top of the page: the campaign, the sentences of the verdict, and the tiles of key figures."""

    campaign: str
    verdicts: tuple[tuple[str, str], ...]  # mark (pass, warn, fail, found, none), sentence
    tiles: tuple[tuple[str, str], ...] = field(default=())  # what, how much


def render_page(head: Head, sections: Sequence[Section]) -> str:
    """The whole page as text; plotly's library stands in it once, so that it opens without a network."""
    drawn = [
        {
            "section": section,
            "figures": [
                _drawn(figure, f"{section.id}-{k}", caption) for k, (figure, caption) in enumerate(section.figures)
            ],
        }
        for section in sections
    ]
    script = _plotly_script() if any(section.figures for section in sections) else ""
    return _template().render(head=head, sections=drawn, plotly=script)


def _drawn(figure: go.Figure, name: str, caption: str) -> dict[str, str]:
    # Nothing of a campaign may leave the page: plotly's button that uploads a chart goes.
    config = {"displaylogo": False, "responsive": True, "showSendToCloud": False}
    html = figure.to_html(full_html=False, include_plotlyjs=False, div_id=f"figure-{name}", config=config)
    return {"html": html, "caption": caption}


def _plotly_script() -> str:
    from plotly.offline import get_plotlyjs

    return get_plotlyjs()


@cache
def _template() -> jinja2.Template:
    import jinja2

    loader = jinja2.PackageLoader("truing.report")
    environment = jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    return environment.get_template("report.html.jinja")
