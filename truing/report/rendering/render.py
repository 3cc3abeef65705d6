"""The page put into one self-contained HTML file, the same bytes for the same tables."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from truing.report.page import Head, Section, all_of

if TYPE_CHECKING:
    import jinja2
    import plotly.graph_objects as go


@dataclass(frozen=True)
class _Drawn:
    """A section with its figures as HTML, and its parts likewise."""

    section: Section
    figures: tuple[dict[str, str], ...]
    parts: tuple[_Drawn, ...]


def render_page(head: Head, sections: Sequence[Section]) -> str:
    """The whole page as text; plotly's library stands in it once, so that it opens without a network."""
    script = _plotly_script() if any(section.figures for section in all_of(sections)) else ""
    return _template().render(head=head, sections=[_drawn(section) for section in sections], plotly=script)


def _drawn(section: Section) -> _Drawn:
    figures = (_figure(drawn, f"{section.id}-{k}", caption) for k, (drawn, caption) in enumerate(section.figures))
    return _Drawn(section, tuple(figures), tuple(_drawn(part) for part in section.parts))


def _figure(figure: go.Figure, name: str, caption: str) -> dict[str, str]:
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

    loader = jinja2.PackageLoader("truing.report.rendering", "")
    environment = jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters["unbroken"] = _unbroken
    return environment.get_template("report.html.jinja")


def _unbroken(sentence: str) -> str:
    """A sentence whose numbers stay in one line with their units."""
    return re.sub(r"(?<=\d) (?=%|[µm]m\b|µrad|mrad|arcsec|ppm|± )|(?<=±) (?=\d)", "\u00a0", sentence)
