"""The page put into one self-contained HTML file, the same bytes for the same tables."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from truing.report.page import Head, Listing, Section, all_of
from truing.report.rendering.embedded import embedded, figure_data, file_name, policy, text_of

if TYPE_CHECKING:
    import jinja2
    import plotly.graph_objects as go


@dataclass(frozen=True)
class _Figure:
    """A figure as the page holds it."""

    name: str
    caption: str
    title: str
    subtitle: str
    spoken: str  # what it shows, for those who do not see it
    height_px: int
    data: str  # JSON, safe in a script element
    step_of: str  # what is chosen by its slider: "pose"
    steps: tuple[str, ...]
    gains: tuple[str, ...]  # amplifications of a 3-D view to choose from
    gain: int  # place of the one that it begins with
    legs: tuple[int, ...]
    file: str


@dataclass(frozen=True)
class _Table:
    """A listing, what it is called, and what is handed out as CSV where that is not what its cells show."""

    listing: Listing
    called: str
    csv: str  # JSON, safe in a script element
    file: str


@dataclass(frozen=True)
class _Drawn:
    """A section with its figures and listings as the page holds them, and its parts likewise."""

    section: Section
    figures: tuple[_Figure, ...]
    tables: tuple[_Table, ...]
    parts: tuple[_Drawn, ...]


def render_page(head: Head, sections: Sequence[Section]) -> str:
    """The whole page as text; plotly's library stands in it once, so that it opens without a network."""
    any_figure = any(section.figures for section in all_of(sections))
    plotly = _plotly_script() if any_figure else ""
    scripts = [_beside(f"{name}.js") for name in ("scene", "narrow", "figures", "csv")]
    return _template().render(
        head=head,
        sections=[_drawn(section, head.campaign) for section in sections],
        style=_beside("page.css"),
        scripts=scripts,
        plotly=plotly,
        figure_template=embedded(_figure_template()) if any_figure else "",
        policy=policy([*scripts, plotly]),
    )


def _drawn(section: Section, campaign: str) -> _Drawn:
    figures = (_figure(*shown, f"{section.id}-{k}", campaign) for k, shown in enumerate(section.figures))
    parts = (_drawn(part, campaign) for part in section.parts)
    return _Drawn(section, tuple(figures), tuple(_tables(section, campaign)), tuple(parts))


def _figure(figure: go.Figure, caption: str, name: str, campaign: str) -> _Figure:
    data, steps = figure_data(figure, _figure_template())
    title, subtitle = (text_of(text) for text in (figure.layout.title.text, figure.layout.title.subtitle.text))
    step_of = text_of(figure.layout.sliders[0].currentvalue.prefix) if steps else ""
    height = int(data["layout"]["height"])
    spoken = ". ".join(words.rstrip(".") for words in (title, subtitle, caption) if words)
    file = file_name(campaign, name)
    scene = data.get("scene", {"gains": [], "gain": None, "legs": []})
    gains = tuple(f"{gain:g} times" for gain in scene["gains"])
    first = scene["gains"].index(scene["gain"]) if gains else 0
    held = embedded(data)
    return _Figure(
        *(name, caption, title, subtitle, f"{spoken}.", height, held, step_of, tuple(steps), gains, first),
        legs=tuple(scene["legs"]),
        file=file,
    )


def _tables(section: Section, campaign: str) -> Iterator[_Table]:
    for k, listing in enumerate(section.listings):
        csv = embedded(listing.csv) if listing.csv else ""
        yield _Table(listing, listing.caption or section.title, csv, file_name(campaign, f"{section.id}-table-{k}"))


@cache
def _figure_template() -> dict[str, Any]:
    """The look that all figures share, as plotly has it."""
    import plotly.graph_objects as go

    template: dict[str, Any] = go.Figure(layout={"template": "plotly_white"}).to_plotly_json()["layout"]["template"]
    return template


def _plotly_script() -> str:
    from plotly.offline import get_plotlyjs

    return get_plotlyjs()


@cache
def _beside(name: str) -> str:
    """A file of this package, as text."""
    return files("truing.report.rendering").joinpath(name).read_text(encoding="utf-8")


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
